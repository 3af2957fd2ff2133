"""The birefringent optical low-pass filter before the sensor.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1.
Out: ``irradiance``, with every point split into four or two.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Facts, Grid, Transfer, measured, param
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.optics import filters
from etendue_camera.optics.stages.lens import Blur


@dataclass(frozen=True, kw_only=True)
class Birefringent(Blur, Transfer):
    """Apply an optical low-pass filter: split light into four equal spots, or into two if one separation is 0."""

    role: ClassVar = "low-pass filter"
    gain: ClassVar = 41.0  # subsample shifts on a grid that truncates the spectrum of the light, 10000 x 10000; else 1
    error: ClassVar = measured(1e-6, 5e-15)  # error of the transform pair, as for every transfer function

    separation_y: float = param(
        0.0, units="um", at_least=0, held=(0, 1e4), doc="spot separation along the filter's y; 0: no split"
    )
    separation_x: float = param(
        0.0, units="um", at_least=0, held=(0, 1e4), doc="spot separation along the filter's x; 0: no split"
    )
    rotation: float = param(
        0.0,
        units="deg",
        at_least=-180,
        at_most=180,
        doc="rotation of the filter relative to the sensor, from x towards y",
    )
    dispersion: str = param(
        "",
        table=True,
        doc="CSV file wavelength_nm,scale: factor on both separations by wavelength; '': separations are the "
        "same at every wavelength",
    )

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        if not self.dispersion:
            return np.ones(1), np.ones(1)
        edges = tuple(coordinates["wavelength_edges"])
        scale = spectra.table_from_csv(self.dispersion, edges)[1][:, 0]
        if not np.all(scale > 0):
            raise ValueError(
                f"{self.dispersion}: the scale must be greater than 0 from {edges[0]:g} to {edges[-1]:g} nm"
            )
        return coordinates["wavelength"], scale

    def transfer(
        self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, prepared: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        scale = np.interp(wavelength * 1e3, *prepared) if self.dispersion else 1.0
        rotation = math.radians(self.rotation)
        return filters.four_spot_otf(fy, fx, self.separation_y * scale, self.separation_x * scale, rotation)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.separation_y == 0 == self.separation_x:
            return 0.0, "both separations are 0"
        return (0.0, "the scene is uniform: splitting has no effect") if facts.uniform else None

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if self.dispersion:
            spectra.require_rows(self.dispersion, grids["irradiance"].bands().edges)
        return []
