"""The error of the answer: stated against true, what is affected by what, what is remembered."""

import copy
import dataclasses
import itertools
import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from etendue import simulate
from etendue.accuracy.answers import pilots, recalled, refinement
from etendue.accuracy.answers.cached import answer_key
from etendue.accuracy.answers.error import Part, answers_of, part_between
from etendue.accuracy.answers.evaluations import Evaluations
from etendue.accuracy.answers.pilots import state_errors
from etendue.accuracy.answers.refinement import DRAWN, Point
from etendue.archive.records.remembered import ANSWER, latest
from etendue.cli.program import main
from etendue.contract.discretised import Discretised
from etendue.contract.registry import installed_stages
from etendue.pipeline.toml import dumps
from etendue.plan.planner import make_plan
from etendue.plan.shown import answers
from etendue.plan.variants import with_draw
from etendue.present.terminal.answer_texts import is_sound, notes, plus_minus
from etendue.session import Collected, collect, execute, load

CAMERA = {
    "f_number": 4.0,
    "focal_length": "7 mm",
    "pixel_pitch": "4 um",
    "integration_time": "10 ms",
    "peak_qe": [0.4, 0.5, 0.4],
    "illuminant": "A",
}
EXTENDED = ("slanted_edge", "points", "uniform", "siemens_star")  # charts that have a margin
WANTED = ["photon_rate", "mean_snr", "lens_numbers.airy_diameter"]


def pipeline(**scene: Any) -> dict[str, Any]:
    """A small camera behind a slanted edge."""
    edge = {
        "use": "slanted_edge",
        "name": "scene",
        "white_luminance": 300.0,
        "width": 96.0,
        "height": 80.0,
        "spacing": 2.0,
        "wavelength_from": 400.0,
        "wavelength_to": 700.0,
        "bin_width": 50.0,
    }
    stages = [edge | scene, *({"use": use} for use in ("irradiance", "diffraction"))]
    stages += [{"use": "pixel", "rows": 16, "columns": 20}, {"use": "mosaic"}, {"use": "exposure"}]
    stages += [{"use": use} for use in ("shot_noise", "full_well", "adc", "exposure_report", "lens_numbers")]
    return {"name": "answer", "camera": dict(CAMERA), "stages": stages, "wanted": WANTED}


def stated(document: dict[str, Any], budget: float = math.inf) -> Any:
    return state_errors(make_plan(load(document), installed_stages()), installed_stages(), None, budget)


def values(document: dict[str, Any], exact: bool) -> dict[str, Any]:
    """Noise-free values of the wanted variables; exact: nothing left out, 64 bits."""
    document = document | ({"precision": "float64", "leave_out": False} if exact else {})
    plan = make_plan(load(document), installed_stages(), expected=True)
    found = Point(plan, installed_stages(), {}, answers(plan)).values(plan)
    return {
        name: (array, plan.node(stage).writes[name], plan.of(stage)[0].stage) for (stage, name), array in found.items()
    }


SCENES = (
    {},
    {"use": "siemens_star", "radius": 30.0, "cycles": 8},
    {"use": "points", "pitch": 40.0, "spot_sigma": 2.0},
    {"use": "colorchecker"},
    {"use": "uniform"},
)


@pytest.mark.parametrize("scene", SCENES, ids=lambda one: one.get("use", "slanted_edge"))
def test_stated_error_covers_a_run_with_everything_three_times_as_fine(scene: dict[str, Any]) -> None:
    """The factor of 10 is the product's promise; 1e-7 of full scale is rounding."""
    made = pipeline(**scene)
    finer = copy.deepcopy(made)
    for name in ("spacing", "bin_width"):
        finer["stages"][0][name] /= 3
    own, exact = values(made, False), values(finer, True)
    errors = stated(made).errors
    for name, error in errors.items():
        array, declared, stage = exact[error.variable]
        true = part_between(own[error.variable][0], array, declared, stage)
        if isinstance(true, str):  # nothing to compare, and so nothing that is stated
            assert not error.parts or error.open, name
            continue
        floor = 1e-7 * max(float(np.max(np.abs(array))), 1.0)
        assert error.rms + floor >= true.rms, name
        assert error.rms <= 10 * max(true.rms, floor), name


