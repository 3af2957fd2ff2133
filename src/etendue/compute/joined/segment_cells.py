"""Segments whose light is means over grid cells: all aliases are folded, so flux is kept and no light becomes negative.

In:  a ``Job`` that reads the segment's input directly, with the stages in between.
Out: its arrays; large ones as bands that are computed on demand.

The light after stages 1...s depends on the product of their transfer functions at frequencies far beyond the grid's
own; a product of separately folded functions would be wrong. So every cell of such a segment starts from its input.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.compute.bands import BandArray, in_order
from etendue.compute.job import Job
from etendue.compute.tables import TABLES, prepared_of, prepared_on
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Summed, Transfer
from etendue.contract.stage import Stage, state_of
from etendue.plan.model import CellRef
from etendue.transfer import cell_pixels, cells, sampling
from etendue.transfer.products import Product
from etendue.transfer.products import weights as weights_of
from etendue.types.arrays import Array

if TYPE_CHECKING:
    from etendue.compute.joined.segments import Result

ROUNDING = 64  # ulp of the brightest cell: the residue that transforms leave where there is no light


@dataclass(eq=False)
class CellTransfer:
    """The product of the transfer functions of some stages at any frequency, and its tables on the grid cells."""

    stages: tuple[Transfer, ...]
    grid: Grid
    precision: str
    last: tuple[Transfer, Any] | None = None  # a segment end that is not a box window, with what it prepared

    @cached_property
    def axes(self) -> tuple[cells.PeriodicAxis, cells.PeriodicAxis]:
        y, x = self.grid.line("y"), self.grid.line("x")
        return cells.PeriodicAxis(sampling.padded_size(y.size), y.step), cells.PeriodicAxis(
            sampling.padded_size(x.size), x.step
        )

    @cached_property
    def product(self) -> Product:
        def prepared(stage: Stage, _: tuple[float, ...]) -> Any:
            return self.last[1] if self.last and stage is self.last[0] else prepared_on(stage, self.grid)

        return Product((*self.stages, *((self.last[0],) if self.last else ())), self.grid.bands().edges, prepared)

    def otf(self, band: int) -> cells.Transfer:
        """Return the product for one band."""
        return lambda fy, fx: self.product.at(fy, fx, slice(band, band + 1))[0]

    @cached_property
    def _key(self) -> tuple[Hashable, ...]:
        states = tuple(state_of(stage) for stage in self.product.stages)
        return (states, self.grid.line("y"), self.grid.line("x"), self.grid.bands().edges)

    def reach(self, band: int) -> cells.Reach:
        step = min(axis.step for axis in self.axes)
        found: cells.Reach = TABLES.get(("cells reach", *self._key, band), lambda: cells.reach_of(self.otf(band), step))
        return found

    def table(self, band: int, what: Hashable, along_y: cells.AliasRule, along_x: cells.AliasRule) -> Array:
        """Return the multiplier of the transform of one band, in the run's precision; ``what``: cache key of the alias
        rules.
        """

        def make() -> Array:
            found = cells.folded(self.otf(band), self.reach(band), *self.axes, along_y, along_x)
            kind = (
                np.result_type(np.dtype(self.precision), np.complex64)
                if np.iscomplexobj(found)
                else np.dtype(self.precision)
            )
            return found.astype(kind)

        return TABLES.get(("cells", *self._key, band, self.precision, what), make)


@dataclass(eq=False)
class BlurredCells(BandArray):
    """Cell means after some transfer functions, one band at a time."""

    light: Array | BandArray
    joined: CellTransfer

    def __post_init__(self) -> None:
        self.shape = self.light.shape
        self.dtype = self.light.dtype

    def __getitem__(self, band: int) -> Array:
        plane = np.asarray(self.light[band])
        y, x = self.joined.axes
        half = sampling.transform(plane) * self.joined.table(
            band, "means", cells.mean_rule(y, False), cells.mean_rule(x, True)
        )
        return without_rounding(sampling.planes_of(half, *self.shape[1:]), plane)


def without_rounding(found: Array, given: Array) -> Array:
    """Set light to 0 if it is negative only because of rounding. ``given`` is the light from which it was computed and
    sets the scale; if ``given`` itself has negative values, nothing is changed.
    """
    if given.size and given.min() >= 0:
        least = -ROUNDING * np.finfo(given.dtype).eps * given.max()
        np.copyto(found, 0.0, where=(found < 0) & (found >= least))
    return found


def from_cells(job: Job, results: Mapping[CellRef, Result]) -> dict[str, Array | BandArray]:
    """Return the arrays of a transfer stage on grid cells, from the segment's input and all transfer functions
    since.
    """
    port, ref, variable = job.inputs[0]
    light, grid = results[ref].arrays[variable], job.input_grids[port]
    (name,) = job.writes
    before, stage = (job.segment.joined or () if job.segment else ()), job.stage
    assert isinstance(stage, Transfer)
    if isinstance(stage, Summed):
        return {name: _pixels(job, stage, light, grid, before)}
    stages = (*before, stage)
    found = BlurredCells(light, CellTransfer(stages, grid, job.precision))
    return {name: found if name in job.by_band else np.asarray(found)}


@dataclass(frozen=True)
class _Along:
    """Pixels along one axis: position of the first pixel and pitch (cells), number, width of a window (um)."""

    start: float
    step: float
    size: int
    width: float


def _pixels(job: Job, end: Summed, light: Array | BandArray, grid: Grid, before: tuple[Transfer, ...]) -> Array:
    """Return sums over bands at the pixels: by folding if the pitch is a whole number of cells, else by an extended
    transform.
    """
    prepared = prepared_of(end, job.input_grids, job.grids)
    weights: Array = weights_of(end, prepared).astype(float)
    (out,) = job.grids.values()
    lines = [(grid.line(dim), *out.line(dim).um(), out.line(dim).size) for dim in ("y", "x")]
    joined, windows = CellTransfer(before, grid, job.precision), None
    alone = CellTransfer((), grid, job.precision, (end, prepared))
    windows = cell_pixels.box_of(alone.otf(0), max(step for _, _, step, _ in lines))
    if windows is None:  # not a box: its transfer function is treated like any other
        joined, windows = CellTransfer(before, grid, job.precision, (end, prepared)), ((0.0, 0.0), (0.0, 0.0))
    along = [
        _Along((start + place - line.start) / line.step, step / line.step, size, width)
        for (line, start, step, size), (width, place) in zip(lines, windows, strict=True)
    ]
    brightest = np.zeros((2, weights.shape[1]))
    if all(abs(one.step - round(one.step)) * one.size < 1e-6 and round(one.step) >= 1 for one in along):
        found = _folded_pixels(light, joined, weights, along, brightest)
    else:
        transforms = []
        for band, plane in enumerate(in_order(light)):
            transforms.append(sampling.transform(_noted(plane, brightest, band)))
        bands = range(len(transforms))
        down, across = (one.start + one.step * np.arange(one.size) for one in along)
        found = cell_pixels.evaluated(
            [joined.otf(b) for b in bands],
            [joined.reach(b) for b in bands],
            weights,
            np.stack(transforms),
            *joined.axes,
            (down, across),
            (along[0].width, along[1].width),
        )
    if (weights >= 0).all():
        limits = np.stack([weights @ brightest[0], weights @ brightest[1]])
        for channel, plane in enumerate(found):
            without_rounding(plane, limits[:, channel].astype(found.dtype))
    return found


def _noted(plane: Array, brightest: Array, band: int) -> Array:
    """Return the plane, and record its smallest and largest value."""
    plane = np.asarray(plane)
    brightest[:, band] = plane.min(), plane.max()
    return plane


def _folded_pixels(
    light: Array | BandArray, joined: CellTransfer, weights: Array, along: Sequence[_Along], brightest: Array
) -> Array:
    y, x = joined.axes
    nearest = [round(one.start) for one in along]
    far = [one.start - near for one, near in zip(along, nearest, strict=True)]
    offsets = [0.0 if abs(offset) < 1e-9 else offset for offset in far]
    widths = [one.width for one in along]
    along_y = cells.window_rule(y, widths[0], offsets[0], False)
    along_x = cells.window_rule(x, widths[1], offsets[1], True)
    sums: Any = None
    for band, plane in enumerate(in_order(light)):
        half = sampling.transform(_noted(plane, brightest, band))
        half = half * joined.table(band, ("pixels", *widths, *offsets), along_y, along_x)
        if sums is None:
            sums = np.zeros((len(weights), *half.shape), dtype=half.dtype)
        for channel, weight in enumerate(weights[:, band]):
            sums[channel] += half.dtype.type(weight) * half
    rows, columns = (
        (near + round(one.step) * np.arange(one.size)) % axis.size
        for near, one, axis in zip(nearest, along, (y, x), strict=True)
    )
    return np.stack([cells.planes_of(half, y, x)[np.ix_(rows, columns)] for half in sums])
