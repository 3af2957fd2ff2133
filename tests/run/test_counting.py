"""Each thing is computed once, and only what has changed is computed again."""

from __future__ import annotations

import math

import pytest
import xarray

from tests.run.small import SWEEP, assert_same_archives, plan_of, run

pytestmark = pytest.mark.long

SIZES = {"f_number": 2, "pixel_pitch": 3, "integration_time": 2}
THREE = {**SWEEP, "sweep.pixel_pitch": ["1.5 um", "2.0 um", "2.6 um"], "tolerance": 1e-7}
LENS, PIXEL = ("irradiance", "falloff", "diffraction", "diffusion", "light_budget"), ("pixel", "mosaic", "resolution")
EXPOSED = ("exposure", "shot_noise", "read_noise", "adc", "linearise", "demosaic", "sharpen", "exposure_report")


@pytest.fixture
def archive(tmp_path):
    """A finished archive of the sweep."""
    assert run(plan_of(THREE), tmp_path / "a").computed > 0
    return tmp_path / "a"


def computed_by_stage(outcome):
    found = {}
    for report in outcome.reports.values():
        if report.status in ("done", "left_out"):
            found[report.stage] = found.get(report.stage, 0) + 1
    return found


def test_each_axis_reaches_only_what_depends_on_it(archive):
    expected = {"scene": 1} | dict.fromkeys(LENS, 2) | dict.fromkeys(PIXEL, 6) | dict.fromkeys(EXPOSED, 12)
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        stages = tree["ledger/stage"].values.tolist()
    assert {name: stages.count(name) for name in set(stages)} == expected
    plan = plan_of(THREE)
    for node in plan.nodes:
        assert expected[node.name] == math.prod(SIZES[axis] for axis in node.axes)


def test_a_second_run_computes_nothing(archive):
    again = run(plan_of(THREE), archive)
    assert again.computed == 0
    assert len(again.reused) == len(plan_of(THREE).cells)


def test_an_added_value_computes_only_what_is_new(archive, tmp_path):
    grown = plan_of({**THREE, "sweep.f_number": [2, 5.6, 4]})
    again = run(grown, archive)
    assert computed_by_stage(again) == dict.fromkeys(LENS, 1) | dict.fromkeys(PIXEL, 3) | dict.fromkeys(EXPOSED, 6)
    assert not again.reasons
    run(grown, tmp_path / "fresh")
    assert_same_archives(archive, tmp_path / "fresh")


def test_a_changed_parameter_computes_from_its_stage_on_and_says_why(archive, tmp_path):
    changed = run(plan_of({**THREE, "sharpen.strength": 0.3}), archive)
    assert computed_by_stage(changed) == {"sharpen": 12}
    assert changed.reasons == {"sharpen": "strength: 0.15 -> 0.3"}
    back = run(plan_of(THREE), archive)
    assert computed_by_stage(back) == {"sharpen": 12}
    assert back.reasons == {"sharpen": "strength: 0.3 -> 0.15"}
    run(plan_of(THREE), tmp_path / "fresh")
    assert_same_archives(archive, tmp_path / "fresh")


def test_a_change_near_the_beginning_names_itself_and_its_consequences(archive):
    changed = run(plan_of({**THREE, "falloff.model": "disc"}), archive)
    assert changed.reasons["falloff"] == "model: cos4 -> disc"
    assert changed.reasons["diffraction"] == "its input falloff has changed"
    assert "irradiance" not in computed_by_stage(changed)


@pytest.mark.parametrize("change", [{"tolerance": 1.1e-7}, {"description": "other words"}, {"name": "another"}])
def test_what_is_not_part_of_a_result_recomputes_nothing(archive, change):
    assert run(plan_of({**THREE, **change}), archive).computed == 0


def test_neither_do_scheduler_workers_batches_or_durability(archive):
    plan = plan_of(THREE)
    assert run(plan, archive, scheduler="threads", workers=2, batch_seconds=0.0, durable=True).computed == 0


def test_another_seed_computes_the_draws_again_and_neither_the_light_nor_the_patterns_of_the_sensor(archive):
    changed = run(plan_of({**THREE, "seed": 4}), archive)
    assert set(computed_by_stage(changed)) == set(EXPOSED) - {"exposure"}
    assert changed.reasons["shot_noise"] == "seed: 3 -> 4"
    other = run(plan_of({**THREE, "camera.sensor_serial": "2"}), archive)
    assert set(computed_by_stage(other)) == set(EXPOSED)
    assert other.reasons["exposure"] == "sensor_serial: 1 -> 2"


def test_a_parameter_of_a_left_out_stage_counts_for_the_draws_behind_it(tmp_path):
    """Random numbers are keyed by the parameter values of all ancestors, left out or not: the key must say so."""
    flat = {"scene.use": "uniform", "camera.focal_length": "1 m"}
    first = plan_of(flat)
    other = plan_of({**flat, "falloff.model": "disc"})
    assert first.of("falloff")[0].left_out and other.of("falloff")[0].left_out
    assert first.of("falloff")[0].key == other.of("falloff")[0].key
    assert first.of("shot_noise")[0].key != other.of("shot_noise")[0].key
    run(first, tmp_path / "a")
    run(other, tmp_path / "a")
    run(other, tmp_path / "fresh")
    assert_same_archives(tmp_path / "a", tmp_path / "fresh")


def test_a_knob_of_fidelity_changes_no_draw():
    first, other = plan_of(THREE), plan_of({**THREE, "diffusion.nodes": 512})
    assert [c.key for c in first.of("diffusion")] != [c.key for c in other.of("diffusion")]
    assert [c.seed for c in first.of("shot_noise")] == [c.seed for c in other.of("shot_noise")]


def test_a_probe_of_transfer_functions_sees_a_change_of_a_left_out_stage(tmp_path):
    flat = {"scene.use": "uniform", "camera.focal_length": "1 m", "wanted": ["resolution"]}
    first, other = plan_of(flat), plan_of({**flat, "diffusion.nodes": 512})
    assert first.of("resolution")[0].key != other.of("resolution")[0].key


def test_changed_code_of_a_joined_stage_changes_the_key_of_the_whole_segment_behind_it(monkeypatch):
    from etendue.plan.wiring import alternatives

    before = plan_of()
    kept = alternatives.code_digest
    monkeypatch.setattr(
        alternatives, "code_digest", lambda kind: "edited" if kind.__name__ == "Diffraction" else kept(kind)
    )
    after = plan_of()
    same = {name for name in ("scene", "irradiance", "falloff") if before.of(name)[0].key == after.of(name)[0].key}
    assert same == {"scene", "irradiance", "falloff"}
    for name in ("diffraction", "diffusion", "pixel", "sharpen"):
        assert before.of(name)[0].key != after.of(name)[0].key, name
