"""Memory of cells of transfer functions while they are computed: transforms, tables, padded planes.

In:  a ``Job`` of a segment, and the simulated run.
Out: bytes of its result by piece, and bytes used temporarily.
"""

from __future__ import annotations

from typing import Any

from etendue.compute.bands import LARGE_BAND
from etendue.compute.job import Job
from etendue.compute.joined.segment_bands import LARGEST_SHARED, TOGETHER, gathered_samples
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Banded, Summed, Transfer
from etendue.transfer import sampling

AHEAD = 2  # bands: one is used while the next one is computed
ON_HALF = 0.25  # fraction of a transform: the table of a transfer function that is even along y
ON_CELLS = 0.27  # fraction of a padded band: the table of a transfer function on cells, which is even along y


def segment_bytes(run: Any, job: Job) -> tuple[dict[Any, float], float]:
    """Return the bytes of a transfer stage's result (its transform under '') and of its working memory."""
    segment, wanted = job.segment, bool(job.store or job.deliver)
    assert segment is not None
    if not (job.transform or wanted):
        return {}, 0.0
    (name,) = job.writes
    grid = job.input_grids[job.inputs[0][0]]
    made = wanted and name not in job.by_band and not segment.seen
    own = {(job.ref, name): run.bytes(job, name)} if made else {}
    if grid.line("y").cells or segment.joined is not None:
        return own, _by_band(run, job, grid)
    transform = grid.bands().size * run.padded(job)
    begun = transform if segment.previous is None else 0.0
    assert isinstance(job.stage, Transfer)
    if isinstance(job.stage, Summed):
        return own, begun + 2 * _channels(job) * run.padded(job)
    table = ON_HALF if job.stage.radial else 2 * ON_HALF
    run.transforms.append(table * transform)
    if job.transform and not segment.seen:
        own[job.ref, ""] = transform
    elif job.transform:
        own |= {piece: n for piece, n in run.pieces.get(job.inputs[0][1], {}).items() if piece[1] == job.inputs[0][2]}
    return own, table * transform * 8 / run.size + 4 * run.padded(job)


def _by_band(run: Any, job: Job, grid: Grid) -> float:
    """Return the working memory of a cell that processes the bands of the segment's input one by one."""
    _, ref, variable = job.inputs[0]
    made = variable in run.jobs[ref].by_band and not run.jobs[ref].store
    planes, padded = run.bands_made(run.jobs[ref]) if made else 1.0, run.padded(job)
    if not isinstance(job.stage, Summed):
        return float(planes * run.plane(job) + 4 * padded) if job.store or not job.by_band else 0.0
    ahead = (planes + AHEAD - 1) * run.plane(job)
    large = grid.line("y").size * grid.line("x").size > sampling.LARGE
    if grid.line("y").cells:
        run.tables += ON_CELLS * grid.bands().size * padded
        return float(ahead + (4 + 2 * _channels(job)) * padded)
    terms, transforms = job.stage.terms(), _channels(job) * job.stage.kept() ** 2 * padded
    if not 0 < terms < grid.bands().size:
        if not large:
            return float(ahead + 4 * padded + 2 * transforms)
        if run.plane(job) > LARGE_BAND:
            ahead = planes * run.plane(job)
        if made and in_rows(run, run.jobs[ref]):
            ahead = 0.0
        # one transform, and behind it the table of the pixel and a plane of the result
        return float(transforms + max(ahead + 1.5 * padded, 1.5 * padded + run.plane(job)))
    run.transforms += [size for size in (terms * padded, transforms) if size <= LARGEST_SHARED]
    strips = made and large and in_rows(run, run.jobs[ref])
    return _gathered(run, job, grid, transforms, planes + AHEAD - 1, strips)


def _gathered(run: Any, job: Job, grid: Grid, transforms: float, ahead: float, strips: bool) -> float:
    """Return the working memory of bands that are projected onto a few planes.

    Parameters
    ----------
    transforms : bytes of the transforms of all channels
    ahead : bands that are held while they are projected
    strips : whether only some rows of the bands are held
    """
    assert isinstance(job.stage, Summed) and job.segment is not None
    terms, padded = job.stage.terms(), run.padded(job)
    if strips:
        held = AHEAD * gathered_samples(grid.bands().size) * run.size  # by one stage, and by the next
    else:
        held = (ahead + TOGETHER - 1) * run.plane(job)
    if terms * padded <= LARGEST_SHARED:
        own = terms * run.plane(job) + max(held, terms * padded)
        return float(max(own, terms * padded + 2 * transforms, 3 * transforms))
    result = sum(run.bytes(job, name) for name in job.writes)  # after the last transform
    if strips:  # no plane is held; sums of radial transfer functions are made in place
        in_place = all(stage.radial for stage in job.segment.joined or ())
        own = held + terms * padded + (0 if in_place else transforms)
    else:  # one plane after the other
        own = terms * run.plane(job) + max(held, padded + transforms)
    return float(max(own - result, transforms + 2 * padded))


def in_rows(run: Any, job: Job) -> bool:
    """Return whether the light of a cell is computed some rows at a time."""
    before = [run.jobs[ref] for _, ref, variable in job.inputs if ref in run.jobs and variable in run.jobs[ref].by_band]
    own = isinstance(job.stage, Banded) and job.stage.in_rows()
    return bool(own and job.by_band and not job.store and all(in_rows(run, one) for one in before))


def _channels(job: Job) -> float:
    out = next(iter(job.grids.values()))
    return out.count / (out["y"].size * out["x"].size)
