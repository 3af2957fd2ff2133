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
from etendue.physics import filters, radiometry
from etendue.stages.conjugates import Conjugates
from etendue.stages.field_tables import FieldTable, field_table
from etendue.stages.illumination import by_curves, farthest, nearest


@dataclass(frozen=True, kw_only=True)
class Irradiance(Conjugates):
    """Light gathered by the aperture: E = pi L T / (4 N_w^2) (aplanatic), the flat disc of eq. 5, or pi L / (4 T_w^2) of a T-number."""

    reads: ClassVar = {"radiance": "wavelength y x [W m-2 sr-1 nm-1]", "white_radiance": "wavelength [W m-2 sr-1 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    pointwise: ClassVar = True
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 1.0

    t_number: float = quantity("t_number")
    transmittance: float = quantity("transmittance")
    aperture_model: str = quantity("aperture_model")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.t_number == 0:
            self.factor()  # a cone that no lens has is refused before anything runs
            return
        if self.transmittance != 1:
            raise ValueError(
                f"t_number is {self.t_number:g} and transmittance {self.transmittance:g}, but a T-number holds the lens's losses already; "
                "leave transmittance at 1, or t_number at 0"
            )
        if self.t_number < self.f_number * (1 - 1e-9):
            raise ValueError(
                f"t_number is {self.t_number:g}, below the f_number {self.f_number:g}: the lens would give more light than it takes in; "
                "give the f_number that goes with it"
            )

    def factor(self) -> float:
        magnification = self.image_magnification()
        if self.t_number > 0:
            return float(radiometry.t_number_factor(self.t_number, magnification, self.pupil_magnification))
        model = radiometry.aplanatic_factor if self.aperture_model == "aplanatic" else radiometry.flat_disc_factor
        return float(model(self.f_number, magnification, self.pupil_magnification)) * self.transmittance

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared

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
class Falloff(Conjugates):
    """Less light off the axis: cos4, the exact Lambertian disc, or a table of relative illumination."""

    purpose: ClassVar = "falloff"
    once: ClassVar = ("fall-off",)
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    pointwise: ClassVar = True
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 2.0

    model: str = param(
        "cos4", choices=("cos4", "disc", "table"), doc="cos4 of the image-side angle, the exact disc of its f-number, or a table"
    )
    table: str = param(
        "",
        table=True,
        doc="CSV height_mm,ratio or angle_deg,ratio, or columns by wavelength (height_mm,450,550,650)",
    )
    geometry: str = param(
        "physical", choices=("physical", "paper"), doc="angles from positions, or the paper's full field stretched over the frame"
    )
    full_field: float = param(60.0, units="deg", above=0, below=170, doc="field over the diagonal of the frame (geometry 'paper')")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.model == "table") != bool(self.table):
            raise ValueError(f"model is {self.model!r} and table is {self.table!r}; a table goes with model = 'table', and only with it")

    def rows(self) -> FieldTable:
        return field_table(self.table, ("height_mm", "angle_deg"))

    def tangent(self, radius_um: Any, corner_um: float) -> Any:
        """Of the angle at which the light of the exit pupil's centre arrives."""
        if self.geometry == "paper":
            return radius_um * (math.tan(math.radians(0.5 * self.full_field)) / corner_um if corner_um > 0 else 0.0)
        return radius_um / (1e3 * self.pupil_distance())

    def relative(self, tangent: Any) -> Any:
        if self.model == "disc":
            return radiometry.disc_falloff(self.f_number, tangent, self.image_magnification(), self.pupil_magnification)
        return radiometry.cos4(tangent)

    def place(self, radius_um: Any, corner_um: float) -> Any:
        """Where in the table a radius is: image height in mm, or field angle on the object's side in degrees."""
        if self.rows().axis == "height_mm":
            return np.asarray(radius_um) * 1e-3
        sideways = self.pupil_magnification if self.geometry == "physical" else 1.0
        return np.degrees(np.arctan(sideways * np.asarray(self.tangent(radius_um, corner_um))))

    def bounds(self, grid: Grid) -> tuple[float, float]:
        """Smallest and largest relative illumination over the frame."""
        corner = farthest(grid)
        if self.model == "table":
            return self.rows().range(float(self.place(nearest(grid), corner)), float(self.place(corner, corner)))
        return float(self.relative(np.array(self.tangent(corner, corner)))), 1.0

    def assumes(self) -> dict[str, Any]:
        if self.model == "table":
            return {"the fall-off": ("that of", self.table)}
        return {"the fall-off": (self.model, self.geometry, *((self.full_field,) if self.geometry == "paper" else ()))}

    def prepare(self, coordinates: Any) -> Any:
        return self.rows().curves(coordinates["wavelength"]) if self.model == "table" else np.ones((1, 1))

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared if len(prepared) == 1 else prepared[bands]

    def run(self, irradiance: Any, y_um: Any, x_um: Any, prepared: Any) -> dict[str, Any]:
        radius = np.hypot(y_um[:, None], x_um[None, :])
        corner = math.hypot(max(abs(y_um[0]), abs(y_um[-1])), max(abs(x_um[0]), abs(x_um[-1])))
        if self.model == "table":
            return {"irradiance": by_curves(irradiance, self.place(radius, corner), self.rows().nodes, prepared)}
        return {"irradiance": irradiance * self.relative(self.tangent(radius, corner)).astype(irradiance.dtype)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str]:
        low, high = self.bounds(grid)
        return max(1.0 - low, high - 1.0), "the field is so small that fall-off stays below this at the corner"

    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["irradiance"].scaled(*self.bounds(grid["irradiance"]))

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-7 if precision == "float32" else 4e-15), "measured"

    def warn(self, facts: Facts, grids: Any) -> list[str]:
        if self.model != "table":
            return []
        corner, bands = farthest(grids["irradiance"]), grids["irradiance"].bands().values()
        return self.rows().remarks(float(self.place(corner, corner)), "mm" if self.rows().axis == "height_mm" else "degrees", bands)


