"""Pixel metrics, and a probe of the light after every stage.

In:  camera quantities; the irradiance of all stages.
Out: scalars, each over the axes that affect it; ``mean_irradiance`` with a dimension ``stage``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Probe, Stage, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.amplifier import full_well
from etendue_camera.light import radiometry


@dataclass(frozen=True, kw_only=True)
class PixelNumbers(Stage):
    """Compute the Nyquist frequency, plate scale (eq. 10) and full well of the pixel."""

    role: ClassVar = "figures"
    writes: ClassVar = {"nyquist_frequency": "[cycles/um]", "plate_scale": "[arcsec/pixel]", "full_well": "[electron]"}
    error: ClassVar = proved(1e-7, 1e-15)

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    focal_length: float = quantity("focal_length")
    full_well_density: float = quantity("full_well_density")

    def run(self) -> dict[str, float | Array]:
        return {
            "nyquist_frequency": np.array(0.5 / self.pixel_pitch),
            "plate_scale": radiometry.plate_scale(self.pixel_pitch, self.focal_length),
            "full_well": np.array(full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)),
        }


@dataclass(frozen=True, kw_only=True)
class LightBudget(Probe):
    """Compute the mean irradiance after every stage that writes it: blur preserves it, falloff and filters do not."""

    role: ClassVar = "figures"
    reads: ClassVar = {"planes": "*.irradiance [W m-2 nm-1]"}
    writes: ClassVar = {"mean_irradiance": "stage [W m-2 nm-1]"}
    nanoseconds: ClassVar = 5.0
    error: ClassVar = proved(1e-7, 1e-15)

    def run(self, planes: list[tuple[str, FloatArray]]) -> dict[str, Array]:
        return {"mean_irradiance": np.array([plane.mean(dtype=np.float64) for _, plane in planes])}
