"""Falloff: relative illumination off axis.

In:  ``irradiance`` on the image plane.
Out: ``irradiance``, multiplied by the factor for its angle, or from a table.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Banded, Bounded, Facts, Grid, measured, param
from etendue_camera.arrays import Array, FloatArray, Floats
from etendue_camera.field.stages.illumination import Dimming, by_curves, farthest, nearest
from etendue_camera.field.stages.profile import Profiled, measured_falloff
from etendue_camera.field.stages.tables import FieldTable, field_table
from etendue_camera.light import radiometry


@dataclass(frozen=True, kw_only=True)
class Falloff(Dimming, Profiled, Banded, Bounded):
    """Apply relative illumination: the cos4 law, the exact Lambertian disc, or a table."""

    role: ClassVar = "falloff"
    once: ClassVar = ("fall-off",)
    keeps: ClassVar = ("order",)
    nanoseconds: ClassVar = 2.0
    working: ClassVar = 0.5
    error: ClassVar = measured(2e-7, 4e-15)

    model: str = param(
        "cos4",
        choices=("cos4", "disc", "table"),
        doc="cos4 of the image-side angle, the exact disc for the f-number, or a table",
    )
    table: str = param(
        "",
        table=True,
        doc="CSV file with columns height_mm,ratio or angle_deg,ratio, or with columns by wavelength "
        "(height_mm,450,550,650)",
    )
    geometry: str = param(
        "physical",
        choices=("physical", "paper"),
        doc="physical: angles from positions; paper: the paper's full field scaled to the frame",
    )
    full_field: float = param(
        60.0, units="deg", above=0, below=170, doc="field of view over the frame diagonal (geometry 'paper')"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_lens()
        if (self.model == "table") != bool(self.table):
            raise ValueError(
                f"model is {self.model!r} and table is {self.table!r}; give a table with model = 'table', and only "
                f"with it"
            )

    def tabled(self) -> bool:
        """Return whether a table applies: the stage's own, or measured values of the lens in place of the cos4 law."""
        return self.model == "table" or (
            self.model == "cos4" and self.geometry == "physical" and self.of_lens() is not None
        )

    def of_lens(self) -> FieldTable | None:
        """Return the measured fall-off of the lens at these settings; None if there is none."""
        return measured_falloff(self, self.focal_length, self.f_number, self.in_focus())

    def rows(self) -> FieldTable:
        if self.model != "table" and (found := self.of_lens()) is not None:
            return found
        return field_table(self.table, ("height_mm", "angle_deg"))

    def tangent(self, radius_um: Floats, corner_um: float) -> Floats:
        """Return the tangent of the angle at which light from the centre of the exit pupil arrives."""
        if self.geometry == "paper":
            return radius_um * (math.tan(math.radians(0.5 * self.full_field)) / corner_um if corner_um > 0 else 0.0)
        return radius_um / (1e3 * self.pupil_distance())

    def relative(self, tangent: FloatArray) -> Floats:
        if self.model == "disc":
            return radiometry.disc_falloff(self.f_number, tangent, self.image_magnification(), self.pupil_magnification)
        return radiometry.cos4(tangent)

    def place(self, radius_um: Floats, corner_um: float) -> FloatArray:
        """Return the table position of a radius (um): image height in mm, or object-side field angle in degrees."""
        if self.rows().axis == "height_mm":
            return np.asarray(radius_um) * 1e-3
        sideways = self.pupil_magnification if self.geometry == "physical" else 1.0
        return np.degrees(np.arctan(sideways * np.asarray(self.tangent(radius_um, corner_um))))

    def bounds(self, grid: Grid) -> tuple[float, float]:
        """Return the smallest and largest relative illumination over the frame."""
        corner = farthest(grid)
        if self.tabled():
            return self.rows().range(float(self.place(nearest(grid), corner)), float(self.place(corner, corner)))
        return float(self.relative(np.array(self.tangent(corner, corner)))), 1.0

    def assumes(self) -> dict[str, Hashable]:
        if self.tabled():
            return {"the fall-off": ("that of", self.table or self.lens_profile)}
        return {"the fall-off": (self.model, self.geometry, *((self.full_field,) if self.geometry == "paper" else ()))}

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        return self.rows().curves(coordinates["wavelength"]) if self.tabled() else np.ones((1, 1))

    def by_band(self, prepared: FloatArray, bands: slice) -> FloatArray:
        return prepared if len(prepared) == 1 else prepared[bands]

    def in_rows(self) -> bool:
        return self.geometry == "physical"  # else the corner of the frame counts

    def run(self, irradiance: FloatArray, y_um: FloatArray, x_um: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        radius = np.hypot(y_um[:, None], x_um[None, :])
        corner = math.hypot(max(abs(y_um[0]), abs(y_um[-1])), max(abs(x_um[0]), abs(x_um[-1])))
        if self.tabled():
            return {"irradiance": by_curves(irradiance, self.place(radius, corner), self.rows().nodes, prepared)}
        return {"irradiance": irradiance * self.relative(self.tangent(radius, corner)).astype(irradiance.dtype)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str]:
        low, high = self.bounds(grid)
        return max(1.0 - low, high - 1.0), "the field is small: at the corner the falloff is below this bound"

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return facts["irradiance"].scaled(*self.bounds(grid["irradiance"]), smooth=not self.tabled())

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        notes = self.lens_notes(
            "the fall-off",
            "the cos4 law is used instead",
            self.of_lens() is not None,
            (self.focal_length, self.f_number),
        )
        if not self.tabled():
            return notes
        corner, bands = farthest(grids["irradiance"]), grids["irradiance"].bands().values()
        return notes + self.rows().remarks(
            float(self.place(corner, corner)), "mm" if self.rows().axis == "height_mm" else "degrees", bands
        )
