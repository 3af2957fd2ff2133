"""Segments with light of many bands: filtered and summed band by band, or first projected onto a few planes.

In:  a ``Job`` that reads the segment's input directly, with the stages in between.
Out: its arrays; large ones as bands that are computed on demand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from etendue.compute.bands import BandArray, in_order, is_dark
from etendue.compute.job import Job
from etendue.compute.ownership import frozen
from etendue.compute.tables import TABLES, prepared_of, prepared_on
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Summed, Transfer
from etendue.contract.stage import state_of
from etendue.plan.model import CellRef
from etendue.transfer import expansion, sampling
from etendue.transfer.products import Product
from etendue.transfer.products import shares as shares_of
from etendue.transfer.products import weights as weights_of
from etendue.transfer.sampling import ComplexArray
from etendue.types.arrays import Array

if TYPE_CHECKING:
    from etendue.compute.joined.segments import Result

TOGETHER = 4  # bands projected in one product
GATHERED = 1 << 20  # samples of large bands, in all, that are made and projected at once
LARGEST_SHARED = 64 << 20  # bytes; up to this size the transforms of all channels are cached for pixels of other sizes
# Digits to which channel weights are rounded, because those of pixels of other sizes differ in the last bits.
DIGITS = 14


@dataclass(eq=False)
class GridTransfer:
    """The product of some transfer functions on the frequencies of a padded grid, one band at a time."""

    stages: tuple[Transfer, ...]
    grid: Grid
    precision: str
    kept: float = 1.0  # share of the Nyquist frequency that is kept

    @cached_property
    def product(self) -> Product:
        return Product(self.stages, self.grid.bands().edges, lambda stage, _: prepared_on(stage, self.grid))

    @cached_property
    def _rows(self) -> Array:
        return sampling.frequencies(self.grid.line("y").size, self.grid.line("y").step, half=False, share=self.kept)

    @cached_property
    def _columns(self) -> Array:
        return sampling.frequencies(self.grid.line("x").size, self.grid.line("x").step, half=True, share=self.kept)

    @property
    def shape(self) -> tuple[int, int]:
        """The numbers of rows and columns that are kept of the half transform."""
        return self._rows.size, self._columns.size

    def band(self, number: int) -> Any:
        """Return the product for one band, (rows, columns)."""
        return self.product.at(self._rows[:, None], self._columns[None, :], slice(number, number + 1))[0]

    @cached_property
    def plane(self) -> Any:
        """A radial look-up if every stage depends only on the radial frequency; else None."""
        if self.product.radial:
            y, x = self.grid.line("y"), self.grid.line("x")
            key = ("radial plane", y.size, y.step, x.size, x.step, self.kept, self.precision)
            return TABLES.get(key, lambda: expansion.RadialPlane(self._rows, self._columns, self.precision))
        return None

    @cached_property
    def table(self) -> Array:
        """The product at the radial nodes, (band, node)."""
        return self.product.along(self.plane.nodes)

    def apply(self, half_transform: Array, band: int) -> None:
        """Multiply the transform of one band in place."""
        if not self.stages:
            return
        if self.plane is not None:
            self.plane.multiply(half_transform, self.table[band])
        else:
            own = self.band(band)
            half_transform *= own.astype(
                np.result_type(half_transform.real if own.dtype.kind == "f" else half_transform), copy=False
            )

    def gathered(self, weights: Array, basis: Array, half_transforms: Iterable[Array]) -> list[ComplexArray]:
        """Return, for each channel c, sum_k u_ck(f) S_k, (Ny, Nh), where S_k are the transforms of the projected
        planes. If the transforms are a list, they are overwritten.
        """
        one_by_one = expansion.coefficients(weights, basis, np.eye(weights.shape[1]))
        tables = None if self.plane is None or not self.stages else expansion.coefficients(weights, basis, self.table)
        if isinstance(half_transforms, list):
            if tables is not None:
                self.plane.combine(half_transforms, tables)
                return half_transforms
            half_transforms = emptied(half_transforms)
        sums: Any = None
        number = 0
        for transform in half_transforms:
            if sums is None:
                sums = np.zeros((weights.shape[0], *transform.shape), dtype=transform.dtype)
            for channel, own in enumerate(sums):
                if tables is not None:
                    self.plane.add_product(own, transform, tables[channel, number])
                else:
                    own += transform * self._mixed(one_by_one[channel, number]).astype(transform.dtype)
            del transform  # before the next is made
            number += 1
        return list(sums)

    def _mixed(self, factors: Array) -> Array:
        """Return sum_l factors[l] T_l(f) on the frequencies of the transform."""
        total: Array = np.zeros((1, 1))
        for band, factor in enumerate(factors):
            total = total + factor * self.band(band)
        return total


@dataclass(eq=False)
class FilteredBands(BandArray):
    """Light after some transfer functions, one band at a time."""

    light: Array | BandArray
    joined: GridTransfer

    def __post_init__(self) -> None:
        self.shape = self.light.shape
        self.dtype = self.light.dtype

    def __getitem__(self, band: int) -> Array:
        plane = np.asarray(self.light[band])
        if is_dark(plane):
            return np.zeros(self.shape[1:], dtype=self.dtype)
        half = sampling.transform(plane)
        self.joined.apply(half, band)
        return sampling.planes_of(half, *self.shape[1:])


def places(grid: Grid, out: Grid) -> list[tuple[float, float, int]]:
    """Return, along y and x, the position of the first pixel and the pitch, in samples of a grid, and the pixel
    count.
    """
    found = []
    for dim in ("y", "x"):
        line, pixels = grid.line(dim), out.line(dim)
        start, step = pixels.um()
        found.append(((start - line.start) / line.step, step / line.step, pixels.size))
    return found


def from_bands(job: Job, results: Mapping[CellRef, Result]) -> dict[str, Array | BandArray]:
    """Return the arrays of a transfer stage, from the segment's input and all transfer functions since."""
    port, ref, variable = job.inputs[0]
    light, grid = results[ref].arrays[variable], job.input_grids[port]
    (name,) = job.writes
    assert job.segment is not None and job.segment.joined is not None
    before = job.segment.joined
    stage = job.stage
    assert isinstance(stage, Transfer)
    if not isinstance(stage, Summed):
        return {name: FilteredBands(light, GridTransfer((*before, stage), grid, job.precision))}
    prepared = prepared_of(job.stage, job.input_grids, job.grids)
    weights = weights_of(stage, prepared).astype(float)
    kept = stage.kept()
    joined = GridTransfer(before, grid, job.precision, kept)
    few = 0 < stage.terms() < light.shape[0]
    sums = weights.sum(axis=1) if few or kept < 1 else None
    channels: Sequence[ComplexArray]
    if sums is None:
        channels = _exact(light, joined, weights)
    else:
        shares = shares_of(stage, prepared, weights).round(DIGITS)
        channels = _shared(job, light, joined, shares, stage.terms() if few else 0)
    kind = channels[0].dtype
    y, x = grid.line("y"), grid.line("x")
    fy = sampling.frequencies(y.size, y.step, half=False, share=kept)[:, None]
    fx = sampling.frequencies(x.size, x.step, half=True, share=kept)[None, :]
    last = Product((stage,), grid.bands().edges, lambda *_: prepared).at(fy, fx)
    if last.shape[0] > 1:
        raise ValueError(
            f"{type(stage).__name__} has a separate transfer function for every band; put it before the sum"
        )
    real = np.empty(0, kind).real.dtype
    last = last.reshape(last.shape[-2:]).astype(real if last.dtype.kind == "f" else kind, copy=False)
    where = places(grid, job.grids[name])
    planes = np.empty((len(weights), where[0][2], where[1][2]), dtype=job.precision)
    for channel in range(len(planes)):
        if isinstance(channels, list):
            half = channels.pop(0)  # it ends here
            half *= last
        else:  # cached transforms must not be changed in place
            half = channels[channel] * last
        if sums is not None:
            half *= sums[channel].astype(real)
        found = sampling.sample(half, y.size, x.size, where[0], where[1], own=True)
        del half  # before memory of the result is touched
        planes[channel] = found
        del found
    return {name: planes}


