"""Defective pixels: hot, dead, stuck.

In:  uniforms that belong to the sensor's pixels, or a list of absolute pixel coordinates.
Out: a map of defect kinds, and their effect on a photocurrent or a code.
Sources: kinds as in EMVA 1288 release 4 (defect pixels are the tails of the histograms of dark signal and response);
hot pixels' exponential law of dark current: Widenhorn et al. 2002 (Proc. SPIE 4669).
"""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from etendue import require

GOOD, HOT, DEAD, STUCK = 0, 1, 2, 3
KINDS = {"hot": HOT, "dead": DEAD, "stuck": STUCK}


def drawn_map(uniform: NDArray, hot: float, dead: float, stuck: float) -> NDArray:
    """Draw kinds of defects from one uniform per pixel: each kind with its fraction; a pixel has at most one kind.

    Parameters
    ----------
    uniform : (y, x) array, dimensionless
        0 <= u < 1, fixed for the sensor.
    hot, dead, stuck : float
        Fractions of all pixels, at or above 0, together at most 1.

    Returns
    -------
    (y, x) array of uint8
        0 good, 1 hot, 2 dead, 3 stuck.

    Raises
    ------
    ValueError
        If a fraction is negative or the sum is above 1.
    """
    shares = np.array([hot, dead, stuck], dtype=float)
    require.that(
        np.all(shares >= 0) and shares.sum() <= 1,
        f"hot, dead and stuck are {hot!r}, {dead!r} and {stuck!r}; they must be fractions at or above 0, together at "
        f"most 1",
    )
    found = np.zeros(uniform.shape, dtype=np.uint8)
    low = 0.0
    for kind, share in zip((HOT, DEAD, STUCK), shares, strict=True):
        found[(uniform >= low) & (uniform < low + share)] = kind
        low += float(share)
    return found


def listed_map(entries: tuple[tuple[int, int, int], ...], rows: NDArray, columns: NDArray) -> NDArray:
    """Return the kinds of the listed pixels in a window.

    Parameters
    ----------
    entries : tuple of (row, column, kind)
        Absolute coordinates, as `read_list` gives them.
    rows, columns : (n,) array
        Absolute coordinates of the window, ascending by 1.

    Returns
    -------
    (rows, columns) array of uint8
    """
    found = np.zeros((rows.size, columns.size), dtype=np.uint8)
    first_row, first_column = (round(float(line[0])) if line.size else 0 for line in (rows, columns))
    for row, column, kind in entries:
        y, x = row - first_row, column - first_column
        if 0 <= y < rows.size and 0 <= x < columns.size:
            found[y, x] = kind
    return found


def read_list(file: str | Path) -> tuple[tuple[int, int, int], ...]:
    """Read defective pixels from a CSV file with the header ``row,column,kind``.

    Parameters
    ----------
    file : path
        One line per pixel; kind is hot, dead or stuck.

    Returns
    -------
    tuple of (row, column, kind)

    Raises
    ------
    ValueError
        If the header or a line cannot be read; the message names the line.
    """
    with open(file, newline="", encoding="utf-8") as opened:
        table = csv.DictReader(line for line in opened if not line.startswith("#"))
        if table.fieldnames is None or [name.strip() for name in table.fieldnames] != ["row", "column", "kind"]:
            raise ValueError(f"{file} starts with {table.fieldnames}; expected the header row,column,kind")
        found = []
        for number, line in enumerate(table, 2):
            row, column, kind = (str(value or "").strip() for value in list(line.values())[:3])
            if not row.lstrip("-").isdigit() or not column.lstrip("-").isdigit() or kind not in KINDS:
                raise ValueError(
                    f"{file}, entry {number - 1}: {row},{column},{kind}; expected two integers and {', '.join(KINDS)}"
                )
            found.append((int(row), int(column), KINDS[kind]))
    return tuple(found)


def hot_rates(uniform: NDArray, mean_rate: float) -> NDArray:
    """Return the dark current of hot pixels, exponentially distributed with the given mean.

    Parameters
    ----------
    uniform : (...) array, dimensionless
        0 <= u < 1.
    mean_rate : float, electron/s
        At or above 0.

    Returns
    -------
    (...) array, electron/s, dtype of uniform

    Raises
    ------
    ValueError
        If the mean is negative or NaN.

    Notes
    -----
    Source: -mean ln(1 - u), the tail of dark current over the pixels of a sensor.
    """
    require.that(mean_rate >= 0, f"mean_rate is {mean_rate!r} electron/s; allowed: numbers at or above 0")
    return -uniform.dtype.type(mean_rate) * np.log1p(-uniform)
