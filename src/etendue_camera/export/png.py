"""8-bit PNG: a variable rendered for viewing; light through the CIE 1931 observer, a mosaic through its own filters.

In:  a frame of an archive.
Out: an RGB PNG, first row of the array on top; encoded sRGB, with provenance as text.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray

from etendue.present.plots import pictures
from etendue_camera.export.frames import ArchivedFrame


def array_of(frame: ArchivedFrame) -> xarray.DataArray:
    """Return the picture of a frame with its metadata.

    Raises
    ------
    ArchiveError
        If the array is missing or differs from the recorded digest.
    """
    values, known = frame.picture(), frame.group.data[frame.variable]
    dims = [str(dim) for dim in known.dims[known.ndim - np.ndim(values) :]]
    coords = {dim: known[dim].variable for dim in dims if dim in known.coords}
    return pictures.with_bands(
        xarray.DataArray(values, {**coords, **frame.labels}, dims, frame.variable, known.attrs), frame.group.data
    )


def write(path: Path, array: xarray.DataArray, white: float, description: str = "") -> None:
    """Write one picture; ``white``: the linear value shown as white."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    said = PngInfo()
    said.add(b"sRGB", b"\0")
    if description:
        said.add_text("Description", description)
    said.add_text("Software", "etendue")
    Image.fromarray(pictures.drawn(array, white)).save(path, format="png", optimize=False, pnginfo=said)
