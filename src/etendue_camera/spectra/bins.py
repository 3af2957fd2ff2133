"""Means over wavelength bins, and tables from CSV and SPDX files.

In:  the rows of a table (nm, values) and bin edges (n + 1 ascending values, nm).
Out: plain float64 arrays, one mean per bin.

A bin mean is the exact integral of a piecewise-linear interpolant divided by the bin width, so that means over parts of
a bin average to the mean over the bin. For values beyond the end of a table see `ends`.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from etendue import plain_files, require
from etendue_camera.spectra.ends import beyond, reach_of
from etendue_camera.spectra.named import spectrum
from etendue_camera.spectra.spdx import ENDING, read_spdx

FloatArray = npt.NDArray[np.float64]
Edges = Sequence[float] | FloatArray
Outside = Literal["zero", "hold"]
REMEMBERED = 256 << 10  # bytes of the largest file whose numbers are cached; up to 32 files are


# ------------------------------------------------------------------------------------------------ bin means


def checked_edges(edges: Edges) -> tuple[float, ...]:
    array = np.asarray(edges, dtype=np.float64)
    require.that(
        array.ndim == 1 and array.size >= 2,
        f"edges must be one axis of at least two wavelengths [nm], got shape {array.shape}",
    )
    if not (np.all(np.isfinite(array)) and array[0] > 0 and np.all(np.diff(array) > 0)):
        raise ValueError(f"edges must be finite, positive and strictly ascending [nm], got {array}")
    return tuple(array.tolist())


def frozen(array: npt.ArrayLike) -> FloatArray:
    result = np.array(array, dtype=np.float64)
    result.setflags(write=False)
    return result


def bin_means(nodes: FloatArray, values: FloatArray, edges: tuple[float, ...], outside: Outside) -> FloatArray:
    """Return exact means of the piecewise-linear curve through (nodes, values) over each bin.

    Every area is a sum of trapezoids inside its own bin: differences of one running integral would lose the
    small values in the feet of a curve to cancellation.
    """
    bounds = np.asarray(edges)
    grid = np.union1d(nodes, bounds)
    grid = grid[(grid >= bounds[0]) & (grid <= bounds[-1])]
    columns = values.reshape(len(nodes), -1)
    curve = np.stack([np.interp(grid, nodes, column) for column in columns.T], axis=1)
    areas = 0.5 * (curve[1:] + curve[:-1]) * np.diff(grid)[:, None]
    if outside == "zero":
        inside = (grid[:-1] >= nodes[0]) & (grid[1:] <= nodes[-1])
        areas *= inside[:, None]
    sums = np.add.reduceat(areas, np.searchsorted(grid, bounds[:-1]), axis=0)
    return (sums / np.diff(bounds)[:, None]).reshape((len(edges) - 1, *values.shape[1:]))


def with_reach(rows: FloatArray, nodes: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Extend a curve with its end values over the range that the rows of its table cover (`ends.reach_of`)."""
    first, last = reach_of(rows)
    return np.concatenate([[first], nodes, [last]]), np.concatenate([values[:1], values, values[-1:]])


# -------------------------------------------------------------------------------------------------- CSV files


def table_from_csv(
    path: str | Path, edges: Edges, columns: Iterable[str] | None = None, outside: Outside = "zero"
) -> tuple[list[str], FloatArray]:
    """Return bin means of a table in a CSV file.

    Parameters
    ----------
    path : str or Path
        Header ``wavelength_nm,a,b,...``, then at least two rows of numbers with ascending wavelengths, in any
        spacing. ``#`` starts a comment; empty lines are skipped; UTF-8. Or an SPDX file: one column (`spdx`).
    edges : (n + 1,) ascending, nm
    columns : names, optional
        Columns to return, in this order; default: all.
    outside : {"zero", "hold"}
        Value at wavelengths more than half a step outside the first or last row: 0, or the value of that row. Within
        half a step the value of the row is used.

    Returns
    -------
    names : list of k str
    means : (n, k) array in the units of the file

    Raises
    ------
    ValueError
        If the file is invalid (the message names file and line), or lacks a column.
    """
    checked = checked_edges(edges)
    names, nodes, values = _read_csv(Path(spectrum(str(path)) or path))
    wanted = names if columns is None else list(columns)
    for name in wanted:
        require_name(name, names, f"column of {path}:")
    chosen = values[:, [names.index(name) for name in wanted]]
    found = _means(_Rows((nodes.tobytes(), chosen.tobytes()), nodes, chosen), checked, outside)
    return wanted, found.copy(order="K")


