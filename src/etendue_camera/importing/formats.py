"""The formats of spectral cubes: endings of files, what they are called, and which function reads them.

In:  the ending of a file.
Out: a reader, imported when it is asked for. One more is a row here, its function, and a row of the table in
     ``docs/python.md``.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple


class Format(NamedTuple):
    """``place``: ``module:function`` of (path, name of the array in it) that gives a ``Cube``."""

    name: str
    place: str

    def reader(self) -> Any:
        module, _, name = self.place.partition(":")
        return getattr(importlib.import_module(f"etendue_camera.importing.{module}"), name)


FORMATS = {
    ".npy": Format("NumPy", "arrays:numpy_array"),
    ".npz": Format("NumPy", "arrays:numpy_arrays"),
    ".mat": Format("MATLAB (ISETCam's too)", "arrays:matlab"),
    ".h5": Format("HDF5", "arrays:hdf5"),
    ".hdf5": Format("HDF5", "arrays:hdf5"),
    ".hdr": Format("ENVI", "rasters:envi"),
    ".exr": Format("spectral OpenEXR", "rasters:openexr"),
    ".tif": Format("TIFF of several pages", "rasters:tiff"),
    ".tiff": Format("TIFF of several pages", "rasters:tiff"),
}
NAMES = ", ".join(dict.fromkeys(one.name for one in FORMATS.values()))