def _shared(
    job: Job, light: Array | BandArray, joined: GridTransfer, shares: Array, terms: int
) -> Sequence[ComplexArray]:
    """Return half transforms of the channels before their pixels. They do not depend on the size of the pixels: small
    ones are cached for the next pixel size and returned as a tuple, large ones are returned as a list.
    """
    assert job.segment is not None
    own = (
        "channels",
        job.segment.source,
        tuple(state_of(stage) for stage in joined.stages),
        shares.tobytes(),
        terms,
        job.precision,
    )

    def shared(planes: int) -> bool:
        size = planes * 2 * np.dtype(job.precision).itemsize * light.shape[1] * light.shape[2]
        return bool(own[1]) and size <= LARGEST_SHARED

    def remembered(made: Callable[[], Iterable[ComplexArray]], *more: float) -> tuple[ComplexArray, ...]:
        return TABLES.get((*own, *more), lambda: tuple(map(frozen, made())), True)

    if not terms:
        exact = partial(_exact, light, joined, shares)
        return remembered(exact, joined.kept) if shared(len(shares)) else exact()
    live = np.any(shares, axis=1).reshape(-1)

    def fitted() -> Array:
        highest = 0.5 * math.hypot(1 / joined.grid.line("y").step, 1 / joined.grid.line("x").step)
        frequency = np.linspace(0.0, highest, expansion.FITTED)
        return expansion.band_basis(
            shares[live], terms, joined.product.along(frequency).real, expansion.importance(frequency)
        )

    def channels() -> list[ComplexArray]:
        basis = fitted()
        transforms: Iterable[ComplexArray]
        if _is_large_in_rows(light) and not shared(terms):
            transforms = _gathered_transforms(light, basis, joined.shape)
        else:  # one at a time, unless they are cached
            made = map(sampling.transform, _gathered(light, basis))
            whole = remembered(lambda: made) if shared(terms) else made
            transforms = map(lambda one: sampling.low_terms(one, joined.shape), whole)
        lit = joined.gathered(shares[live], basis, transforms)
        kind = lit[0].dtype
        return [lit.pop(0) if one else np.zeros(joined.shape, kind) for one in live.tolist()]

    return remembered(channels, joined.kept) if shared(len(shares)) else channels()


