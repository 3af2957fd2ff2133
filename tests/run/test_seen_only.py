"""What is looked at for its transfer function alone is not computed: the stage is known without running it."""

from __future__ import annotations

import numpy as np

import etendue
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan, summary
from etendue.run.peak_memory import peak_memory
from etendue.session import Options, execute, load
from tests.plan.given import CAMERA, SCENE, SENSOR

TEXT = CAMERA + SCENE.format(scene="siemens_star") + SENSOR + '[[stages]]\nuse = "resolution"\n'
SWEEP = {"sweep.f_number": [2.8, 8], "sweep.pixel_pitch": [2.0, 4.0], "sweep.integration_time": ["1 ms", "2 ms"]}


def plan_of(**given):
    return make_plan(load(TEXT, SWEEP | given), installed_stages())


def test_a_wanted_mtf_runs_no_stage_of_the_picture_and_is_the_same():
    whole = plan_of(wanted=["photon_rate", "mtf50"])
    alone = plan_of(wanted=["mtf50"])
    assert not whole.seen_only
    assert alone.seen_only == {"scene", "irradiance", "falloff", "diffraction", "lens_gaussian", "diffusion", "pixel"}
    found = execute(alone, None, Options("serial"))
    assert {stage for stage, _ in found.reports} == {"resolution"}
    other = execute(whole, None, Options("serial"))
    np.testing.assert_array_equal(found.tree["resolution"].mtf50, other.tree["resolution"].mtf50)


def test_a_plan_and_its_memory_count_only_what_is_computed():
    alone, whole = plan_of(wanted=["mtf50"]), plan_of(wanted=["photon_rate", "mtf50"])
    said, more = summary(alone), summary(whole)
    assert said["cells"] == 4 < more["cells"] == 4 + 4 + 1 + 2 * 5
    assert said["bytes"] < 0.1 * more["bytes"]
    assert {stage["seconds"] for stage in said["stages"] if stage["name"] != "resolution"} == {0}
    assert peak_memory(alone).bytes < 0.1 * peak_memory(whole).bytes


def test_an_archive_gains_the_picture_when_it_is_wanted_and_keeps_it_afterwards(tmp_path):
    folder = tmp_path / "a"
    first = execute(plan_of(wanted=["mtf50"]), folder, Options("serial"))
    assert first.computed == 4
    assert set(etendue.open_archive(folder).children) == {"resolution", "ledger", "summary"}
    second = execute(plan_of(wanted=["mtf50", "photon_rate"]), folder, Options("serial"))
    assert second.computed == 15
    third = execute(plan_of(wanted=["mtf50"]), folder, Options("serial"))
    assert third.computed == 0
    assert any("photon_rate" in group.variables for group in etendue.open_archive(folder)["pixel"].subtree)


def test_what_reads_a_picture_computes_it_for_a_probe_beside_it():
    """The colour of a picture needs the picture; the probe beside it changes nothing about that."""
    assert not plan_of(wanted=["mtf50", "mosaic_linear"]).seen_only
    assert plan_of(wanted=["mosaic_linear"]).seen_only == frozenset()
