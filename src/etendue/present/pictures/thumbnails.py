"""Small pictures of what a cell has made, reduced where it is made: neither held to the end of a run at full size, nor
sent.

In:  a plan and the cells to be shown; later, in whichever worker computes one of them, its arrays.
Out: ``Look`` by cell, which gives ``Thumbnail`` by variable: linear sRGB, encoded values or grey, at most 256 x 256.

Which variables are shown, and how, distributions say (``spec.variables.Variable``); ``appearance`` makes pictures of
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.contract.dims import banded
from etendue.contract.seen import flat_dims
from etendue.contract.variables import variable as known
from etendue.plan.drawn import drawn_of
from etendue.plan.model import Cell, CellRef, Plan
from etendue.present.pictures.appearance import Appearance, appearance
from etendue.present.pictures.details import Window, band_of, lines_of
from etendue.present.pictures.fitting import LARGEST, Fitted, Rows, Tinted, as_float, fitted
from etendue.types.arrays import Array


@dataclass(frozen=True)
class Thumbnail:
    """(3, y, x) float32, not yet scaled where it is linear; the true size; of larger ones some rows as they are, and
    the first of them.
    """

    picture: Any
    size: tuple[int, int]
    band: Any = None
    first: int = 0


@dataclass(frozen=True)
class _View:
    """How one variable of one cell is made small. What it needs of the plan, and nothing of the plan besides."""

    seen: Appearance
    middles: int = 0  # leading dims of which the middle is taken
    light: bool = False  # many planes, perhaps stored one by one
    rows: tuple[int, int] = (0, 0)  # that are kept as they are where the picture is larger than a thumbnail

    def of(self, array: Array) -> Thumbnail | None:
        if getattr(array, "on_demand", False):  # a large variable that is not stored would be made again
            return None
        for _ in range(self.middles):  # of several frames the one in the middle; planes are a picture
            array = array[len(array) // 2]
        size = (array.shape[-2], array.shape[-1])
        if self.light and max(size) > LARGEST:
            picture, band = self._large_light(array)
        else:
            picture, band = self.seen.small(array), self.band(array) if max(size) > LARGEST else None
        return Thumbnail(np.ascontiguousarray(picture, dtype=np.float32), size, band, self.rows[0])

    def band(self, array: Array) -> Any:
        """Some rows of a large picture as they are, in the colours of the whole."""
        first, last = self.rows
        return None if last <= first or self.seen.grey else self.banded(np.asarray(array[..., first:last, :]))

    def banded(self, rows: Array) -> Array:
        """The same of rows that begin where the band begins; what comes row by row has it from here."""
        return np.array(self.seen.rgb(rows, self.rows[0]), dtype=np.float32)

    def _large_light(self, array: Array) -> tuple[Any, Any]:
        """Made small, and some rows of it: perhaps stored by band, as it is too large to be held."""
        small, band = [], _Mixing(self.seen)
        for number in range(array.shape[0]):
            plane = np.asarray(array[number])
            small.append(fitted(plane))
            band.add(number, as_float(plane[slice(*self.rows)]))
        rows = band.made()
        return self.seen.mixed(np.stack(small)), rows if rows.size else None

    def gathering(self, shape: tuple[int, ...]) -> Gathering | None:
        if self.middles or self.light or self.seen.grey:
            return None
        if self.seen.tints is not None:
            return Gathering(self, shape, Tinted(shape, self.seen.tints, self.seen.values))
        return Gathering(self, shape, Fitted(shape, self.seen.values))

    def finished(self, small: Any) -> Any:
        """What is made of a variable once it is small."""
        return small if self.seen.tints is not None else self.seen.mixed(small)


@dataclass(frozen=True)
class Look:
    """What is looked at of a cell: its pictures, made small, and its plain figures. It travels to where the cell is
    computed.
    """

    views: Mapping[str, _View]
    figures: frozenset[str]
    kept: frozenset[str] = frozenset()  # what is handed on as it is

    def __call__(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Thumbnails and figures by variable; a thumbnail stays as it is."""
        found = {v: arrays[v] for v in self.figures | self.kept if v in arrays}
        for variable, view in self.views.items():
            if variable in self.kept:
                continue
            array = arrays.get(variable)
            small = array if array is None or isinstance(array, Thumbnail) else view.of(array)
            if small is not None:
                found[variable] = small
        return found

    def beside(self, keeps: bool, kept: frozenset[tuple[str, str]], stage: str) -> Look:
        """The same for a keeper that takes the arrays of what is kept themselves: they are looked at where they
        stand.
        """
        return replace(self, kept=frozenset(v for s, v in kept if s == stage)) if keeps else self

    def gathering(self, variable: str, shape: tuple[int, ...]) -> Gathering | None:
        """What makes a variable small that comes row by row; None where all of it is needed, or it is small."""
        view = self.views.get(variable)
        return view.gathering(shape) if view and max(shape[-2:]) > LARGEST else None


