"""Cells of one stage in a batch: what they have in common is settled with the first of them, so that each of the others
costs little more than its kernel.

In:  ordinary jobs, one by one, and the results that they read.
Out: the checked arrays of each.

A cell is ordinary if its own distribution is ours and nothing about it is special: it is not mapped, left out, computed
by band or waiting for a value, and it looks at no other stage. All others go the general way (``cell._made``), whose
checks, messages and bits are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from etendue.compute.form import form_of
from etendue.compute.given import Clipped, beside, looked_through, not_negative
from etendue.compute.job import Job
from etendue.compute.joined.segments import Result
from etendue.compute.ownership import for_reading, taken
from etendue.compute.random import philox
from etendue.contract.capabilities import Banded
from etendue.contract.stage import Stage
from etendue.plan.model import CellRef
from etendue.plugins import guests
from etendue.types.arrays import CellArrays

Check = Callable[[Job, Any], CellArrays]


def is_ordinary(job: Job) -> bool:
    """Return True if nothing about a cell is special, apart from its stage."""
    return (
        job.segment is None
        and job.looking is None
        and job.waiting is None
        and job.mapped is None
        and not (job.left_out or job.by_band)
        and job.task == "compute"
    )


def common(groups: dict[str, Alike], job: Job) -> Alike | None:
    """Return what a cell has in common with those of its stage in ``groups``; None if it has to go the general way."""
    if not is_ordinary(job):
        return None
    known = groups.get(job.ref[0])
    if known is None or not known.holds(job):
        known = groups[job.ref[0]] = Alike(job)
    return known if known.ordinary else None


class Alike:
    """What the ordinary cells of one stage have in common: their form and, while the stage is the same, its tables."""

    def __init__(self, job: Job) -> None:
        self.form = form = form_of(job)
        kind = type(job.stage)
        ports = [port for port, _, _ in job.inputs]
        by_factors = issubclass(kind, Banded) and kind.pointwise  # may be computed in its lit bands only
        self.ordinary = not (guests.is_guest(kind) or form.transfer or by_factors) and set(ports) <= set(form.asks)
        self.draws = "rng" in form.special
        self.outputs = [(output.variable, output.shape, output.dtype) for output in form.outputs]
        self.writes = form.writes.keys()
        self.stage: Stage | None = None
        self.owner = b""
        self.beside: CellArrays = {}

    def holds(self, job: Job) -> bool:
        """Return whether a cell has this form; the objects of the cells of a run are the same, so that most comparisons
        end at once.
        """
        if job.form is None:
            if not self.form.fits(job):
                return False
            job.form = self.form
        return job.form is self.form

    def made(self, job: Job, results: Mapping[CellRef, Result], clipped: Clipped, check: Check) -> CellArrays:
        """Return the arrays of one cell, as ``check`` gives them."""
        given: CellArrays = {}
        clips = job.stage.negative == "clip"
        for port, ref, variable in job.inputs:
            array = looked_through(job, results, ref, variable)
            given[port] = for_reading(not_negative(job, results, port, array, clipped) if clips else array)
        given |= self._beside(job, results)
        if self.draws:
            given["rng"] = philox(job.seed)
        found = job.run(**given)
        if type(found) is not dict or found.keys() != self.writes:
            return check(job, found)
        held = dict(found)
        del found, given  # a further reference would make ``taken`` copy
        if not all(_is(held[variable], shape, dtype) for variable, shape, dtype in self.outputs):
            other = [held]
            del held
            return check(job, other.pop())
        return {variable: taken(held, variable) for variable, _, _ in self.outputs}

    def _beside(self, job: Job, results: Mapping[CellRef, Result]) -> CellArrays:
        """Return the arguments that are not arrays of ports; those of the cell before if its stage is the same."""
        if self.stage is not job.stage or self.owner != job.pattern_of:
            self.beside = beside(job, results)
            self.beside.pop("rng", None)
            self.stage, self.owner = (job.stage if self.form.lasts(job.stage) else None), job.pattern_of
        return self.beside


def _is(array: Any, shape: tuple[int, ...], dtype: np.dtype[np.generic]) -> bool:
    return type(array) is np.ndarray and array.shape == shape and array.dtype == dtype
