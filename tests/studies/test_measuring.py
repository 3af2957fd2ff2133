"""Global errors: measured against the reference, on sample cells, remembered in the archive."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from etendue.accuracy.differences import difference
from etendue.accuracy.measuring import Measurement, measure
from etendue.accuracy.pilot import places
from etendue.accuracy.reference import knobs_of, reference_of
from etendue.builder.simulating import simulate
from etendue.cli.program import main
from etendue.contract.arrays.variables import parse_declaration
from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage
from etendue.contract.values.parameter import param
from etendue.errors import RequestError
from etendue.session import load
from tests.run.small import BARE
from tests.studies import strangers

KNOBS = {"diffusion.nodes": 32, "resolution.nodes": 32}
PICTURE = parse_declaration("rgb", "channel y x [1]")


def pipeline_of(text=BARE, **overrides):
    return load(text, overrides)


@given(
    st.lists(st.integers(1, 9), max_size=5),
    st.lists(st.booleans(), min_size=5, max_size=5),
    st.integers(1, 12),
)
def test_places_hold_both_ends_and_every_word_and_are_few(sizes, words, most):
    found = places(sizes, words, most)
    assert len(set(found)) == len(found)
    assert all(0 <= i < n for place in found for i, n in zip(place, sizes, strict=True))
    assert found == places(sizes, words, most)
    assert (0,) * len(sizes) in found or most == 1
    for axis, (size, is_word) in enumerate(zip(sizes, words, strict=False)):
        if is_word:
            assert {place[axis] for place in found} == set(range(size))
    if not any(words[: len(sizes)]):
        assert len(found) <= max(most, 1)
        if math.prod(sizes) <= most:
            assert len(found) == math.prod(sizes)
        elif most >= 3:
            assert tuple(n - 1 for n in sizes) in found


def test_the_error_at_the_reference_is_nothing():
    pipeline = pipeline_of(precision="float64", leave_out=False)
    exact = reference_of(pipeline, installed_stages()).pipeline
    found = Measurement(exact, installed_stages(), reference=reference_of(pipeline, installed_stages())).errors()
    assert len(found.errors) > 5
    assert {(e.rms, e.max) for e in found.errors.values()} == {(0.0, 0.0)}


def test_what_is_measured_is_the_difference_of_two_runs():
    """In front of all noise an ordinary run is the expected one: the error is that of two runs held side by side."""
    pipeline = pipeline_of(wanted=["photon_rate", "resolution.mtf50"], precision="float64", **KNOBS)
    exact = replace(reference_of(pipeline_of(), installed_stages()), coarser=None)
    exact = replace(exact, pipeline=replace(exact.pipeline, wanted=pipeline.wanted))
    found = Measurement(pipeline, installed_stages(), reference=exact).errors().errors
    runs = [simulate(one, scheduler="serial") for one in (pipeline, exact.pipeline)]
    rough, fine = (run["pixel"]["photon_rate"].values for run in runs)
    assert found["photon_rate"].max == pytest.approx(np.abs(rough - fine).max() / fine.max(), rel=1e-12)
    assert found["photon_rate"].rms == pytest.approx(np.sqrt(np.mean((rough - fine) ** 2)) / fine.max(), rel=1e-12)
    assert 1e-9 < found["photon_rate"].rms < found["photon_rate"].max
    rough, fine = (run["resolution"]["mtf50"].values for run in runs)
    assert found["mtf50"].max == pytest.approx(np.nanmax(np.abs(rough - fine) / fine), rel=1e-9, abs=1e-15)


def test_values_in_the_file_are_the_model_and_the_scene_is_too():
    registry = installed_stages()
    knobs = {knob.key: knob for knob in reference_of(pipeline_of(), registry).knobs}
    assert {"diffusion.nodes", "pixel.wavelength_terms", "resolution.nodes"} <= set(knobs)
    assert not {"scene.spacing", "scene.bin_width", "scene.softness"} & set(knobs)
    written = {knob.key for knob in reference_of(pipeline_of(**{"diffusion.nodes": 64}), registry).knobs}
    assert written == set(knobs) - {"diffusion.nodes"}
    exact = pipeline_of(**{"diffusion.nodes": 64, "tolerance": 0})
    assert Measurement(exact, registry).errors().errors["rgb_camera"].rms < 1e-6


def test_a_knob_of_a_stage_that_a_sweep_swaps_in_is_at_its_reference_too():
    sweep = {"sweep.diffusion.use": ["diffusion", {"use": "diffusion", "nodes": 64, "label": "rough"}]}
    pipeline = pipeline_of(**sweep)
    (own,) = (knob for knob in knobs_of(pipeline, installed_stages()) if knob.key == "diffusion.nodes")
    assert own.written  # in one of its tables
    reference = reference_of(pipeline, installed_stages(), knobs=[own]).pipeline
    assert [one.get("nodes") for one in reference.sweep["diffusion.use"]] == [0, 64]
    assert [one.get("label") for one in reference.sweep["diffusion.use"]] == ["diffusion", "rough"]


def test_a_finite_reference_that_still_moves_is_unknown_below_that():
    pipeline = pipeline_of(wanted=["resolution.aliasing"], tolerance=1e-9)
    own = measure(pipeline, installed_stages()).errors["aliasing"]
    assert own.how.startswith("unknown below")
    assert measure(replace(pipeline, tolerance=0.5), installed_stages()).errors["aliasing"].how == "measured"


def test_what_stands_behind_a_stage_that_hides_its_mean_is_unknown():
    text = BARE.replace('[[stages]]\nuse = "read_noise"\n', '[[stages]]\nuse = "secretive"\n')
    found = measure(pipeline_of(text, wanted=["photon_rate", "rgb_camera"]), strangers.registry()).errors
    assert found["photon_rate"].how == "measured"
    assert (found["rgb_camera"].rms, found["rgb_camera"].how) == (None, "unknown")
    assert "secretive" in found["rgb_camera"].why
    assert found["rgb_camera"].held(0.1) is None


@pytest.mark.parametrize(
    ("declared", "reference", "found", "rms"),
    [
        ("channel y x [1]", [[[1.0, 0.0]]], [[[1.0, 0.1]]], 0.1 / math.sqrt(2)),
        ("y x [electron]", [[50.0, 200.0]], [[50.0, 190.0]], 0.05 / math.sqrt(2)),
        ("stage [um-1] nan", [1.0, 100.0, np.nan], [1.1, 110.0, np.nan], 0.1),
        ("channel [1]", [0.0, 2.0], [0.2, 2.0], 0.1 / math.sqrt(2)),
        ("[dB]", 40.0, 44.0, 0.1),
        ("stage [1] uint8", [1, 2, 3, 4], [1, 2, 3, 5], 0.5),
        ("[m] nan", math.inf, math.inf, 0.0),
    ],
)
def test_errors_are_relative_to_full_scale(declared, reference, found, rms):
    own = difference(np.array(found), np.array(reference), parse_declaration("v", declared), Stage())
    assert own.relative == pytest.approx(rms, rel=1e-9)
    assert own.largest_relative >= own.relative


def test_shares_are_of_the_frame_and_places_in_a_list_right_or_wrong():
    share = parse_declaration("gamut_clipped", "[1]")
    assert difference(np.array(0.02), np.array(0.01), share, Stage()).relative == pytest.approx(0.01)
    place = parse_declaration("limiting_factor", "[1] nan")
    assert [difference(np.array(n), np.array(2.0), place, Stage()).relative for n in (2.0, 3.0, 1.0)] == [0.0, 1.0, 1.0]
    assert difference(np.array(np.nan), np.array(np.nan), place, Stage()).relative == 0


def test_what_is_undefined_in_one_run_alone_cannot_be_compared():
    own = difference(np.array([1.0, np.nan]), np.array([1.0, 1.0]), parse_declaration("v", "stage [1] nan"), Stage())
    assert own.relative is None
    assert "undefined" in own.why
    other = difference(np.array(-math.inf), np.array(math.inf), parse_declaration("v", "[m] nan"), Stage())
    assert other.relative is None


def test_settings_belong_to_knobs():
    with pytest.raises(TypeError, match="fidelity"):
        param(1.0, settings=(2.0, 1.0))


def test_a_second_run_does_not_measure_again(tmp_path, monkeypatch):
    """Nothing is computed where nothing has changed; a changed camera is measured anew."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "camera.toml").write_text(BARE)

    def run(*words):
        done = CliRunner().invoke(main, ["run", "camera.toml", "--measure", "--json", "--scheduler", "serial", *words])
        assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    first, second, other = run(), run(), run("--set", "camera.f_number=5")
    assert [one["measured"]["remembered"] for one in (first, second, other)] == [False, True, False]
    assert first["global_error"] == second["global_error"]
    assert {"rms", "max", "how", "held"} <= first["global_error"]["rgb_camera"].keys()
    assert first["global_error"]["rgb_camera"]["held"] is True
    assert run()["measured"]["remembered"] is True


def test_a_reference_that_the_camera_does_not_take_is_the_best_that_it_takes():
    """Common noise inverts the distribution, which it cannot at every mean: the knob of the draw has no closed form
    there.
    """
    pipeline = pipeline_of(**{"camera.noise": "common", "wanted": ["rgb_camera"], "tolerance": 0})
    measurement = Measurement(pipeline, installed_stages())
    knobs = {knob.key: knob for knob in measurement.reference.knobs}
    assert 30 <= knobs["shot_noise.exact_below"].reference < math.inf
    assert knobs["diffusion.nodes"].reference == 0
    assert measurement.errors().errors["rgb_camera"].rms < 1e-6


def test_a_pipeline_with_faults_is_refused_before_anything_is_measured():
    with pytest.raises(RequestError, match="sharpen"):
        Measurement(pipeline_of(**{"sharpen.strength": "much"}), installed_stages())
