"""The content of a scene's light by frequency, computed before planning with one transform per band.

In:  a source and the grid of its output.
Out: a ``Content``, with every number rounded up to three digits, and lower bounds rounded down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.contract.arrays.coordinates import coordinates_of
from etendue.contract.arrays.dims import is_light
from etendue.contract.arrays.facts import Content
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Banded, Source, is_random
from etendue.contract.stage import Stage, arguments_of, writes_of
from etendue.contract.values.bounds import MOST_VALUES
from etendue.errors import EtendueError
from etendue.process import unwarned
from etendue.telling import foreign
from etendue.transfer import mixtures
from etendue.transfer import rings as scene_rings
from etendue.types.arrays import Array, FloatArray

LARGEST = 1 << 25  # values examined at most; for more, some bands represent their neighbours
AT_ONCE = 1 << 24  # values computed together: one band, or all if the source cannot compute single bands


def light_of(source: type[Source]) -> str | None:
    """Return the name of the variable in which a source writes light by band and place; None if it writes none."""
    return next((d.variable for d in writes_of(source).values() if len(d.dims) == 3 and is_light(d.dims)), None)


def content_of(source: Source, grids: Mapping[str, Grid]) -> Content | None:
    """Return the power of a scene's light by band and spatial frequency (a ``Content``). Return None if the light is
    not samples of a band-limited function, if the scene draws random numbers, if it has more than 17 million samples
    per band, or if it cannot be computed; the run then reports the reason.
    """
    try:
        with np.errstate(all="ignore"), unwarned():
            return _looked_at(source, grids)
    except (EtendueError, ValueError, OSError, MemoryError, FloatingPointError):
        return None


def _looked_at(source: Source, grids: Mapping[str, Grid]) -> Content | None:
    variable = light_of(type(source))
    if variable is None or is_random(type(source)):
        return None
    grid = grids[variable]
    y, x = grid.line("y"), grid.line("x")
    together = y.size * x.size if isinstance(source, Banded) else grid.count
    if y.cells or x.cells or together > AT_ONCE or grid.count > MOST_VALUES:
        return None
    edges = scene_rings.ring_edges(y.size, x.size, y.step, x.step)
    widths = scene_rings.blur_widths(y.size, x.size, y.step, x.step)
    if (mixture := _mixture(source, grids)) is not None:
        parts, weights = mixture
        found = mixtures.looked_at(parts, weights, (y.step, x.step), edges, widths)
        whole = _content(found, edges, widths, len(found)) if found else None
        return whole and replace(whole, white=_white(source, grids))
    rows: list[Any] = []
    for planes in _planes(source, grids, variable):
        if not isinstance(planes, np.ndarray) or planes.dtype.kind != "f" or planes.shape[1:] != (y.size, x.size):
            return None
        for plane in planes:
            low, high, mean = float(plane.min()), float(plane.max()), float(plane.mean(dtype=np.float64))
            if not math.isfinite(low + high):
                return None
            own = np.asarray(plane, dtype=np.float32) / np.float32(high or 1.0)
            power, amplitude = scene_rings.ring_sums(own, y.step, x.step, edges)
            peaks = scene_rings.largest_behind(own, y.step, x.step, widths) if high > 0 else 0 * widths
            rows.append((low, mean, high, power * high**2, amplitude * abs(high), peaks * high))
    return replace(_content(rows, edges, widths, grid.bands().size), white=_white(source, grids))


def _mixture(source: Source, grids: Mapping[str, Grid]) -> tuple[Sequence[Array], FloatArray] | None:
    if not isinstance(source, Banded):
        return None
    given = {**coordinates_of(grids), **coordinates_of(grids, "out_")}
    with foreign(f"{type(source).__name__}.mixture"):
        return source.mixture(source.prepare(given))


def _white(source: Source, grids: Mapping[str, Grid]) -> tuple[float, ...]:
    """Return the light of a white surface by band, from the constants that the source declares; () unless it declares
    this light.
    """
    if not isinstance(source, Banded):
        return ()
    given = {**coordinates_of(grids), **coordinates_of(grids, "out_")}
    with foreign(f"{type(source).__name__}.constants"):
        constants = source.constants(source.prepare(given))
    found = [constants[name] for name, grid in grids.items() if name in constants and grid.banded]
    return tuple(_up(float(value)) for value in found[0]) if len(found) == 1 else ()


def _content(rows: list[Any], edges: FloatArray, widths: FloatArray, bands: int) -> Content:
    """Return the content of all bands, given (low, mean, high, power, amplitude, peaks) of the examined bands."""
    full = max(max(abs(row[0]), abs(row[2])) for row in rows)
    if full == 0:
        full, rows = 0.0, [(0.0, 0.0, 0.0, 0 * row[3], 0 * row[4], 0 * row[5]) for row in rows]
    own = full or 1.0
    # Each band that was not examined is represented by the nearest one that was.
    every = [rows[min(round(band * len(rows) / bands), len(rows) - 1)] for band in range(bands)]
    return Content(
        _up(full),
        tuple(map(float, edges)),
        tuple(tuple(_up(v / own**2) for v in row[3]) for row in every),
        tuple(tuple(_up(v / own) for v in row[4]) for row in every),
        tuple(-_up(-row[0] / own) for row in every),
        tuple(_up(row[1] / own) for row in every),
        tuple(_up(row[2] / own) for row in every),
        widths=tuple(map(float, widths)),
        peaks=tuple(tuple(-_up(-v / own) for v in row[5]) for row in every),
    )


def _planes(source: Source, grids: Mapping[str, Grid], variable: str) -> Iterator[Array]:
    """Yield the scene's light, some bands at a time; only every n-th band if there are too many values."""
    grid = grids[variable]
    given = {**coordinates_of(grids), **coordinates_of(grids, "out_")}
    count, size = grid.bands().size, grid.line("y").size * grid.line("x").size
    own: Any = source
    with foreign(f"{type(source).__name__}.prepare"):
        prepared = None if type(source).prepare is Stage.prepare else own.prepare(given)

    def made(part: Any) -> FloatArray:
        asked = {"asked": frozenset[str]()} | given | ({"prepared": part} if part is not None else {})
        with foreign(f"{type(source).__name__}.run"):
            return own.run(**{name: asked[name] for name in arguments_of(type(source))}).get(variable)

    if not isinstance(source, Banded) or count * size <= AT_ONCE:
        yield made(prepared)
        return
    for band in range(0, count, max(1, math.ceil(count * size / LARGEST))):
        with foreign(f"{type(source).__name__}.by_band"):
            part = own.by_band(prepared, slice(band, band + 1))
        yield made(part)


def _up(value: float) -> float:
    """Return the value rounded up to three digits."""
    if value == 0 or not math.isfinite(value):
        return value
    digits = 2 - math.floor(math.log10(abs(value)))
    scale = 10.0**digits if digits < 300 else 1e300
    return math.ceil(value * scale - 1e-9) / scale
