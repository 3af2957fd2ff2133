"""A spectral cube: values, wavelengths, level. The user states the facts that the file does not contain.

In:  a file, its format by extension; command-line options.
Out: a ``Cube`` that is valid light: wavelengths ascend, values are finite and not negative.
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
LEVELS = {  # by the words of --level: unit of the cube, factor to this unit
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
    wavelength : band centres in nm; None if the file does not give them
    level : a key of ``LEVELS``; '' if the file does not give it
    white : spectrum of a perfect diffuser by band, in the unit of the values; None if unknown
    """

    values: Any
    wavelength: Any = None
    level: str = ""
    white: Any = None
    told: tuple[str, ...] = ()  # where wavelengths, level and white come from


def read_cube(path: Path, variable: str = "") -> Cube:
    """Read the content of a file; ``variable``: the array in it, if there are several.

    Raises
    ------
    RequestError
        If the file does not exist, its format is unknown or needs a missing reader, or it has no cube.
    """
    if not path.exists():
        names = [one.name for one in path.parent.iterdir()] if path.parent.is_dir() else []
        raise RequestError(f"no such file: {path}{nearest(path.name, names)}")
    reader = _reader(path)
    try:
        plain_files.check_plain(path)
        cube = reader(path, variable)
    except RequestError:
        raise
    except Exception as error:  # third-party readers raise many kinds of errors
        raise RequestError(
            f"{path} could not be read as {path.suffix}: {' '.join(str(error).split())[:200] or type(error).__name__}"
        ) from None
    if cube.values.ndim != 3 or 0 in cube.values.shape or cube.values.dtype.kind not in "fiu":
        raise RequestError(
            f"{path} has {cube.values.dtype} data of shape {cube.values.shape}; expected a numeric array with three "
            "axes"
        )
    return cube


def _reader(path: Path) -> Callable[[Path, str], Cube]:
    suffix = path.suffix.lower()
    if suffix in (".img", ".dat", ".raw", ".bil", ".bip", ".bsq") and path.with_suffix(".hdr").exists():
        raise RequestError(f"{path} is the data file of a header: import {path.with_suffix('.hdr')}")
    if suffix in PICTURES:
        raise RequestError(
            f"{path} is a colour picture without spectra: use it as a scene with the stage photograph, or measure it "
            "with etendue measure"
        )
    if suffix not in FORMATS:
        raise RequestError(
            f"{path}: unknown file format {suffix or 'without extension'}; known are {', '.join(FORMATS)}"
        )
    found: Callable[[Path, str], Cube] = FORMATS[suffix].reader()
    return found


def needed(module: str, what: str) -> Any:
    """Return a module from the optional dependencies ``cubes``; raise RequestError if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise RequestError(f"{what} requires a reader that is not installed: pip install 'etendue[cubes]'") from None


def wavelengths_of(text: str) -> Any:
    """Parse band centres in nm: ``400:700:10``, ``450,550,650``, or a file with one number per line.

    Raises
    ------
    RequestError
        If the text is none of these.
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
            f"--wavelengths {text}: expected FIRST:LAST:STEP, a list of numbers, or a file with one number per line, "
            "in nm"
        ) from None


def in_order(cube: Cube, axes: str) -> Cube:
    """Return the cube with axes (wavelength, y, x); ``axes``: their order in the file, such as ``yxw``; '' if the
    reader has already put them in this order.

    Raises
    ------
    RequestError
        If the axes are not these three.
    """
    if not axes:
        return cube
    if sorted(axes) != sorted("wyx"):
        raise RequestError(f"--axes {axes}: expected the letters w, y and x in file order, such as yxw")
    return replace(cube, values=np.transpose(cube.values, [axes.index(one) for one in "wyx"]))


def as_light(cube: Cube, name: str) -> tuple[Cube, str]:
    """Convert values to the unit of their level and sort wavelengths; return the cube and the unit.

    Raises
    ------
    RequestError
        If wavelengths or level are unknown or do not fit, or a value is not valid light.
    """
    if cube.wavelength is None:
        raise RequestError(f"{name} does not give its wavelengths: use --wavelengths FIRST:LAST:STEP, in nm")
    wavelength = np.asarray(cube.wavelength, dtype=float)
    if wavelength.shape != cube.values.shape[:1]:
        axes = f"its axes are {cube.values.shape} as wavelength, y, x"
        raise RequestError(
            f"{name}: {wavelength.size} wavelengths for {cube.values.shape[0]} bands; {axes} (change with --axes)"
        )
    if not cube.level:
        raise RequestError(
            f"{name} does not give its level: use --level radiance ({RADIANCE}), relative (1 = white), or "
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
            f"{name}: wavelengths must differ and be above 100 nm; they start with {wavelength[:3].tolist()}"
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
            "use --clip to set negative values to 0"
            if np.isfinite(values).all()
            else "correct the non-finite values in the file first"
        )
        raise RequestError(f"{name} has {int(bad.sum())} invalid radiance values, the first {what}; {way_out}")
    white = None if cube.white is None else np.asarray(cube.white, dtype=float)[order] * scale
    return replace(cube, values=values, wavelength=wavelength, white=white), unit
