"""Jobs are made when they are asked for: what is said of them before is what they are, and a long sweep holds few of
them.
"""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

from etendue.compute.jobs import Jobs, make_jobs
from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.planner import make_plan
from etendue.run.batches import partition
from etendue.session import Options, execute
from tests.run.small import SWEEP, plan_of

DOTS = """
name = "dots"
precision = "float32"
[camera]
peak_qe = 0.4
pixel_pitch = "4 um"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "250 cd m-2"
width = "16 um"
height = "16 um"
spacing = "4 um"
wavelength_from = "500 nm"
wavelength_to = "600 nm"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 4
columns = 4
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[sweep]
f_number = { from = 1.4, to = 22, steps = 10, spacing = "log" }
integration_time = { from = "1 ms", to = "20 ms", steps = TIMES, spacing = "log" }
"""


def test_cells_are_numbered_in_the_order_of_the_plan():
    plan = plan_of(SWEEP)
    assert (
        [plan.numbers.of(ref) for ref in plan.cells] == list(range(len(plan.cells))) == list(range(plan.numbers.count))
    )
    for node in plan.nodes:
        assert [plan.numbers.of(cell.ref) for cell in plan.of(node.name)] == list(plan.numbers.range(node.name))


@pytest.mark.parametrize("part", ["all", "the last stages", "every other cell"])
def test_what_is_said_of_a_job_before_it_is_made_is_what_it_is(part):
    plan = plan_of(SWEEP)
    every = list(plan.cells)
    todo = {"all": every, "the last stages": every[len(every) // 2 :], "every other cell": every[::2]}[part]
    jobs = make_jobs(plan, set(todo), lambda cell: None)
    assert isinstance(jobs, Jobs)
    assert list(jobs) == [ref for ref in every if ref in jobs]
    assert len(jobs) == len(list(jobs))
    for place, (ref, job) in enumerate(jobs.items()):
        assert job.ref == ref
        assert jobs.needs(ref) == job.needs
        assert jobs.seconds(ref) == job.seconds
        assert jobs.place(ref) == place
        assert set(job.needs) <= set(jobs)  # what is read is computed or loaded
    assert [(b.refs, b.exports, b.imports) for b in partition(jobs)] == [
        (b.refs, b.exports, b.imports) for b in partition(dict(jobs))
    ]


def _traced(times: int, folder: Path) -> tuple[int, int, int]:
    """Cells; bytes of the plan; the most that storing the sweep takes beside it."""
    tracemalloc.start()
    plan = make_plan(parse_pipeline(DOTS.replace("TIMES", str(times))), installed_stages())
    assert all(cell.key and cell.inputs is not None and cell.seed is not None for cell in plan.cells.values())
    planned, _ = tracemalloc.get_traced_memory()  # with what a plan finds when it is asked
    tracemalloc.reset_peak()
    execute(plan, folder, Options(scheduler="serial"))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return len(plan.cells), planned, peak - planned


def test_what_storing_a_sweep_takes_beside_its_plan_grows_slower_than_the_plan(tmp_path):
    """A plan takes 800 bytes a cell; a run that made all jobs first and kept what each reported took 4500 beside it."""
    _traced(4, tmp_path / "imports")
    few, many = _traced(5, tmp_path / "few"), _traced(25, tmp_path / "many")
    growth = [(b - a) / (many[0] - few[0]) for a, b in zip(few[1:], many[1:], strict=True)]
    assert growth[1] < 1.5 * growth[0]
