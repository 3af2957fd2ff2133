"""Arrays as an eye sees them: light through the CIE 1931 observer, a mosaic through its own filters, display values as they are.

In:  a ``DataArray`` of one cell, over y and x, perhaps wavelength or channel in front; its attributes say how it is drawn
     (``drawn_as``, ``drawn_white``, ``drawn_black``, ``drawn_pattern``, ``drawn_for``), else its name does.
Out: (y, x, 3) bytes, encoded sRGB, the first row of the array on top.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray

from etendue import spectra
from etendue.errors import RequestError
from etendue.physics.colour import matrices
from etendue.physics.colour.encoding import srgb_encode
from etendue.physics.sensor import cfa
from etendue.spec.variables import variable as known

BRIGHT, SHARE = 0.995, 0.9  # this quantile of the brightest channel is shown at this share of white
HATCH = (225, 120, 112), (250, 232, 230)  # stripes where there is nothing to be seen
STRIPE = 4  # pixels
TO_RGB = np.linalg.inv(matrices.RGB_TO_XYZ_SRGB)


def how(array: xarray.DataArray) -> str:
    """``linear``, ``encoded`` or ``map``: as its attributes say, as its variable is known, or numbers as a map."""
    return str(array.attrs.get("drawn_as", "")) or known(str(array.name)).shown or "map"


def linear(array: xarray.DataArray) -> Any:
    """(3, y, x) float64: light and signals in linear sRGB, not yet scaled; encoded values and maps in 0 to 1.

    Raises
    ------
    RequestError
        Dims that are no picture.
    """
    front = [str(dim) for dim in array.dims if dim not in ("y", "x")]
    if not {"y", "x"} <= set(map(str, array.dims)) or len(front) > 1:
        left = [dim for dim in front if dim not in ("wavelength", "channel")] or list(map(str, array.dims))
        dims = ", ".join(map(str, array.dims))
        raise RequestError(f"{array.name or 'the array'} has dims {dims}: choose a value of {' and '.join(left)} to see a picture")
    array = array.transpose(*front, "y", "x")
    values = np.asarray(array.values, np.float64)
    if how(array) == "encoded":
        return _three(values)
    if front == ["wavelength"]:
        edges = _edges(array["wavelength"].values)
        observer = (spectra.colour_matching(edges) * np.diff(edges)[:, None]).T
        return matrices.apply_matrix(TO_RGB, np.tensordot(observer, values, axes=1))
    if front == ["channel"]:
        names = [str(name) for name in array["channel"].values.tolist()] if "channel" in array.coords else []
        if names == ["X", "Y", "Z"]:
            return matrices.apply_matrix(_to_rgb(array.attrs.get("drawn_for")), values)
        return _three(values if names[:3] == ["R", "G", "B"] else values.mean(axis=0, keepdims=True))
    if how(array) == "map":
        return _three(_share(values, array))
    values = np.maximum(values - float(array.attrs.get("drawn_black", 0)), 0)
    pattern = array.attrs.get("drawn_pattern")
    return _tinted(values, str(pattern), array) if pattern else _three(values)


def brightness(found: Any, array: xarray.DataArray) -> float:
    """The linear value that is shown as white."""
    white = array.attrs.get("drawn_white", known(str(array.name)).white)
    if white is not None:
        return float(white)
    peaks = found.max(axis=0)
    peaks = peaks[np.isfinite(peaks)]
    bright = max(float(np.quantile(peaks, BRIGHT)), 1e-3 * float(peaks.max())) / SHARE if peaks.size else 0.0
    return bright if bright > 0 else 1.0


def drawn(array: xarray.DataArray, bright: float | None = None, failed: bool = False) -> Any:
    """(y, x, 3) uint8 as it looks; striped where values are not there, or all of it where the cell has ``failed``."""
    found = linear(array)
    lost = np.isnan(found).any(axis=0) | failed
    if how(array) == "linear":
        found = srgb_encode(np.clip(np.nan_to_num(found) / (bright or brightness(found, array)), 0, 1))
    picture = np.moveaxis(np.rint(255 * np.clip(np.nan_to_num(found), 0, 1)).astype(np.uint8), 0, -1)
    if lost.any():
        rows, columns = np.indices(lost.shape)
        stripes = np.where((((rows + columns) // STRIPE) % 2 == 0)[..., None], *(np.array(colour, np.uint8) for colour in HATCH))
        picture = np.where(lost[..., None], stripes, picture)
    return np.ascontiguousarray(picture)


def _three(values: Any) -> Any:
    values = values[None] if values.ndim == 2 else values
    return values[:3] if len(values) >= 3 else np.repeat(values[:1], 3, axis=0)


def _share(values: Any, array: xarray.DataArray) -> Any:
    """Numbers as a share of their range."""
    shown = known(str(array.name))
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.log(values) if shown.log else values
        finite = values[np.isfinite(values)]
        ends = (
            (np.log(shown.range) if shown.log else shown.range) if shown.range else (finite.min(), finite.max()) if finite.size else (0, 1)
        )
        found = (values - ends[0]) / (ends[1] - ends[0]) if ends[1] > ends[0] else np.where(np.isnan(values), np.nan, 0.5)
    return np.where(np.isnan(values), np.nan, np.clip(found, 0, 1))


def _tinted(values: Any, pattern: str, array: xarray.DataArray) -> Any:
    """Each pixel in the colour of its filter, as the first pixel of the window sees it."""
    mask = cfa.read(pattern)
    start = [round(float(array[dim].values[0])) if dim in array.coords else 0 for dim in ("y", "x")]
    tints = np.array([cfa.tint(channel) for channel in mask.channels])[cfa.channel_index(mask, *values.shape, *start)]
    return np.moveaxis(tints, -1, 0) * values


def _to_rgb(white: Any) -> Any:
    """From tristimulus values to linear sRGB; with a white, as its viewer sees it and not as it would look beside D65."""
    if white is None:
        return TO_RGB
    return TO_RGB @ matrices.von_kries_matrix(
        np.asarray(white, float), matrices.xyz_from_xy(matrices.D65_XY), matrices.TRANSFORMS["bradford"]
    )


def _edges(middles: Any) -> Any:
    """Edges of bins by their middles, which halve them."""
    middles = np.asarray(middles, float)
    half = 0.5 * np.diff(middles) if middles.size > 1 else np.array([5.0])
    inner = middles[:-1] + half if middles.size > 1 else middles[:0]
    return np.concatenate([[middles[0] - half[0]], inner, [middles[-1] + half[-1]]])
