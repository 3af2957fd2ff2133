"""What a process remembers between cells: coordinates, prepared tables, fixed patterns, transfer functions.

In:  grids and stages.
Out: read-only arrays, made once and kept while there is room.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from etendue.coordinates import coordinates_of
from etendue.physics.electronics.noise import sensor_normal, sensor_uniform
from etendue.spec.grid import Bands, Grid, Line
from etendue.spec.stage import Stage, state_of
from etendue.telling import foreign

LARGEST_CACHE = 256 << 20
LARGEST_PATTERN = LARGEST_CACHE // 4  # bytes of the pattern of a frame: of a larger one strips are not kept, none would be found again
LARGEST_SHARED = 1 << 18  # pixels up to which a pattern is kept beside what is made of it, for another strength of it


class Key:
    """A key whose hash is taken once: of a stage and its grids it costs more than looking up what is kept under it."""

    __slots__ = ("taken", "value")

    def __init__(self, value: Any) -> None:
        self.value, self.taken = value, hash(value)

    def __hash__(self) -> int:
        return self.taken

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Key) and self.value == other.value


class Cache:
    """Values by key, least recently used dropped first, bounded in bytes. Shared by the threads of a process."""

    def __init__(self, largest: int) -> None:
        self.largest, self.held = largest, 0
        self.entries: OrderedDict[Any, tuple[Any, int]] = OrderedDict()
        self.lock = threading.Lock()
        self.making: dict[Any, threading.Lock] = {}

    def get(self, key: Any, make: Callable[[], Any]) -> Any:
        with self.lock:
            found = self.entries.get(key)
            if found is not None:
                self.entries.move_to_end(key)
                return found[0]
            making = self.making.setdefault(key, threading.Lock())
        with making:
            with self.lock:
                if key in self.entries:
                    return self.entries[key][0]
            value = make()
            size = _size(value)
            with self.lock:
                self.entries[key] = (value, size)
                self.held += size
                while self.held > self.largest and len(self.entries) > 1:
                    _, (_, dropped) = self.entries.popitem(last=False)
                    self.held -= dropped
                self.making.pop(key, None)
        return value

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


def _made_anew(key: Any, make: Callable[[], Any]) -> Any:
    return make()


class SensorRandom:
    """Random numbers that belong to the pixels, rows and columns of one sensor: the same in every cell, frame and window."""

    def __init__(self, words: bytes, grid: Grid, precision: str, keep: bool = True) -> None:
        self.words, self.rows, self.columns, self.precision = words, grid.line("y"), grid.line("x"), precision
        self._made = TABLES.get if keep else _made_anew

    def normal(self, stream: str) -> Any:
        """(y, x) standard normals for a named stream such as ``"prnu"``."""
        return self._pattern(stream, sensor_normal, (*self._span(self.rows), *self._span(self.columns)))

    def spread(self, stream: str, rms: float) -> Any:
        """(y, x) factors about 1 with this relative deviation, never negative: 1 + rms times the normals of a stream. Made once."""
        spans = (*self._span(self.rows), *self._span(self.columns))

        def make() -> Any:
            if self.rows.size * self.columns.size <= LARGEST_SHARED:
                pattern = self.normal(stream)
                factor = pattern * pattern.dtype.type(rms)
            else:
                factor = sensor_normal(
                    self.words + b"|" + stream.encode(), spans[0], spans[2], spans[1], spans[3], np.dtype(self.precision)
                )
                factor *= factor.dtype.type(rms)
            factor += 1
            np.maximum(factor, 0, out=factor)
            factor.flags.writeable = False
            return factor

        return self._made(("sensor spread", self.words, stream, rms, spans, self.precision), make).view()

    def uniform(self, stream: str) -> Any:
        """(y, x) uniforms, 0 <= u < 1."""
        return self._pattern(stream, sensor_uniform, (*self._span(self.rows), *self._span(self.columns)))

    def row_normal(self, stream: str) -> Any:
        """(y, 1) standard normals: one for each row, whichever columns the window holds."""
        return self._pattern(stream, sensor_normal, (*self._span(self.rows), 0, 1))

    def column_normal(self, stream: str) -> Any:
        """(1, x) standard normals: one for each column."""
        return self._pattern(stream, sensor_normal, (0, 1, *self._span(self.columns)))

    def _span(self, line: Line) -> tuple[int, int]:
        return round(line.start), line.size

    def _pattern(self, stream: str, draw: Callable[..., Any], spans: tuple[int, int, int, int]) -> Any:
        words = self.words + b"|" + stream.encode()
        first_row, rows, first_column, columns = spans

        def make() -> Any:
            pattern = draw(words, first_row, first_column, rows, columns, np.dtype(self.precision))
            pattern.flags.writeable = False
            return pattern

        return self._made(("sensor", draw.__name__, words, spans, self.precision), make).view()


def key_of_prepared(stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid]) -> tuple[Key, bool]:
    """Under what the tables of a stage are kept, and whether that stays so: files may change."""
    state = state_of(stage)
    return Key(("prepare", state, tuple(sorted(input_grids.items())), tuple(sorted(grids.items())))), not state[1]


def prepared_of(stage: Stage, input_grids: Mapping[str, Grid], grids: Mapping[str, Grid], key: Key | None = None) -> Any:
    """``stage.prepare``, once per (parameters, coordinates) and process; ``key``: where it is known already."""
    if type(stage).prepare is Stage.prepare:
        return None
    own: Any = stage

    def make() -> Any:
        with foreign(f"{type(stage).__name__}.prepare"):
            return own.prepare({**coordinates_of(grids), **coordinates_of(input_grids), **coordinates_of(grids, "out_")})

    return TABLES.get(key or key_of_prepared(stage, input_grids, grids)[0], make)


def prepared_for(stage: Stage, edges: tuple[float, ...]) -> Any:
    """What a stage has prepared for wavelength bins alone."""
    return prepared_of(stage, {"irradiance": Grid.of({"wavelength": Bands(edges)})}, {})
