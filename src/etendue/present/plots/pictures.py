"""Conversion of arrays to pictures in the colours that the eye sees, from their coordinates and attributes, by the
rules of ``present.pictures.appearance``.

In:  a ``DataArray`` of one cell, over y and x, perhaps with bands or channels first; its attributes
     (``contract.drawn``), else its name, define how it is drawn.
Out: (y, x, 3) bytes, encoded sRGB, the first row of the array at the top.
"""

from __future__ import annotations

import numpy as np
import xarray

from etendue.archive.structure.layout import BOUNDS
from etendue.contract.arrays.colouring import flat_dims
from etendue.contract.arrays.dims import banded
from etendue.contract.arrays.drawn import Drawn, read
from etendue.errors import RequestError
from etendue.present.pictures.appearance import Appearance, appearance, brightness, rendered
from etendue.types.arrays import Array

ENDS = ("band_from", "band_to")


def drawn_as(array: xarray.DataArray) -> Drawn:
    """Return the drawing properties of the array of one cell, whose axis values are in the coordinates."""
    at = {str(name): one.item() for name, one in array.coords.items() if not one.dims}
    return read(str(array.name), array.attrs, at)


def one_frame(array: xarray.DataArray) -> xarray.DataArray:
    """Return the middle one of several frames; planes and bands are kept, because they form one picture."""
    return array.isel({dim: array.sizes[dim] // 2 for dim in array.dims if dim not in ("y", "x", *flat_dims())})


def with_bands(array: xarray.DataArray, group: xarray.Dataset) -> xarray.DataArray:
    """Add the edges of the bands from the group, because the band centres alone do not give the widths."""
    band = banded(map(str, array.dims))
    if not band or f"{band}{BOUNDS}" not in group:
        return array
    bounds = group[f"{band}{BOUNDS}"].values
    return array.assign_coords({name: (band, ends) for name, ends in zip(ENDS, bounds.T, strict=True)})


def appearance_of(array: xarray.DataArray) -> Appearance:
    """Return the appearance of an array.

    Raises
    ------
    RequestError
        The array does not have the dims of a picture.
    """
    dims = [str(dim) for dim in array.dims]
    first = [round(float(array[dim].values[0])) if dim in array.coords else 0 for dim in ("y", "x")]
    names = array["channel"].values.tolist() if "channel" in array.coords else range(array.sizes.get("channel", 0))
    found = appearance(
        drawn_as(array), dims, _edges(array, banded(dims)) if banded(dims) else None, names, (first[0], first[1])
    )
    if found is None:
        left = [dim for dim in dims if dim not in ("y", "x", *flat_dims())] or dims
        raise RequestError(
            f"{array.name or 'the array'} has dims {', '.join(dims)}: choose a value of {' and '.join(left)} to see a "
            f"picture"
        )
    return found


def bright_in(array: xarray.DataArray) -> float:
    """Return the linear value shown as white if this picture is shown alone."""
    array = upright(array)
    own = appearance_of(array)
    return brightness(own.drawn, own.small(array.values) if own.drawn.scaled else None)


def drawn(array: xarray.DataArray, bright: float | None = None, failed: bool = False, small: bool = False) -> Array:
    """Return a picture as uint8 (y, x, 3), at full size or ``small``. Missing values are striped; if the cell
    ``failed``, the whole picture is.
    """
    array = upright(array)
    own = appearance_of(array)
    if failed:
        return rendered(own.drawn, np.full((3, *array.shape[-2:]), np.nan), 1.0)
    light = (own.small if small else own.rgb)(array.values)
    return rendered(own.drawn, light, bright or bright_in(array))


def upright(array: xarray.DataArray) -> xarray.DataArray:
    """Move y and x to the end."""
    front = [dim for dim in array.dims if dim not in ("y", "x")]
    return array.transpose(*front, "y", "x") if {"y", "x"} <= set(array.dims) else array


def _edges(array: xarray.DataArray, band: str) -> Array:
    """Return the edges of the bands: as stored next to the light, else midway between the band centres."""
    if set(ENDS) <= set(array.coords):
        first, last = (array[name].values for name in ENDS)
        return np.append(first, last[-1])
    middles = np.asarray(array[band].values, float)
    half = 0.5 * np.diff(middles) if middles.size > 1 else np.array([5.0])
    inner = middles[:-1] + half if middles.size > 1 else middles[:0]
    return np.concatenate([[middles[0] - half[0]], inner, [middles[-1] + half[-1]]])
