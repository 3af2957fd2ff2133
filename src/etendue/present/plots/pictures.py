"""Arrays as an eye sees them, from what they say of themselves: ``report.appearance`` asked with coordinates and
attributes.

In:  a ``DataArray`` of one cell, over y and x, perhaps bands or channels in front; its attributes say how it is drawn
     (``spec.drawn``), else its name does.
Out: (y, x, 3) bytes, encoded sRGB, the first row of the array on top.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray

from etendue.archive.layout import BOUNDS
from etendue.contract.dims import banded
from etendue.contract.drawn import Drawn, Pictured, lit_by, read
from etendue.contract.seen import flat_dims
from etendue.errors import RequestError
from etendue.present.pictures.appearance import Appearance, appearance, as_bytes, brightness, seen, striped
from etendue.types.arrays import Array

ENDS = ("band_from", "band_to")


def drawn_as(array: xarray.DataArray) -> Drawn:
    """What is said of an array, at its place on the axes of a sweep."""
    at = {str(name): one.item() for name, one in array.coords.items() if not one.dims}
    return read(str(array.name), array.attrs, at)


def one_frame(array: xarray.DataArray) -> xarray.DataArray:
    """Of several frames the one in the middle; planes and bands are one picture."""
    return array.isel({dim: array.sizes[dim] // 2 for dim in array.dims if dim not in ("y", "x", *flat_dims())})


def with_bands(array: xarray.DataArray, group: xarray.Dataset) -> xarray.DataArray:
    """With the ends of its bands as its group has them: their middles alone do not say how wide each is."""
    band = banded(map(str, array.dims))
    if not band or f"{band}{BOUNDS}" not in group:
        return array
    bounds = group[f"{band}{BOUNDS}"].values
    return array.assign_coords({name: (band, ends) for name, ends in zip(ENDS, bounds.T, strict=True)})


def appearance_of(array: xarray.DataArray) -> Appearance:
    """How an array is seen.

    Raises
    ------
    RequestError
        Dims that are no picture.
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
    """The linear value that is shown as white in a picture that stands alone."""
    array = upright(array)
    own = appearance_of(array)
    return brightness(own.small(array.values)) if own.drawn.scaled else own.drawn.white or 1.0


def bright_among(order: Sequence[Pictured], number: int, bright_of: Callable[[int], float | None]) -> float:
    """The same of one among the pictures of a cell; ``bright_of`` says what is bright in those that are there."""
    there = list(range(len(order)))
    while order[number].drawn.scaled:
        other = there[lit_by([order[n] for n in there], there.index(number))]
        if (found := bright_of(other)) is not None or other == number:
            return found or 1.0
        there.remove(other)
    return order[number].drawn.white or 1.0


def drawn(array: xarray.DataArray, bright: float | None = None, failed: bool = False) -> Array:
    """(y, x, 3) uint8 as it looks; striped where values are not there, or all of it where the cell has ``failed``."""
    array = upright(array)
    own = appearance_of(array)
    if failed:
        picture = striped(array.shape[-2:])
    else:
        picture = seen(own.drawn, own.rgb(array.values), bright or bright_in(array))
    return np.ascontiguousarray(np.moveaxis(as_bytes(picture), 0, -1))


def upright(array: xarray.DataArray) -> xarray.DataArray:
    """With y and x behind whatever else there is."""
    front = [dim for dim in array.dims if dim not in ("y", "x")]
    return array.transpose(*front, "y", "x") if {"y", "x"} <= set(array.dims) else array


def _edges(array: xarray.DataArray, band: str) -> Array:
    """Edges of bins: as they stand beside the light, else by their middles, which halve them."""
    if set(ENDS) <= set(array.coords):
        first, last = (array[name].values for name in ENDS)
        return np.append(first, last[-1])
    middles = np.asarray(array[band].values, float)
    half = 0.5 * np.diff(middles) if middles.size > 1 else np.array([5.0])
    inner = middles[:-1] + half if middles.size > 1 else middles[:0]
    return np.concatenate([[middles[0] - half[0]], inner, [middles[-1] + half[-1]]])
