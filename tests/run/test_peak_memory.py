"""What a plan says that is held, against what is: in all, cell by cell, and where cells are joined or left out."""

import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from etendue.compute import rows as cut_of
from etendue.compute.cell import compute
from etendue.compute.joined.segments import Result
from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage
from etendue.pipeline.file import read_pipeline
from etendue.plan import cost
from etendue.plan.model import LeftOut
from etendue.plan.planner import make_plan
from etendue.present.pictures import details, fitting
from etendue.run import peak_memory as counting
from etendue.run.peak_memory import kept_bytes, peak_memory
from etendue.session import Options, execute
from etendue.testing.bench import Bench

ROOT = Path(__file__).parents[2]
FRAME = {
    "sweep": {},
    "camera.f_number": 2.8,
    "camera.pixel_pitch": "2.8 um",
    "camera.integration_time": "8 ms",
    "precision": "float32",
    "scene.spacing": "2.8 um",
    "scene.width": "1433.6 um",
    "scene.height": "1075.2 um",
    "pixel.rows": 352,
    "pixel.columns": 480,
}


def plan_of(**overrides):
    return make_plan(read_pipeline(ROOT / "pipelines" / "smallest.toml", FRAME | overrides), installed_stages())


def test_a_frame_takes_what_its_plan_says():
    """In the arrays of a run in memory, 0.2 Mpixel: within 1.3 times, either way."""
    small = {"scene.width": "358.4 um", "scene.height": "268.8 um", "pixel.rows": 64, "pixel.columns": 96}
    execute(plan_of(**small), None, Options("serial", pictures=False))  # imports
    plan = plan_of()
    from etendue.compute.tables import TABLES

    TABLES.clear()
    tracemalloc.start()
    try:
        execute(plan, None, Options("serial", pictures=False))
        measured = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    expected = peak_memory(plan, 1, in_memory=True, pictures=False).bytes
    assert measured / 1.3 < expected < 1.3 * measured


def test_a_stage_that_is_left_out_holds_nothing():
    """What it writes is what it reads: no cell of a plan holds more for it, and its own need is 0 where nothing of
    it is stored.
    """
    plan = plan_of(keep=["rgb_display"], wanted=["rgb_display"])
    for name in ("sharpen", "read_noise", "falloff"):
        cells = {
            ref: cell.changed(left_out=LeftOut(0.0, "a law")) if ref[0] == name else cell
            for ref, cell in plan.cells.items()
        }
        needs = []
        for own in (plan, replace(plan, cells=cells)):
            jobs = counting._jobs(own, 1, False, False)
            run = counting._Run(own.precision, jobs, set(), False, 1)
            needs.append({job.ref[0]: run.cell(job) for job in jobs.values()})
        assert needs[0][name] > needs[1][name] == 0
        assert sum(needs[1].values()) < sum(needs[0].values())


def test_joined_passes_count_once(monkeypatch):
    """Stages worked together in strips hold strips, not a frame each; light made by band holds bands, not each
    stage's light.
    """
    asked = {"keep": ["rgb_display"], "wanted": ["rgb_display"], "scene.bin_width": "2.5 nm"}
    plan = plan_of(**asked)
    whole = peak_memory(plan, 1, pictures=False).bytes
    light = cost.cell_bytes(plan.node("irradiance"), plan.of("irradiance")[0], plan.precision)
    assert whole > 3 * light
    monkeypatch.setattr(cost, "LARGEST_WHOLE", 1)
    monkeypatch.setattr(cut_of, "LARGEST_WHOLE", 1)
    monkeypatch.setattr(cut_of, "STRIP", 1)
    cut = plan_of(**asked)
    assert peak_memory(cut, 1, pictures=False).bytes < light


class _Doubled(Stage):
    """Of this module: another distribution's."""

    reads: ClassVar = {"rgb": "channel y x [1]"}
    writes: ClassVar = {"rgb": "channel y x [1]"}
    working: ClassVar = 0.0

    def run(self, rgb):
        return {"rgb": 2 * rgb}


def test_copies_that_other_distributions_are_handed_are_counted(monkeypatch):
    """A stage of theirs holds its input twice; one of the package does not: planned and found."""
    bench, frame = Bench(_Doubled()), (240, 320)
    found = []
    for module in (__name__, "etendue.own"):
        monkeypatch.setattr(_Doubled, "__module__", module)
        job, array = bench.job("float32", frame), np.ones((3, *frame), "float32")
        results = {("rgb", ()): Result({"rgb": array})}
        compute(job, results)
        tracemalloc.start()
        try:
            compute(job, results)
            held = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert held == pytest.approx(counting.job_bytes(job, "float32")[0], rel=0.05)
        found.append(held / array.nbytes)
    assert found == pytest.approx([2, 1], rel=0.05)


def test_more_workers_hold_more_and_a_longer_sweep_does_not():
    def swept(values):
        return make_plan(
            read_pipeline(ROOT / "pipelines" / "smallest.toml", {"sweep.f_number": values}), installed_stages()
        )

    plan, longer = swept([2.0, 2.8, 4.0, 5.6]), swept([2 + 0.1 * n for n in range(30)])
    one, two, four = (peak_memory(plan, workers, pictures=False).bytes for workers in (1, 2, 4))
    assert one < two <= four <= 4 * one
    assert peak_memory(longer, 1, pictures=False).bytes < 1.3 * one
    assert peak_memory(longer, 1, in_memory=True).bytes > kept_bytes(longer) > 4 * kept_bytes(plan)


def test_pictures_are_as_large_as_they_are_counted():
    assert (counting.SHOWN_WHOLE, counting.SHOWN) == (details.BAND, fitting.LARGEST)


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="resident peaks are asked of Linux")
def test_frames_of_a_megapixel_take_what_their_plans_say():
    """Resident memory of fresh processes, within 1.3 times either way: ``benchmarks/memory.py`` prints the same for
    larger ones.
    """
    done = subprocess.run(
        [
            sys.executable,
            ROOT / "benchmarks" / "memory.py",
            "--workers",
            "1",
            "--mpixel",
            "1",
            "--bands",
            "3",
            "--precision",
            "float32",
            "--repeats",
            "3",
            "--camera",
            "smallest",
            "sensors",
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    worst = float(done.stdout.splitlines()[-1].split()[1])
    assert 1 <= worst <= 1.3, done.stdout