class _Mixing:
    """Planes brought to their colours as they come: what is held is three of them, however many there are."""

    def __init__(self, seen: Appearance) -> None:
        self.seen, self.apart = seen, list[Any]()
        self.sum: Any = None

    def add(self, number: int, plane: Array) -> None:
        if self.seen.matrix is None:
            self.apart.append(plane)
            return
        weights = self.seen.matrix[:, number].astype(plane.dtype)
        if self.sum is None:
            self.sum = np.zeros((len(weights), *plane.shape), plane.dtype)
        for own, weight in zip(self.sum, weights, strict=True):
            own += weight * plane

    def made(self) -> Array:
        return self.seen.mixed(np.stack(self.apart)) if self.sum is None else self.sum


class Gathering:
    """A thumbnail of rows that come in order: with the bits of the whole."""

    def __init__(self, view: _View, shape: tuple[int, ...], rows: Rows) -> None:
        self.view, self.size, self.rows = view, (shape[-2], shape[-1]), rows
        self.band: list[Any] = []

    def take(self, start: int, rows: Array) -> None:
        self.rows.take(start, rows)
        first, last = (min(max(0, end - start), rows.shape[-2]) for end in self.view.rows)
        if last > first:
            self.band.append(np.array(rows[..., first:last, :]))

    def made(self) -> Thumbnail:
        picture = np.ascontiguousarray(self.view.finished(self.rows.made()), dtype=np.float32)
        band = self.view.banded(np.concatenate(self.band, axis=-2)) if self.band else None
        return Thumbnail(picture, self.size, band, self.view.rows[0])


def only(found: Mapping[str, Any]) -> dict[str, Thumbnail]:
    """The thumbnails among what was looked at."""
    return {variable: one for variable, one in found.items() if isinstance(one, Thumbnail)}


def window_of(plan: Plan, shown: Iterable[CellRef]) -> Window | None:
    """The rows that are kept of every picture of some cells, whichever of them there will be."""
    return band_of(
        [grid for ref in shown for v, grid in plan.cells[ref].grids.items() if known(v).shown not in ("", "map")]
    )


def looks(plan: Plan, shown: Iterable[CellRef]) -> dict[CellRef, Look]:
    """How each of some cells is looked at."""
    found, shown = {}, list(shown)
    window = window_of(plan, shown)
    for ref in shown:
        cell, node = plan.cells[ref], plan.node(ref[0])
        views = {v: view for v in node.writes if (view := _view(plan, cell, v)) is not None}
        if window is not None:
            views = {
                v: replace(view, rows=window.rows(y[0])) if (y := lines_of(cell.grids[v])) else view
                for v, view in views.items()
            }
        figures = frozenset(v for v, declared in node.writes.items() if not set(declared.dims) - {"stage"})
        found[ref] = Look(views, figures - views.keys())
    return found


def _view(plan: Plan, cell: Cell, variable: str) -> _View | None:
    drawn, grid = drawn_of(plan, cell, variable), cell.grids[variable]
    if drawn is None:
        return None
    dims = plan.node(cell.node).writes[variable].dims
    middles = sum(dim not in flat_dims() for dim in dims[:-2])
    first = (round(grid.line("y").start), round(grid.line("x").start)) if drawn.pattern else (0, 0)
    edges = grid.bands().edges if banded(dims) else None
    seen = appearance(drawn, dims[middles:], edges, grid["channel"].values() if "channel" in dims else (), first)
    return None if seen is None else _View(seen, middles, edges is not None)
