"""The lens as a light gatherer: scene radiance to irradiance on the image plane, fall-off, filters.

In:  ``radiance`` of the scene on the image-plane grid.
Out: ``irradiance`` (wavelength, y, x), W m-2 nm-1, in front of the sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from etendue import spectra
from etendue.api import Facts, Grid, Stage, hookimpl, param, quantity
from etendue.physics import radiometry


@dataclass(frozen=True, kw_only=True)
class Irradiance(Stage):
    """Light gathered by the aperture: E = pi L T / (4 N_w^2) (aplanatic), or the flat disc of eq. 5."""

    reads: ClassVar = {"radiance": "wavelength y x [W m-2 sr-1 nm-1]", "white_radiance": "wavelength [W m-2 sr-1 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 1.0

    f_number: float = quantity("f_number")
    magnification: float = quantity("magnification")
    transmittance: float = quantity("transmittance")
    aperture_model: str = quantity("aperture_model")

    def factor(self) -> float:
        model = radiometry.aplanatic_factor if self.aperture_model == "aplanatic" else radiometry.flat_disc_factor
        return float(model(self.f_number, self.magnification)) * self.transmittance

    def run(self, radiance: Any, white_radiance: Any) -> dict[str, Any]:
        factor = self.factor()
        return {"irradiance": radiance * radiance.dtype.type(factor), "white_irradiance": white_radiance * factor}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["radiance"].scaled(self.factor())

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 4e-16), "proved"

    def warn(self, facts: Facts, grids: Any) -> list[str]:
        return ["below f/1.2 scalar diffraction and the thin-lens aperture are approximate"] if self.f_number < 1.2 else []


@dataclass(frozen=True, kw_only=True)
class Falloff(Stage):
    """Less light off the axis: cos4, or the exact Lambertian disc."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 2.0

    f_number: float = quantity("f_number")
    focal_length: float = quantity("focal_length")
    magnification: float = quantity("magnification")
    model: str = param("cos4", choices=("cos4", "disc"), doc="cos4 of the field angle, or the exact disc of its f-number")
    geometry: str = param(
        "physical", choices=("physical", "paper"), doc="angles from positions, or the paper's full field stretched over the frame"
    )
    full_field: float = param(60.0, units="deg", above=0, below=170, doc="field over the diagonal of the frame (geometry 'paper')")

    def tangent(self, radius_um: Any, corner_um: float) -> Any:
        if self.geometry == "paper":
            return radius_um * (math.tan(math.radians(0.5 * self.full_field)) / corner_um if corner_um > 0 else 0.0)
        return radius_um / (1e3 * self.focal_length * (1 - self.magnification))

    def relative(self, tangent: Any) -> Any:
        if self.model == "disc":
            return radiometry.disc_falloff(self.f_number, tangent, self.magnification)
        return radiometry.cos4(tangent)

    def lowest(self, grid: Grid) -> float:
        corner = _corner(grid)
        return float(self.relative(np.array(self.tangent(corner, corner))))

    def run(self, irradiance: Any, y_um: Any, x_um: Any) -> dict[str, Any]:
        radius = np.hypot(y_um[:, None], x_um[None, :])
        corner = math.hypot(max(abs(y_um[0]), abs(y_um[-1])), max(abs(x_um[0]), abs(x_um[-1])))
        return {"irradiance": irradiance * self.relative(self.tangent(radius, corner)).astype(irradiance.dtype)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str]:
        return 1.0 - self.lowest(grid), "the field is so small that fall-off stays below this at the corner"

    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["irradiance"].scaled(self.lowest(grid["irradiance"]), 1.0)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-7 if precision == "float32" else 4e-15), "measured"


def _corner(grid: Grid) -> float:
    far = []
    for dim in ("y", "x"):
        line = grid.line(dim)
        start, step = line.um()
        far.append(max(abs(start), abs(start + step * (line.size - 1))))
    return math.hypot(*far)


@dataclass(frozen=True, kw_only=True)
class OpticalFilter(Stage):
    """A filter in the light path: an infrared cut, or any transmission table."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0

    table: str = param("", table=True, doc="CSV with columns wavelength_nm, transmission; '' for the smooth cut below")
    cut_off: float = param(650.0, units="nm", above=0, infinite=True, doc="half transmission of the cut; inf for none")
    edge: float = param(15.0, units="nm", above=0, doc="width of the cut from 73 to 27 per cent")

    def prepare(self, coordinates: Any) -> Any:
        if self.table:
            return spectra.table_from_csv(self.table, tuple(coordinates["wavelength_edges"]))[1][:, 0]
        if math.isinf(self.cut_off):
            return np.ones(coordinates["wavelength"].size)
        return 1.0 / (1.0 + np.exp(2 * (coordinates["wavelength"] - self.cut_off) / self.edge))

    def run(self, irradiance: Any, white_irradiance: Any, prepared: Any) -> dict[str, Any]:
        return {
            "irradiance": irradiance * prepared[:, None, None].astype(irradiance.dtype),
            "white_irradiance": white_irradiance * prepared,
        }

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "it lets everything through") if not self.table and math.isinf(self.cut_off) else None

    def carry(self, facts: Any, grid: Any) -> Facts:
        return replace(facts["irradiance"], low=None, high=None)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 4e-16), "proved"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"irradiance": Irradiance, "falloff": Falloff, "optical_filter": OpticalFilter}
