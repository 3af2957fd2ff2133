"""Run a stage slice by slice over the dims that it does not work on: frames, channels of full planes, dims of plugins.

In:  a ``Job`` with mapped dims and the results it reads.
Out: its arrays; each slice has the bits that the stage gives for that slice alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.compute.found import seed_found, stage_found, with_found
from etendue.compute.given import Clipped, beside, looked_through, not_negative
from etendue.compute.job import Job
from etendue.compute.joined.segments import Result, transferred
from etendue.compute.ownership import as_array, for_reading, handed
from etendue.compute.random import philox, renamed
from etendue.contract.capabilities import Transfer, is_random
from etendue.contract.stage import Stage, quantities_of, writes_of
from etendue.errors import PluginError
from etendue.plan.model import CellRef
from etendue.types.arrays import Array, CellArrays, FloatArray

Results = Mapping[CellRef, Result]
Check = Callable[[Job, Any], CellArrays]


def one_by_one(job: Job, results: Results, clipped: Clipped, check: Check) -> dict[str, Array]:
    """Return every variable with the mapped dims first; ``check`` compares a result with the declaration."""
    slices = _Slices(job, results, clipped)
    if isinstance(job.stage, Transfer):
        return slices.joined([transferred(*slices.alone(at))[1] for at in np.ndindex(*slices.sizes)], check)
    names = job.asks
    # One call for all slices needs one stage for all of them, and no random numbers: the draws of a slice must not
    # depend on the slices before it.
    if job.stage.elementwise and not (
        slices.found or slices.along or (is_random(type(job.stage)) and not job.averages)
    ):
        return slices.at_once(names, check)
    called = "mean" if job.averages else "run"
    arrays: CellArrays = {}
    constant: CellArrays = {}
    generator: np.random.Generator | None = None
    for number, at in enumerate(np.ndindex(*slices.sizes)):
        stage = slices.stage_at(at)
        if not number or slices.prepares_anew:
            # without a seed, because the generator is set from the words of each slice below
            constant = beside(replace(slices.core, stage=stage, seed=b""), results)
        given = slices.arrays_at(at) | constant
        if "rng" in constant:
            words = seed_found(job, results, at) + slices.words(at)
            given["rng"] = generator = renamed(generator, words) if generator else philox(words)
        found = getattr(stage, called)(**handed(stage, {name: given[name] for name in names if name in given}))
        if number:
            # The first slice was checked against the declaration; the others only have to match the first, which is
            # faster.
            _put(arrays, found, slices, at)
        else:
            arrays = {name: slices.whole(name, array) for name, array in check(slices.core, found).items()}
    return arrays


def _put(arrays: dict[str, Array], found: Any, slices: _Slices, at: tuple[int, ...]) -> None:
    """Store another slice; raise an error if its variables, shapes or types differ from those of the first slice."""
    name = type(slices.core.stage).__name__
    if not isinstance(found, dict) or found.keys() != arrays.keys():
        raise PluginError(f"{name}.run gave other variables for slice {at} than for the first")
    for variable in slices.led:
        array, place = found[variable], arrays[variable]
        if type(array) is not np.ndarray:
            array = as_array(name, variable, array)
        fits = array.dtype == place.dtype or (place.dtype.kind == "f" and array.dtype.kind in "fiub")
        if not fits or array.shape != place.shape[len(at) :]:
            expected = f"the first is {place.dtype} {place.shape[len(at) :]}"
            raise PluginError(f"{name} gave slice {at} of {variable} as {array.dtype} {array.shape}, but {expected}")
        place[at] = array


@dataclass(init=False)
class _Slices:
    """A job that is run slice by slice: the input of each slice, and the place of its result."""

    def __init__(self, job: Job, results: Results, clipped: Clipped) -> None:
        mapped = job.mapped
        assert mapped is not None
        self.job, self.results, self.clipped = job, results, clipped
        self.found = job.waiting.found if job.waiting else ()
        self.dims = [dim for dim, _ in mapped.dims]
        self.labels = [list(coordinate.values()) for _, coordinate in mapped.dims]
        self.sizes = tuple(len(own) for own in self.labels)
        declared = {d.variable: d for d in writes_of(type(job.stage)).values() if d.variable in job.writes}
        # Variables that start with the mapped dims; the stage itself writes the others with these dims.
        self.led = [v for v, d in declared.items() if job.writes[v].dims != d.dims]
        grids = {v: job.grids[v].take(d.dims) for v, d in declared.items()}
        self.core = replace(job, mapped=None, waiting=None, writes=declared, grids=grids)
        self.along = {
            n: self.dims.index(p.along) for n, p in quantities_of(type(job.stage)).items() if p.along in self.dims
        }
        self.given = [
            (port, looked_through(job, results, ref, v), mapped.leading[ref[0], v]) for port, ref, v in job.inputs
        ]
        self.negative = {
            p for p, ref, v in job.inputs if job.stage.negative == "clip" and results[ref].lowest.get(v, 0.0) < 0
        }
        self.prepares_anew = bool((self.found or self.along) and type(job.stage).prepare is not Stage.prepare)

    def stage_at(self, at: tuple[int, ...]) -> Stage:
        """Return the stage of a slice, with the values found for it and its labels along mapped dims."""
        stage = stage_found(self.job, self.results, at)
        return (
            replace(stage, **{name: self.labels[i][at[i]] for name, i in self.along.items()}) if self.along else stage
        )

    def arrays_at(self, at: tuple[int, ...]) -> CellArrays:
        """Return the input of a slice, as parts of read-only arrays."""
        found = {
            port: array[tuple([at[i] for i in lead])] if lead else for_reading(array)
            for port, array, lead in self.given
        }
        for port in self.negative:
            found[port] = not_negative(self.job, self.results, port, found[port], self.clipped)
        return found

    def alone(self, at: tuple[int, ...]) -> tuple[Job, dict[CellRef, Result]]:
        """Return a slice as a separate job, and its input."""
        own = replace(
            with_found(self.job, self.results, at), mapped=None, writes=self.core.writes, grids=self.core.grids
        )
        seen = dict(self.results)
        for (_, ref, variable), array in zip(own.inputs, self.arrays_at(at).values(), strict=True):
            seen[ref] = Result(arrays={variable: array}, lowest=self.results[ref].lowest)
        return own, seen

    def joined(self, found: list[CellArrays], check: Check) -> CellArrays:
        """Return all slices of a transfer stage, stacked."""
        every = [check(self.core, arrays) for arrays in found]
        return {
            name: np.stack([arrays[name] for arrays in every]).reshape(*self.sizes, *every[0][name].shape)
            for name in every[0]
        }

    def at_once(self, names: tuple[str, ...], check: Check) -> dict[str, Array]:
        """Compute all slices in one call, for an elementwise stage; outputs without the mapped dims are broadcast."""
        given = {port: for_reading(array) for port, array, _ in self.given} | beside(self.core, self.results)
        for port in self.negative:
            given[port] = not_negative(self.job, self.results, port, given[port], self.clipped)
        found = self.core.run(**handed(self.core.stage, {name: given[name] for name in names if name in given}))
        if isinstance(found, dict):
            for variable in self.led:
                shape = self.job.grids[variable].shape(self.job.writes[variable].dims)
                if variable in found and np.shape(found[variable]) == shape[len(self.sizes) :]:
                    found[variable] = np.broadcast_to(found[variable], shape).copy()
        return check(replace(self.job, mapped=None), found)

    def words(self, at: tuple[int, ...]) -> bytes:
        return "".join(f"|{dim}={own[i]}" for dim, own, i in zip(self.dims, self.labels, at, strict=True)).encode()

    def whole(self, name: str, first: FloatArray) -> FloatArray:
        """Return an array for all slices with the first slice in its place."""
        if name not in self.led:
            return first
        array = np.empty((*self.sizes, *first.shape), first.dtype)
        array[(0,) * len(self.sizes)] = first
        return array
