"""Small pictures of what a cell has made, reduced where it is made: neither held to the end of a run at full size, nor sent.

In:  a plan and the cells to be shown; later, in whichever worker computes one of them, its arrays.
Out: ``Look`` by cell, which gives ``Thumbnail`` by variable: linear sRGB, encoded values or grey, at most 256 x 256.

Which variables are shown, and how, distributions say (``spec.variables.Variable``). Light is shown through the CIE 1931
observer; a mosaic through its own filters; camera channels as they are; tristimulus values through sRGB.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from etendue import spectra
from etendue.physics.colour import matrices
from etendue.physics.scene.resampling import area_weights
from etendue.physics.sensor import cfa
from etendue.plan.model import Cell, CellRef, Plan
from etendue.report.details import Window, band_of, lines_of
from etendue.spec.capabilities import Viewed
from etendue.spec.variables import Variable
from etendue.spec.variables import variable as known

LARGEST = 256  # samples on either side
Decode = Callable[[Any], Any]


@dataclass(frozen=True)
class Thumbnail:
    """(3, y, x) float32, not yet scaled where it is linear; the true size; of larger ones some rows as they are, and the first of them."""

    picture: Any
    size: tuple[int, int]
    band: Any = None
    first: int = 0


@dataclass(frozen=True)
class _View:
    """How one variable of one cell is made small. What it needs of the plan, and nothing of the plan besides."""

    how: str  # light, planes, mosaic, encoded or map
    shown: Variable
    middles: int = 0  # leading dims of which the middle is taken
    observer: Any = None  # (3, bands) of light: weights of its bands in X, Y, Z
    matrix: Any = None  # (3, 3) to linear sRGB; None: as it is
    colours: int = 3  # planes that are red, green and blue; 0: their mean is grey
    tints: Any = None  # (rows, columns, 3): the colour of each pixel of one period of a mosaic
    black: float = 0.0
    rows: tuple[int, int] = (0, 0)  # that are kept as they are where the picture is larger than a thumbnail

    def of(self, array: Any) -> Thumbnail | None:
        if getattr(array, "on_demand", False):  # a large variable that is not stored would be made again
            return None
        for _ in range(self.middles):  # of several frames the one in the middle; planes are a picture
            array = array[len(array) // 2]
        if self.how == "map" and array.ndim != 2:
            return None
        size = (array.shape[-2], array.shape[-1])
        if self.how == "light" and max(size) > LARGEST:
            picture, band = self._large_light(array)
        else:
            picture, band = _MAKERS[self.how](self, array), self.band(array) if max(size) > LARGEST else None
        return Thumbnail(np.ascontiguousarray(picture, dtype=np.float32), size, band, self.rows[0])

    def band(self, array: Any) -> Any:
        """Some rows of a large picture as they are, in the colours of the whole."""
        first, last = self.rows
        if last <= first or self.how == "map":
            return None
        return self.banded(np.asarray(array[..., first:last, :]))

    def banded(self, rows: Any) -> Any:
        """The same of rows that begin where the band begins; what comes row by row has it from here."""
        if self.how == "mosaic":
            plane = self.above_black(rows)
            if self.tints is None:
                return np.repeat(plane[None], 3, axis=0)
            height, width = self.tints.shape[:2]
            at = np.ix_((self.rows[0] + np.arange(plane.shape[0])) % height, np.arange(plane.shape[1]) % width)
            return np.moveaxis(self.tints[at], -1, 0) * plane
        return np.array(self._coloured(as_float(rows)) if self.how == "planes" else as_float(rows), dtype=np.float32)

    def _light(self, array: Any) -> Any:
        whole = array if isinstance(array, np.ndarray) else np.stack([np.asarray(array[band]) for band in range(array.shape[0])])
        return matrices.apply_matrix(self.matrix, np.tensordot(self.observer, np.asarray(whole, dtype=np.float32), axes=1))

    def _large_light(self, array: Any) -> tuple[Any, Any]:
        """Made small, and some rows of it: perhaps stored by band, as it is too large to be held."""
        small, rows = [], []
        for number in range(array.shape[0]):
            plane = np.asarray(array[number])
            small.append(fitted(plane))
            rows.append(as_float(plane[slice(*self.rows)]))
        found, band = (matrices.apply_matrix(self.matrix, np.tensordot(self.observer, np.stack(one), axes=1)) for one in (small, rows))
        return found, band.astype(np.float32) if band.size else None

    def gathering(self, shape: tuple[int, ...]) -> Gathering | None:
        if self.middles or self.how in ("light", "map") or (self.how == "mosaic" and len(shape) > 2):
            return None
        if self.how == "mosaic" and self.tints is not None:
            return Gathering(self, shape, _Tinted(shape, self.tints, self.above_black))
        return Gathering(self, shape, _Fitted(shape, self.above_black if self.how == "mosaic" else as_float))

    def finished(self, small: Any) -> Any:
        """What is made of a variable once it is small."""
        if self.how == "planes":
            return self._coloured(small)
        return np.repeat(small[None], 3, axis=0) if self.how == "mosaic" and self.tints is None else small

    def above_black(self, rows: Any) -> Any:
        rows = as_float(rows)
        return np.maximum(rows - self.black, 0) if self.black else rows

    def _planes(self, array: Any) -> Any:
        return self._coloured(fitted(np.asarray(array)))

    def _coloured(self, planes: Any) -> Any:
        planes = planes if self.matrix is None else matrices.apply_matrix(self.matrix, planes)
        return planes[:3] if self.colours else np.repeat(planes.mean(axis=0, keepdims=True), 3, axis=0)

    def _mosaic(self, array: Any) -> Any:
        plane = np.asarray(array)
        if self.tints is None:
            return np.repeat(fitted(plane, self.above_black)[None], 3, axis=0)
        return _tinted(plane, self.tints, self.above_black)

    def _encoded(self, array: Any) -> Any:
        return fitted(np.asarray(array))

    def _map(self, array: Any) -> Any:
        return mapped(np.asarray(array), self.shown)


_MAKERS: dict[str, Callable[[_View, Any], Any]] = {
    "light": _View._light, "planes": _View._planes, "mosaic": _View._mosaic, "encoded": _View._encoded, "map": _View._map,
}  # fmt: skip


@dataclass(frozen=True)
class Look:
    """What is looked at of a cell: its pictures, made small, and its plain figures. It travels to where the cell is computed."""

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
        """The same for a keeper that takes the arrays of what is kept themselves: they are looked at where they stand."""
        return replace(self, kept=frozenset(v for s, v in kept if s == stage)) if keeps else self

    def gathering(self, variable: str, shape: tuple[int, ...]) -> Gathering | None:
        """What makes a variable small that comes row by row; None where all of it is needed, or it is small."""
        view = self.views.get(variable)
        return view.gathering(shape) if view and max(shape[-2:]) > LARGEST else None


class Gathering:
    """A thumbnail of rows that come in order: with the bits of the whole."""

    def __init__(self, view: _View, shape: tuple[int, ...], rows: _Rows) -> None:
        self.view, self.size, self.rows = view, (shape[-2], shape[-1]), rows
        self.band: list[Any] = []

    def take(self, start: int, rows: Any) -> None:
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
    return band_of([grid for ref in shown for v, grid in plan.cells[ref].grids.items() if known(v).shown in ("linear", "encoded")])


def looks(plan: Plan, shown: Iterable[CellRef]) -> dict[CellRef, Look]:
    """How each of some cells is looked at."""
    found, shown = {}, list(shown)
    window = window_of(plan, shown)
    for ref in shown:
        cell, node = plan.cells[ref], plan.node(ref[0])
        middles = sum(dim != "channel" for dim in node.mapped)
        views = {v: view for v in node.writes if known(v).shown and (view := _view(plan, cell, v, middles)) is not None}
        if window is not None:
            views = {v: replace(view, rows=window.rows(y[0])) if (y := lines_of(cell.grids[v])) else view for v, view in views.items()}
        figures = frozenset(v for v, declared in node.writes.items() if not set(declared.dims) - {"stage"})
        found[ref] = Look(views, figures - views.keys())
    return found


def _view(plan: Plan, cell: Cell, variable: str, middles: int) -> _View | None:
    shown, grid = known(variable), cell.grids[variable]
    if shown.shown in ("encoded", "map"):
        return _View(shown.shown, shown, middles)
    if "y" not in grid or "x" not in grid:
        return None
    dims = plan.node(cell.node).writes[variable].dims[middles:]
    to_rgb = np.linalg.inv(matrices.RGB_TO_XYZ_SRGB)
    if dims == ("wavelength", "y", "x"):
        edges = grid.bands().edges
        observer = (spectra.colour_matching(edges) * np.diff(edges)[:, None]).T.astype(np.float32)
        return _View("light", shown, middles, observer=observer, matrix=to_rgb)
    if dims == ("channel", "y", "x"):
        names = grid["channel"].values()
        matrix = None
        if names == ["X", "Y", "Z"]:
            white = cell.stage.viewing_white() if isinstance(cell.stage, Viewed) else None
            matrix = to_rgb
            if white is not None:  # shown as its viewer sees it, not as it would look beside a D65 white
                matrix = matrix @ matrices.von_kries_matrix(white, matrices.xyz_from_xy(matrices.D65_XY), matrices.TRANSFORMS["bradford"])
        return _View("planes", shown, middles, matrix=matrix, colours=3 if names[:3] in (["R", "G", "B"], ["X", "Y", "Z"]) else 0)
    if dims == ("y", "x"):
        black = float(plan.camera.get(shown.black, 0) or 0) if shown.black else 0.0
        pattern, tints = plan.camera.get("pattern"), None
        if pattern is not None:
            mask = cfa.read(str(pattern))
            index = cfa.channel_index(mask, *mask.period, round(grid.line("y").start), round(grid.line("x").start))
            tints = np.array([cfa.tint(channel) for channel in mask.channels], dtype=np.float32)[index]
        return _View("mosaic", shown, middles, tints=tints, black=black)
    return None


# ---------------------------------------------------------------------------------------------- made smaller


def as_float(rows: Any) -> Any:
    return rows.astype(np.float32, copy=False)


def fitted(picture: Any, decode: Decode = as_float) -> Any:
    """Area-averaged until it fits; smaller pictures stay as they are.

    Parameters
    ----------
    picture : (..., y, x) array
    decode : callable
        Values to float32, elementwise; asked for some rows at a time, so that nothing of the size of the picture is made.

    Returns
    -------
    (..., y', x') float32, at most 256 on either side
    """
    y, x = picture.shape[-2:]
    if max(y, x) <= LARGEST:
        return decode(picture)
    gathered = _Fitted(picture.shape, decode)
    gathered.take(0, picture)
    return gathered.made()


def _tinted(plane: Any, tints: Any, decode: Decode) -> Any:
    """`fitted` of a mosaic in the colours of its filters, (3, y', x'): each pixel is added to the colours that it has."""
    y, x = plane.shape
    if max(y, x) <= LARGEST:
        height, width = tints.shape[:2]
        tiled = np.tile(tints, (-(-y // height), -(-x // width), 1))[:y, :x]
        return np.moveaxis(tiled, -1, 0) * decode(plane)
    gathered = _Tinted(plane.shape, tints, decode)
    gathered.take(0, plane)
    return gathered.made()


class _Rows(ABC):
    """Rows of a large picture averaged as they come: each sample that follows is made as soon as its rows are there."""

    def __init__(self, shape: tuple[int, ...], decode: Decode) -> None:
        y, x = shape[-2:]
        self.down, self.across = _down(y, _fitting(y, max(y, x))), _down(x, _fitting(x, max(y, x)))
        self.decode, self.next = decode, 0
        self.start, self.left = 0, np.empty((*shape[:-2], 0, x), np.float32)  # rows that are needed again

    def take(self, start: int, rows: Any) -> None:
        """The rows from ``start`` on, which follow those taken before."""
        if self.left.size:
            start, rows = self.start, np.concatenate((self.left, rows), axis=-2)
        while self.next < len(self.down):
            first, weights = self.down[self.next]
            if first + weights.size > start + rows.shape[-2]:
                break
            self.put(self.next, first, weights, self.decode(rows[..., first - start : first - start + weights.size, :]))
            self.next += 1
        self.start = self.down[self.next][0] if self.next < len(self.down) else start + rows.shape[-2]
        self.left = rows[..., self.start - start :, :].copy()

    @abstractmethod
    def put(self, row: int, first: int, weights: Any, light: Any) -> None: ...

    @abstractmethod
    def made(self) -> Any: ...


class _Fitted(_Rows):
    def __init__(self, shape: tuple[int, ...], decode: Decode) -> None:
        super().__init__(shape, decode)
        self.rows = np.empty((*shape[:-2], len(self.down), shape[-1]), np.float32)

    def put(self, row: int, first: int, weights: Any, light: Any) -> None:
        self.rows[..., row, :] = weights @ light

    def made(self) -> Any:
        return _across(self.rows, self.across)


class _Tinted(_Rows):
    """Each pixel is added to the colours that it has."""

    def __init__(self, shape: tuple[int, ...], tints: Any, decode: Decode) -> None:
        super().__init__(shape, decode)
        self.tints = tints
        self.rows = np.zeros((len(tints), len(self.down), shape[-1]), np.float32)  # by the row of the period in which a pixel stands

    def put(self, row: int, first: int, weights: Any, light: Any) -> None:
        height = len(self.tints)
        for phase in range(height):
            own = slice((phase - first) % height, None, height)
            self.rows[phase, row] = weights[own] @ light[own]

    def made(self) -> Any:
        height, width = self.tints.shape[:2]
        coloured = np.zeros((3, *self.rows.shape[1:]), np.float32)
        for phase in range(height):
            for place in range(width):
                for colour in np.flatnonzero(self.tints[phase, place]):
                    coloured[colour, :, place::width] += self.tints[phase, place, colour] * self.rows[phase, :, place::width]
        return _across(coloured, self.across)


def _fitting(size: int, largest: int) -> int:
    """Samples on one side of a picture that fits."""
    return max(1, round(size * LARGEST / largest))


@lru_cache(maxsize=16)
def _down(before: int, after: int) -> tuple[tuple[int, Any], ...]:
    """For each sample after: the first sample before that lies in it, and the share of that one and the next."""
    whole = area_weights(before, after).astype(np.float32)
    spans = [(row * before // after, -(-(row + 1) * before // after)) for row in range(after)]
    return tuple((first, whole[row, first:last].copy()) for row, (first, last) in enumerate(spans))


def _across(rows: Any, down: tuple[tuple[int, Any], ...]) -> Any:
    """Columns averaged as rows were: (..., y', x) to (..., y', x')."""
    turned = np.ascontiguousarray(np.swapaxes(rows, -1, -2))
    found = np.empty((*turned.shape[:-2], len(down), turned.shape[-1]), np.float32)
    for row, (first, weights) in enumerate(down):
        found[..., row, :] = weights @ turned[..., first : first + weights.size, :]
    return np.swapaxes(found, -1, -2)


def mapped(plane: Any, shown: Variable) -> Any:
    """Numbers over y and x as grey, from the lower end of their range to the upper one; what is undefined is black."""

    def measured(rows: Any) -> Any:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(rows, dtype=np.float64) if shown.log else rows.astype(np.float64)

    if shown.range:
        low, high = np.log(shown.range) if shown.log else shown.range
    else:
        low, high = np.inf, -np.inf
        for first in range(0, plane.shape[0], LARGEST):
            found = measured(plane[first : first + LARGEST])
            finite = np.isfinite(found)
            low, high = min(low, found[finite].min(initial=np.inf)), max(high, found[finite].max(initial=-np.inf))

    def grey(rows: Any) -> Any:
        found = measured(rows)
        with np.errstate(invalid="ignore"):
            share = (found - low) / (high - low) if high > low else 0.5
        return np.clip(np.where(np.isfinite(found), share, 0.0), 0, 1).astype(np.float32)

    return np.repeat(fitted(plane, grey)[None], 3, axis=0)
