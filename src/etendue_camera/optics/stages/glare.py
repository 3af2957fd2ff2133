"""Veiling glare: light that the lens scatters over the image.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1.
Out: ``irradiance`` of the same light, partly scattered.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Facts, Grid, Transfer, param
from etendue_camera.arrays import FloatArray
from etendue_camera.optics import glare
from etendue_camera.optics.stages.lens import Blur


@dataclass(frozen=True, kw_only=True)
class Glare(Blur, Transfer):
    """Scatter light into a tail around every point and a uniform veil over the (padded) frame. No light is lost."""

    role: ClassVar = "glare"
    gain: ClassVar = 1.3  # at most 1.23, where the grid truncates the transfer function of a narrow tail

    fraction: float = param(0.0, at_least=0, at_most=1, doc="fraction of the light in the tail; 0: no tail")
    radius: float = param(50.0, units="um", above=0, doc="width r0 of the tail (1 + (r/r0)^2)^(-power/2)")
    power: float = param(3.0, above=2, at_most=10, doc="exponent of the decay of the tail")
    veil: float = param(
        0.0, at_least=0, at_most=1, doc="fraction of the light spread uniformly over the frame; 0: no veil"
    )

    def __post_init__(self) -> None:
        if self.fraction + self.veil > 1:
            raise ValueError(
                f"fraction {self.fraction:g} and veil {self.veil:g} sum to more than 1; their sum must be at most 1"
            )

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray) -> FloatArray:
        return glare.glare_otf(np.hypot(fy, fx), self.fraction, self.veil, self.radius, self.power)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str]:
        if self.fraction == 0 and self.veil == 0:
            return 0.0, "no light is scattered"
        if facts.uniform:
            return 0.0, "the scene is uniform: scatter has no effect"
        return (1 + self.gain) * (self.fraction + self.veil), "at most this fraction of the light is scattered"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        grid = grids["irradiance"]
        line = min((grid.line(dim) for dim in ("y", "x")), key=lambda one: one.size * one.step)
        outside = self.fraction * float(1 - glare.tail_within(0.5 * line.size * line.step, self.radius, self.power))
        if facts.uniform or outside < 0.01:
            return []
        return [
            f"{100 * outside:.2g} % of the light would be scattered beyond half the frame and return from "
            f"the mirror image that "
            "continues the scene: give the scene a larger margin, or assign that fraction to veil"
        ]
