"""All stability checks, in processes; the order of rows does not depend on their number.

In:  names of stages; none: all stages, kernels and cameras.
Out: rows, as they are found.
"""

from __future__ import annotations

import itertools
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass

from etendue.contract.registry import installed_stages
from etendue.errors import PluginError, RequestError, nearest
from etendue.run.workers import begin_worker
from etendue.testing.seeds import seeded
from etendue_lab.stability import cameras, kernels, stages
from etendue_lab.stability.rows import LawCase

SHARES = 12  # number of parts into which the cameras are divided


@dataclass(frozen=True)
class WorkShare:
    """A share of the work for one process: a stage, the closed forms, or some cameras."""

    what: str  # stage, forms or cameras
    name: str
    share: int = 0
    stages: frozenset[str] = frozenset()  # closed forms of these stages only, if any
    seed: int = 0  # seed of the statistical laws


Told = Callable[[int, int, str], None]  # parts done, total, the last one


def parts(names: Sequence[str], seed: int = 0) -> list[WorkShare]:
    """Return the parts into which the work is divided among processes.

    Raises
    ------
    RequestError
        A name is not an installed stage.
    """
    registry = installed_stages()
    for name in names:
        if name not in registry:
            raise RequestError(
                f"unknown stage {name!r}{nearest(name, registry.names())}{registry.found.missed('stages', name)}"
            )
    forms = WorkShare("forms", "closed forms", stages=frozenset(names))
    cameras = [] if names else [WorkShare("cameras", "whole cameras", share) for share in range(SHARES)]
    return [*(WorkShare("stage", name, seed=seed) for name in sorted(set(names)) or registry.names()), forms, *cameras]


def rows_of_part(part: WorkShare) -> list[LawCase]:
    """Run a part; called in a worker process."""
    try:
        if part.what == "forms":
            return list(kernels.rows_of_forms(part.stages))
        if part.what == "cameras":
            chosen = itertools.islice(cameras.cameras(), part.share, None, SHARES)
            return [row for name, document in chosen for row in cameras.rows_of_camera(name, document)]
        with seeded(part.seed):
            return list(stages.rows_of(part.name))
    except PluginError as error:
        return [LawCase(part.name, "it can be loaded", "", False, why=str(error))]


def stability(
    names: Sequence[str], workers: int = 0, told: Told = lambda done, total, name: None, seed: int = 0
) -> list[LawCase]:
    """Return every row, in the order of the parts. The number of processes affects only the time.

    ``seed``: seed of the random numbers in statistical laws; other results do not depend on it.
    """
    every = parts(names, seed)
    found: dict[WorkShare, list[LawCase]] = {}
    for number, (part, rows) in enumerate(done(every, workers or os.cpu_count() or 1), 1):
        found[part] = rows
        told(number, len(every), part.name)
    rows = [row for part in every for row in found[part]]
    place = {name: number for number, name in enumerate(dict.fromkeys(row.stage for row in rows))}
    # Closed forms are tested together with the stages that use them.
    return sorted(rows, key=lambda row: place[row.stage])


def done(every: list[WorkShare], workers: int) -> Iterator[tuple[WorkShare, list[LawCase]]]:
    """Yield parts as they finish."""
    if workers == 1 or len(every) == 1:
        for part in every:
            yield part, rows_of_part(part)
        return
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=begin_worker)
    try:
        cameras_last = sorted(every, key=lambda part: part.what == "cameras")  # equal parts, to fill the last seconds
        waiting = {pool.submit(rows_of_part, part): part for part in cameras_last}
        for future in as_completed(waiting):
            part = waiting[future]
            try:
                yield part, future.result()
            except BrokenProcessPool:
                yield (
                    part,
                    [
                        LawCase(
                            part.name,
                            "its process lives",
                            "",
                            False,
                            why="a worker process died during this test or during a simultaneous test",
                        )
                    ],
                )
    except BaseException:  # do not wait for running parts
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()  # all parts are finished: wait for the workers, so that they do not outlive the caller
