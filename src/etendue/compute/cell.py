"""Compute one cell: pass plain arrays to a stage, check the result, store it.

In:  a ``Job`` and the results it reads.
Out: its ``Result`` and a ``CellReport``; a failure is a report, not an exception.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.compute.bands import BandArray, StoredBands, Timed, elsewhere, made_by_band, of_lit_bands
from etendue.compute.form import Output, form_of
from etendue.compute.found import with_found
from etendue.compute.given import Alike, Clipped, arguments, common
from etendue.compute.job import Job
from etendue.compute.joined.segments import Result, passed_on, transferred
from etendue.compute.mapped import one_by_one
from etendue.compute.ownership import as_array, for_reading, frozen, guests_of, handed, taken, undisturbed
from etendue.compute.rounded import handed_on
from etendue.contract.ports import CellReport, WrittenChunk
from etendue.errors import ArchiveInUse, EtendueError, MachineError, PluginError, refused_by_the_machine
from etendue.interrupts import is_ours
from etendue.plan.model import CellRef
from etendue.plugins import guests
from etendue.telling import plain, told
from etendue.types.arrays import Array, CellArrays


def check(job: Job, arrays: Any, outputs: tuple[Output, ...] | None = None) -> CellArrays:
    """Check a stage's result against the declaration of all its outputs, or of some of them; convert floats to the
    plan's precision.
    """
    form, name = form_of(job), type(job.stage).__name__
    if not isinstance(arrays, dict):
        raise PluginError(f"{name}.run gave {type(arrays).__name__}, not a dict of the variables it writes")
    if arrays.keys() != (form.writes.keys() if outputs is None else {output.variable for output in outputs}):
        raise PluginError(f"{name}.run gave {sorted(map(str, arrays))}, but declares {sorted(job.writes)}")
    checked, arrays = CellArrays(), dict(arrays)
    for output in form.outputs if outputs is None else outputs:
        variable, wanted = output.variable, output.dtype
        array = arrays.pop(variable)
        if type(array) is not np.ndarray:
            if isinstance(array, BandArray):
                checked[variable] = array  # checked band by band as it is computed
                continue
            array = as_array(name, variable, array)
        if array.shape != output.shape:
            dims = output.declaration.dims
            raise PluginError(f"{name} gave {variable} with shape {array.shape}, but declares {dims} = {output.shape}")
        if array.dtype != wanted:
            if wanted.kind != "f" and job.expected and array.dtype.kind == "f":
                wanted = np.dtype(job.precision)  # a mean is not rounded
            if wanted.kind != "f":
                raise PluginError(f"{name} gave {variable} as {array.dtype}, but declares {wanted}")
            if array.dtype.kind not in "fiub":
                raise PluginError(f"{name} gave {variable} as {array.dtype}, but declares floats")
            array = array.astype(wanted)  # infinite values are found and reported below
        if form.transfer:  # computed by the engine, or its unchanged input: no copy needed
            checked[variable] = frozen(array if array.flags.c_contiguous else array.copy(order="C"))
            continue
        given = {variable: array}
        del array
        checked[variable] = taken(given, variable)
    return checked


def smallest(array: Array) -> float:
    """Return the smallest value of an array; NaN if any value is NaN or infinite."""
    low, high = float(array.min()), float(array.max())
    return low if np.isfinite(low) and np.isfinite(high) else float("nan")


def finite(array: Array) -> bool:
    """Return True if no value is NaN or infinite. The squares are summed in one pass; the values are tested one by one
    only if the sum is not finite.
    """
    if not array.ndim:
        return math.isfinite(array)
    flat = array.reshape(-1)
    return math.isfinite(flat.dot(flat)) or bool(np.isfinite(flat).all())


def undefined(job: Job, arrays: Mapping[str, Array]) -> dict[str, float]:
    """Return NaN for each float array with undefined values; raise an error if undefined values were not declared."""
    found = {}
    for variable, array in arrays.items():
        if type(array) is not np.ndarray and isinstance(array, BandArray):
            continue
        if array.dtype.kind != "f" or array.size == 0 or finite(array):
            continue
        if not job.writes[variable].nan:
            bad = int(array.size - np.isfinite(array).sum())
            raise PluginError(
                f"{type(job.stage).__name__} wrote {bad} of {array.size} values of {variable} that are NaN or "
                f"infinite; likely causes: "
                "an input beyond the declared range, an ill-conditioned step, missing data. If NaN is intended, "
                "declare '[unit] nan'"
            )
        found[variable] = float("nan")
    return found


def compute(
    job: Job,
    results: Mapping[CellRef, Result],
    began: float | None = None,
    groups: dict[str, Alike] | None = None,
) -> tuple[Result, CellReport]:
    """Compute or load one cell. Exceptions of stages become a failed report.

    ``began`` is the thread time at the end of the previous cell, which is reused because reading the clock costs 5 us.
    ``groups``: the common properties of the cells of each stage, in a batch that runs ``undisturbed`` as a whole.
    """
    began = time.thread_time() if began is None else began
    for ref in job.needs:
        # The cell is skipped rather than failed, with the name of the cell that failed first: one cause is reported
        # once.
        if results[ref].failed:
            return Result(failed=results[ref].failed), CellReport(
                *job.ref, "skipped", message=f"{results[ref].failed} failed"
            )
    clipped: Clipped = []
    elsewhere.seconds = 0.0
    try:
        if job.task == "load":
            result, arrays = undisturbed(_load, job, results)
            # A stored array may contain declared NaN. Noting that here saves every reader another pass over the array.
            result.arrays, result.lowest = arrays, result.lowest | undefined(job, arrays)
            return result, CellReport(*job.ref, "loaded")
        group = common(groups, job) if groups is not None else None
        if group is not None:
            arrays = group.made(job, results, clipped, check)
            arrays = handed_on(job, arrays) if job.steps else arrays
            return kept(job, Result(lowest=undefined(job, arrays)), arrays, clipped, lambda: time.thread_time() - began)
        with guests_of(job):
            result, arrays = undisturbed(_made, job, results, clipped)
        arrays = handed_on(job, arrays) if job.steps else arrays
        return kept(job, result, arrays, clipped, lambda: time.thread_time() - began + elsewhere.seconds)
    except (MachineError, ArchiveInUse):
        raise  # not caused by the stage (a full disk, or another run owns the archive), so the run ends
    except BaseException as error:  # SystemExit too: a stage must not end more than its own cell
        if is_ours(error):
            raise
        text = plain(str(error)) if in_words(error) else told(error)
        return Result(failed=job.ref[0]), CellReport(*job.ref, "failed", time.thread_time() - began, message=text)


def kept(
    job: Job, result: Result, arrays: CellArrays, clipped: Clipped, seconds_of: Callable[[], float]
) -> tuple[Result, CellReport]:
    """Store the kept variables of a cell, and leave in its result the variables that other cells read."""
    seconds = seconds_of()
    written: tuple[WrittenChunk, ...] = ()
    if job.target and job.store:
        given = {v: Timed(arrays[v]) if isinstance(arrays[v], BandArray) else arrays[v] for v in job.store}
        with refused_by_the_machine():
            written = job.target.write(given)
        seconds += sum(array.seconds for array in given.values() if isinstance(array, Timed))
        arrays |= {v: StoredBands(job, v) for v in job.store if isinstance(arrays[v], BandArray)}
    arrays, more = _looked_at(job, arrays)
    seconds += more
    result.arrays = {v: arrays[v] for v in job.deliver if v in arrays} if arrays else {}
    share, flux = (sum(values) / len(clipped) for values in zip(*clipped, strict=True)) if clipped else (0.0, 0.0)
    status = "left_out" if job.left_out else "done"
    counted = () if job.left_out else form_of(job).counted
    floored = sum(float(np.nansum(arrays[v])) for v in counted if v in arrays)
    return result, CellReport(
        *job.ref, status, seconds, tuple(written), clipped=share, clipped_flux=flux, floored=floored
    )


def _looked_at(job: Job, arrays: CellArrays) -> tuple[CellArrays, float]:
    """If the caller only looks at the light, return its reduction by the caller and the seconds spent on the bands;
    otherwise return the arrays and 0. An error in one band is an error of the cell.
    """
    if job.segment is None or not job.segment.seen or job.look is None:
        return arrays, 0.0
    bands = list(arrays.values())
    return job.look(arrays), sum(array.seconds for array in bands)


def in_words(error: BaseException) -> bool:
    """Return True if the text of an exception explains it without a traceback: an exception of etendue, or a ValueError
    that code of etendue raised about a value.
    """
    if isinstance(error, EtendueError):
        return True
    place = error.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return (
        isinstance(error, ValueError)
        and place is not None
        and guests.is_ours(place.tb_frame.f_globals.get("__name__", ""))
    )


def _made(job: Job, results: Mapping[CellRef, Result], clipped: Clipped) -> tuple[Result, CellArrays]:
    """Return the checked result of the stage."""
    if job.mapped and not job.left_out:
        arrays = one_by_one(job, results, clipped, check)
        return Result(lowest=undefined(job, arrays)), arrays
    if job.left_out:
        return _passed(job, results, clipped)
    job = with_found(job, results)
    transfer = form_of(job).transfer
    if transfer:
        result, arrays = transferred(job, results)
    elif job.by_band:
        given = {port: for_reading(results[ref].arrays[variable]) for port, ref, variable in job.inputs}
        result, arrays = Result(), made_by_band(job, given)
    else:
        given = {port: results[ref].arrays[variable] for port, ref, variable in job.inputs}
        lit = of_lit_bands(job, given)
        del given
        result = Result()
        arrays = job.run(**handed(job.stage, arguments(job, results, clipped))) if lit is None else lit
    if not transfer or arrays:
        held = [arrays]
        del arrays  # another reference would make ``taken`` copy all of them
        arrays = check(job, held.pop())
        result.lowest = undefined(job, arrays)
    return result, arrays


def _passed(job: Job, results: Mapping[CellRef, Result], clipped: Clipped) -> tuple[Result, CellArrays]:
    """Return the arrays and light that a left-out cell passes on; the stage is run only for optional outputs that are
    wanted.
    """
    result, arrays = passed_on(job, results)
    # The stage before may have declared undefined values, which this one must not pass on without declaring them too.
    doubtful = {name: array for name, array in arrays.items() if math.isnan(result.lowest.get(name, 0.0))}
    undefined(job, doubtful)
    if any(job.writes[name].optional for name in (*job.store, *job.deliver)):
        found, other = _made(replace(job, left_out=False), results, clipped)
        arrays |= {name: array for name, array in other.items() if job.writes[name].optional}
        result.lowest |= {name: low for name, low in found.lowest.items() if job.writes[name].optional}
    return result, arrays


def _load(job: Job, results: Mapping[CellRef, Result]) -> tuple[Result, CellArrays]:
    """Load a finished cell: read its arrays back, or rebuild its transform from the segment's input."""
    arrays: CellArrays = {}
    if job.left_out:
        result, arrays = passed_on(job, results)
    elif job.transform:
        result, _ = transferred(with_found(job, results), results)
    else:
        result = Result()
    stored = [v for v in job.deliver if v not in arrays]
    assert job.target is not None or not stored
    with refused_by_the_machine():
        for v in stored:
            assert job.target is not None
            arrays[v] = StoredBands(job, v) if v in job.by_band else job.target.read(v)
    return result, {v: array if isinstance(array, BandArray) else frozen(array) for v, array in arrays.items()}
