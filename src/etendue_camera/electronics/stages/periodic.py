"""Periodic offset patterns, fixed to the pixels of a sensor.

In:  ``charge`` (y, x) or (frame, y, x), electron.
Out: the same with the patterns.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Stage, param, proved
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import periodic


@dataclass(frozen=True, kw_only=True)
class PeriodicPattern(Stage):
    """Add waves to the offsets of pixels: interference locked to the pixel clock, the same in every frame."""

    role: ClassVar = "periodic pattern"
    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    handed: ClassVar = True  # a wave begins at the first pixel
    gain: ClassVar = None  # the pattern does not count towards the full scale of the light
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 2.0
    working: ClassVar = 2.0
    error: ClassVar = proved(3e-7, 1e-12)

    amplitudes: tuple[float, ...] = param((), units="electron", at_least=0, doc="amplitude of each wave")
    frequencies_y: tuple[float, ...] = param(
        (), at_least=-0.5, at_most=0.5, doc="frequency of each wave along y, cycles/pixel"
    )
    frequencies_x: tuple[float, ...] = param(
        (), at_least=-0.5, at_most=0.5, doc="frequency of each wave along x, cycles/pixel"
    )
    phases: tuple[float, ...] = param((), at_least=-1, at_most=1, doc="phase of each wave at the first pixel, cycles")

    def __post_init__(self) -> None:
        periodic.offsets([], [], self.amplitudes, self.frequencies_y, self.frequencies_x, self.phases)

    def prepare(self, coordinates: Mapping[str, Array]) -> Array:
        rows, columns = coordinates["y"], coordinates["x"]
        return periodic.offsets(rows, columns, self.amplitudes, self.frequencies_y, self.frequencies_x, self.phases)

    def run(self, charge: FloatArray, prepared: Array) -> dict[str, Array]:
        return {"charge": charge + np.asarray(prepared, dtype=charge.dtype)}