def _exact(light: Array | BandArray, joined: GridTransfer, weights: Array) -> list[ComplexArray]:
    """Transform and filter every band by itself; sum in frequency."""
    sums: list[ComplexArray] = []
    transforms = _transforms(light, [bool(own.any()) for own in weights.T], joined.shape[1])
    for band in range(len(light)):
        half = next(transforms)
        if half is None and (sums or band + 1 < len(weights[0])):  # without light, one zero transform is still needed
            continue
        if half is None:
            half = sampling.transform(np.zeros(light.shape[1:], light.dtype), joined.shape[1])
        half = sampling.low_terms(half, joined.shape)
        joined.apply(half, band)
        sums = sums or [np.zeros(half.shape, half.dtype) for _ in weights]
        expansion.add_weighted(sums, weights[:, band], half)
        del half  # before the next is made
    return sums


def _is_large_in_rows(light: Array | BandArray) -> TypeGuard[BandArray]:
    """Return whether some rows of a band can be computed alone, and whole bands take much memory."""
    return isinstance(light, BandArray) and light.in_rows and math.prod(light.shape[1:]) > sampling.LARGE


def _transforms(light: Array | BandArray, seen: Sequence[bool], columns: int) -> Iterator[ComplexArray | None]:
    """Yield the first columns of the transform of every band; None for a band without light or channel response."""
    size, (ny, nx) = len(light), light.shape[1:]
    if not _is_large_in_rows(light):
        for band, plane in enumerate(in_order(light)):
            dark = not seen[band] or is_dark(plane)
            yield None if dark else sampling.transform(np.asarray(plane), columns)
        return
    for band in range(size):
        lit = False

        def rows_of(rows: slice, band: int = band) -> Array:
            nonlocal lit
            found: Array = light.rows(slice(band, band + 1), rows)[0]
            lit = lit or not is_dark(found)
            return found

        found = [sampling.transform_of_rows(rows_of, ny, nx, light.dtype, columns) if seen[band] else None]
        if seen[band] and found[0] is None:  # of few rows
            plane = light[band]
            found, lit = [sampling.transform(plane, columns)], not is_dark(plane)
        yield found.pop() if lit else None


