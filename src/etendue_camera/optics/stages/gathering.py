"""Light gathering: scene radiance to irradiance on the image plane, and filters in the light path.

In:  ``radiance`` of the scene on the image-plane grid.
Out: ``irradiance`` (wavelength, y, x), W m-2 nm-1, before the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from etendue.api import Banded, Bounded, Facts, Grid, Tinting, param, proved, quantity
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.light import radiometry
from etendue_camera.optics import filters
from etendue_camera.optics.stages.conjugates import Conjugates


@dataclass(frozen=True, kw_only=True)
class Irradiance(Conjugates, Banded):
    """Compute irradiance from radiance: E = pi L T / (4 N_w^2) (aplanatic), the flat disc of eq. 5, or pi L / (4 T_w^2)
    for a T-number.
    """

    role: ClassVar = "light gathering"
    reads: ClassVar = {"radiance": "wavelength y x [W m-2 sr-1 nm-1]", "white_radiance": "wavelength [W m-2 sr-1 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    pointwise: ClassVar = True
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.0
    error: ClassVar = proved(1e-7, 4e-16)

    t_number: float = quantity("t_number")
    transmittance: float = quantity("transmittance")
    aperture_model: str = quantity("aperture_model")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.t_number == 0:
            self.factor()  # rejects an impossible light cone before anything runs
            return
        if self.transmittance != 1:
            raise ValueError(
                f"t_number is {self.t_number:g} and transmittance {self.transmittance:g}, but a T-number includes the "
                f"lens losses already; "
                "set transmittance to 1, or t_number to 0"
            )
        if self.t_number < self.f_number * (1 - 1e-9):
            raise ValueError(
                f"t_number is {self.t_number:g}, below the f_number {self.f_number:g}: the lens would transmit more "
                "light than it receives; give the matching f_number"
            )

    def factor(self) -> float:
        magnification = self.image_magnification()
        if self.t_number > 0:  # the f-number of a lossless aplanatic lens that gives as much light (ISO 517)
            return float(radiometry.aplanatic_factor(self.t_number, magnification, self.pupil_magnification))
        model = radiometry.aplanatic_factor if self.aperture_model == "aplanatic" else radiometry.flat_disc_factor
        return float(model(self.f_number, magnification, self.pupil_magnification)) * self.transmittance

    def by_band(self, prepared: None, bands: slice) -> None:
        return prepared

    def in_rows(self) -> bool:
        return True

    def run(self, radiance: FloatArray, white_radiance: FloatArray) -> dict[str, Array]:
        factor = self.factor()
        return {"irradiance": radiance * radiance.dtype.type(factor), "white_irradiance": white_radiance * factor}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return facts["radiance"].scaled(self.factor())

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        return (
            ["below f/1.2, scalar diffraction and the thin-lens aperture are only approximate"]
            if self.f_number < 1.2
            else []
        )


@dataclass(frozen=True, kw_only=True)
class OpticalFilter(Banded, Bounded, Tinting):
    """Apply a filter in the light path: a smooth short-pass, or any transmission table. Use several stages for several
    filters.
    """

    role: ClassVar = "optical filter"
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    pointwise: ClassVar = True
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.0
    error: ClassVar = proved(1e-7, 4e-16)

    table: str = param(
        "",
        table=True,
        doc="CSV (wavelength_nm,transmission) or SPDX file; 0 beyond its rows by more than half a step; '': the smooth "
        "short-pass",
    )
    cut_off: float = param(
        650.0,
        units="nm",
        above=0,
        infinite=True,
        doc="wavelength of half transmission of the smooth short-pass; inf: none",
    )
    edge: float = param(15.0, units="nm", above=0, doc="width of the cut-off, from 73 % to 27 % transmission")

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        if self.table:
            transmission = spectra.table_from_csv(self.table, tuple(coordinates["wavelength_edges"]))[1][:, 0]
            if transmission.min() < 0 or transmission.max() > 1 + 1e-9:
                raise ValueError(
                    f"{self.table}: transmission {transmission.min():g} to {transmission.max():g}; it must be between "
                    "0 and 1; is it in per cent?"
                )
            return transmission
        return filters.smooth_cut(coordinates["wavelength"], self.cut_off, self.edge)

    def transmission(self, grid: Grid) -> FloatArray:
        bands = grid.bands()
        return np.asarray(
            self.prepare({"wavelength_edges": np.array(bands.edges), "wavelength": np.array(bands.values())})
        )

    def by_band(self, prepared: FloatArray, bands: slice) -> FloatArray:
        return prepared[bands]

    def in_rows(self) -> bool:
        return True

    def run(self, irradiance: FloatArray, white_irradiance: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return {
            "irradiance": irradiance * prepared[:, None, None].astype(irradiance.dtype),
            "white_irradiance": white_irradiance * prepared,
        }

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        """Return the largest fraction that the filter removes from any band, with a reason; every band counts, because
        the white has light in every band.
        """
        if not self.table and math.isinf(self.cut_off):
            return 0.0, "it transmits everything"
        return float(np.abs(1.0 - self.transmission(grid)).max()), "it transmits nearly all of the light"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if not self.table:
            return []
        names, rows, values = spectra.csv_rows(self.table)
        edges = grids["irradiance"].bands().edges
        return spectra.cut_off_note(self.table, names[:1], rows, values[:, :1], edges[0], edges[-1])

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        light, passed = facts["irradiance"], tuple(map(float, self.transmission(grid["irradiance"])))
        if light.white is not None:
            light = replace(light, white=tuple(own * share for own, share in zip(light.white, passed, strict=True)))
        if light.content is None:
            return replace(light, low=None, high=None)
        content = light.content.weighed(passed)
        low, high = content.range_of_light()
        return replace(light, content=content, low=low, high=high)
