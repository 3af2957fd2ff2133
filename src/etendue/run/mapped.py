"""A stage run one by one over the dims that it does not work on: frames, channels of full planes, whatever a plugin adds.

In:  a ``Job`` with mapped dims and the results it reads.
Out: its arrays; each slice has the bits that the stage gives of that slice alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.plan.model import CellRef
from etendue.run.found import with_found
from etendue.run.given import Clipped, looked_through
from etendue.run.jobs import Job
from etendue.run.segments import Result
from etendue.spec.stage import quantities_of, writes_of

Make = Callable[[Job, Mapping[CellRef, Result], Clipped], tuple[Result, dict[str, Any]]]


def one_by_one(job: Job, results: Mapping[CellRef, Result], clipped: Clipped, make: Make) -> dict[str, Any]:
    """Every variable of every slice, the mapped dims in front."""
    dims = [dim for dim, _ in job.mapped]
    labels = [_labels(coordinate) for _, coordinate in job.mapped]
    sizes = tuple(len(own) for own in labels)
    declared = {d.variable: d for d in writes_of(type(job.stage)).values() if d.variable in job.writes}
    core = replace(
        job,
        mapped=(),
        writes=declared,
        grids={v: job.grids[v].take(d.dims) for v, d in declared.items()},
        inputs=tuple((port, (ref[0], (-1 - number,)), variable) for number, (port, ref, variable) in enumerate(job.inputs)),
        previous=None,
    )
    whole = [(looked_through(job, results, port, ref, v), results[ref], v, job.leading[ref[0], v]) for port, ref, v in job.inputs]
    along = {name: dims.index(p.along) for name, p in quantities_of(type(job.stage)).items() if p.along in dims}
    arrays: dict[str, Any] = {}
    for at in np.ndindex(*sizes):
        seen: dict[CellRef, Result] = dict(results)
        for number, (array, result, variable, lead) in enumerate(whole):
            seen[core.inputs[number][1]] = Result(arrays={variable: array[tuple(at[i] for i in lead)]}, lowest=result.lowest)
        words = "".join(f"|{dim}={own[i]}" for dim, own, i in zip(dims, labels, at, strict=True))
        one = with_found(core, seen, at)
        stage = replace(one.stage, **{name: labels[i][at[i]] for name, i in along.items()}) if along else one.stage
        one = replace(one, stage=stage, seed=one.seed + words.encode())
        for name, array in make(one, seen, clipped)[1].items():
            if job.writes[name].dims == declared[name].dims:  # it has the dim itself: the same for all
                arrays.setdefault(name, array)
                continue
            if name not in arrays:
                arrays[name] = np.empty((*sizes, *array.shape), array.dtype)
            arrays[name][at] = array
    return arrays


def _labels(coordinate: Any) -> list[Any]:
    return list(coordinate.values())