@pytest.mark.parametrize("scene", SCENES, ids=lambda one: one.get("use", "slanted_edge"))
@pytest.mark.parametrize(
    ("refines", "splits", "label"),
    [
        (True, 3, "spacing"),
        (False, 3, "spacing"),
        (False, 1, "margin and omissions and spacing"),
        (False, 0, "bins and margin and omissions and spacing"),
    ],
    ids=["refined", "steps", "bins", "whole"],
)
def test_cheaper_ways_cover_it_too(
    scene: dict[str, Any], refines: bool, splits: int, label: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The budget counts as small for any pipeline here; with ``bins`` and ``whole`` no time is left for more. With a
    refinement, the stated error is below ten times the true one as well.
    """
    monkeypatch.setattr(pilots, "THRIFT", 1e12)
    if not refines:
        monkeypatch.setattr(pilots.Together, "refine", lambda self: None)
    split, done = pilots.Together._split, itertools.count()
    monkeypatch.setattr(pilots.Together, "_split", lambda *given: next(done) < splits and split(*given))
    made = pipeline(**scene)
    finer = copy.deepcopy(made)
    for name in ("spacing", "bin_width"):
        finer["stages"][0][name] /= 3
    own, exact = values(made, False), values(finer, True)
    errors = stated(made, 1e6).errors
    whole = label if scene.get("use", "slanted_edge") in EXTENDED else label.replace("margin and ", "")
    assert whole in errors["photon_rate"].parts
    for name in own:
        array, declared, stage = own[name]
        true = part_between(array, exact[name][0], declared, stage)
        assert isinstance(true, Part)
        if "noise-free path" in errors[name].open:  # so few are black that noise decides
            continue
        assert not errors[name].open, name
        assert errors[name].rms >= true.rms - 1e-7, (name, errors[name].rms, true.rms)
        if refines:
            floor = 1e-7 * max(float(np.max(np.abs(array))), 1.0)
            assert errors[name].rms <= 10 * max(true.rms, floor), (name, errors[name].rms, true.rms)


@pytest.mark.parametrize(
    ("name", "scene"),
    [("spacing", {"use": "points", "pitch": 16.0}), ("bins", {"bin_width": 100.0})],
    ids=["close points", "three bands"],
)
def test_what_cannot_be_coarser_is_refined_and_not_called_fixed(
    name: str, scene: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Points closer than their blur on a coarser grid are refused; three bands are as few as there are."""
    own = stated(pipeline(**scene)).errors["photon_rate"]
    monkeypatch.setattr(pilots, "THRIFT", 1e12)
    short = stated(pipeline(**scene), 1e6).errors["photon_rate"]
    assert name not in short.fixed
    assert short.parts[name].rms == pytest.approx(own.parts[name].rms)


@pytest.mark.parametrize("place", ["memory", "archive"])
def test_errors_that_start_from_the_results_of_the_run_are_those_of_a_new_computation(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit by bit; and the light of the run is not computed again, unless it is damaged by then."""
    document = pipeline(white_luminance=3000.0) | {"sweep": {"f_number": [2.0, 8.0]}, "tolerance": 1e-6}
    plan = make_plan(load(document), installed_stages())
    outcome = execute(plan, None if place == "memory" else tmp_path / "run")
    fresh = state_errors(plan, installed_stages(), None, math.inf).errors
    computed: list[str] = []
    monkeypatch.setattr(refinement, "collect", lambda *given: _noting(computed, collect(*given)))
    kept = state_errors(plan, installed_stages(), outcome, math.inf).errors
    assert {name: one.parts for name, one in kept.items()} == {name: one.parts for name, one in fresh.items()}
    assert kept["mean_snr"].noise > 0 and 0.1 < kept["mean_snr"].noise / fresh["mean_snr"].noise < 10
    light = computed.count("pixel")
    computed.clear()
    if place == "archive":
        shutil.rmtree(tmp_path / "run" / "data.zarr")
    else:
        outcome.arrays = {}
    again = state_errors(plan, installed_stages(), outcome, math.inf).errors
    assert again["mean_snr"].parts == fresh["mean_snr"].parts
    assert computed.count("pixel") == light + 2  # once for each point of the sweep


def _noting(computed: list[str], found: Collected) -> Collected:
    computed += [stage for stage, _ in found.reports]
    return found


SWEPT = {
    "f_number": [2.0, 4.0, 8.0],
    "integration_time": ["5 ms", "10 ms"],
    "diffraction.use": [
        {"use": "diffraction", "label": "sharp"},
        {"use": "lens_gaussian", "sigma": 3.0, "label": "soft"},
    ],
}


@pytest.mark.parametrize("place", [(0, 1, 1), (2, 0, 0), (1, 1, 0)])
def test_the_plan_of_one_point_computes_what_that_point_alone_computes(place: tuple[int, int, int]) -> None:
    """Bit by bit, and draws are others than those of the run and of one another."""
    swept = pipeline() | {"sweep": SWEPT}
    alone = swept | {"sweep": {key: [SWEPT[key][at]] for key, at in zip(SWEPT, place, strict=True)}}
    whole, single = (make_plan(load(one), installed_stages()) for one in (swept, alone))
    at = {axis.dim: axis.values[place[list(SWEPT).index(axis.key)]] for axis in whole.axes}
    wanted = answers(whole)
    point, own = Point(whole, installed_stages(), at, wanted), Point(single, installed_stages(), at, wanted)
    found, expected = point.values(point.base), own.values(make_plan(load(alone), installed_stages(), expected=True))
    assert found.keys() == expected.keys()
    for one, array in expected.items():
        np.testing.assert_array_equal(found[one], array, err_msg=str(one))
    shot = point.base.of("shot_noise")[0].ref
    draws = [collect(with_draw(point.base, number), {shot: ["charge"]}).arrays[shot]["charge"] for number in (0, 1, 1)]
    assert np.array_equal(draws[1], draws[2]) and not np.array_equal(draws[0], draws[1])


def test_what_is_too_short_for_pictures_refines_cheap_numbers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other variables keep the errors that they have, or stay not measured for want of time."""
    monkeypatch.setattr(pilots, "THRIFT", 1e12)
    made = pipeline() | {"wanted": ["photon_rate", "mean_snr", "resolution"]}
    made["stages"].append({"use": "resolution"})
    whole = stated(made, 1e6).errors
    cheap = {one for one in whole if whole[one].stage == "resolution"}
    affordable = Evaluations.affordable

    def few(self: Evaluations, *which: Any) -> frozenset[Any]:
        return frozenset(one for one in affordable(self, *which) if one[0] == "resolution")

    monkeypatch.setattr(Evaluations, "affordable", few)
    found = stated(made, 1e6).errors
    assert {"mtf", "mtf50_lp_mm"} <= cheap
    for name, error in found.items():
        assert set(error.open) == set(whole[name].open), name
        if name in cheap:
            assert error.parts == whole[name].parts, name
        else:
            assert list(error.parts) == ["bins and margin and omissions and spacing"], name


def test_a_number_that_grows_without_limit_has_no_error() -> None:
    """Too dark for codes, only the light has an edge; its MTF50 on grids of half the spacing is twice as high."""
    made = pipeline(white_luminance=0.01)
    made["stages"].append({"use": "edge_resolution"})
    own = stated(made | {"wanted": ["edge_mtf50"]}).errors["edge_mtf50"]
    assert own.open["spacing"] == "one step changes it by 50%, so it does not converge on these grids"
    assert "spacing" not in own.parts


def test_what_a_discretisation_cannot_reach_has_no_error_of_it() -> None:
    own = stated(pipeline()).errors["airy_diameter"]
    assert {name: own.parts[name].rms for name in ("bins", "spacing", "margin")} == dict.fromkeys(
        ("bins", "spacing", "margin"), 0.0
    )


def test_error_of_bins_falls_when_bins_are_halved() -> None:
    """At least as with first order, less a quarter for bins that straddle features of the spectrum."""
    coarse, fine = (stated(pipeline(bin_width=width)).errors["photon_rate"].parts["bins"].rms for width in (50, 25))
    assert fine < 0.75 * coarse


def test_what_cannot_be_refined_is_named_and_never_zero() -> None:
    found = stated(pipeline(use="colorchecker"))
    error = found.errors["photon_rate"]
    assert "margin" in error.fixed
    assert "margin" not in error.parts
    assert any("because it cannot be refined: margin" in text for text in notes(found.document()))


@pytest.mark.parametrize(("tolerance", "named"), [(1e-3, True), (0.2, False)])
def test_a_knob_that_no_study_refines_is_named_where_its_stage_is_above_the_tolerance(
    tolerance: float, named: bool
) -> None:
    document = pipeline() | {"tolerance": tolerance}
    document["stages"][2] = {"use": "aberrations", "accuracy": 0.1, "heights": 2}
    found = stated(document)
    texts = [text for text in notes(found.document()) if "aberrations (accuracy)" in text]
    assert bool(texts) == named
    assert all("not included in these errors" in text and "of full scale" in text for text in texts)


def test_with_common_draws_omissions_are_measured_against_the_best_that_the_stages_accept() -> None:
    made = pipeline()
    made["camera"] |= {"noise": "common"}
    errors = stated(made).errors
    assert "omissions" in errors["photon_rate"].parts
    assert not any("omissions" in one.open for one in errors.values())


def test_without_time_nothing_is_claimed() -> None:
    found = stated(pipeline(), budget=0.0)
    error = found.errors["photon_rate"]
    assert set(error.open) >= {"bins", "spacing", "margin"}
    assert not {"bins", "spacing", "margin"} & set(error.parts)
    assert any("--measure" in text for text in notes(found.document()))


def test_errors_are_the_same_after_storing() -> None:
    found = stated(pipeline())
    again = answers_of(json.loads(json.dumps(recalled.finite(found.document()))))
    assert again is not None
    assert again.errors == found.errors
    assert again.shown == found.shown
    assert again.remembered


@pytest.mark.parametrize(
    "document", [{}, {"errors": 1}, {"errors": {"a": {}}, "shown": {}}, {"errors": {}, "shown": 3}]
)
def test_documents_of_another_form_are_measured_again(document: dict[str, Any]) -> None:
    assert answers_of(document) is None


def test_equal_cells_are_measured_once(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    registry = installed_stages()
    plan = make_plan(load(pipeline()), registry)
    outcome = execute(plan)
    first = recalled.answer_errors(outcome, registry, math.inf)
    monkeypatch.setattr(recalled, "state_errors", lambda *given: pytest.fail("measured again"))
    second = recalled.answer_errors(outcome, registry, math.inf, tmp_path)
    assert second.errors == first.errors
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "other"))
    assert recalled.recalled(plan, tmp_path) is not None  # from the archive
    other = make_plan(load(pipeline(bin_width=25.0)), registry)
    assert recalled.recalled(other, tmp_path) is None


def test_a_small_budget_never_replaces_what_a_larger_one_found(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    registry = installed_stages()
    outcome = execute(make_plan(load(pipeline()), registry))
    poor = recalled.answer_errors(outcome, registry, 0.0, tmp_path)
    rich = recalled.answer_errors(outcome, registry, math.inf, tmp_path)
    assert poor.dear > 0
    assert rich.dear == 0
    assert recalled.answer_errors(outcome, registry, 0.0, tmp_path).errors == rich.errors


def test_a_sweep_states_the_larger_of_its_measured_points_with_a_factor() -> None:
    swept = pipeline() | {"sweep": {"f_number": [2, 4, 8, 16, 22]}}
    found = stated(swept)
    error, here = found.errors["photon_rate"], found.shown["photon_rate"]
    assert found.points == 4
    assert error.scaled > 1
    assert error.rms >= error.scaled * here.rms


def test_every_refinement_is_accepted_by_its_stage() -> None:
    """Finer, coarser and wider values of every installed scene; samples stay inside the wider light."""
    registry, checked = installed_stages(), 0
    for use in registry.names():
        kind = registry.load(use)
        if not issubclass(kind, Discretised) or use in ("photograph", "radiance_cube", "patch_chart"):
            continue
        stage = load(pipeline(use=use, **({"pitch": 40.0, "spot_sigma": 2.0} if use == "points" else {})))
        own = make_plan(stage, registry).of("scene")[0].stage
        assert isinstance(own, Discretised)
        for name, why in own.discretisations().items():
            for factor in (2, 3, -2, -8):
                values = own.refined(name, factor)
                assert bool(values) <= (not why)
                other = dataclasses.replace(own, **values)
                try:
                    _, grids = other.describe()
                except ValueError:  # a chart may be too small for coarse samples
                    assert factor < 0
                    continue
                checked += len(grids)
                if name == "margin" and values:
                    inner, outer = own.describe()[1]["radiance"], grids["radiance"]
                    for dim in ("y", "x"):
                        mine, theirs = inner.line(dim).values(), outer.line(dim).values()
                        offset = (mine[0] - theirs[0]) / inner.line(dim).step
                        assert offset > 0 and abs(offset - round(offset)) < 1e-9
    assert checked > 50


def test_texts_say_what_is_missing_and_nothing_where_too_little_is_known() -> None:
    parts = {"bins": {"rms": 0.02, "basis": "refined"}, "spacing": {"rms": 0.01, "basis": "refined"}}
    document: dict[str, Any] = {"rms": 0.03, "unit": "dB", "parts": parts, "open": {}}
    assert plus_minus(document, "dB") == "\u00b10.03 dB (bins 0.02, spacing 0.01)"
    of_channels = document | {
        "max": 0.06,
        "parts": {"bins": {"rms": 0.02, "max": 0.05}, "spacing": {"rms": 0.01, "max": 0.01}},
    }
    assert plus_minus(of_channels, "dB") == "\u00b10.06 dB (bins 0.05, spacing 0.01)"
    assert plus_minus(of_channels | {"unit": ""}, "of full scale").startswith("\u00b10.03 of full scale (bins 0.02")
    document["noise"] = 0.4
    assert plus_minus(document, "dB") == "\u00b10.03 dB (bins 0.02, spacing 0.01) \u00b10.4 (noise)"
    document |= {"open": {"margin": "costs about 40 s"}, "noise": None}
    assert (
        plus_minus(document, "dB")
        == "dB (error at least 0.03: bins 0.02, spacing 0.01; margin not measured, --measure does)"
    )
    bound = {"omissions": {"rms": 1e-5, "basis": "bound"}}
    assert plus_minus({**document, "parts": bound}, "dB") == ""  # says nothing of what is larger
    assert plus_minus({**document, "parts": {}}) == ""
    assert plus_minus(None) == ""


def test_command_line_states_plans_and_stores_errors(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "answer.toml").write_text(dumps(pipeline()))

    def said(*words: str) -> str:
        result = CliRunner().invoke(main, [*words])
        assert result.exit_code == 0, result.output
        return result.stdout

    assert "known after a run" in said("plan", "answer.toml")
    assert "answer" not in json.loads(said("run", "answer.toml", "--json", "--no-errors"))
    found = json.loads(said("run", "answer.toml", "--json", "--measure"))
    snr = next(one for one in found["headlines"] if one["name"] == "mean_snr")
    assert snr["error"]["rms"] == found["answer"]["shown"]["mean_snr"]["rms"] > 0
    assert "error of the answer" in said("run", "answer.toml", "--quiet")
    assert json.loads(said("plan", "answer.toml", "--json"))["answer"]["errors"] == found["answer"]["errors"]
    assert "error of the answer" in said("plan", "answer.toml")


def test_python_writes_errors_beside_the_values(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path))
    monkeypatch.setattr("etendue.accuracy.answers.recalled.SHARE", 1e3)  # a run this small has no time for it
    value = simulate(pipeline())["exposure_report"]["mean_snr"]
    assert value.attrs["error"] > 0
    assert value.attrs["error_parts"].startswith("\u00b1")
    assert "error" not in simulate(pipeline(), errors=False)["exposure_report"]["mean_snr"].attrs


def test_noisy_metrics_carry_the_scatter_of_the_noise_apart() -> None:
    """The interval about one draw covers other draws: 95 % of them, so 16 of 20 at the least (binomial, 2e-4)."""
    made = pipeline(width=200.0, height=160.0)
    made["stages"][3] |= {"rows": 32, "columns": 40}
    uses = ("linearise", "white", "balance_mosaic", "demosaic_bilinear", "colour_fit", "camera_to_xyz", "balance")
    made["stages"] += [{"use": use} for use in (*uses, "display", "encode", "edge_resolution")]
    made |= {"wanted": ["edge_mtf50", "mean_snr"], "seed": 7}
    errors = stated(made).errors
    assert not errors["mean_snr"].noise
    half = errors["edge_mtf50"].noise
    assert half is not None
    assert half > 0
    plan = make_plan(load(made), installed_stages(), expected=True)
    point = Point(plan, installed_stages(), {}, plan.wanted)
    key = ("edge_resolution", "edge_mtf50")
    mean = np.ravel(point.values(plan)[key])[-1]
    draws = [np.ravel(point.values(point.planned({"draw": number}, DRAWN))[key])[-1] for number in range(100, 120)]
    assert np.sum(np.abs(np.array(draws) - mean) <= half) >= 16


def test_light_on_the_grid_that_is_refined_has_an_error_too() -> None:
    """It is compared on its own grid: bands and cells as means, samples interpolated."""
    error = stated(pipeline() | {"wanted": ["irradiance.irradiance"]}).errors["irradiance"]
    assert set(error.parts) >= {"bins", "spacing", "margin"}
    assert not error.open
    assert 0 < error.parts["spacing"].rms < 0.5


def test_a_scene_that_an_axis_swaps_in_is_refined_as_if_it_stood_alone() -> None:
    """At the shown point, the middle of the axis; also with values in the table of the swap."""
    alone = stated(pipeline()).shown["photon_rate"]
    values = {key: value for key, value in pipeline()["stages"][0].items() if key not in ("use", "name")}
    tables = [{"use": use, **values} for use in ("uniform", "slanted_edge", "colorchecker")]
    swapped = pipeline() | {"sweep": {"scene.use": tables}}
    found = stated(swapped).shown["photon_rate"]
    for part in ("spacing", "bins", "margin"):
        assert found.parts[part].rms == pytest.approx(alone.parts[part].rms, rel=1e-3)


def test_a_saturated_picture_says_nothing_about_other_points_of_a_sweep() -> None:
    """At the shown point, the last one measured here, every pixel is full: no refinement changes the raw values."""
    swept = pipeline() | {"wanted": ["raw", "photon_rate"], "sweep": {"integration_time": ["1 ms", "900 s", "901 s"]}}
    plan = make_plan(load(swept), installed_stages())
    found = state_errors(plan, installed_stages(), None, math.inf, places=1).errors
    assert found["raw"].rms == 0 and list(found["raw"].open) == ["other points"]
    assert found["photon_rate"].rms > 0 and not found["photon_rate"].open
    assert "not measured for raw (other points): at the measured point no refinement changes it" in notes(
        state_errors(plan, installed_stages(), None, math.inf, places=1).document()
    )
    every = state_errors(plan, installed_stages(), None, math.inf).errors["raw"]
    assert every.rms > 0 and not every.open


def test_a_source_that_says_nothing_of_its_sampling_is_named() -> None:
    plan = make_plan(load("plugins/etendue-array/pipelines/beam.toml"), installed_stages())
    found = state_errors(plan, installed_stages(), None, math.inf)
    assert all(any(name.startswith("discretisation of") for name in one.fixed) for one in found.errors.values())


def test_what_differs_only_in_the_shown_point_or_in_what_is_written_has_another_key() -> None:
    swept = pipeline() | {"sweep": {"f_number": [2, 4, 16]}}
    keys = {answer_key(make_plan(load(one), installed_stages())) for one in (swept, _with_f_number(swept, 16.0))}
    assert len(keys) == 2


def _with_f_number(document: dict[str, Any], value: float) -> dict[str, Any]:
    return document | {"camera": document["camera"] | {"f_number": value}}


def test_numbers_that_only_noise_makes_have_no_error_of_the_noise_free_path() -> None:
    """In the dark every pixel is black without noise; with it, most are not."""
    made = pipeline(white_luminance=0.02)
    made["stages"] = [one for one in made["stages"] if one["use"] != "exposure_report"]
    made["stages"].insert(-2, {"use": "read_noise"})
    made["stages"].append({"use": "exposure_report"})
    made["camera"] |= {"read_noise": 5}
    made |= {"wanted": ["black_fraction"]}
    error = stated(made).errors["black_fraction"]
    assert "noise-free path" in error.open
    assert not error.parts


def test_a_stage_that_fails_when_refined_does_not_fail_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    def broken(self: Any, name: str, factor: int) -> dict[str, Any]:
        raise RuntimeError("not today")

    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    registry = installed_stages()
    outcome = execute(make_plan(load(pipeline()), registry))
    monkeypatch.setattr(registry.load("slanted_edge"), "refined", broken)
    found = recalled.answer_errors(outcome, registry, math.inf, tmp_path)
    assert found.errors == {}
    assert "not today" in " ".join(notes(found.document()))


EDITED: list[Any] = [
    [],
    {"at": {"f_number": [[2]]}},
    {"at": {}, "remedies": ["bins"]},
    {"at": {}, "why": 3},
    {"errors": {}},
    {"at": {}, "points": "1"},
    *({"part": {"rms": wrong, "max": 0.0, "basis": "refined"}} for wrong in ("much", [], {}, True)),
    {"x" * 400: {"rms": 0.1, "max": 0.1, "basis": "refined"}},
]


@pytest.mark.parametrize("edit", EDITED, ids=range(len(EDITED)))
def test_edited_documents_are_measured_again_and_shown_nowhere(edit: Any) -> None:
    document = stated(pipeline()).document()
    assert is_sound(document)
    if isinstance(edit, dict) and not {"errors", "at"} & edit.keys():
        document["shown"]["photon_rate"]["parts"] = edit
    elif isinstance(edit, dict):
        document = {**document, **edit, **({"shown": None} if "errors" in edit else {})}
    else:
        document = edit
    assert not is_sound(document)


def test_the_report_never_shows_the_errors_of_another_run(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The archive holds those of the last run, or none."""
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    (tmp_path / "answer.toml").write_text(dumps(pipeline()))

    def run(*more: str) -> Any:
        words = ["run", str(tmp_path / "answer.toml"), "--archive", str(tmp_path / "a"), "--quiet", *more]
        assert CliRunner().invoke(main, words).exit_code == 0
        stored = latest(tmp_path / "a", ANSWER)
        return stored and stored["shown"]["mean_snr"]["rms"]

    finer = ("--set", "scene.spacing=1 um")
    coarse, none, fine = run("--measure"), run("--no-errors", *finer), run("--measure", *finer)
    assert none is None
    assert fine != coarse
    assert run() == coarse  # recalled, and the only one
    before = (tmp_path / "a" / "measured.json").stat().st_mtime_ns
    run()
    assert (tmp_path / "a" / "measured.json").stat().st_mtime_ns == before  # nothing new, nothing written


def test_a_finished_run_that_is_interrupted_in_its_pilot_still_tells_its_results(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("etendue.cli.bodies.runs.answer_errors", interrupted)
    (tmp_path / "answer.toml").write_text(dumps(pipeline()))
    words = ["run", str(tmp_path / "answer.toml"), "--archive", str(tmp_path / "a"), "--quiet"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0
    assert "not measured: interrupted" in " ".join(done.stdout.split())
    assert "mean_snr" in done.stdout


def test_what_would_make_the_answer_better_is_said() -> None:
    found = stated(pipeline())
    assert found.remedies["bins"] == "scene.bin_width = 25"
    assert found.remedies["spacing"] == "scene.spacing = 1"
    (line,) = (text for text in notes(found.document()) if text.startswith("for smaller errors: --set scene."))
    assert line.endswith("; use one or more; the first has the largest effect)")
    assert "margin" not in stated(pipeline(use="colorchecker")).remedies


def test_what_the_stages_refuse_is_no_remedy_and_the_stage_says_why() -> None:
    made = pipeline(spacing=4.0)
    made["stages"][3] |= {"sampling": "paper"}
    found = stated(made)
    assert "spacing" not in found.remedies
    assert "sampling = 'paper'" in found.errors["photon_rate"].fixed["spacing"]


def test_what_is_known_of_one_variable_leaves_the_others_to_be_measured() -> None:
    plan, known = make_plan(load(pipeline()), installed_stages()), {"bins": {"photon_rate": Part(0.5, 0.5)}}
    own = state_errors(plan, installed_stages(), None, math.inf, known=known).errors
    free = stated(pipeline()).errors
    assert own["photon_rate"].parts["bins"] == Part(0.5, 0.5)
    assert own["mean_snr"].parts["bins"] == free["mean_snr"].parts["bins"] != Part(0.0, 0.0)
    assert not own["mean_snr"].open