def _gathered(light: Array | BandArray, basis: Array) -> Iterator[Array]:
    """Yield a few planes, each a sum over bands, of which every channel is a linear combination; no plane is kept."""
    planes = [np.zeros(light.shape[1:], dtype=light.dtype) for _ in basis]
    group: dict[int, Array] = {}
    for band, plane in enumerate(in_order(light)):
        if not is_dark(plane):
            group[band] = np.asarray(plane)
        if group and (len(group) == TOGETHER or band + 1 == light.shape[0]):
            expansion.add_projected(planes, basis[:, list(group)], list(group.values()))
            group = {}
    yield from emptied(planes)


def emptied(arrays: list[Array]) -> Iterator[Array]:
    """Yield the arrays of a list and remove them from it, so that each can be freed before the next is used."""
    while arrays:
        yield arrays.pop(0)


def _gathered_transforms(light: BandArray, basis: Array, shape: tuple[int, int]) -> list[ComplexArray]:
    """Return the terms of shape ``shape`` of the transforms of large gathered planes, with the same bits as from whole
    planes, without holding a whole plane.
    """
    blocks, (ny, nx) = _gathered_blocks(light, basis), light.shape[1:]
    rest = np.empty((len(basis), 0), light.dtype)

    def rows_of(rows: slice) -> Array:
        nonlocal rest
        size, own = (rows.stop - rows.start) * nx, [rest]
        while sum(one.shape[1] for one in own) < size:
            own.append(next(blocks))
        found = np.concatenate(own, axis=1)
        rest = found[:, size:].copy()
        return found[:, :size].reshape(len(basis), -1, nx)

    made = sampling.transforms_of_rows(rows_of, len(basis), ny, nx, light.dtype, shape[1])
    if made is None:  # of few rows
        made = [sampling.transform(plane, shape[1]) for plane in rows_of(slice(0, ny))]
    for number in range(len(made)):
        made[number] = sampling.low_terms(made[number], shape)
    return made


def _gathered_blocks(light: BandArray, basis: Array) -> Iterator[Array]:
    """Yield successive samples of the gathered planes, (plane, sample)."""
    count, rows, columns = light.shape
    whole, size = rows * columns, gathered_samples(count) // count

    def some(bands: slice, start: int) -> Array:
        """Return a range of samples of some bands, which may begin and end within a row."""
        stop, first = min(start + size, whole), start // columns
        own = light.rows(bands, slice(first, -(-stop // columns)))
        return own.reshape(len(own), -1)[:, start - first * columns : stop - first * columns]

    starts = range(0, whole, size)
    # most bands are recognised by their first samples; dark bands take no place in a product, as with whole bands
    lit = [band for band in range(count) if any(some(slice(band, band + 1), start).any() for start in starts)]
    for start in starts:
        sums = np.zeros((len(basis), min(size, whole - start)), light.dtype)
        found = some(slice(lit[0], lit[-1] + 1), start) if lit else sums[:0]
        for first in range(0, len(lit), TOGETHER):
            group = lit[first : first + TOGETHER]
            expansion.add_projected(list(sums), basis[:, group], [found[band - lit[0]] for band in group])
        yield sums


def gathered_samples(bands: int) -> int:
    """Return the number of samples, over all bands, that are made at once: a whole number of blocks of every band."""
    return bands * expansion.BLOCK * max(1, GATHERED // (expansion.BLOCK * bands))
