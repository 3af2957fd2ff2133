"""The Zarr store that ``radiance_cube`` reads.

In:  a ``Cube`` that is valid light, its unit, the sample spacing.
Out: a folder, complete or absent.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import click
import numpy as np

from etendue.errors import RequestError
from etendue.types.documents import Document
from etendue_camera.importing.cube import RADIANCE, Cube
from etendue_camera.importing.light import TOO_WHITE, Said, light_of

CHUNK = 512  # pixels along y and x


def level_told(cube: Cube, unit: str) -> str:
    """Return a line on the values: their type, range and illuminant."""
    low, high = float(cube.values.min()), float(cube.values.max())
    between = f"{low:.4g} to {high:.4g}"
    if unit == RADIANCE:
        white = (
            ""
            if cube.white is not None
            else "; white is unknown (see --white-at): with white_luminance, values count as relative to white"
        )
        return f"values: spectral radiance, {between} {RADIANCE}{white}"
    return (
        f"values: reflectance, {between}; 1 = white, a perfect diffuser, in every band. The light is the pipeline's: "
        f"illuminant under "
        "[camera], white_luminance in the stage"
    )


def size_told(cube: Cube, spacing: float | None) -> str:
    """Return a line on the size of the picture on the sensor, or why it is unknown."""
    rows, columns = cube.values.shape[1:]
    if spacing is not None:
        return (
            f"on the sensor: {columns * spacing:g} x {rows * spacing:g} um (width x height), {spacing:g} um per sample"
        )
    return (
        "on the sensor: size unknown without --spacing; set spacing in the stage: "
        f"2 um give {2 * columns:g} x {2 * rows:g} um (width x height)"
    )


def write_store(cube: Cube, unit: str, place: Path, spacing: float | None, source: str) -> None:
    """Write the variable ``radiance`` with its coordinates, and ``white_radiance`` if known.

    Raises
    ------
    RequestError
        If the target exists.
    """
    import xarray

    if place.exists() or place.is_symlink():
        raise RequestError(f"{place} exists and is not overwritten: give another name with -o")
    bands, rows, columns = cube.values.shape
    low, high = float(cube.values.min()), float(cube.values.max())
    attrs: Document = {"units": unit, "long_name": "spectral radiance", "source": source}
    if 0 < low <= high < math.inf:
        attrs["actual_range"] = [low, high]
    coordinates: Document = {"wavelength": ("wavelength", cube.wavelength, {"units": "nm"})}
    if bands == 1:
        raise RequestError("a single band has no width: a cube must have at least two")
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


def import_command(file: Path, output: Path | None, spacing: float | None, **words: Any) -> None:
    cube, unit = light_of(file, Said(**words))
    highest = float(cube.values.max())
    if unit != RADIANCE and highest > TOO_WHITE:
        click.echo(
            f"note: 1 is white, but values reach {highest:.4g}: use --scale, or --white-at on a white patch, to get a "
            f"reflectance",
            err=True,
        )
    place = output or Path(f"{file.stem}.zarr")
    write_store(cube, unit, place, spacing, file.name)
    for text in cube.told:
        click.echo(f"note: {text}", err=True)
    bands, rows, columns = cube.values.shape
    click.echo(
        f"{place}: {bands} bands of {cube.wavelength[0]:g} to {cube.wavelength[-1]:g} nm, {columns} x {rows} samples "
        f"(width x height)"
    )
    click.echo(f"{level_told(cube, unit)}\n{size_told(cube, spacing)}")
    lines = ['use = "radiance_cube"', 'name = "scene"', f'file = "{place}"']
    if unit != RADIANCE:
        lines.append('white_luminance = "1000 cd m-2"')
    elif cube.white is None:
        lines.append(
            '# white_luminance = "1000 cd m-2"   # would treat the values as reflectance: import with --white-at '
            "instead"
        )
    if spacing is None:
        lines.append('spacing = "2 um"')
    click.echo("in a pipeline:\n[[stages]]\n" + "\n".join(lines))
