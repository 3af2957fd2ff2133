"""The arguments of a stage's ``run``: read-only arrays, coordinates, prepared tables, random numbers.

In:  a ``Job`` and the results it reads.
Out: arguments by name.

Properties that the ordinary cells of one stage in a batch share are determined for the first cell, so that every other
cell takes little more time than its kernel. A cell is ordinary if its stage belongs to this distribution and nothing
about it is special: it is not mapped, left out, computed by band or waiting for a value, and it looks at no other
stage. All other cells are computed by ``cell._made``, with the same checks, messages and bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.compute.bands import BandArray
from etendue.compute.form import form_of
from etendue.compute.job import Job, Looking
from etendue.compute.joined.otf import transfers_of, weights_of
from etendue.compute.joined.segments import Result
from etendue.compute.ownership import for_reading, frozen, taken
from etendue.compute.random import philox
from etendue.compute.tables import PatternRandom, prepared_of
from etendue.contract.capabilities import Banded, Probe
from etendue.contract.stage import Stage
from etendue.errors import PluginError
from etendue.plan.model import CellRef
from etendue.plugins import guests
from etendue.types.arrays import Array, CellArrays

if TYPE_CHECKING:
    from etendue.contract.arrays.grid import Grid

NOTHING = Looking()
Clipped = list[tuple[float, float]]  # fraction of values that were negative, and their fraction of the flux


def arguments(job: Job, results: Mapping[CellRef, Result], clipped: Clipped) -> CellArrays:
    """Return all arguments of ``run``, in its order."""
    given = {port: looked_through(job, results, ref, variable) for port, ref, variable in job.inputs}
    for port, array in given.items():
        given[port] = for_reading(not_negative(job, results, port, array, clipped))
    given |= beside(job, results)
    return {name: given[name] for name in job.asks if name in given}


def looked_through(job: Job, results: Mapping[CellRef, Result], ref: CellRef, variable: str) -> Any:
    """Return an input array after checking it for values that its stage refuses."""
    result, policy = results[ref], job.stage.negative
    array = result.arrays[variable]
    if type(array) is not np.ndarray and isinstance(array, BandArray):  # the stage needs the whole array
        array = np.asarray(array)
    if array.dtype.kind != "f" or not array.size:
        return array
    if job.stage.nan != "keep" and not math.isfinite(result.lowest.get(variable, 0.0)):
        raise PluginError(
            f"{variable} from {ref[0]!r} holds NaN or infinite values, which {job.ref[0]!r} refuses; "
            "find the stage that produced them, or use a stage that declares nan = 'keep'"
        )
    if policy == "keep":
        return array
    if variable not in result.lowest:  # computed once, and only if a stage needs it
        result.lowest[variable] = float(array.min())
    if policy == "error" and result.lowest[variable] < 0:
        raise PluginError(
            f"{variable} from {ref[0]!r} holds negative values (smallest {result.lowest[variable]:.3g}), which "
            f"{job.ref[0]!r} refuses; find the stage that produced them, or use a stage that keeps or clips them"
        )
    return array


def not_negative(job: Job, results: Mapping[CellRef, Result], port: str, array: Array, clipped: Clipped) -> Array:
    """Return the array of a port, or a slice of it, with negative values set to 0 if the stage clips them."""
    if job.stage.negative != "clip":
        return array
    _, ref, variable = next(one for one in job.inputs if one[0] == port)
    if array.dtype.kind != "f" or not results[ref].lowest.get(variable, 0.0) < 0:
        return array
    below, taken, flux = clipped_figures(array)
    total = float(flux.sum())
    clipped.append((below / array.size, float(taken.sum()) / total if total else 0.0))
    return frozen(np.maximum(array, 0))


def clipped_figures(array: Array) -> tuple[int, Array, Array]:
    """Return the number of negative values and, for each row, the sum of the negative values and the sum of all
    magnitudes. Sums are taken row by row, so that a frame gives the same sums as its strips.
    """
    taken = -np.minimum(array, 0).sum(axis=-1, dtype=np.float64)
    return int(np.count_nonzero(array < 0)), taken, np.abs(array).sum(axis=-1, dtype=np.float64)


def beside(job: Job, results: Mapping[CellRef, Result]) -> CellArrays:
    """Return the arguments of ``run`` that are not read from earlier cells: what the stage sees of other stages
    (variables, transfer functions, data sheets), and special arguments such as ``prepared`` and ``rng``.
    """
    given: CellArrays = {}
    looking = job.looking or NOTHING
    for port, what, pairs in looking.ports:
        if what == "transfer":
            given[port] = transfers_of(job)
        elif what == "datasheet":
            given[port] = [(name, sheet) for (name, _), sheet in zip(pairs, looking.sheets, strict=True)]
        else:
            grids = looking.grids[port] if isinstance(job.stage, Probe) and job.stage.with_grids else ()
            given[port] = _Seen([(name, results[ref].arrays[what]) for name, ref in pairs], grids).given()
    form = form_of(job)
    special = form.special
    if "asked" in special:
        given["asked"] = frozenset(name for name, declared in job.writes.items() if declared.optional)
    if "prepared" in special:
        given["prepared"] = _prepared(job)
    if "rng" in special:
        given["rng"] = philox(job.seed)
    for name in form.patterns:
        given[name] = PatternRandom(job.pattern_of, next(iter(job.grids.values())), job.precision)
    for name in form.beside:
        if name not in given:
            if name not in form.coordinates:
                raise PluginError(f"{type(job.stage).__name__}.run asks for {name}, which its grids do not have")
            given[name] = for_reading(form.coordinates[name])
    return given


class _Seen(Sequence[tuple[Any, ...]]):
    """The arrays that a stage looks at, as (stage name, array) or (stage name, array, grid). Light that is computed by
    band is computed as a whole on access, so that a loop over the stages holds one array at a time.
    """

    def __init__(self, seen: list[tuple[str, Any]], grids: Sequence[Grid]) -> None:
        self.seen, self.grids = seen, grids

    def given(self) -> Sequence[tuple[Any, ...]]:
        """Return a list if all arrays are in memory."""
        return self if any(isinstance(array, BandArray) for _, array in self.seen) else list(self)

    def __len__(self) -> int:
        return len(self.seen)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[n] for n in range(*number.indices(len(self)))]
        name, array = self.seen[number]
        whole = for_reading(frozen(np.asarray(array)) if isinstance(array, BandArray) else array)
        return (name, whole, self.grids[number]) if self.grids else (name, whole)


def _prepared(job: Job) -> Any:
    """Return the prepared tables of a stage. A stage that looks at transfer functions and has no ``prepare`` gets the
    weights of the channels.
    """
    if type(job.stage).prepare is not Stage.prepare or not (job.looking and job.looking.transfers):
        return prepared_of(job.stage, job.input_grids, job.grids, form_of(job).key_of_prepared(job.stage))
    return None if job.looking.channel_weights is None else weights_of(job.looking.channel_weights, job.looking.bands)


# -- cells that are alike ------------------------------------------------------------------------------------------

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
    """Return the properties that a cell shares with the other cells of its stage in ``groups``; None if ``cell._made``
    must compute them.
    """
    if not is_ordinary(job):
        return None
    known = groups.get(job.ref[0])
    if known is None or not known.holds(job):
        known = groups[job.ref[0]] = Alike(job)
    return known if known.ordinary else None


class Alike:
    """The shared properties of the ordinary cells of one stage: their form and, as long as the parameters of the stage
    are the same, its tables.
    """

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
        """Return whether a cell has this form. Most comparisons are fast, because the cells of a run share their
        objects.
        """
        if job.form is None:
            if not self.form.fits(job):
                return False
            job.form = self.form
        return job.form is self.form

    def made(self, job: Job, results: Mapping[CellRef, Result], clipped: Clipped, check: Check) -> CellArrays:
        """Return the arrays of one cell; ``check`` is called only if they are not exactly as declared."""
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
        as_declared = all(
            type(held[variable]) is np.ndarray and held[variable].shape == shape and held[variable].dtype == dtype
            for variable, shape, dtype in self.outputs
        )
        if not as_declared:
            other = [held]
            del held
            return check(job, other.pop())
        return {variable: taken(held, variable) for variable, _, _ in self.outputs}

    def _beside(self, job: Job, results: Mapping[CellRef, Result]) -> CellArrays:
        """Return the arguments that are not arrays of ports. They are reused while the stage stays the same."""
        if self.stage is not job.stage or self.owner != job.pattern_of:
            self.beside = beside(job, results)
            self.beside.pop("rng", None)
            self.stage, self.owner = (job.stage if self.form.lasts(job.stage) else None), job.pattern_of
        return self.beside
