"""What a process remembers between cells: coordinates, prepared tables, fixed patterns, transfer functions.

In:  grids and stages.
Out: read-only arrays, made once and kept while there is room.
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
from etendue.contract.capabilities import bands_of
from etendue.contract.coordinates import coordinates_of
from etendue.contract.grid import Bands, Grid, Line
from etendue.contract.stage import Stage, state_of
from etendue.telling import foreign
from etendue.types.arrays import FloatArray

LARGEST_CACHE = 256 << 20
LARGEST_PATTERN = (
    LARGEST_CACHE // 4
)  # bytes of the pattern of a frame: of a larger one strips are not kept, none would be found again
LASTING = 50  # runs for which something is kept that none of them asks for
LARGEST_SHARED = 1 << 18  # pixels up to which a pattern is kept beside what is made of it, for another strength of it
Window = tuple[int, int, int, int]  # first row, first column, rows, columns


class Key:
    """A key whose hash is taken once: of a stage and its grids it costs more than looking up what is kept under it."""

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
    run: int  # the last that asked for it


Made = TypeVar("Made")


class Cache:
    """Values by key, least recently used dropped first: bounded in bytes, and in runs of the process that have not
    asked for them.

    Shared by the threads of a process.
    """

    def __init__(self, largest: int) -> None:
        self.largest, self.held, self.runs = largest, 0, 0
        self.entries: OrderedDict[Hashable, _Entry] = OrderedDict()
        self.lock = threading.Lock()
        self.making: dict[Hashable, threading.Lock] = {}

    def get(self, key: Hashable, make: Callable[[], Made]) -> Made:
        with self.lock:
            found = self.entries.get(key)
            if found is not None:
                self.entries.move_to_end(key)
                found.run = self.runs
                held: Made = found.value
                return held
            making = self.making.setdefault(key, threading.Lock())
        with making:
            with self.lock:
                if key in self.entries:
                    held = self.entries[key].value
                    return held
            try:
                value = make()
                size = _size(value)
                with self.lock:
                    self._drop(key)
                    self.entries[key] = _Entry(value, size, self.runs)
                    self.held += size
                    while self.held > self.largest and len(self.entries) > 1:
                        self._drop(next(iter(self.entries)))
            finally:
                with self.lock:
                    self.making.pop(key, None)
        return value

    @contextmanager
    def run(self) -> Iterator[None]:
        """A run: behind it what none of the last runs has asked for is let go."""
        try:
            yield
        finally:
            with self.lock:
                self.runs += 1
                while self.entries and self.entries[oldest := next(iter(self.entries))].run < self.runs - LASTING:
                    self._drop(oldest)

    def _drop(self, key: Hashable) -> None:
        entry = self.entries.pop(key, None)
        self.held -= entry.size if entry is not None else 0

    def clear(self) -> None:
        """Forget everything: for measurements that must not profit from what was made before."""
        with self.lock:
            self.entries.clear()
            self.held = 0


def _size(value: Any, depth: int = 6) -> int:
    """Bytes of the arrays in a value, containers and the fields of objects looked into."""
    known = getattr(value, "nbytes", None)
    if known is not None:
        return int(known)
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple | list):
        return 256 + sum(_size(v, depth - 1) for v in value)
    inside = getattr(value, "__dict__", None)
    return 256 + sum(_size(v, depth - 1) for v in inside.values()) if inside and depth and not callable(value) else 256


TABLES = Cache(LARGEST_CACHE)


class PatternRandom:
    """Random numbers by absolute position, for places, rows and columns: the same in every cell, frame, window and
    precision.

    They are named by whose they are, how they are drawn, and the pattern's own name: stages that ask for one pattern
    are given one. ``frame``: pixels of the whole frame, where the grid holds some of its rows.
    """

    def __init__(self, serial: bytes, grid: Grid, precision: str, frame: int = 0) -> None:
        self.serial, self.precision, self.frame = serial, np.dtype(precision), frame
        self.own = False
        (top, rows), (left, columns) = _span(grid.line("y")), _span(grid.line("x"))
        self.pixels, self.rows, self.columns = (top, left, rows, columns), (top, 0, rows, 1), (0, left, 1, columns)

    def apart(self) -> PatternRandom:
        """The same for one who may not see what others are given."""
        self.own = True
        return self

    def normal(self, pattern: str) -> FloatArray:
        """(y, x) standard normals of the pattern of this name, such as ``"grain"``."""
        return self._normals("normal", pattern, self.pixels)

    def spread(self, pattern: str, rms: float) -> FloatArray:
        """(y, x) factors about 1 with this relative deviation, never negative: 1 + rms times the normals of this
        name. Made once.
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
        """(y, x) uniforms, 0 <= u < 1, float64 in every run: a share of 1e-8 is no other in single precision."""
        words = self._words("uniform", pattern)
        return self._kept(
            ("uniform", pattern), self.pixels, np.dtype(np.float64), lambda: tiled_uniform(words, *self.pixels)
        )

    def row_normal(self, pattern: str) -> FloatArray:
        """(y, 1) standard normals: one for each row, whichever columns the window holds."""
        return self._normals("row", pattern, self.rows)

    def column_normal(self, pattern: str) -> FloatArray:
        """(1, x) standard normals: one for each column."""
        return self._normals("column", pattern, self.columns)

    def _normals(self, how: str, pattern: str, window: Window) -> FloatArray:
        words = self._words(how, pattern)
        return self._kept((how, pattern), window, self.precision, lambda: tiled_normal(words, *window, self.precision))

    def _words(self, how: str, pattern: str) -> bytes:
        """A serial holds no line break: no two patterns have the same words."""
        return b"\n".join((self.serial, how.encode(), pattern.encode()))

    def _kept(
        self, what: tuple[str | float, ...], window: Window, dtype: np.dtype[Any], make: Callable[[], FloatArray]
    ) -> FloatArray:
        """What is made, for reading; made anew for strips of a frame so large that none would be found again."""

        def read_only() -> FloatArray:
            array = make()
            array.flags.writeable = False
            return array

        if self.frame * dtype.itemsize > LARGEST_PATTERN:
            return read_only()
        found = TABLES.get(("pattern", self.serial, *what, window, dtype), read_only)
        return found.copy() if self.own else found.view()


def _span(line: Line) -> tuple[int, int]:
    """The first pixel and how many; of a stage that writes larger ones, in those."""
    return math.floor(line.start / line.step + 0.5), line.size


def key_of_prepared(stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid]) -> tuple[Key, bool]:
    """Under what the tables of a stage are kept, and whether that stays so: files may change."""
    state = state_of(stage)
    return Key(("prepare", state, tuple(sorted(input_grids.items())), tuple(sorted(grids.items())))), not state[1]


def prepared_of(
    stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid], key: Key | None = None
) -> Any:
    """``stage.prepare``, once per (parameters, coordinates) and process; ``key``: where it is known already."""
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
    """What a stage has prepared for bands with these edges alone."""
    return prepared_of(stage, {first_port(stage): Grid.of({bands_of(type(stage)): Bands(edges)})}, {})


def prepared_on(stage: Stage, grid: Grid) -> Any:
    """What a stage has prepared for the grid of what it reads."""
    return prepared_of(stage, {first_port(stage): grid}, {})


def first_port(stage: Stage) -> str:
    return next(iter(type(stage).reads), "")