@dataclass(frozen=True)
class _Rows:
    """Rows of a table; two objects with the same numbers are equal."""

    numbers: tuple[bytes, bytes]
    nodes: FloatArray = field(compare=False)
    values: FloatArray = field(compare=False)


@lru_cache(maxsize=64)  # planning asks for the same means several times
def _means(rows: _Rows, edges: tuple[float, ...], outside: Outside) -> FloatArray:
    return bin_means(*with_reach(rows.nodes, rows.nodes, rows.values), edges, outside)


def csv_rows(path: str | Path) -> tuple[list[str], FloatArray, FloatArray]:
    """Return the column names (k), wavelengths (rows,) in nm and values (rows, k) of a table, as `table_from_csv` reads
    them.

    A name under which a distribution provides a table works like a path.
    """
    return _read_csv(Path(spectrum(str(path)) or path))


def require_rows(path: str | Path, edges: Edges) -> None:
    """Raise ValueError for a table whose rows do not cover all of these wavelengths (`ends.beyond`), where neither 0
    nor an end value would be valid.
    """
    rows, bounds = csv_rows(path)[1], checked_edges(edges)
    if max(beyond(rows, bounds[0], bounds[-1])) > 1e-9:
        raise ValueError(
            f"{path} has rows from {rows[0]:g} to {rows[-1]:g} nm, but the light extends from {bounds[0]:g} to "
            f"{bounds[-1]:g} nm; "
            "add rows, or narrow the scene's wavelengths"
        )


def _read_csv(path: Path) -> tuple[list[str], FloatArray, FloatArray]:
    if path.suffix == ENDING:
        return read_spdx(path)
    content = plain_files.table(path)
    names, table = _parsed(path, content) if len(content) <= REMEMBERED else _parsed.__wrapped__(path, content)
    table = table.copy()  # a copy, so that a caller cannot change the cached arrays
    return list(names), table[:, 0], table[:, 1:]


@lru_cache(maxsize=32)  # cached by content, because planning reads a table several times
def _parsed(path: Path, content: bytes) -> tuple[list[str], FloatArray]:
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: not a UTF-8 text file ({error.reason} at byte {error.start})") from error
    numbered = enumerate(text.splitlines(), start=1)
    stripped = ((number, line.partition("#")[0].strip()) for number, line in numbered)
    lines = [(number, [cell.strip() for cell in line.split(",")]) for number, line in stripped if line]
    require.that(lines, f"{path}: no header; expected 'wavelength_nm,a,b,...'")
    first, header = lines[0]
    names = header[1:]
    require.that(
        header[0] == "wavelength_nm" and names and all(names) and len(set(names)) >= len(names),
        f"{path}, line {first}: header {','.join(header)!r}; expected 'wavelength_nm,a,b,...' with distinct names",
    )
    rows = [_csv_row(path, number, cells, header) for number, cells in lines[1:]]
    require.that(len(rows) >= 2, f"{path}: {len(rows)} rows of numbers; at least two are required")
    table = np.array(rows)
    for (number, _), before, after in zip(lines[2:], table[:-1, 0], table[1:, 0], strict=True):
        if not after > before:
            raise ValueError(f"{path}, line {number}: wavelength {after:g} nm must be greater than {before:g} nm")
    return names, table


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


def require_name(name: str, names: Collection[str], kind: str, besides: str = "") -> None:
    """Raise ValueError, with the nearest names, if a name is not in the list."""
    if name in list(names):  # a list, because key views of colour also match other spellings
        return
    spelled = {candidate.casefold(): candidate for candidate in names}
    nearest = [spelled[n] for n in get_close_matches(str(name).casefold(), spelled, n=5, cutoff=0.4)]
    shown = nearest or sorted(names)[:12]
    label = "nearest names" if nearest else "known names"
    tail = f"; also {besides}" if besides else ""
    raise ValueError(f"unknown {kind} {name!r}; {label}: {', '.join(map(repr, shown))}{tail}")
