"""What segments of transfer functions hold while they are computed: spectra, tables, padded planes."""
from __future__ import annotations
from typing import Any

from etendue.plan.strips import by_band
from etendue.run.job import Job
from etendue.spec.capabilities import Summed

AHEAD = 2  # bands: one is used while the next one is made


def segment_bytes(run: Any, job: Job) -> tuple[dict[Any, float], float]:
    """What the result of a transfer stage holds, and what comes to it while it is computed."""
    segment = job.segment
    assert segment is not None
    wanted = bool(job.store or job.deliver)
    if not (job.spectrum or wanted):
        return {}, 0.0
    (name,) = job.writes
    port = job.inputs[0][0]
    grid = job.input_grids[port]
    bands, padded, plane = grid.bands().size, run.padded(job), run.plane(job)
    own = {(job.ref, name): run.bytes(job, name)} if wanted and name not in job.by_band else {}
    summed = isinstance(job.stage, Summed)
    if grid.line("y").cells or segment.joined is not None:
        return own, _direct(run, job, grid, bands, padded, plane, summed)
    spectrum = bands * padded
    working = 0.0
    if segment.previous is None:
        working = 2 * spectrum  # padded planes, and what becomes of them
    if summed:
        out = next(iter(job.grids.values()))
        channels = out.count / (out["y"].size * out["x"].size)
        return own, max(working, spectrum + 4 * channels * padded)
    if job.left_out:
        return own | ({(job.ref, ""): spectrum} if job.spectrum else {}), working
    run.tables += 0.5 * spectrum
    if job.spectrum:
        own[job.ref, ""] = spectrum
    else:
        working += spectrum
    if wanted:
        working = max(working, 2 * spectrum)
    return own, working


def _direct(run: Any, job: Job, grid: Any, bands: int, padded: float, plane: float, summed: bool) -> float:
    _, ref, variable = job.inputs[0]
    source = run.jobs.get(ref)
    making = run.bands_made(source) if source is not None and run._by_band(ref, variable) and not source.store else 1.0
    if not summed:
        if grid.line("y").cells:
            run.tables += 0.0
        return (making * plane + 4 * padded) if job.store or name_whole(job) else 0.0
    channels = 3
    if grid.line("y").cells:
        run.tables += bands * 0.5 * padded
    return AHEAD * making * plane + (4 + channels) * padded


def name_whole(job: Job) -> bool:
    return not job.by_band
