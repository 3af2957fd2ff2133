"""The Zarr store that ``radiance_cube`` reads.

In:  a ``Cube`` that is light, its unit, the distance between samples.
Out: a folder, whole or not there.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from pathlib import Path

import numpy as np

from etendue.errors import RequestError
from etendue.types.documents import Document
from etendue_camera.importing.cube import RADIANCE, Cube

CHUNK = 512  # pixels along y and x


def level_told(cube: Cube, unit: str) -> str:
    """What the values are, with their range, and what lights them."""
    low, high = float(cube.values.min()), float(cube.values.max())
    between = f"{low:.4g} to {high:.4g}"
    if unit == RADIANCE:
        white = (
            ""
            if cube.white is not None
            else "; white is not known (--white-at): give white_luminance, and it counts as relative to white"
        )
        return f"values: spectral radiance, {between} {RADIANCE}{white}"
    return (
        f"values: reflectance, {between}; 1 = white, a perfect diffuser, in every band. Its light is the pipeline's: "
        f"illuminant under "
        "[camera], white_luminance in the stage"
    )


def size_told(cube: Cube, spacing: float | None) -> str:
    """The size of the picture on the sensor, or why it is not known."""
    rows, columns = cube.values.shape[1:]
    if spacing is not None:
        return f"on the sensor: {columns * spacing:g} x {rows * spacing:g} um (width x height), {spacing:g} um a sample"
    return (
        "on the sensor: size not known, as no --spacing was given: spacing in the stage says how far apart samples lie "
        "there; "
        f"2 um make it {2 * columns:g} x {2 * rows:g} um (width x height)"
    )


def write_store(cube: Cube, unit: str, place: Path, spacing: float | None, source: str) -> None:
    """One variable ``radiance`` with its coordinates; ``white_radiance`` where it is known.

    Raises
    ------
    RequestError
        Something stands there already.
    """
    import xarray

    if place.exists() or place.is_symlink():
        raise RequestError(f"{place} is there already; nothing is written over: give another name, -o")
    bands, rows, columns = cube.values.shape
    low, high = float(cube.values.min()), float(cube.values.max())
    attrs: Document = {"units": unit, "long_name": "spectral radiance", "source": source}
    if 0 < low <= high < math.inf:
        attrs["actual_range"] = [low, high]
    coordinates: Document = {"wavelength": ("wavelength", cube.wavelength, {"units": "nm"})}
    if bands == 1:
        raise RequestError("one band has no width: a cube has two at least")
    if spacing is not None:
        for dim, size in (("y", rows), ("x", columns)):
            coordinates[dim] = (dim, spacing * (np.arange(size) - 0.5 * (size - 1)), {"units": "um"})
    variables: Document = {"radiance": (("wavelength", "y", "x"), cube.values, attrs)}
    if cube.white is not None:
        variables["white_radiance"] = (("wavelength",), cube.white, {"units": unit if unit == RADIANCE else "1"})
    dataset = xarray.Dataset(variables, coordinates, {"title": f"from {source}"})
    place.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
    try:
        chunks = (1, min(rows, CHUNK), min(columns, CHUNK))
        dataset.to_zarr(beside / "store", zarr_format=3, consolidated=False, encoding={"radiance": {"chunks": chunks}})
        os.rename(beside / "store", place)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
