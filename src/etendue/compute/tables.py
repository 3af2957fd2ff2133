"""The per-process cache between cells: coordinates, prepared tables, fixed patterns, transfer functions.

In:  grids and stages.
Out: read-only arrays, computed once and kept while there is room.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from etendue.compute.random import tiled_normal, tiled_uniform
from etendue.contract.arrays.coordinates import coordinates_of
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.capabilities import bands_of
from etendue.contract.stage import Stage, state_of
from etendue.telling import foreign
from etendue.types.arrays import FloatArray

LARGEST_CACHE = 256 << 20
LARGEST_TRANSFORMS = 48 << 20  # bytes of transforms among them: few of a sweep are used again
# bytes; patterns of larger frames are not cached, since strips would evict each other before they are reused
LARGEST_PATTERN = LARGEST_CACHE // 4
LASTING = 50  # an entry unused for this many runs is dropped
LARGEST_SHARED = 1 << 18  # pixels; up to this size the raw normals are cached too, for use with other strengths
Window = tuple[int, int, int, int]  # first row, first column, rows, columns


class Key:
    """A key that computes its hash once: for a stage with its grids, hashing costs more than the look-up itself."""

    __slots__ = ("taken", "value")

    def __init__(self, value: Hashable) -> None:
        self.value, self.taken = value, hash(value)

    def __hash__(self) -> int:
        return self.taken

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Key) and self.value == other.value


@dataclass(slots=True)
class _Entry:
    value: Any
    size: int
    run: int  # the last run that used it
    transform: bool


Made = TypeVar("Made")


class Cache:
    """A cache of values by key. Values are dropped if the cache exceeds a number of bytes (the least recently used
    first), or if a value was not used for a number of runs of the process.

    Shared by the threads of a process.
    """

    def __init__(self, largest: int) -> None:
        self.largest, self.held, self.runs = largest, 0, 0
        self.entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self.lock = threading.Lock()
        self.making: dict[Hashable, threading.Lock] = {}

    def get(self, key: Hashable, make: Callable[[], Made], transform: bool = False) -> Made:
        """Return the value of a key; it is made if it is not in the cache. ``transform``: the value is one of many
        large arrays of a sweep, few of which are used again; together, these take at most ``LARGEST_TRANSFORMS`` bytes.
        """
        with self.lock:
            found = self.entries.get(key)
            if found is not None:
                self.entries.move_to_end(key)
                found.run = self.runs
                held: Made = found.value
                return held
            # One lock per key, so that threads wait for a value being computed instead of computing it twice.
            making = self.making.setdefault(key, threading.Lock())
        with making:
            with self.lock:
                if key in self.entries:
                    # another thread has computed the value while this one waited for its lock
                    held = self.entries[key].value
                    return held
            try:
                value = make()
                size = _size(value)
                with self.lock:
                    self._drop(key)
                    self.entries[key] = _Entry(value, size, self.runs, transform)
                    self.held += size
                    self._shrink(transform)
            finally:
                with self.lock:
                    self.making.pop(key, None)
        return value

    @contextmanager
    def run(self) -> Iterator[None]:
        """Enclose a run; afterwards, entries that were not used in the last runs are dropped."""
        try:
            yield
        finally:
            with self.lock:
                self.runs += 1
                # Entries are in the order of their last use, so the loop ends at the first one that was used recently.
                while self.entries and self.entries[oldest := next(iter(self.entries))].run < self.runs - LASTING:
                    self._drop(oldest)

    def _shrink(self, transforms: bool) -> None:
        """Drop the oldest entries while there are too many bytes, but never the newest: the caller holds its value, so
        dropping it would free no memory.
        """
        if transforms:
            own = [(key, entry.size) for key, entry in self.entries.items() if entry.transform]
            held = sum(size for _, size in own)
            for key, size in own[:-1]:
                if held <= LARGEST_TRANSFORMS:
                    break
                self._drop(key)
                held -= size
        while self.held > self.largest and len(self.entries) > 1:
            self._drop(next(iter(self.entries)))

    def _drop(self, key: Hashable) -> None:
        entry = self.entries.pop(key, None)
        self.held -= entry.size if entry is not None else 0

    def clear(self) -> None:
        """Drop everything, for measurements that must not use earlier results."""
        with self.lock:
            self.entries.clear()
            self.held = 0


def _size(value: Any, depth: int = 6) -> int:
    """Return the bytes of the arrays in a value, including arrays in containers and in fields of objects."""
    known = getattr(value, "nbytes", None)
    if known is not None:
        return int(known)
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple | list):
        return 256 + sum(_size(v, depth - 1) for v in value)
    # ``depth`` ends the recursion for objects that refer to each other.
    inside = getattr(value, "__dict__", None)
    return 256 + sum(_size(v, depth - 1) for v in inside.values()) if inside and depth and not callable(value) else 256


TABLES = Cache(LARGEST_CACHE)


class PatternRandom:
    """Random numbers by absolute position, for pixels, rows and columns: the same in every cell, frame, window and
    precision.

    A pattern is identified by its owner, its distribution, and its own name: stages that request a pattern of the same
    name get the same values. ``frame``: pixels of the whole frame, if the grid holds only some of its rows.
    """

    def __init__(self, serial: bytes, grid: Grid, precision: str, frame: int = 0) -> None:
        self.serial, self.precision, self.frame = serial, np.dtype(precision), frame
        self.own = False
        (top, rows), (left, columns) = _span(grid.line("y")), _span(grid.line("x"))
        self.pixels, self.rows, self.columns = (top, left, rows, columns), (top, 0, rows, 1), (0, left, 1, columns)

    def apart(self) -> PatternRandom:
        """Return copies from now on, for a stage that must not share arrays with other stages."""
        self.own = True
        return self

    def normal(self, pattern: str) -> FloatArray:
        """Return the (y, x) standard normal numbers of the pattern of this name, such as ``"grain"``."""
        return self._normals("normal", pattern, self.pixels)

    def spread(self, pattern: str, rms: float) -> FloatArray:
        """Return (y, x) factors about 1 with relative standard deviation ``rms``: 1 + rms times the numbers of
        ``normal`` for this pattern, clipped at 0. Cached.
        """

        def make() -> FloatArray:
            if self.pixels[2] * self.pixels[3] <= LARGEST_SHARED:
                known = self.normal(pattern)
                factor = known * known.dtype.type(rms)
            else:
                factor = tiled_normal(self._words("normal", pattern), *self.pixels, self.precision)
                factor *= factor.dtype.type(rms)
            factor += 1
            return np.maximum(factor, 0, out=factor)

        return self._kept(("spread", pattern, rms), self.pixels, self.precision, make)

    def uniform(self, pattern: str) -> FloatArray:
        """Return (y, x) uniform random numbers, 0 <= u < 1, in float64 in every run, so that ``u < 1e-8`` selects that
        share of the pixels in any precision.
        """
        words = self._words("uniform", pattern)
        return self._kept(
            ("uniform", pattern), self.pixels, np.dtype(np.float64), lambda: tiled_uniform(words, *self.pixels)
        )

    def row_normal(self, pattern: str) -> FloatArray:
        """Return (y, 1) standard normal numbers, one per row, independent of the columns in the window."""
        return self._normals("row", pattern, self.rows)

    def column_normal(self, pattern: str) -> FloatArray:
        """Return (1, x) standard normal numbers, one per column."""
        return self._normals("column", pattern, self.columns)

    def _normals(self, how: str, pattern: str, window: Window) -> FloatArray:
        words = self._words(how, pattern)
        return self._kept((how, pattern), window, self.precision, lambda: tiled_normal(words, *window, self.precision))

    def _words(self, how: str, pattern: str) -> bytes:
        """Return the seed words of a pattern. A serial holds no line break, so no two patterns have the same words."""
        return b"\n".join((self.serial, how.encode(), pattern.encode()))

    def _kept(
        self, what: tuple[str | float, ...], window: Window, dtype: np.dtype[Any], make: Callable[[], FloatArray]
    ) -> FloatArray:
        """Return a cached read-only array; computed again for strips of very large frames, see ``LARGEST_PATTERN``."""

        def read_only() -> FloatArray:
            array = make()
            array.flags.writeable = False
            return array

        if self.frame * dtype.itemsize > LARGEST_PATTERN:
            return read_only()
        found = TABLES.get(("pattern", self.serial, *what, window, dtype), read_only)
        return found.copy() if self.own else found.view()


def _span(line: Line) -> tuple[int, int]:
    """Return the position of the first pixel, in steps of the line, and the number of pixels."""
    return math.floor(line.start / line.step + 0.5), line.size


def key_of_prepared(stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid]) -> tuple[Key, bool]:
    """Return the key of a stage's prepared tables, and whether this key stays valid during the process; a key that
    depends on files does not.
    """
    state = state_of(stage)
    return Key(("prepare", state, tuple(sorted(input_grids.items())), tuple(sorted(grids.items())))), not state[1]


def prepared_of(
    stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid], key: Key | None = None
) -> Any:
    """Return the tables of ``stage.prepare``, computed once per (parameters, coordinates) and process; None if the
    stage has no such method. ``key``: the key, if already known.
    """
    if type(stage).prepare is Stage.prepare:
        return None
    own: Stage = stage

    def make() -> Any:
        with foreign(f"{type(stage).__name__}.prepare"):
            return own.prepare(
                {**coordinates_of(grids), **coordinates_of(input_grids), **coordinates_of(grids, "out_")}
            )

    return TABLES.get(key or key_of_prepared(stage, input_grids, grids)[0], make)


def prepared_for(stage: Stage, edges: tuple[float, ...]) -> Any:
    """Return the tables that a stage prepares for bands with these edges, without a grid."""
    return prepared_of(stage, {first_port(stage): Grid.of({bands_of(type(stage)): Bands(edges)})}, {})


def prepared_on(stage: Stage, grid: Grid) -> Any:
    """Return the tables that a stage prepares for the grid of its input."""
    return prepared_of(stage, {first_port(stage): grid}, {})


def first_port(stage: Stage) -> str:
    return next(iter(type(stage).reads), "")
