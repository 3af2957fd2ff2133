"""Large frames worked strip by strip: the bits, figures and failures of cells computed whole, and nothing whole that
nobody wants.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from etendue.api import Bands, Facts, Grid, Haloed, Line, Source, hookimpl
from etendue.compute import rows as cut_of
from etendue.compute import strips
from etendue.compute.jobs import make_jobs
from etendue.contract.registry import Registry, installed_stages
from etendue.plan.planner import make_plan
from etendue.plugins.discovery import Discovery, installed
from etendue.plugins.hookspecs import GROUP
from etendue.run.batches import partition
from etendue.run.peak_memory import peak_memory
from etendue.session import load
from tests.run.small import BARE, assert_same_archives, assert_same_arrays, assert_same_bits, by_labels, run

COLOUR = """
[[stages]]
use = "white"
[[stages]]
use = "colour_fit"
[[stages]]
use = "camera_to_xyz"
[[stages]]
use = "balance"
[[stages]]
use = "display"
[[stages]]
use = "encode"
"""
FOUND_WHITE = """
[[stages]]
use = "white"
[[stages]]
use = "white_estimate"
[[stages]]
use = "balance_mosaic"
"""

CAMERA = BARE + COLOUR
BALANCED = BARE.replace('[[stages]]\nuse = "demosaic_bilinear"', FOUND_WHITE + '[[stages]]\nuse = "demosaic_bilinear"')
BEHIND = "".join(f'[[stages]]\nuse = "{name}"\n' for name in ("codes", "linearise", "demosaic_bilinear", "sharpen"))
RAW = (
    'name = "raw"\nprecision = "float32"\nkeep = ["rgb_display"]\n[camera]\npeak_qe = [0.4, 0.4, 0.4]\n'
    + BEHIND
    + COLOUR
)
FORKED = {"sweep.integration_time": ["2 ms", "8 ms"], "sweep.sharpen.strength": [0.1, 0.4]}


@pytest.fixture
def small_strips(monkeypatch):
    """Strips of eight rows in frames of 32."""
    monkeypatch.setattr(cut_of, "LARGEST_WHOLE", 0)
    monkeypatch.setattr(cut_of, "STRIP", 1)
    monkeypatch.setattr(cut_of, "TILE", 8)
    monkeypatch.setattr(cut_of, "HALOS", 2)


@pytest.fixture
def walked_cells(monkeypatch):
    """The cells that ended in strips."""
    seen: list[Any] = []
    whole = strips._walked

    def noted(jobs, results, at):
        ended = whole(jobs, results, at)
        seen.extend(job.ref for job in jobs)
        return ended

    monkeypatch.setattr(strips, "_walked", noted)
    return seen


def plan_of(text: str = CAMERA, overrides: dict[str, Any] | None = None, stages: Registry | None = None) -> Any:
    return make_plan(load(text, overrides or {}), stages or installed_stages())


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("text", [CAMERA, BALANCED], ids=["to the display", "white found in the picture"])
@pytest.mark.parametrize("scheduler", ["serial", "threads"])
def test_strips_change_no_bit_and_no_figure(text, precision, scheduler, request):
    plan = plan_of(text, {**FORKED, "precision": precision})
    whole = run(plan)
    request.getfixturevalue("small_strips")
    seen = request.getfixturevalue("walked_cells")
    cut = run(plan, scheduler=scheduler)
    assert not whole.failed
    assert not cut.failed
    assert len(seen) > len(plan.cells) / 2
    assert_same_arrays(by_labels(plan, cut.arrays), by_labels(plan, whole.arrays))
    for ref, report in whole.reports.items():
        other = cut.reports[ref]
        assert (report.status, report.clipped, report.clipped_flux, report.floored) == (
            other.status,
            other.clipped,
            other.clipped_flux,
            other.floored,
        )


def test_an_archive_made_in_strips_is_that_of_whole_frames(tmp_path, request):
    plan = plan_of(CAMERA, FORKED)
    run(plan, tmp_path / "whole")
    request.getfixturevalue("small_strips")
    run(plan, tmp_path / "cut")
    assert_same_archives(tmp_path / "whole", tmp_path / "cut")


def test_processes_are_told_which_cells_go_together(small_strips):
    plan = plan_of(BARE)
    assert_same_arrays(
        by_labels(plan, run(plan, scheduler="processes", workers=1).arrays), by_labels(plan, run(plan).arrays)
    )


def test_a_walk_ends_where_the_whole_frame_is_needed_and_where_a_sweep_forks(small_strips):
    plan = plan_of(BALANCED, FORKED)
    jobs = make_jobs(plan, set(plan.cells), lambda cell: None)
    together: dict[int, list[str]] = {}
    for ref, job in jobs.items():
        if job.walk:
            together.setdefault(job.walk.number, []).append(ref[0])
    found = {tuple(sorted(names)) for names in together.values()}
    assert ("adc", "linearise", "read_noise") in found  # shot_noise draws in an order that all of the frame decides
    assert ("balance_mosaic", "demosaic") in found  # the white is found in the whole mosaic, and sharpen is swept
    assert ("sharpen",) in found


def test_no_batch_waits_for_itself_however_small_batches_are(small_strips):
    """Walks are computed as one: batches that hold them still only need batches of a lower level."""
    plan = plan_of(BALANCED, FORKED)
    jobs = make_jobs(plan, set(plan.cells), lambda cell: None)
    for seconds in (0.0, 1e-4, 1e-3, 1.0):
        batches = {batch.number: batch for batch in partition(jobs, seconds)}
        assert sorted(job.ref for batch in batches.values() for job in batch.jobs) == sorted(jobs)
        for batch in batches.values():
            assert all(batches[number].level < batch.level for number in batch.inputs)
            numbers = [job.walk.number for job in batch.jobs if job.walk]
            assert all(numbers.count(job.walk.number) == job.walk.members for job in batch.jobs if job.walk)


def test_what_nobody_keeps_is_never_whole(monkeypatch, stages):
    """From raw codes on, beside codes and picture: nothing of their size in strips, two pictures at least where
    cells are whole.
    """
    plan = plan_of(RAW, {}, stages)
    whole, cut = _peak(plan, monkeypatch, 1 << 40), _peak(plan, monkeypatch, 0)
    assert_same_bits(cut[1], whole[1])
    picture, codes = cut[1].nbytes, cut[1].nbytes / 6
    assert cut[0] < 2 * picture + codes
    assert whole[0] > 3 * picture + codes
    for largest, measured in ((0, cut[0]), (1 << 40, whole[0])):
        monkeypatch.setattr(cut_of, "LARGEST_WHOLE", largest)
        assert measured / 1.3 < peak_memory(plan, 1, in_memory=True, pictures=False).bytes < 1.3 * measured


def test_pictures_of_what_is_never_whole_are_those_of_the_whole(monkeypatch, stages):
    plan = plan_of(RAW, {"keep": ["rgb_display"]}, stages)
    monkeypatch.setattr(cut_of, "STRIP", 1)
    frames = []
    for largest in (1 << 40, 0):
        monkeypatch.setattr(cut_of, "LARGEST_WHOLE", largest)
        frames.append(run(plan).tree["frames"])
    shown = ["codes", "linearise", "demosaic_bilinear", "sharpen", "camera_to_xyz", "balance", "display", "encode"]
    assert list(frames[0].stage.values) == shown
    assert_same_bits(frames[1].preview.values, frames[0].preview.values)


def _peak(plan: Any, monkeypatch: Any, largest: int) -> tuple[int, Any]:
    """Most bytes held at once while a plan is computed, and its picture."""
    monkeypatch.setattr(cut_of, "LARGEST_WHOLE", largest)
    monkeypatch.setattr(cut_of, "STRIP", 1)
    run(plan, pictures=False)  # tables and imports
    tracemalloc.start()
    try:
        tree = run(plan, pictures=False).tree
        return tracemalloc.get_traced_memory()[1], tree["encode"].rgb_display.values
    finally:
        tracemalloc.stop()


@dataclass(frozen=True, kw_only=True)
class Codes(Source):
    """A frame of 1024 x 512 codes under a known light."""

    writes: ClassVar = {
        "raw": "y x [DN] uint16",
        "white_radiance": "wavelength [W m-2 sr-1 nm-1]",
        "white_irradiance": "wavelength [W m-2 nm-1]",
    }

    def describe(self):
        frame = Grid.of({dim: Line(size, 0.0, 1.0, "pixel", (0.0, 2.0)) for dim, size in (("y", 1024), ("x", 512))})
        light = Grid.of({"wavelength": Bands((400.0, 500.0, 600.0, 700.0))})
        return Facts(), {"raw": frame, "white_radiance": light, "white_irradiance": light}

    def run(self, out_y, out_x):
        codes = (out_y[:, None].astype(np.uint16) * 7 + out_x.astype(np.uint16) * 3) % 3000
        return {"raw": codes, "white_radiance": np.full(3, 0.1), "white_irradiance": np.full(3, 0.01)}


@dataclass(frozen=True, kw_only=True)
class Fussy(Haloed):
    """Gives the light on, and breaks off at one row."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    negative: ClassVar = "keep"

    def run(self, charge, y):
        if (y == 20).any():
            raise ArithmeticError("row 20 is beyond me")
        return {"charge": charge}


