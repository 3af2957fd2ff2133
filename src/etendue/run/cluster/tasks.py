"""The tasks of workers: functions by name, with arguments as bytes that neither dask nor the scheduler inspects.

In:  the jobs of a batch as bytes; the results that it reads.
Out: its result, which stays on its worker; its reports, which the owner of the run fetches.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Mapping, Set
from typing import Any

import cloudpickle

from etendue.compute.job import Job
from etendue.interrupts import is_ours
from etendue.plan.model import CellRef
from etendue.plugins.guests import Guest
from etendue.run.batches import NOBODY, BatchResult, Names, run_batch
from etendue.run.cluster.alike import Common, be_alike
from etendue.run.one_thread import ONE_THREAD
from etendue.run.workers import unfit

Told = tuple[tuple[Any, ...], dict[CellRef, dict[str, object]]]  # reports, and the requested arrays


def as_bytes(
    jobs: Iterable[Job],
    exports: Mapping[CellRef, Names],
    imports: Iterable[Iterable[CellRef]],
    deliver: Set[CellRef],
    doomed: Mapping[CellRef, str] = NOBODY,
    topic: str = "",
    number: int = 0,
) -> bytes:
    """Pickle a batch or a part of one. ``topic``: the Dask topic under which the start of each cell is reported, with
    the batch number.
    """
    jobs = tuple(jobs)
    own = frozenset(job.ref for job in jobs if job.ref in deliver)
    rest = (dict(exports), tuple(map(tuple, imports)), own, dict(doomed), topic, number)
    try:
        return bytes(cloudpickle.dumps((jobs, *rest), protocol=pickle.HIGHEST_PROTOCOL))
    except BaseException as error:
        if is_ours(error):
            raise
    cannot = unfit(jobs)
    jobs = tuple(job if job.ref not in cannot else job.without_stage() for job in jobs)
    return bytes(
        cloudpickle.dumps((jobs, *rest[:3], {**cannot, **doomed}, *rest[4:]), protocol=pickle.HIGHEST_PROTOCOL)
    )


def compute(common: Common, data: bytes, *before: BatchResult) -> BatchResult:
    """Return the result of a batch. The worker may be shared, so its number of BLAS threads is restored afterwards."""
    with ONE_THREAD:
        be_alike(common)
        with Guest("a plugin, when it was imported,"):
            jobs, exports, imports, deliver, doomed, topic, number = pickle.loads(data)
        at = None
        if topic:
            import distributed

            worker = distributed.get_worker()

            def at(_: int) -> None:
                worker.log_event(topic, number)

        return run_batch(jobs, exports, imports, deliver, *before, doomed=doomed, at=at)


def told(result: BatchResult) -> Told:
    """Return the reports and arrays that the owner of the run fetches."""
    return result.reports, result.kept


def compute_and_tell(common: Common, data: bytes, *before: BatchResult) -> Told:
    """Compute a batch whose result no other batch reads; return the reports and arrays that the owner fetches."""
    return told(compute(common, data, *before))


def joined(exports: tuple[CellRef, ...], *parts: BatchResult) -> BatchResult:
    """Join the results of the cells of one batch."""
    results = {ref: result for part in parts for ref, result in part.results.items()}
    kept = {ref: arrays for part in parts for ref, arrays in part.kept.items()}
    return BatchResult({ref: results[ref] for ref in exports}, tuple(r for part in parts for r in part.reports), kept)
