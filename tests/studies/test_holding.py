"""A global error that is asked for is held, with the loosest tolerance that holds it, or it is said what stands in
the way.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from etendue.accuracy import holding
from etendue.accuracy.holding import LADDER, Asked, hold, missed
from etendue.accuracy.measuring import GlobalError, MeasuredErrors, Measurement
from etendue.accuracy.pilot import MARGIN, stated_elsewhere
from etendue.cli.program import main
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.session import Options, collect, load
from tests.plan.given import CAMERA, SCENE, SENSOR

TEXT = (
    CAMERA
    + SCENE.format(scene="composite")
    + SENSOR
    + '[sweep]\nf_number = [2, 4, 8]\npixel_pitch = ["2 um", "4 um"]\n'
)
WANTED = {"wanted": ["photon_rate"]}


def pipeline_of(**overrides):
    return load(TEXT, {**WANTED, **overrides})


@pytest.mark.parametrize("asked", [0.1, 3e-3, 1e-4])
def test_what_is_asked_for_is_held_and_the_next_looser_tolerance_does_not_hold_it(asked):
    registry = installed_stages()
    found = hold(pipeline_of(), registry, asked)
    assert found.held
    assert found.tolerance in LADDER.settings
    assert all(error.rms <= asked for error in found.measured.errors.values())
    for looser in LADDER.coarser(found.tolerance)[:1]:
        measured = Measurement(replace(pipeline_of(), tolerance=looser), registry).errors()
        assert missed(measured, Asked(asked), "rms")


def test_what_rounding_does_not_allow_cannot_be_held_and_is_said():
    """Double precision has no more than 1e-16 of full scale, and a stage that rounds so is to blame."""
    found = hold(pipeline_of(wanted=["mosaic_linear"], precision="float32"), installed_stages(), 1e-12)
    assert not found.held
    assert found.missed == ("mosaic_linear",)
    assert found.blame
    assert found.measured.errors["mosaic_linear"].rms > 1e-12


def test_a_search_without_time_measures_nothing_and_says_what_the_next_run_would_take():
    found = hold(pipeline_of(), installed_stages(), 1e-3, options=Options("serial", hold_seconds=0))
    assert not found.held
    assert found.tolerance == 1e-3
    assert found.needed.seconds > 0
    assert found.needed.bytes > 0
    assert found.measured.errors["photon_rate"].how == "unknown"
    assert found.seconds == 0


def test_a_search_ends_at_the_best_that_it_may_take():
    """The first tolerance and its reference are measured; what is needed for the next one is not left."""
    whole = hold(pipeline_of(), installed_stages(), 0.1)
    part = hold(pipeline_of(), installed_stages(), 0.1, options=Options(hold_seconds=0.6 * whole.seconds))
    assert whole.needed is None
    assert part.needed is None or part.tolerance <= whole.tolerance


def test_what_the_file_writes_is_the_model():
    assert hold(pipeline_of(**{"diffusion.nodes": 2}), installed_stages(), 1e-3).held


def test_a_run_holds_says_so_and_remembers(tmp_path):
    file = tmp_path / "file.toml"
    file.write_text('name = "held"\nwanted = ["photon_rate"]\n' + TEXT)

    def run(*more):
        done = CliRunner().invoke(
            main, ["run", str(file), "--archive", str(tmp_path / "a"), "--scheduler", "serial", "--json", *more]
        )
        assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    first, second = run("--hold", "1e-3"), run("--hold", "1e-3")
    assert first["hold"]["held"]
    assert not first["hold"]["remembered"]
    assert second["hold"]["remembered"]
    assert second["computed"] == 0
    assert first["global_error"]["photon_rate"]["held"] is True
    assert first["hold"]["tolerance"] == second["hold"]["tolerance"] == first["tolerance"]
    both = CliRunner().invoke(main, ["run", str(file), "--hold", "1e-3", "--tolerance", "1e-3"])
    assert both.exit_code == 2


def test_what_is_stated_of_other_cells_is_no_less_than_the_worst_of_them():
    registry = installed_stages()
    pipeline = pipeline_of(tolerance=3e-3, **{"sweep.f_number": [1.4, 2, 2.8, 4, 5.6, 8, 11, 16]})
    few = Measurement(pipeline, registry, 3)
    stated = stated_elsewhere(make_plan(pipeline, registry, expected=True), few.errors(), few.places)["photon_rate"]
    true = Measurement(pipeline, registry, 100).errors().errors["photon_rate"].rms
    assert true <= stated < 10 * true
    every = Measurement(pipeline, registry, 100)
    assert stated_elsewhere(make_plan(pipeline, registry), every.errors(), every.places) == {"photon_rate": None}


def test_a_cell_of_gathered_bands_alone_is_that_of_a_sweep_bit_for_bit():
    """What pixels of other sizes share changes nothing: neither whether it is shared, nor by whom it was made."""
    pipeline = pipeline_of(tolerance=1e-2)
    asked = {("pixel", (i, j)): ["photon_rate"] for i in range(3) for j in range(2)}
    plan = make_plan(pipeline, installed_stages())
    assert all(cell.stage.wavelength_terms for cell in plan.of("pixel"))
    swept = collect(plan, asked, Options("threads", 2)).arrays
    for (_, (i, j)), arrays in swept.items():
        alone = load(
            TEXT.split("[sweep]")[0],
            {**WANTED, "tolerance": 1e-2, "camera.f_number": (2, 4, 8)[i], "camera.pixel_pitch": f"{(2, 4)[j]} um"},
        )
        own = collect(make_plan(alone, installed_stages()), {("pixel", ()): ["photon_rate"]}, Options("serial")).arrays
        assert np.array_equal(own["pixel", ()]["photon_rate"], arrays["photon_rate"])


def measured(**errors):
    return MeasuredErrors({name: GlobalError(rms, rms, 1.0, "measured") for name, rms in errors.items()}, 1, 0.0)


@pytest.mark.parametrize(
    ("error", "below", "held"),
    [
        (1e-5, 0.0, True),
        (1e-5, 1e-4, True),
        (1e-5, 2e-3, None),
        (2e-3, 0.0, False),
        (2e-3, 5e-3, False),
        (1e-3, 1e-3, True),
    ],
)
def test_an_error_is_held_unless_it_or_the_doubt_of_its_reference_is_larger_than_asked(error, below, held):
    """However small it is, a reference that is off by more than what is asked says nothing of it."""
    assert GlobalError(error, 1.0, 1.0, "measured", below=below).held(1e-3) is held
    assert GlobalError(1.0, error, 1.0, "measured", below=below).held(1e-3, "max") is held
    assert GlobalError(None, None, None, "unknown").held(1e-3) is None


def test_of_tolerances_that_are_all_as_far_off_the_loosest_is_taken(monkeypatch):
    """A stricter one would cost time and bring nothing nearer."""
    planned = {
        "plan": lambda pipeline: SimpleNamespace(precision="", cells={1: SimpleNamespace(key=pipeline.tolerance)})
    }
    same = SimpleNamespace(
        pipeline=replace(pipeline_of(), tolerance=1e-3),
        seconds=0.0,
        options=Options(),
        run=lambda plan: None,
        compared=lambda plan, found, before: measured(photon_rate=0.5),
        **planned,
    )
    monkeypatch.setattr(holding, "blamed", lambda *_: {})
    found = holding._search(same, Asked(1e-3), "rms")
    assert (found.held, found.tolerance) == (False, 1e-3)


def test_bounds_of_all_stages_on_the_way_to_a_cell_are_added_up():
    """What is measured where the lens adds 1e-3 grows where it adds 3e-3, beside the 2e-3 of the pixel."""
    cells = {("lens", (n,)): (bound, ()) for n, bound in enumerate((1e-3, 3e-3))}
    cells |= {("pixel", (n,)): (2e-3, (("light", ("lens", (n,)), "light"),)) for n in (0, 1)}
    axis = SimpleNamespace(dim="f_number", values=(2, 4))
    plan = SimpleNamespace(
        cells={ref: SimpleNamespace(ref=ref, bound=bound, inputs=inputs) for ref, (bound, inputs) in cells.items()},
        wanted=[("pixel", "photon_rate")],
        axes=(axis,),
        axis=lambda dim: axis,
        everywhere=lambda at: at,
        node=lambda name: SimpleNamespace(axes=("f_number",)),
        of=lambda name: [cell for ref, cell in plan.cells.items() if ref[0] == name],
    )
    stated = stated_elsewhere(plan, measured(photon_rate=1e-4), [{"f_number": 2}])
    assert stated == {"photon_rate": pytest.approx(MARGIN * 1e-4 * (5e-3 / 3e-3))}


def test_a_metric_is_held_in_its_own_unit_and_nothing_else_is_asked_for():
    """A looser goal never needs a stricter tolerance; within a tenth of the metric anything goes."""
    text = TEXT.replace("[sweep]", '[[stages]]\nuse = "exposure_report"\n[sweep]')
    pipeline, registry = load(text, {"wanted": ["photon_rate", "mean_snr"]}), installed_stages()
    value = Measurement(pipeline, registry).errors().errors["mean_snr"].scale
    strict, loose = (hold(pipeline, registry, Asked(None, {"mean_snr": goal})) for goal in (1e-6 * value, 0.1 * value))
    assert loose.held
    assert loose.tolerance >= strict.tolerance
    error = strict.measured.errors["mean_snr"]
    assert not strict.held or error.rms * error.scale <= 1e-6 * value * (1 + 1e-9)
    assert strict.document()["limits"].keys() == {"mean_snr"}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--hold", "nothing=1"], "no wanted variable has this name"),
        (["--hold", "photon_rate=-1"], "must be above 0"),
        (["--hold", "2"], "at most 1"),
        (["--hold", "photon_rate=much"], "neither a number nor METRIC=NUMBER"),
    ],
)
def test_what_cannot_be_held_is_refused_before_anything_runs(words, said, tmp_path):
    file = tmp_path / "file.toml"
    file.write_text('name = "held"\nwanted = ["photon_rate"]\n' + TEXT)
    done = CliRunner().invoke(main, ["run", str(file), "--archive", str(tmp_path / "a"), *words])
    assert done.exit_code == 2
    assert said in " ".join(done.stderr.split())


def test_what_is_held_is_not_called_the_answer_where_bins_alone_exceed_it(tmp_path, monkeypatch):
    """Two bands for all colours put the light off by more than a thousandth, whatever the stages hold."""
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("etendue.cli.bodies.runs.AT_LEAST", 100.0)
    file = tmp_path / "file.toml"
    file.write_text('name = "held"\nwanted = ["photon_rate"]\n' + TEXT)
    words = ["run", str(file), "--archive", str(tmp_path / "a"), "--json", "--hold", "photon_rate=1e-9"]
    found = json.loads(CliRunner().invoke(main, [*words, "--set", "scene.bin_width=100 nm"]).stdout)["hold"]
    assert any("the answer is not: photon_rate" in text and "refine" in text for text in found["beyond"])
