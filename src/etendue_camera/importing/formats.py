"""The formats of spectral cubes: file extensions, names and reader functions.

In:  a file extension.
Out: a reader, imported on demand. To add a format, add a row here, its function, and a row of the table in
     ``docs/python.md``.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from etendue_camera.importing.cube import Cube

Reader = Callable[[Path, str], "Cube"]


class Format(NamedTuple):
    """``place``: ``module:function`` of (path, name of the array in it) that returns a ``Cube``."""

    name: str
    place: str

    def reader(self) -> Reader:
        module, _, name = self.place.partition(":")
        found: Reader = getattr(importlib.import_module(f"etendue_camera.importing.{module}"), name)
        return found


FORMATS = {
    ".npy": Format("NumPy", "arrays:numpy_array"),
    ".npz": Format("NumPy", "arrays:numpy_arrays"),
    ".mat": Format("MATLAB (including ISETCam)", "arrays:matlab"),
    ".h5": Format("HDF5", "arrays:hdf5"),
    ".hdf5": Format("HDF5", "arrays:hdf5"),
    ".hdr": Format("ENVI", "rasters:envi"),
    ".exr": Format("spectral OpenEXR", "rasters:openexr"),
    ".tif": Format("multi-page TIFF", "rasters:tiff"),
    ".tiff": Format("multi-page TIFF", "rasters:tiff"),
}
NAMES = ", ".join(dict.fromkeys(one.name for one in FORMATS.values()))