@dataclass(frozen=True, kw_only=True)
class Brightest(Haloed):
    """Says how bright its rows are, and not how the figures of some rows become that of all."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]", "brightest": "[1]"}
    negative: ClassVar = "keep"

    def run(self, charge):
        return {"charge": charge.copy(), "brightest": np.array(float(charge.max()))}


@hookimpl
def etendue_stages():
    return {"fussy": Fussy, "brightest": Brightest, "codes": Codes}


@pytest.fixture
def stages():
    from importlib.metadata import EntryPoint

    return Registry(Discovery([*installed().points, EntryPoint("own", __name__, GROUP)]))


def test_what_fails_in_strips_fails_as_it_does_whole(small_strips, stages):
    """The cell that fails is named, with its own words; what stands before it is done, what depends on it skipped."""
    plan = plan_of(CAMERA.replace('use = "adc"', 'use = "fussy"\n[[stages]]\nuse = "adc"'), {}, stages)
    outcome = run(plan)
    assert [report.stage for report in outcome.failed] == ["fussy"]
    assert "row 20 is beyond me" in outcome.failed[0].message
    assert outcome.reports["read_noise", ()].status == "done"
    assert outcome.reports["encode", ()].status == "skipped"


def test_a_figure_that_is_not_the_same_for_all_rows_is_taken_from_the_whole(small_strips, stages, walked_cells):
    plan = plan_of(CAMERA.replace('use = "adc"', 'use = "brightest"\n[[stages]]\nuse = "adc"'), {}, stages)
    outcome = run(plan)
    found = outcome.arrays["brightest", ()]
    assert float(found["brightest"]) == found["charge"].max()
    assert ("brightest", ()) not in walked_cells
    assert ("exposure", ()) in walked_cells
