"""Measured or computed spectral radiance from a Zarr store, read one wavelength band at a time.

In:  a Zarr store with a variable (wavelength, y, x), as xarray writes it: another archive's scene, a hyperspectral camera's cube.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import spectra
from etendue.api import Bands, Facts, Grid, Line, Stage, hookimpl, param, quantity

SPECTRAL = "W m-2 sr-1 nm-1"


@dataclass(frozen=True, kw_only=True)
class RadianceCube(Stage):
    """Spectral radiance from a Zarr store: its own wavelengths and positions, at its own level or at a stated one.

    Coordinates ``wavelength`` (nm; bins by ``wavelength_bounds``, else midway between the centres) and ``y``, ``x`` (um on
    the image plane, evenly spaced; else ``spacing`` says). An attribute ``actual_range`` = [lowest, highest] lets the plan
    choose the precision. ``white_radiance`` is read where the store has it.
    """

    reads: ClassVar = {}
    writes: ClassVar = {"radiance": f"wavelength y x [{SPECTRAL}]", "white_radiance": f"wavelength [{SPECTRAL}]"}
    libraries: ClassVar[tuple[str, ...]] = ("zarr", "colour-science")
    nanoseconds: ClassVar = 2.0

    file: str = param(file=True, folder=True, doc="the Zarr store, such as another archive's data.zarr")
    variable: str = param("radiance", doc="the variable in it, such as 'scene/radiance'")
    illuminant: str = quantity("illuminant")
    white_luminance: float = param(
        0.0, units="cd m-2", at_least=0,
        doc="luminance of a perfect white diffuser under the illuminant: the cube is relative to it, 1 = white; 0: the cube is radiance",
    )  # fmt: skip
    spacing: float = param(0.0, units="um", at_least=0, doc="distance between samples; 0: from the coordinates of the store")

    def _open(self) -> tuple[Any, Any]:
        """The array, and its group."""
        import zarr

        group_path, _, name = self.variable.rpartition("/")
        try:
            group = zarr.open_group(self.file, mode="r", path=group_path or None)
            array = group[name]
        except (KeyError, FileNotFoundError, ValueError) as error:
            raise ValueError(f"{self.file} holds no variable {self.variable!r}: {error}") from None
        if getattr(array, "ndim", 0) != 3:
            raise ValueError(f"{self.variable} in {self.file} must have the dims wavelength, y, x; it has {getattr(array, 'shape', ())}")
        return array, group

    def describe(self) -> tuple[Facts, dict[str, Grid]]:
        array, group = self._open()
        bands = Bands(_edges(group, array.shape[0], self.variable))
        lines = {dim: self._line(group, dim, size) for dim, size in zip(("y", "x"), array.shape[1:], strict=True)}
        grid = Grid.of({"wavelength": bands, **lines})
        if self.white_luminance:
            spectra.check_illuminant(self.illuminant, bands.edges[0], bands.edges[-1])
            spectra.check_luminance(self.illuminant)
        if "white_radiance" not in group and not self.white_luminance:
            raise ValueError(
                f"{self.file} holds no white_radiance, so nobody knows what is white; give white_luminance: the cube is then "
                "relative to a white diffuser under the illuminant"
            )
        low, high = (float(v) for v in array.attrs.get("actual_range", (0.0, 0.0)))
        known = Facts(contrast=high / low) if low > 0 else Facts()
        return known, {"radiance": grid, "white_radiance": grid.take(("wavelength",))}

    def warn(self, facts: Facts, grids: Any) -> list[str]:
        if not self.white_luminance:
            return []
        array, group = self._open()
        edges = _edges(group, array.shape[0], self.variable)
        return spectra.luminance_notes(self.illuminant, edges[0], edges[-1])

    def _line(self, group: Any, dim: str, size: int) -> Line:
        if self.spacing:
            return Line(size, -0.5 * (size - 1) * self.spacing, self.spacing)
        if dim not in group or size < 2:
            raise ValueError(f"{self.file} has no coordinate {dim!r}; give the spacing in um")
        values = np.asarray(group[dim][...], dtype=float)
        step = (values[-1] - values[0]) / (size - 1)
        if not step > 0 or np.abs(np.diff(values) - step).max() > 1e-6 * step:
            raise ValueError(f"{dim} in {self.file} is not evenly spaced and ascending; resample the cube, or give the spacing in um")
        return Line(size, float(values[0]), float(step))

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (6e-8 if precision == "float32" else 1e-16), "proved"

    def prepare(self, coordinates: Any) -> Any:
        array, group = self._open()
        edges = tuple(coordinates["out_wavelength_edges"])
        if self.white_luminance:
            white = spectra.light_of_luminance(self.illuminant, edges, self.white_luminance)
            return array.__getitem__, slice(0, white.size), white, white
        white = np.asarray(group["white_radiance"][...], dtype=float)
        return array.__getitem__, slice(0, white.size), white, np.ones_like(white)

    def by_band(self, prepared: Any, bands: slice) -> Any:
        read, _, white, scale = prepared
        return read, bands, white[bands], scale[bands]

    def constants(self, prepared: Any) -> dict[str, Any]:
        return {"white_radiance": prepared[2]}

    def run(self, prepared: Any) -> dict[str, Any]:
        read, bands, white, scale = prepared
        light = read(bands)
        if not np.all(scale == 1):
            light = light * scale[:, None, None].astype(light.dtype)
        return {"radiance": light, "white_radiance": white}


def _edges(group: Any, size: int, variable: str) -> tuple[float, ...]:
    if "wavelength_bounds" in group:
        bounds = np.asarray(group["wavelength_bounds"][...], dtype=float)
        return (*map(float, bounds[:, 0]), float(bounds[-1, 1]))
    if "wavelength" not in group or size < 2:
        raise ValueError(f"{variable} has no coordinate wavelength (nm)")
    centres = np.asarray(group["wavelength"][...], dtype=float)
    if not np.all(np.diff(centres) > 0) or not 100 < centres[0] < math.inf:
        raise ValueError(f"wavelength of {variable} must ascend, in nm; it begins with {centres[:3]}")
    middle = 0.5 * (centres[:-1] + centres[1:])
    return (float(2 * centres[0] - middle[0]), *map(float, middle), float(2 * centres[-1] - middle[-1]))


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"radiance_cube": RadianceCube}
