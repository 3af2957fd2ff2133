"""Cubes in picture files: one plane per band.

In:  a path.
Out: a ``Cube``, wavelength axis first.
"""

from __future__ import annotations

import glob
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue_camera.importing.cube import Cube, needed
from etendue_camera.picture_files import check_directories, check_segments

if TYPE_CHECKING:
    from etendue.types.arrays import Array

TO_NM = {"nanometers": 1.0, "nm": 1.0, "micrometers": 1e3, "um": 1e3, "microns": 1e3, "angstroms": 0.1, "meters": 1e9}
_LAYER = re.compile(r"(?:S0|S|T)?\.?(\d+(?:[.,]\d+)?)\s*nm", re.IGNORECASE)


def envi(path: Path, variable: str) -> Cube:
    """Read ENVI from its header, which names the data file; apply wavelengths and scale factor if given."""
    _refuse_leading_out(path)
    reader = needed("spectral.io.envi", f"{path} (ENVI)")
    image = reader.open(str(path))
    plain_files.refuse_unfolding(
        math.prod(image.shape) * np.dtype(image.dtype).itemsize, Path(image.filename).stat().st_size, "it"
    )
    values = np.moveaxis(np.asarray(image.load(scale=False)), 2, 0)
    header = {key.lower(): value for key, value in image.metadata.items()}
    wavelength, unit = header.get("wavelength"), str(header.get("wavelength units", "")).strip().lower()
    told: tuple[str, ...] = ()
    if wavelength is not None:
        centres = np.array([float(one) for one in wavelength])
        if unit not in TO_NM:
            unit = "micrometers" if centres.max() < 100 else "nanometers"
            told = (f"wavelengths are taken as {unit}; the header does not give their unit",)
        wavelength = centres * TO_NM[unit]
    factor = float(header.get("reflectance scale factor", 0) or 0)
    return Cube(values / np.float32(factor) if factor else values, wavelength, "relative" if factor else "", None, told)


def _refuse_leading_out(header: Path) -> None:
    """Raise RequestError if a file beside the header, such as its data file, is a link out of the header's folder."""
    folder = header.parent.resolve()
    for beside in header.parent.glob(f"{glob.escape(header.stem)}*"):
        if beside != header and beside.is_symlink() and beside.resolve().parent != folder:
            raise RequestError(
                f"{beside} is a link out of the folder of its header; replace it by a copy of its target"
            )


def openexr(path: Path, variable: str) -> Cube:
    """Read OpenEXR with one layer per wavelength: names such as ``S0.550,5nm`` (ART's form), ``w550nm``."""
    reader = needed("OpenEXR", f"{path} (OpenEXR)")
    with reader.File(str(path), header_only=True) as file:
        header = file.header()
        low, high = header["dataWindow"]
        pixels = math.prod(int(b) - int(a) + 1 for a, b in zip(low, high, strict=True))
        plain_files.refuse_unfolding(4 * pixels * len(header["channels"]), path.stat().st_size, "it")
    with reader.File(str(path), separate_channels=True) as file:
        layers = {name: channel.pixels for name, channel in file.channels().items()}
    found: dict[float, Array] = {}
    for name, pixels in layers.items():
        match = _LAYER.search(name)
        if match and not name.upper().startswith(("S1", "S2", "S3")):  # Stokes components after the first: polarisation
            found[float(match[1].replace(",", "."))] = pixels
    if not found:
        raise RequestError(
            f"{path} has the layers {', '.join(sorted(layers)[:6])}, but none named by wavelength, such as S0.550,0nm"
        )
    emissive = any(name.upper().startswith("S0") for name in layers)
    centres = sorted(found)
    return Cube(np.stack([found[one] for one in centres]), np.array(centres), "radiance" if emissive else "")


def tiff(path: Path, variable: str) -> Cube:
    """Read a TIFF file with one page per band; integers are divided by their full scale."""
    import tifffile

    check_directories(path)
    with tifffile.TiffFile(path) as file:
        size = sum(
            math.prod(series.shape) * series.dtype.itemsize for series in file.series if series.dtype is not None
        )
        for page in file.pages:
            check_segments(path, page.aspage())
    plain_files.refuse_unfolding(size, path.stat().st_size, "it")
    values = tifffile.imread(path)
    if values.ndim == 2:
        values = values[None]
    if values.ndim == 3 and values.shape[2] <= 4 < values.shape[0]:
        raise RequestError(
            f"{path} is a colour picture ({values.shape}) without spectra; use the stage photograph for pictures"
        )
    told: tuple[str, ...] = ()
    if values.dtype.kind == "u":
        top = float(np.iinfo(values.dtype).max)
        values, told = values / np.float32(top), (f"integers divided by {top:.0f}",)
    return Cube(values, None, "", None, told)
