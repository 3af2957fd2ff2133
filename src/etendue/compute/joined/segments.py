"""Transfer functions: one transform at the start of a segment, products in frequency, one transform per wanted result.

In:  a ``Job`` of a transfer stage and the results it reads.
Out: its ``Result`` with the transform for the next stage, and its arrays.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from etendue.compute.bands import BandArray, among_all, lit_bands
from etendue.compute.job import Job
from etendue.compute.joined.segment_bands import from_bands, places
from etendue.compute.joined.segment_cells import from_cells
from etendue.compute.ownership import frozen
from etendue.compute.tables import TABLES, prepared_of
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Summed, Transfer
from etendue.contract.stage import state_of
from etendue.errors import PluginError
from etendue.plan.model import CellRef
from etendue.transfer import sampling
from etendue.transfer.products import EVERY, Product, asked, weights
from etendue.types.arrays import Array, CellArrays


@dataclass(eq=False)
class Light:
    """The light at a place in a segment: a transform in the bands ``lit``, outside which there is no light, times some
    transfer functions. Before the first stage that needs the whole light, this is the unchanged light of the segment's
    input.
    """

    untouched: Any = None
    lit: slice = field(default_factory=lambda: EVERY)
    made: tuple[Any, tuple[Array, ...]] = (None, ())  # the transform if it exists, and the factors to multiply it by

    def lit_in(self) -> slice:
        if self.lit == EVERY:
            self.lit = lit_bands(self.untouched)
        return self.lit

    def part(self, bands: slice) -> Any:
        """Return the product of some of the lit bands."""
        transform, factors = self.made
        some = self._transformed(bands) if transform is None else transform[bands]
        for otf in factors:
            some = _times(some, otf if len(otf) == 1 else otf[bands])
        return some

    def whole(self) -> Any:
        """Return the product of all lit bands, computed once for all cells that continue from here."""
        transform, factors = self.made
        if transform is None or factors:
            own = transform is None
            transform = self._transformed(EVERY) if own else transform
            for otf in factors:
                transform, own = _times(transform, otf, own), True
            self.made = transform, ()
        return transform

    def _transformed(self, bands: slice) -> Any:
        return sampling.transform(self.untouched[self.lit_in()][bands])


@dataclass
class Result:
    """The result of a cell for its readers: arrays, the light inside a segment, and the smallest value of those arrays
    for which it was needed so far (NaN if an array has undefined values).
    """

    arrays: CellArrays = field(default_factory=dict)
    lowest: dict[str, float] = field(default_factory=dict)
    light: Light | None = None
    failed: str = ""

    def read_only(self) -> Result:
        """Make the arrays read-only again: pickling for another process loses the flag."""
        light = (self.light.made[0], self.light.untouched) if self.light else ()
        for array in (*self.arrays.values(), *light):
            if array is not None and not isinstance(array, BandArray):
                frozen(array)
        return self


def passed_on(job: Job, results: Mapping[CellRef, Result]) -> tuple[Result, CellArrays]:
    """Return the arrays of its input that a left-out cell passes on, and the light of its segment."""
    result, arrays = Result(), CellArrays()
    for _, ref, variable in job.inputs:
        if variable in job.passes and variable not in arrays:
            arrays[variable] = results[ref].arrays[variable]
            if variable in results[ref].lowest:
                result.lowest[variable] = results[ref].lowest[variable]
    if job.segment is not None and job.segment.previous is not None:
        result.light = results[job.segment.previous].light
    elif job.segment is not None:
        _, ref, variable = job.inputs[0]
        result.light = Light(untouched=results[ref].arrays[variable])
    return result, arrays


def _on_grid(job: Job, stage: Transfer, lit: slice) -> Array:
    """Return a stage's transfer function at the frequencies of the padded grid, (lit band or 1, Ny, Nx // 2 + 1),
    cached. If it depends on the magnitude of the frequency alone, return only rows 0 to Ny // 2.
    """
    grid = job.input_grids[job.inputs[0][0]]
    y, x = grid.line("y"), grid.line("x")
    edges = grid.bands().edges

    def make() -> Array:
        fy = sampling.frequencies(y.size, y.step, half=False)[:, None]
        fx = sampling.frequencies(x.size, x.step, half=True)[None, :]
        if stage.radial:
            fy = np.abs(fy[: fy.size // 2 + 1])
        middles = Product((stage,), edges).middles[lit]
        value = asked(stage, fy, fx, middles, prepared_of(stage, job.input_grids, job.grids))
        own = np.dtype(job.precision)
        return np.array(value, dtype=np.result_type(own, np.complex64) if np.iscomplexobj(value) else own, order="C")

    return TABLES.get(("transfer", state_of(stage), y, x, edges, lit.start, lit.stop, job.precision), make, True)


def _times(transform: Array, otf: Array, in_place: bool = False) -> Array:
    """Multiply transforms by a transfer function, whose rows of negative frequencies may be omitted."""
    rows, upper, kind = transform.shape[-2], otf.shape[-2], np.result_type(transform, otf)
    out = transform if in_place and kind == transform.dtype else np.empty(transform.shape, kind)
    if upper in (1, rows):
        return np.multiply(transform, otf, out=out)
    np.multiply(transform[..., :upper, :], otf, out=out[..., :upper, :])
    np.multiply(transform[..., upper:, :], otf[..., rows - upper : 0 : -1, :], out=out[..., upper:, :])
    return out


@dataclass(eq=False)
class LightBands(BandArray):
    """Light inside a segment, transformed back band by band."""

    light: Light
    grid: Grid
    precision: str
    on_demand = False  # cheap enough to be looked at
    seconds = 0.0  # of the bands that were requested one by one

    def __post_init__(self) -> None:
        self.shape = self.grid.bands().size, self.grid.line("y").size, self.grid.line("x").size
        self.dtype = np.dtype(self.precision)

    def _some(self, bands: slice) -> Array:
        return sampling.planes_of(self.light.part(bands), self.shape[1], self.shape[2])

    def __getitem__(self, band: int) -> Array:
        began, lit = time.thread_time(), self.light.lit_in()
        if not lit.start <= band < lit.stop:
            return np.zeros(self.shape[1:], self.dtype)
        plane: Array = self._some(slice(band - lit.start, band - lit.start + 1))[0]
        if not np.isfinite(plane).all():
            raise PluginError(f"a transfer function made NaN or infinite values of band {band}")
        self.seconds += time.thread_time() - began
        return plane

    def whole(self) -> Array:
        lit = self.light.lit_in()
        found = np.empty((lit.stop - lit.start, *self.shape[1:]), self.dtype)
        for bands in sampling.groups(found.shape):
            found[bands] = self._some(bands)
        return among_all(found, lit, self.shape[0])


def _summed(own: Array, light: Light, otf: Array) -> Array:
    """Return the transforms of channels: the weighted sums over bands of the light after the stage."""
    transform = light.whole()
    if otf.shape[0] > 1:
        transform = _times(transform, otf)
    channels = sampling.sum_over_bands(own, np.ascontiguousarray(transform))
    return _times(channels, otf) if otf.shape[0] == 1 else channels


def transferred(job: Job, results: Mapping[CellRef, Result]) -> tuple[Result, CellArrays]:
    if not (job.transform or job.store or job.deliver):
        return Result(), {}
    if job.input_grids[job.inputs[0][0]].line("y").cells:
        return Result(), from_cells(job, results)
    if job.segment is not None and job.segment.joined is not None:
        return Result(), from_bands(job, results)
    port, ref, variable = job.inputs[0]
    grid = job.input_grids[port]
    y, x = grid.line("y"), grid.line("x")
    first = job.segment is None or job.segment.previous is None
    light = Light(untouched=results[ref].arrays[variable]) if first else results[ref].light
    assert light is not None
    lit = light.lit_in()
    (name,) = job.writes
    stage = job.stage
    assert isinstance(stage, Transfer)
    otf = _on_grid(job, stage, lit)
    if isinstance(stage, Summed):
        channels = _summed(weights(stage, prepared_of(stage, job.input_grids, job.grids))[:, lit], light, otf)
        return Result(), {name: sampling.sample(channels, y.size, x.size, *places(grid, job.grids[name]))}
    seen = job.segment is not None and job.segment.seen
    if job.transform and not seen:
        # Only this cell has the transform that it made itself; others read that of a previous stage.
        light = Light(None, lit, (_times(light.whole(), otf, first), ()))
    else:
        transform, factors = light.made
        light = Light(light.untouched, lit, (transform, (*factors, otf)))
    arrays: CellArrays = {}
    if job.store or job.deliver:
        bands = LightBands(light, grid, job.precision)
        arrays = {name: bands if seen else bands.whole()}
    return Result(light=light if job.transform else None), arrays
