"""Spectra in SPDX files, as published by makers of lamps and filters.

In:  a file in ANSI/IES TM-27-14 format (XML).
Out: a name, wavelengths (nm), values in the units of the file.
Source: ANSI/IES TM-27-14, Electronic Transfer of Spectral Data.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from etendue import plain_files

ENDING = ".spdx"
COLUMN = "spectrum"  # the only column of such a file


def read_spdx(path: Path) -> tuple[list[str], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Read the only column of an SPDX file, as `bins.csv_rows` returns columns of a CSV file.

    Parameters
    ----------
    path : Path
        A root ``IESTM2714`` with ``SpectralDistribution`` and in it at least two
        ``<SpectralData wavelength="380.0">0.013</SpectralData>`` of ascending wavelength in nm. The header and
        ``SpectralQuantity`` are ignored.

    Returns
    -------
    names, (rows,) wavelengths in nm, (rows, 1) values

    Raises
    ------
    ValueError
        If the file is not XML of this form, has an invalid number, or wavelengths that do not ascend.
    """
    try:
        root = ElementTree.fromstring(plain_files.table(path))
    except (
        ElementTree.ParseError,
        LookupError,
        ValueError,
    ) as error:  # not XML; an unknown or multi-byte encoding
        raise ValueError(f"{path} is not an SPDX file: {error}; expected XML, preferably in UTF-8") from None
    found = [one for one in root.iter() if one.tag.rpartition("}")[2] == "SpectralData"]
    if len(found) < 2:
        raise ValueError(f"{path} has {len(found)} SpectralData elements; ANSI/IES TM-27-14 requires at least two")
    rows = np.array([[_number(path, one, one.get("wavelength")), _number(path, one, one.text)] for one in found])
    for before, after in zip(rows[:-1, 0], rows[1:, 0], strict=True):
        if not after > before:
            raise ValueError(f"{path}: wavelength {after:g} nm must be greater than {before:g} nm")
    return [COLUMN], rows[:, 0], rows[:, 1:]


def _number(path: Path, one: ElementTree.Element, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"{path}: {text!r} in SpectralData at {one.get('wavelength')} nm is not a finite number")
    return value