@dataclass(frozen=True, kw_only=True)
class OpticalFilter(Stage):
    """A filter in the light path: a smooth short-pass, or any transmission table; several filters are several stages."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    pointwise: ClassVar = True
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0

    table: str = param(
        "", table=True, doc="CSV with columns wavelength_nm, transmission, 0 half a step beyond its rows; '' for the smooth cut below"
    )
    cut_off: float = param(650.0, units="nm", above=0, infinite=True, doc="half transmission of the smooth short-pass; inf for none")
    edge: float = param(15.0, units="nm", above=0, doc="width of the cut from 73 to 27 per cent")

    def prepare(self, coordinates: Any) -> Any:
        if self.table:
            transmission = spectra.table_from_csv(self.table, tuple(coordinates["wavelength_edges"]))[1][:, 0]
            if transmission.min() < 0 or transmission.max() > 1 + 1e-9:
                raise ValueError(
                    f"{self.table}: transmission {transmission.min():g} to {transmission.max():g}; allowed is 0 to 1; is it in per cent?"
                )
            return transmission
        return filters.smooth_cut(coordinates["wavelength"], self.cut_off, self.edge)

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared[bands]

    def run(self, irradiance: Any, white_irradiance: Any, prepared: Any) -> dict[str, Any]:
        return {
            "irradiance": irradiance * prepared[:, None, None].astype(irradiance.dtype),
            "white_irradiance": white_irradiance * prepared,
        }

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "it lets everything through") if not self.table and math.isinf(self.cut_off) else None

    def warn(self, facts: Facts, grids: Any) -> list[str]:
        if not self.table:
            return []
        names, rows, values = spectra.csv_rows(self.table)
        edges = grids["irradiance"].bands().edges
        return spectra.cut_off_note(self.table, names[:1], rows, values[:, :1], edges[0], edges[-1])

    def carry(self, facts: Any, grid: Any) -> Facts:
        return replace(facts["irradiance"], low=None, high=None)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 4e-16), "proved"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"irradiance": Irradiance, "falloff": Falloff, "optical_filter": OpticalFilter}
