"""Transfer functions: one transform at the start of a segment, products in frequency, one transform per wanted result.

In:  a ``Job`` of a transfer stage and the results it reads.
Out: its ``Result`` with the transform for the next stage, and its arrays.
"""

from __future__ import annotations

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
from etendue.contract.capabilities import Summed, Transfer
from etendue.contract.stage import state_of
from etendue.plan.model import CellRef
from etendue.transfer import sampling
from etendue.transfer.products import EVERY, Product, weights
from etendue.types.arrays import Array, CellArrays


@dataclass(eq=False)
class Light:
    """The light at a place in a segment: its transform in the bands ``lit``, outside which there is no light. If all
    stages before were left out, it holds the input of the segment instead; the first stage that needs the transform
    computes it for all.
    """

    transform: Any = None
    untouched: Any = None
    lit: slice = field(default_factory=lambda: EVERY)

    def transformed(self) -> tuple[Any, slice]:
        if self.transform is None:
            self.lit = lit_bands(self.untouched)
            self.transform = sampling.transform(self.untouched[self.lit])
        return self.transform, self.lit


@dataclass
class Result:
    """The result of a cell for its readers: arrays, the light inside a segment, and the smallest value of each array
    that was needed so far (NaN if the array has undefined values).
    """

    arrays: CellArrays = field(default_factory=dict)
    lowest: dict[str, float] = field(default_factory=dict)
    light: Light | None = None
    failed: str = ""

    def read_only(self) -> Result:
        """Make the arrays read-only again: pickling for another process loses the flag."""
        light = (self.light.transform, self.light.untouched) if self.light else ()
        for array in (*self.arrays.values(), *light):
            if array is not None and not isinstance(array, BandArray):
                frozen(array)
        return self


def passed_on(job: Job, results: Mapping[CellRef, Result]) -> tuple[Result, CellArrays]:
    """Return the arrays that a left-out cell passes on, which are those of its input, and the light of its segment."""
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
    """Return (lit band or 1, Ny, Nx // 2 + 1): a stage's own transfer function at the frequencies of the padded grid,
    cached.
    """
    grid = job.input_grids[job.inputs[0][0]]
    y, x = grid.line("y"), grid.line("x")
    edges = grid.bands().edges

    def make() -> Array:
        fy = sampling.frequencies(y.size, y.step, half=False)[:, None]
        fx = sampling.frequencies(x.size, x.step, half=True)[None, :]
        value = Product((stage,), edges, lambda own, _: prepared_of(own, job.input_grids, job.grids)).at(fy, fx, lit)
        kind = (
            np.result_type(np.dtype(job.precision), np.complex64) if np.iscomplexobj(value) else np.dtype(job.precision)
        )
        return np.ascontiguousarray(value, dtype=kind)

    return TABLES.get(("transfer", state_of(stage), y, x, edges, lit.start, lit.stop, job.precision), make)


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
    transform, lit = light.transformed()
    (name,) = job.writes
    stage = job.stage
    assert isinstance(stage, Transfer)
    if isinstance(stage, Summed):
        own, otf = weights(stage, prepared_of(stage, job.input_grids, job.grids)), _on_grid(job, stage, lit)
        if otf.shape[0] > 1:
            transform = transform * otf
        channels = sampling.sum_over_bands(own[:, lit], np.ascontiguousarray(transform))
        if otf.shape[0] == 1:
            channels = channels * otf
        return Result(), {name: sampling.sample(channels, y.size, x.size, *places(grid, job.grids[name]))}
    otf = _on_grid(job, stage, lit)
    # Only this cell has the transform that it made itself; others read that of a previous stage.
    alone = first and np.result_type(transform, otf) == transform.dtype
    transform = np.multiply(transform, otf, out=transform) if alone else transform * otf
    arrays = {}
    if job.store or job.deliver:
        arrays = {name: among_all(sampling.planes_of(transform, y.size, x.size), lit, grid.bands().size)}
    return Result(light=Light(transform, lit=lit) if job.transform else None), arrays
