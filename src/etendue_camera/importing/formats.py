"""The formats of spectral cubes: file extensions, names and reader functions.

In:  a file extension.
Out: a reader, imported on demand. To add a format, add a row here, its function, and a row of the table in
     ``docs/python.md``.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple


class Format(NamedTuple):
    """``place``: ``module:function`` of (path, name of the array in it) that returns a ``Cube``."""

    name: str
    place: str

    def reader(self) -> Any:
        module, _, name = self.place.partition(":")
        return getattr(importlib.import_module(f"etendue_camera.importing.{module}"), name)


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
