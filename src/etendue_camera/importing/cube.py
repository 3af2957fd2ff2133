"""A spectral cube as it was read: values, wavelengths, level; and what is said of it where a file does not.

In:  a file, its format by its name; words of the command line.
Out: a ``Cube`` that is light: wavelengths ascend, values are finite, nowhere below 0.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError, nearest
from etendue_camera.importing.formats import FORMATS

RADIANCE = "W m-2 sr-1 nm-1"
RELATIVE = "1"
LEVELS = {  # words of --level: unit, factor to it
    "radiance": (RADIANCE, 1.0),
    "W m-2 sr-1 um-1": (RADIANCE, 1e-3),
    "mW m-2 sr-1 nm-1": (RADIANCE, 1e-3),
    "uW cm-2 sr-1 nm-1": (RADIANCE, 1e-2),
    "photons": (RADIANCE, 1.0),  # s-1 sr-1 m-2 nm-1: each carries h c / wavelength
    "relative": (RELATIVE, 1.0),
}
PICTURES = (".jpg", ".jpeg", ".png", ".dng", ".nef", ".cr2", ".cr3", ".arw", ".heic", ".webp", ".bmp")
PLANCK_LIGHT = 6.62607015e-34 * 299792458.0  # J m


@dataclass(frozen=True)
class Cube:
    """Spectral light by (wavelength, y, x).

    Attributes
    ----------
    values : (wavelength, y, x)
    wavelength : centres of the bands in nm; None where the file does not say
    level : a word of ``LEVELS``; '' where the file does not say
    white : of a perfect diffuser by band, in the unit of the values; None where nobody knows
    """

    values: Any
    wavelength: Any = None
    level: str = ""
    white: Any = None
    told: tuple[str, ...] = ()  # where what is known comes from


def read_cube(path: Path, variable: str = "") -> Cube:
    """What a file holds; ``variable``: the array in it, where there are several.

    Raises
    ------
    RequestError
        There is no such file, its format is unknown or needs a reader that is not installed, or it holds no cube.
    """
    if not path.exists():
        names = [one.name for one in path.parent.iterdir()] if path.parent.is_dir() else []
        raise RequestError(f"there is no file {path}{nearest(path.name, names)}")
    reader = _reader(path)
    try:
        plain_files.check_plain(path)
        cube = reader(path, variable)
    except RequestError:
        raise
    except Exception as error:  # of a reader of somebody else, which knows many ways to break off
        raise RequestError(
            f"{path} cannot be read as {path.suffix}: {' '.join(str(error).split())[:200] or type(error).__name__}"
        ) from None
    if cube.values.ndim != 3 or 0 in cube.values.shape or cube.values.dtype.kind not in "fiu":
        raise RequestError(f"{path} holds {cube.values.dtype} {cube.values.shape}; expected numbers by three axes")
    return cube


def _reader(path: Path) -> Callable[[Path, str], Cube]:
    suffix = path.suffix.lower()
    if suffix in (".img", ".dat", ".raw", ".bil", ".bip", ".bsq") and path.with_suffix(".hdr").exists():
        raise RequestError(f"{path} is described by its header: import {path.with_suffix('.hdr')}")
    if suffix in PICTURES:
        raise RequestError(
            f"{path} is a picture, of colours, not of spectra: the stage photograph takes it as a scene, etendue "
            f"measure measures it"
        )
    if suffix not in FORMATS:
        raise RequestError(f"{path}: files {suffix or 'without an ending'} are unknown; known are {', '.join(FORMATS)}")
    found: Callable[[Path, str], Cube] = FORMATS[suffix].reader()
    return found


def needed(module: str, what: str) -> Any:
    """A reader from an extra of the distribution."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise RequestError(f"{what} needs a reader that is not installed: pip install 'etendue[cubes]'") from None


def wavelengths_of(text: str) -> Any:
    """Centres in nm: ``400:700:10``, ``450,550,650``, or a file with a number a line.

    Raises
    ------
    RequestError
        It is none of these.
    """
    try:
        if ":" in text:
            first, last, step = (float(part) for part in text.split(":"))
            count = round((last - first) / step) + 1
            if not step > 0 or count < 1 or abs(first + (count - 1) * step - last) > 1e-6 * step:
                raise ValueError
            return first + step * np.arange(count)
        if Path(text).is_file():
            return np.array([float(line.split(",")[0]) for line in Path(text).read_text().splitlines() if line.strip()])
        return np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise RequestError(
            f"--wavelengths {text}: expected FIRST:LAST:STEP, a list of numbers, or a file with one a line, in nm"
        ) from None


def in_order(cube: Cube, axes: str) -> Cube:
    """With its axes as (wavelength, y, x); ``axes``: what they are in the file, such as ``yxw``, or '' where the reader
    knows.

    Raises
    ------
    RequestError
        The axes are not these three.
    """
    if not axes:
        return cube
    if sorted(axes) != sorted("wyx"):
        raise RequestError(f"--axes {axes}: expected the letters w, y and x in the order of the file, such as yxw")
    return replace(cube, values=np.transpose(cube.values, [axes.index(one) for one in "wyx"]))


def as_light(cube: Cube, name: str) -> tuple[Cube, str]:
    """Values in the unit of their level, wavelengths ascending; gives the unit too.

    Raises
    ------
    RequestError
        Wavelengths or level are not known or do not fit, or a value is no light.
    """
    if cube.wavelength is None:
        raise RequestError(f"{name} does not say its wavelengths: --wavelengths FIRST:LAST:STEP, in nm")
    wavelength = np.asarray(cube.wavelength, dtype=float)
    if wavelength.shape != cube.values.shape[:1]:
        axes = f"its axes are {cube.values.shape} as wavelength, y, x"
        raise RequestError(
            f"{name}: {wavelength.size} wavelengths for {cube.values.shape[0]} bands; {axes} (others: --axes)"
        )
    if not cube.level:
        raise RequestError(
            f"{name} does not say its level: --level radiance ({RADIANCE}), relative (1 = white), or "
            f"{', '.join(LEVELS)}"
        )
    if cube.level not in LEVELS:
        raise RequestError(f"--level {cube.level}: {nearest(cube.level, LEVELS)[2:]}")
    order = np.argsort(wavelength, kind="stable")
    wavelength, values = (
        wavelength[order],
        cube.values[order].astype(np.float32 if cube.values.dtype.itemsize <= 4 else np.float64),
    )
    if not (np.diff(wavelength) > 0).all() or not wavelength[0] > 100:
        raise RequestError(
            f"{name}: wavelengths must differ and be above 100 nm; they begin with {wavelength[:3].tolist()}"
        )
    unit, factor = LEVELS[cube.level]
    scale = np.full(wavelength.size, factor)
    if cube.level == "photons":
        scale = PLANCK_LIGHT / (wavelength * 1e-9)
    values *= scale[:, None, None].astype(values.dtype)
    bad = ~np.isfinite(values) | (values < 0)
    if bad.any():
        band, y, x = (int(i) for i in np.argwhere(bad)[0])
        what = f"{values[band, y, x]:g} in band {band}, row {y}, column {x}"
        way_out = (
            "--clip takes what is below 0 as 0"
            if np.isfinite(values).all()
            else "mend what is not finite in the file first"
        )
        raise RequestError(f"{name} holds {int(bad.sum())} values that are no light, the first {what}; {way_out}")
    white = None if cube.white is None else np.asarray(cube.white, dtype=float)[order] * scale
    return replace(cube, values=values, wavelength=wavelength, white=white), unit
