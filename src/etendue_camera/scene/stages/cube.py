"""Measured or computed spectral radiance from a Zarr store, read one wavelength band at a time.

In:  a Zarr store with a variable (wavelength, y, x), as xarray writes it: the scene of another archive, a hyperspectral
     camera's cube.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import require
from etendue.api import Banded, Bands, Discretised, Facts, Grid, Line, Source, param, proved, quantity
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.scene.stages import cube_store

# how bands are read, which of them, the light of white in them, the factor on what is read
Prepared = tuple[Callable[[slice], Array], slice, FloatArray, FloatArray]

SPECTRAL = "W m-2 sr-1 nm-1"


@dataclass(frozen=True, kw_only=True)
class RadianceCube(Source, Banded, Discretised):
    """Read spectral radiance from a Zarr store, with its own wavelengths and positions, at its own or a given level.

    Coordinates are ``wavelength`` (nm; bins from ``wavelength_bounds``, otherwise midway between centres) and ``y``,
    ``x`` (um on the image plane, evenly spaced; otherwise give ``spacing``). An attribute ``actual_range`` = [lowest,
    highest] lets the plan choose the precision. ``white_radiance`` is read if the store has it.
    """

    role: ClassVar = "scene"
    reads: ClassVar = {}
    writes: ClassVar = {"radiance": f"wavelength y x [{SPECTRAL}]", "white_radiance": f"wavelength [{SPECTRAL}]"}
    libraries: ClassVar[tuple[str, ...]] = ("zarr", "colour-science")
    nanoseconds: ClassVar = 2.0
    error: ClassVar = proved(6e-8, 1e-16)

    file: str = param(
        file=True,
        folder=True,
        example="package:etendue_camera/data/examples/cube.zarr",
        doc="the Zarr store, such as another archive's data.zarr",
    )
    variable: str = param("radiance", doc="name of the variable in the store, such as 'scene/radiance'")
    illuminant: str = quantity("illuminant")
    white_luminance: float = param(
        0.0,
        units="cd m-2",
        at_least=0,
        doc="luminance of a perfect white diffuser under the illuminant, for a cube of relative values (1 = white); 0: "
        "the cube is in absolute radiance",
    )
    spacing: float = param(0.0, units="um", at_least=0, doc="sample spacing; 0: from the coordinates of the store")

    def discretisations(self) -> dict[str, str]:
        return {"bins": "fixed by the file", "spacing": "fixed by the file", "margin": "fixed by the file"}

    def refined(self, name: str, factor: int) -> dict[str, Any]:
        """Return no finer values: the sampling of a file is fixed."""
        return {}

    def _open(self) -> tuple[Any, Any]:
        """Return the array and its group."""
        import zarr

        group_path, _, name = self.variable.rpartition("/")
        cube_store.refuse_links(self.file)
        try:
            group = zarr.open_group(self.file, mode="r", path=group_path or None, use_consolidated=False)
            array = group[name]
        except Exception as error:  # damaged metadata can raise anything
            raise ValueError(
                f"{self.file} has no variable {self.variable!r}: {' '.join(str(error).split())[:150]}"
            ) from None
        cube_store.check_array(self.file, self.variable, array, "" if self.white_luminance else SPECTRAL)
        return array, group

    def describe(self) -> tuple[Facts, dict[str, Grid]]:
        array, group = self._open()
        cube_store.check_chunks(self.file, self.variable, array)
        bands = Bands(_edges(self.file, group, array.shape[0], self.variable))
        lines = {dim: self._line(group, dim, size) for dim, size in zip(("y", "x"), array.shape[1:], strict=True)}
        grid = Grid.of({"wavelength": bands, **lines})
        if self.white_luminance:
            spectra.check_illuminant(self.illuminant, bands.edges[0], bands.edges[-1])
            spectra.check_luminance(self.illuminant)
        require.that(
            "white_radiance" in group or self.white_luminance,
            f"{self.file} has no white_radiance, so white is unknown; give white_luminance: the cube "
            f"is then "
            "relative to a white diffuser under the illuminant",
        )
        if not self.white_luminance:
            self._white(array, group)
        low, high = _range(array.attrs.get("actual_range"))
        known = Facts(contrast=high / low) if low > 0 else Facts()
        return known, {"radiance": grid, "white_radiance": grid.take(("wavelength",))}

    def white_light(self, edges: tuple[float, ...]) -> Array:
        return (
            spectra.light_of_radiance(self.illuminant, edges, 1.0)
            if self.white_luminance
            else self._white(*self._open())
        )

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if not self.white_luminance:
            return []
        array, group = self._open()
        edges = _edges(self.file, group, array.shape[0], self.variable)
        return spectra.luminance_notes(self.illuminant, edges[0], edges[-1])

    def _white(self, array: Any, group: Any) -> FloatArray:
        """Return the radiance of a white diffuser by band, from the store."""
        white = cube_store.values_of(self.file, group, "white_radiance", (array.shape[0],), SPECTRAL)
        if not (white >= 0).all() or not (white > 0).any():
            raise ValueError(
                f"white_radiance in {self.file} is {white.min():g} to {white.max():g}; it must not be below 0"
            )
        return white

    def _line(self, group: Any, dim: str, size: int) -> Line:
        if self.spacing:
            return Line(size, -0.5 * (size - 1) * self.spacing, self.spacing)
        require.that(dim in group and size >= 2, f"{self.file} has no coordinate {dim!r}; give spacing")
        values = cube_store.values_of(self.file, group, dim, (size,), "um")
        step = (values[-1] - values[0]) / (size - 1)
        require.that(
            step > 0 and not np.abs(np.diff(values) - step).max() > 1e-6 * step,
            f"{dim} in {self.file} is not evenly spaced and ascending; resample the cube, or give spacing",
        )
        return Line(size, float(values[0]), float(step))

    def prepare(self, coordinates: Mapping[str, Array]) -> Prepared:
        array, group = self._open()
        edges = tuple(coordinates["out_wavelength_edges"])
        if self.white_luminance:
            white: FloatArray = spectra.light_of_luminance(self.illuminant, edges, self.white_luminance)
            return array.__getitem__, slice(0, white.size), white, white
        white = self._white(array, group)
        return array.__getitem__, slice(0, white.size), white, np.ones_like(white)

    def by_band(self, prepared: Prepared, bands: slice) -> Prepared:
        read, _, white, scale = prepared
        return read, bands, white[bands], scale[bands]

    def constants(self, prepared: Prepared) -> dict[str, Array]:
        return {"white_radiance": prepared[2]}

    def run(self, prepared: Prepared) -> dict[str, Array]:
        read, bands, white, scale = prepared
        try:
            light = read(bands)
        except Exception as error:  # raised by a store or a codec
            raise ValueError(
                f"{self.variable} in {self.file} could not be read: {' '.join(str(error).split())[:150]}"
            ) from None
        cube_store.check_values(self.file, self.variable, light, range(white.size)[bands])
        if not np.all(scale == 1):
            light = light * scale[:, None, None].astype(light.dtype)
        return {"radiance": light, "white_radiance": white}


def _range(given: Any) -> tuple[float, float]:
    """Return the lowest and highest value of an attribute ``actual_range``; (0, 0) where it is missing or invalid."""
    try:
        low, high = (float(v) for v in given)
    except (TypeError, ValueError):
        return 0.0, 0.0
    return (low, high) if 0 < low <= high < math.inf else (0.0, 0.0)


def _edges(path: str, group: Any, size: int, variable: str) -> tuple[float, ...]:
    if "wavelength_bounds" in group:
        bounds = cube_store.values_of(path, group, "wavelength_bounds", (size, 2), "nm")
        if not (
            bounds[0, 0] > 0
            and (bounds[:, 0] < bounds[:, 1]).all()
            and np.allclose(bounds[1:, 0], bounds[:-1, 1], rtol=1e-9)
        ):
            raise ValueError(
                f"wavelength_bounds of {variable} must ascend without gaps, in nm; they start with "
                f"{bounds[:2].tolist()}"
            )
        return (*map(float, bounds[:, 0]), float(bounds[-1, 1]))
    if "wavelength" not in group or size < 2:
        one = " of one band needs wavelength_bounds (nm)" if size == 1 else " has no coordinate wavelength (nm)"
        raise ValueError(f"{variable}{one}")
    centres = cube_store.values_of(path, group, "wavelength", (size,), "nm")
    if not np.all(np.diff(centres) > 0) or not 100 < centres[0] < math.inf:
        raise ValueError(f"wavelength of {variable} must ascend, in nm; it starts with {centres[:3].tolist()}")
    middle = 0.5 * (centres[:-1] + centres[1:])
    return (float(2 * centres[0] - middle[0]), *map(float, middle), float(2 * centres[-1] - middle[-1]))
