"""Exposure in the paper's own order: after demosaicing, as fractions of the full well.

In:  ``photocurrent`` (y, x), electron/s; ``rgb_camera`` (channel, y, x), 1 at the full well.
Out: ``mosaic_linear`` and ``rgb_camera``, 1 at the full well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Haloed, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import amplifier, dynamic_range
from etendue_camera.electronics.stages.gain_chain import Well


@dataclass(frozen=True, kw_only=True)
class ChargeFraction(Well, Haloed):
    """Convert photocurrent to the fraction of the full well that it fills in a reference time: the paper's noise-free
    mosaic.
    """

    role: ClassVar = "linearisation"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = 1.0
    negative: ClassVar = "clip"
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.0
    error: ClassVar = proved(1.3e-7, 3e-16)  # the factor and the product are rounded

    reference_time: float = param(0.01, units="s", above=0)

    def run(self, photocurrent: FloatArray) -> dict[str, Array]:
        return {
            "mosaic_linear": photocurrent * photocurrent.dtype.type(self.reference_time / self.well()),
            "clipping_level": np.array(1.0),  # where paper_exposure clips
        }


@dataclass(frozen=True, kw_only=True)
class PaperExposure(Haloed):
    """Apply integration time and dynamic range after demosaicing, as the paper does (its Fig. 9c).

    Values are scaled by the time, clipped at the full well, and set to 0 below the smallest detectable charge (eq. 13,
    with the square of q where the paper prints q).
    """

    role: ClassVar = "exposure"
    decides: ClassVar = True  # charge below the smallest detectable is 0
    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    gain: ClassVar = None  # the output jumps at the smallest detectable charge, and is clipped
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0
    working: ClassVar = 2.2
    error: ClassVar = proved(1e-7, 3e-16)

    integration_time: float = quantity("integration_time")
    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")
    dark_current_density: float = quantity("dark_current_density")
    temperature: float = quantity("temperature")
    dark_reference_temperature: float = quantity("dark_reference_temperature")
    dark_doubling: float = quantity("dark_doubling")
    read_noise: float = quantity("read_noise")
    dsnu: float = quantity("dsnu")
    reference_time: float = param(0.01, units="s", above=0)

    def run(self, rgb_camera: FloatArray) -> dict[str, Array]:
        kind = rgb_camera.dtype.type
        capacity = amplifier.full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)
        warm = amplifier.dark_current_factor(self.temperature, self.dark_reference_temperature, self.dark_doubling)
        dark = float(
            dynamic_range.dark_electrons(self.dark_current_density * warm, self.pixel_pitch**2, self.integration_time)
        )
        smallest = kind(math.sqrt(dark + self.read_noise**2 + self.dsnu**2) / capacity)
        scaled = rgb_camera * kind(self.integration_time / self.reference_time)
        return {"rgb_camera": np.where(scaled < smallest, kind(0), np.minimum(scaled, kind(1)))}
