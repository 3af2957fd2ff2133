"""Light from a cube of another program: options supply what its file lacks, such as its white.

In:  a file, and the options of the command.
Out: a ``Cube`` of spectral radiance or of reflectance, and its unit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from etendue.errors import RequestError
from etendue_camera.arrays import FloatArray
from etendue_camera.importing.cube import RADIANCE, Cube, as_light, in_order, read_cube, wavelengths_of

TOO_WHITE = 1.5  # relative to white; larger values are hardly reflectances
PATCH = 5  # default side of the white patch, pixels


@dataclass(frozen=True)
class Said:
    """Options of the command that describe the content of a file."""

    variable: str
    axes: str
    wavelengths: str | None
    level: str
    scale: float | None
    white_at: str | None
    white_reflectance: float
    clip: bool


def light_of(file: Path, said: Said) -> tuple[Cube, str]:
    """Return the content of a file as light, and its unit: ``RADIANCE``, or the unit of a reflectance.

    Raises
    ------
    RequestError
        As for reading cubes; if the white patch is invalid or lies outside the picture.
    """
    cube = in_order(read_cube(file, said.variable), said.axes)
    if said.wavelengths is not None:
        cube = replace(cube, wavelength=wavelengths_of(said.wavelengths))
    if said.clip:
        cube = replace(cube, values=np.maximum(cube.values, 0))
    if said.scale is not None:
        kind = np.result_type(cube.values.dtype, np.float32)
        cube = replace(cube, values=cube.values * np.asarray(said.scale, kind))
    cube, unit = as_light(replace(cube, level=said.level or cube.level), str(file))
    if said.white_at is not None:
        try:
            y, x, *size = (int(one) for one in said.white_at.split(","))
        except ValueError:
            raise RequestError(
                f"--white-at {said.white_at}: expected a row, a column and optionally a size, in pixels"
            ) from None
        white = white_at(cube, y, x, size[0] if size else PATCH, said.white_reflectance)
        cube = replace(cube, white=white) if unit == RADIANCE else relative_to(cube, white, str(file))
    return cube, unit


def white_at(cube: Cube, y: int, x: int, size: int, reflectance: float) -> FloatArray:
    """Return the spectrum of white from a patch of known reflectance: the mean of ``size`` x ``size`` pixels at (y, x).

    Raises
    ------
    RequestError
        If the patch lies outside the picture.
    """
    half = size // 2
    top, left = y - half, x - half
    if top < 0 or left < 0 or top + size > cube.values.shape[1] or left + size > cube.values.shape[2]:
        raise RequestError(
            f"--white-at {y},{x}: the patch of {size} pixels lies outside the picture of {cube.values.shape[1:]} (y, x)"
        )
    return cube.values[:, top : top + size, left : left + size].mean(axis=(1, 2), dtype=float) / reflectance


def relative_to(cube: Cube, white: FloatArray, name: str) -> Cube:
    """Return a reflectance: values divided by white, band by band.

    Raises
    ------
    RequestError
        If white is dark in a band.
    """
    if not (white > 0).all():
        raise RequestError(
            f"{name}: the patch of --white-at is dark at {cube.wavelength[int(np.argmin(white))]:g} nm, so values "
            "cannot be divided by it"
        )
    return replace(cube, values=(cube.values / white[:, None, None]).astype(cube.values.dtype), white=None)
