"""Field curves from CSV files: relative illumination or angular response, in one column or one per wavelength.

In:  the path of a CSV file, the allowed names of its first column.
Out: the curve, cached until the file changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from etendue import require
from etendue.contract.stage import file_state
from etendue_camera.arrays import FloatArray
from etendue_camera.field.illumination import table_at


@dataclass(frozen=True)
class FieldTable:
    """The rows of a table. ``wavelengths`` is empty where one column applies to all."""

    path: str
    axis: str
    nodes: FloatArray
    values: FloatArray  # (rows, columns)
    wavelengths: tuple[float, ...]

    def centre(self) -> FloatArray:
        """Return each column's value at 0."""
        return np.array([float(table_at(0.0, self.nodes, column)) for column in self.values.T])

    def curves(self, wavelength_nm: FloatArray) -> FloatArray:
        """Return each column relative to its value at 0, (wavelength or 1, rows): linear between columns, constant
        outside."""
        relative = self.values / self.centre()
        return (
            np.stack([np.interp(wavelength_nm, self.wavelengths, row) for row in relative], axis=1)
            if self.wavelengths
            else relative.T
        )

    def range(self, low: float, high: float) -> tuple[float, float]:
        """Return the smallest and largest relative value of any column between two places."""
        inside = self.nodes[(self.nodes > low) & (self.nodes < high)]
        places = np.concatenate([[low], inside, [high]])
        found = np.array([table_at(places, self.nodes, column) for column in (self.values / self.centre()).T])
        return float(found.min()), float(found.max())

    def remarks(self, reach: float, unit: str, bands_nm: list[float]) -> list[str]:
        """Return notes for the user: a table that is not 1 on the axis, a frame or light that it does not cover."""
        found, centre = [], self.centre()
        if np.any(np.abs(centre - 1) > 1e-9):
            found.append(
                f"{self.path} is {', '.join(f'{value:.6g}' for value in centre)} on axis, not 1: it is divided by "
                f"this value"
            )
        if reach > self.nodes[-1] * (1 + 1e-9):
            found.append(
                f"{self.path} ends at {self.nodes[-1]:g}, but the frame corner is at {reach:.4g} {unit}: the last "
                "value is used there"
            )
        if len(self.wavelengths) > 1:
            first, last = self.wavelengths[0], self.wavelengths[-1]
            before, behind = (0.5 * (self.wavelengths[i + 1] - self.wavelengths[i]) for i in (0, -2))
            if bands_nm[0] < first - before or bands_nm[-1] > last + behind:
                found.append(f"{self.path} has {first:g} to {last:g} nm; outside this range the nearest column is used")
        return found


def field_table(path: str, axes: tuple[str, ...]) -> FieldTable:
    """Read ``<axis>,ratio`` or ``<axis>,450,550,650`` (columns by wavelength, nm).

    Raises
    ------
    ValueError
        If the file is invalid, naming file and line: wrong first column, rows that do not ascend, values that are
        not finite or negative, no value on the axis.
    """
    return _read(path, axes, file_state(path))


@lru_cache(maxsize=64)
def _read(path: str, axes: tuple[str, ...], state: tuple[int, int]) -> FieldTable:
    try:
        with open(path, encoding="utf-8-sig") as file:
            numbered = [(n, line.partition("#")[0].strip()) for n, line in enumerate(file, 1)]
    except OSError as error:
        raise ValueError(f"{path}: cannot read: {error.strerror}") from None
    lines = [(n, [cell.strip() for cell in text.split(",")]) for n, text in numbered if text]
    expected = " or ".join(f"'{axis},ratio'" for axis in axes) + ", or wavelengths in nm in place of 'ratio'"
    require.that(lines and lines[0][1][0] in axes and len(lines[0][1]) >= 2, f"{path}: expected a header {expected}")
    header = lines[0][1]
    table = np.array(_rows(path, header, lines[1:]))
    table.flags.writeable = False
    read = FieldTable(path, header[0], table[:, 0], table[:, 1:], _wavelengths(path, header[1:]))
    if not (read.nodes[0] <= 0 <= read.nodes[-1]) or np.any(read.centre() <= 0):
        raise ValueError(
            f"{path}: a row at {header[0]} 0 with ratios above 0 is required: all values are relative to the axis"
        )
    return read


def _rows(path: str, header: list[str], lines: list[tuple[int, list[str]]]) -> list[list[float]]:
    """Return the numbers, whose first column must ascend."""
    rows: list[list[float]] = []
    for number, cells in lines:
        row = [_number(cell) for cell in cells]
        if len(row) != len(header) or not np.all(np.isfinite(row)):
            raise ValueError(f"{path}, line {number}: expected {len(header)} finite numbers, got {','.join(cells)!r}")
        if rows and row[0] <= rows[-1][0]:
            raise ValueError(f"{path}, line {number}: {header[0]} {row[0]:g} must be greater than {rows[-1][0]:g}")
        if min(row[1:]) < 0:
            raise ValueError(f"{path}, line {number}: ratios must not be negative")
        rows.append(row)
    require.that(len(rows) >= 2, f"{path}: {len(rows)} rows of numbers; at least two are required")
    return rows


def _wavelengths(path: str, names: list[str]) -> tuple[float, ...]:
    """Return the wavelengths that name the columns; empty for one column with another name."""
    found = tuple(_number(name) for name in names)
    if len(names) == 1 and math.isnan(found[0]):
        return ()
    require.that(
        all(a < b for a, b in pairwise(found)) and not any(map(math.isnan, found)),
        f"{path}: columns {', '.join(names)}; several columns must be named by ascending wavelengths in nm",
    )
    return found


def _number(text: str) -> float:
    """Return the number in the text, or NaN if it is not a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan
