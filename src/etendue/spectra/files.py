"""Spectral tables in files: comma-separated text, or the exchange format of the lighting industry.

In:  the path of a table.
Out: names of its columns, wavelengths (nm), values: float64.
Sources: IES TM-27-14, Standard Format for the Electronic Transfer of Spectral Data (``.spdx``, one spectrum a file).
"""

from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def read_table(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    """A table of spectra.

    Parameters
    ----------
    path : Path
        ``.csv``: header ``wavelength_nm,a,b,...``, then at least two rows of numbers with ascending wavelengths, in any spacing. ``#``
        starts a comment; empty lines are skipped; UTF-8. ``.spdx``: IES TM-27-14, of which colour-science reads wavelengths and values;
        its one column has the name of the file.

    Returns
    -------
    names : list of k str
    wavelengths : (rows,) array, nm, ascending
    values : (rows, k) array in the units of the file

    Raises
    ------
    ValueError
        A broken file, naming file and line.
    """
    return _read_spdx(path) if path.suffix == ".spdx" else _read_csv(path)


def _read_spdx(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    from colour import SpectralDistribution_IESTM2714

    path.open("rb").close()  # what is not there is said as of any file
    try:
        found = SpectralDistribution_IESTM2714(str(path)).read()
        rows, values = np.asarray(found.wavelengths, dtype=float), np.asarray(found.values, dtype=float)
    except (ParseError, ValueError, KeyError, AttributeError, TypeError, AssertionError) as error:
        raise ValueError(f"{path}: no spectrum of IES TM-27-14 ({error}); expected the XML of an .spdx file, or a .csv table") from None
    if rows.size < 2:
        raise ValueError(f"{path}: {rows.size} wavelengths; at least two are needed")
    if not (np.isfinite(rows).all() and np.isfinite(values).all()):
        raise ValueError(f"{path}: a wavelength or a value is not a finite number")
    return [path.stem], rows, values[:, None]


def _read_csv(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a UTF-8 text file ({error.reason} at byte {error.start})") from error
    numbered = enumerate(text.splitlines(), start=1)
    stripped = ((number, line.partition("#")[0].strip()) for number, line in numbered)
    lines = [(number, [cell.strip() for cell in line.split(",")]) for number, line in stripped if line]
    if not lines:
        raise ValueError(f"{path}: no header; expected 'wavelength_nm,a,b,...'")
    first, header = lines[0]
    names = header[1:]
    if header[0] != "wavelength_nm" or not names or not all(names) or len(set(names)) < len(names):
        raise ValueError(f"{path}, line {first}: header {','.join(header)!r}; expected 'wavelength_nm,a,b,...' with distinct names")
    rows = [_csv_row(path, number, cells, header) for number, cells in lines[1:]]
    if len(rows) < 2:
        raise ValueError(f"{path}: {len(rows)} rows of numbers; at least two are needed")
    table = np.array(rows)
    for (number, _), before, after in zip(lines[2:], table[:-1, 0], table[1:, 0], strict=True):
        if not after > before:
            raise ValueError(f"{path}, line {number}: wavelength {after:g} nm does not ascend from {before:g} nm")
    return names, table[:, 0], table[:, 1:]


def _csv_row(path: Path, number: int, cells: list[str], header: list[str]) -> list[float]:
    if len(cells) != len(header):
        raise ValueError(f"{path}, line {number}: {len(cells)} cells, but the header has {len(header)}")
    values = []
    for cell, name in zip(cells, header, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ValueError(f"{path}, line {number}: {cell!r} in column {name!r} is not a finite number")
        values.append(value)
    return values
