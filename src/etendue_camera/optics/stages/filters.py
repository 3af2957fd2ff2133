"""The birefringent low-pass filter in front of the sensor.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1.
Out: ``irradiance``, every point of it split into four, or two.
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
    """An optical low-pass filter: light split into four equal spots, or two where one separation is 0."""

    role: ClassVar = "low-pass filter"
    gain: ClassVar = (
        41.0  # shifts by parts of a sample on a grid that cuts the light's spectrum off, 10000 x 10000; else 1
    )
    error: ClassVar = measured(1e-6, 5e-15)  # of the transform pair, as for every transfer function

    separation_y: float = param(
        0.0, units="um", at_least=0, held=(0, 1e4), doc="distance of the spots along the filter's y; 0: not split"
    )
    separation_x: float = param(
        0.0, units="um", at_least=0, held=(0, 1e4), doc="distance of the spots along the filter's x; 0: not split"
    )
    rotation: float = param(
        0.0, units="deg", at_least=-180, at_most=180, doc="of the filter against the sensor, from x towards y"
    )
    dispersion: str = param(
        "",
        table=True,
        doc="CSV wavelength_nm,scale: separations by wavelength, relative to those given; '': the same at every "
        "wavelength",
    )

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        if not self.dispersion:
            return np.ones(1), np.ones(1)
        edges = tuple(coordinates["wavelength_edges"])
        scale = spectra.table_from_csv(self.dispersion, edges)[1][:, 0]
        if not np.all(scale > 0):
            raise ValueError(f"{self.dispersion} must give a scale above 0 from {edges[0]:g} to {edges[-1]:g} nm")
        return coordinates["wavelength"], scale

    def transfer(
        self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, prepared: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        scale = np.interp(wavelength * 1e3, *prepared) if self.dispersion else 1.0
        rotation = math.radians(self.rotation)
        return filters.four_spot_otf(fy, fx, self.separation_y * scale, self.separation_x * scale, rotation)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.separation_y == 0 == self.separation_x:
            return 0.0, "nothing is split"
        return (0.0, "the scene is uniform: splitting changes nothing") if facts.uniform else None

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if self.dispersion:
            spectra.require_rows(self.dispersion, grids["irradiance"].bands().edges)
        return []
