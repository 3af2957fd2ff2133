"""Thumbnails of a cell, reduced where the cell is computed, so that full-size arrays are neither kept to the end of a
run nor sent.

In:  a plan and the cells to be shown; later, in whichever worker computes one of them, its arrays.
Out: ``Look`` by cell, which returns ``Thumbnail`` by variable: linear sRGB, encoded values or grey, at most 256 x 256.

Distributions declare which variables are shown, and how (``contract.variables.Variable``); ``appearance`` makes
pictures of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.contract.arrays.colouring import flat_dims
from etendue.contract.arrays.dims import banded
from etendue.contract.arrays.variables import variable as known
from etendue.plan.drawn import drawn_of
from etendue.plan.identity.same_as import source_of
from etendue.plan.model import Cell, CellRef, Plan
from etendue.present.pictures.appearance import Appearance, appearance
from etendue.present.pictures.details import PlaneWindow, kept_window, lines_of
from etendue.present.pictures.fitting import LARGEST, Fitted, Rows, Tinted, fitted
from etendue.types.arrays import Array, FloatArray


@dataclass(frozen=True)
class Thumbnail:
    """A small picture, (3, y, x) float32, whose linear values are not scaled; the true size of the picture; for larger
    pictures also a window at full resolution, and the first row and column of that window.
    """

    picture: Any
    size: tuple[int, int]
    window: Any = None
    first: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class View:
    """The reduction of one variable of one cell. It holds only the parts of the plan that it needs, because it is sent
    to workers.
    """

    seen: Appearance
    middles: int = 0  # leading dims of which the middle is taken
    light: bool = False  # many planes, perhaps stored one by one
    # rows and columns kept at full resolution if the picture is larger than a thumbnail: the first, and the one after
    # the last
    rows: tuple[int, int] = (0, 0)
    columns: tuple[int, int] = (0, 0)

    @property
    def first(self) -> tuple[int, int]:
        return self.rows[0], self.columns[0]

    def of(self, array: Array) -> Thumbnail | None:
        if getattr(array, "on_demand", False):  # a large variable that is not stored would be computed again
            return None
        for _ in range(self.middles):  # the middle one of several frames; planes form a picture
            array = array[len(array) // 2]
        size = (array.shape[-2], array.shape[-1])
        if self.light and max(size) > LARGEST:
            picture, window = self._large_light(array)
        else:
            picture, window = self.seen.small(array), self.window(array) if max(size) > LARGEST else None
        return Thumbnail(np.ascontiguousarray(picture, dtype=np.float32), size, window, self.first)

    def window(self, array: Array) -> Array | None:
        """Return the kept window of a large picture at full resolution, in colours; None if no window is kept."""
        first, last = self.rows
        if last <= first or self.seen.grey:
            return None
        return self.coloured(np.asarray(array[..., first:last, slice(*self.columns)]))

    def coloured(self, window: Array) -> Array:
        """Return the colours of the window, (3, y, x) float32; a pattern is aligned to the whole picture."""
        return np.array(self.seen.rgb(window, self.first), dtype=np.float32)

    def _large_light(self, array: Array) -> tuple[Any, Any]:
        """Return the reduced picture and a window of it; planes are read one by one, as all together may be too large
        for memory.
        """
        small = []

        def windows() -> Iterator[Any]:
            for number in range(array.shape[0]):
                plane = np.asarray(array[number])
                small.append(fitted(plane, self.seen.values))
                yield self.seen.values(plane[slice(*self.rows), slice(*self.columns)])

        window = self.seen.mixed(windows())
        return self.seen.mixed(np.stack(small)), window if window.size else None

    def gathering(self, shape: tuple[int, ...]) -> Gathering | None:
        if self.middles or self.light or self.seen.grey:
            return None
        if self.seen.tints is not None:
            return Gathering(self, shape, Tinted(shape, self.seen.tints, self.seen.values))
        return Gathering(self, shape, Fitted(shape, self.seen.values))

    def finished(self, small: FloatArray) -> FloatArray:
        """Return the colours of a variable that has been reduced already."""
        return small if self.seen.tints is not None else self.seen.mixed(small)


@dataclass(frozen=True)
class Observer:
    """The reduction of a cell to what is shown of it: small pictures and scalar metrics. The observer is sent to the
    worker that computes the cell.
    """

    views: Mapping[str, View]
    figures: frozenset[str]
    kept: frozenset[str] = frozenset()  # variables passed on unchanged

    def __call__(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return the thumbnails and metrics of a cell by variable; inputs that are thumbnails already are passed on."""
        found = {v: arrays[v] for v in self.figures | self.kept if v in arrays}
        for variable, view in self.views.items():
            if variable in self.kept:
                continue
            array = arrays.get(variable)
            small = array if array is None or isinstance(array, Thumbnail) else view.of(array)
            if small is not None:
                found[variable] = small
        return found

    def beside(self, keeps: bool, kept: frozenset[tuple[str, str]], stage: str) -> Observer:
        """If the store keeps arrays, return an observer that passes the kept variables on: their pictures are made from
        the stored arrays later.
        """
        return replace(self, kept=frozenset(v for s, v in kept if s == stage)) if keeps else self

    def gathering(self, variable: str, shape: tuple[int, ...]) -> Gathering | None:
        """Return an object that reduces a variable row by row; None if the variable is small or is needed as a
        whole."""
        view = self.views.get(variable)
        return view.gathering(shape) if view and max(shape[-2:]) > LARGEST else None


class Gathering:
    """Makes a thumbnail from rows that arrive in order; it is bit-identical to the thumbnail of the whole picture."""

    def __init__(self, view: View, shape: tuple[int, ...], rows: Rows) -> None:
        self.view, self.size, self.rows = view, (shape[-2], shape[-1]), rows
        self.window: list[Any] = []

    def take(self, start: int, rows: Array) -> None:
        self.rows.take(start, rows)
        first, last = (min(max(0, end - start), rows.shape[-2]) for end in self.view.rows)
        if last > first:
            self.window.append(np.array(rows[..., first:last, slice(*self.view.columns)]))

    def made(self) -> Thumbnail:
        picture = np.ascontiguousarray(self.view.finished(self.rows.made()), dtype=np.float32)
        window = self.view.coloured(np.concatenate(self.window, axis=-2)) if self.window else None
        return Thumbnail(picture, self.size, window, self.view.first)


def only(found: Mapping[str, Any]) -> dict[str, Thumbnail]:
    """Return only the thumbnails among the results of an observer."""
    return {variable: one for variable, one in found.items() if isinstance(one, Thumbnail)}


def window_of(plan: Plan, shown: Iterable[CellRef]) -> PlaneWindow | None:
    """Return the window of the image plane that all pictures of these cells keep at full resolution."""
    return kept_window(
        [grid for ref in shown for v, grid in plan.cells[ref].grids.items() if known(v).shown not in ("", "map")]
    )


def looks(plan: Plan, shown: Iterable[CellRef]) -> dict[CellRef, Observer]:
    """Return, for each shown cell, the observer that reduces it."""
    found, shown = {}, list(shown)
    refs = set(shown)
    window = window_of(plan, shown)
    for ref in shown:
        cell, node = plan.cells[ref], plan.node(ref[0])
        views = {
            v: view for v in node.writes if not drawn_before(plan, cell, v, refs) and (view := _view(plan, cell, v))
        }
        if window is not None:
            views = {
                v: replace(view, rows=window.rows(lines[0]), columns=window.columns(lines[1]))
                if (lines := lines_of(cell.grids[v]))
                else view
                for v, view in views.items()
            }
        figures = frozenset(v for v, declared in node.writes.items() if not set(declared.dims) - {"stage"})
        if views or figures or cell.left_out is None:
            found[ref] = Observer(views, figures - views.keys())
    return found


def drawn_before(plan: Plan, cell: Cell, variable: str, shown: Collection[CellRef]) -> CellRef | None:
    """Return the earlier shown cell whose picture is also that of this left-out cell; None if this cell needs a picture
    of its own.
    """
    found, ref = None, source_of(cell, variable)
    while ref is not None and ref in shown:
        found, ref = ref, source_of(plan.cells[ref], variable)
    return found


def _view(plan: Plan, cell: Cell, variable: str) -> View | None:
    drawn, grid = drawn_of(plan, cell, variable), cell.grids[variable]
    if drawn is None:
        return None
    dims = plan.node(cell.node).writes[variable].dims
    middles = sum(dim not in flat_dims() for dim in dims[:-2])
    first = (round(grid.line("y").start), round(grid.line("x").start)) if drawn.pattern else (0, 0)
    edges = grid.bands().edges if banded(dims) else None
    seen = appearance(drawn, dims[middles:], edges, grid["channel"].values() if "channel" in dims else (), first)
    return None if seen is None else View(seen, middles, edges is not None and not seen.grey)
