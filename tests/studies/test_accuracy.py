"""Error against run time: orders of convergence, the front, the cheapest setting."""

import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from etendue.accuracy.measuring import Measurement
from etendue.accuracy.orders import convergence, remaining
from etendue.accuracy.sampling import moved
from etendue.accuracy.study import accuracy
from etendue.accuracy.timing import Timing
from etendue.accuracy.trials import Trials
from etendue.cli.program import main
from etendue.compute.tables import TABLES
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.cost import cell_seconds
from etendue.plan.expansion.search import Knob, Setting, cheapest, combinations, front
from etendue.session import load
from tests.run.small import BARE, text_of

pytestmark = pytest.mark.long

POINTS = st.lists(st.tuples(st.floats(1e-12, 1), st.floats(1e-3, 10)), min_size=1, max_size=20)


def itself(point):
    return point


@given(st.floats(0.5, 6), st.floats(1e-3, 1e-1), st.booleans())
def test_the_order_of_a_power_law_is_found(order, size, counts):
    """Counts grow towards the reference, widths shrink; rounding of logarithms leaves 1e-9."""
    steps = np.array([1.0, 2.0, 4.0, 8.0])
    settings_ = list(32 * steps) if counts else list(size / steps)
    found = convergence([*settings_, 0], [*(0.05 * steps**-order), 0.0])
    assert (found.law, found.settings) == ("algebraic", tuple(settings_))
    assert found.order == pytest.approx(order, rel=1e-9)


@given(st.floats(0.5, 6), st.booleans())
def test_the_order_of_a_power_law_is_found_beside_a_finite_reference(order, counts):
    """Of differences to a setting that itself errs by as power a law; in plain slopes the last order would be too
    high by half of it.
    """
    widths = np.array([32.0, 16.0, 8.0, 4.0, 2.0])
    settings_, last = (1 / widths, 1.0) if counts else (widths, 1.0)
    errors = 0.09 * (widths**order - 1) / (32**order - 1)
    found = convergence([*map(float, settings_)], [*errors], reference=last)
    assert found.order == pytest.approx(order, rel=1e-6)


def test_an_expansion_that_converges_by_a_factor_a_term_is_called_so():
    terms = [3, 4, 5, 6, 8, 10]
    found = convergence(terms, [0.05 * math.exp(-1.5 * n) for n in terms])
    assert found.law == "geometric"
    assert found.order == pytest.approx(1.5, rel=1e-9)


def test_an_order_is_that_of_the_settings_in_front_of_a_plateau():
    settings_ = [8, 16, 32, 64, 128, 256, 512]
    found = convergence(settings_, [max(n**-4.0, 2e-7) for n in settings_])
    assert found.settings == (8.0, 16.0, 32.0)
    assert found.order == pytest.approx(4)


def test_what_the_reference_does_not_know_shows_no_order():
    errors = [1e-2, 1e-4, 1e-6, 1e-8]
    assert convergence([8, 16, 32, 64], errors, floor=1e-7).settings == (8.0, 16.0)
    assert convergence([8, 16, 32, 64], errors, floor=1e-7).order is None
    assert convergence(["a", "b"], [0.1, 0.0]).order is None


@given(POINTS)
def test_nothing_on_the_front_is_beaten_and_all_else_is(points):
    chosen = front(points, itself)
    for error, seconds in chosen:
        assert not any((e <= error and s < seconds) or (e < error and s <= seconds) for e, s in points)
    for error, seconds in points:
        assert any(e <= error and s <= seconds for e, s in chosen)


@given(POINTS, st.floats(0.1, 1))
def test_a_slower_setting_is_on_the_front_only_where_it_is_worth_it(points, worth):
    errors = [error for error, _ in front(points, itself, worth)]
    assert all(later < worth * earlier for earlier, later in itertools.pairwise(errors))


@given(POINTS, st.floats(1e-12, 1))
def test_the_cheapest_within_a_tolerance_stands_on_the_front(points, tolerance):
    found = cheapest(points, itself, tolerance)
    within = [p for p in points if p[0] <= tolerance]
    assert (found is None) == (not within)
    if found is not None:
        assert found[1] == min(s for _, s in within)
        assert found in front(points, itself)


KNOB = st.lists(st.tuples(st.floats(1e-9, 0.5), st.floats(1e-3, 1)), min_size=1, max_size=4)


def choices_of(knobs):
    """By knob its settings 0, 1, ... with error and cost."""
    named = [Knob("", f"knob{i}", tuple(range(len(own)))) for i, own in enumerate(knobs)]
    return {
        knob.key: [Setting(knob, number, *one) for number, one in enumerate(own)]
        for knob, own in zip(named, knobs, strict=True)
    }


@given(st.lists(KNOB, min_size=1, max_size=4), st.floats(-3, 9))
def test_no_combination_costs_less_at_any_price_of_error(knobs, exponent):
    """Errors and seconds that add up: against all combinations. Between two neighbouring prices of the search lies a
    factor of 1.26.
    """
    choices = choices_of(knobs)
    price = 10.0**exponent

    def cost(settings):
        return sum(choices[key][i].cost + price * choices[key][i].error for key, i in settings.items())

    every = [dict(zip(choices, one, strict=True)) for one in itertools.product(*(range(len(k)) for k in knobs))]
    found = combinations(choices, 10_000)
    assert min(map(cost, found)) <= 1.26 * min(map(cost, every))
    assert len({tuple(sorted(one.items())) for one in found}) == len(found)
    assert len(combinations(choices, 3)) <= 3


@pytest.fixture(scope="module")
def camera():
    return load(BARE, {"wanted": ["photon_rate", "rgb_camera", "resolution"]})


@pytest.fixture(scope="module")
def found(camera):
    return accuracy(
        camera,
        installed_stages(),
        {"diffusion.nodes": (), "pixel.wavelength_terms": (3, 4, 0), "precision": ()},
        repeat=1,
        most=6,
    )


def test_a_knob_converges_as_its_method_says(found):
    """Cubic interpolation between the nodes: order 4, within 0.3 on the finest settings that rounding leaves."""
    (curve,) = (c for c in found.curves if c.knob.key == "diffusion.nodes")
    assert (curve.convergence.law, curve.measured_at) == ("algebraic", "pixel.photon_rate")
    assert curve.convergence.order == pytest.approx(4, abs=0.3)


def test_wider_wavelength_bins_converge_as_the_midpoint_rule_does(camera):
    """Every bin has its mean of light, and the optics of its middle: order 2. Held against bins a fourth as wide as
    the finest.
    """
    settings_ = (75.0, 50.0, 25.0, 5.0)
    curve = accuracy(camera, installed_stages(), {"scene.bin_width": settings_}, repeat=1, most=0).curves[0]
    errors = [curve.stage_error(t) for t in curve.trials]
    assert math.log(errors[1] / errors[2]) / math.log(2) == pytest.approx(2, abs=0.5)
    assert errors[-1] == 0
    assert curve.affected >= {"scene", "pixel", "demosaic"}


def test_an_error_of_a_trial_is_the_error_of_that_pipeline(camera, found):
    trial = next(t for t in found.trials if t.settings == {"diffusion.nodes": 64})
    measured = Measurement(camera, installed_stages(), 1)
    rest = {(k.stage, k.use, k.name): k.reference for k in measured.reference.knobs}
    own = measured.errors(0.0, settings={**rest, ("diffusion", "diffusion", "nodes"): 64}, precision="float64")
    assert trial.error == pytest.approx(own.worst, rel=1e-9)
    assert own.errors[trial.variable].rms == own.worst


def test_the_front_and_the_choices_are_of_trials(found):
    assert found.trials[0].settings == {}
    assert found.trials[0].error == 0
    assert {id(t) for t in found.frontier} <= {id(t) for t in found.trials}
    for tolerance, trial in found.cheapest:
        if tolerance > found.floor:
            assert trial.error <= tolerance
        within = [t.cost for t in found.trials if t.error is not None and max(t.error, found.floor) <= tolerance]
        assert (trial.cost if trial else None) == min(within, default=None)
    assert [t for t, _ in found.cheapest] == [pytest.approx(10.0**-n) for n in range(1, 9)]


def test_work_that_no_knob_touches_costs_every_trial_the_same(found):
    whole = {c.knob.key: c.affected for c in found.curves}
    untouched = {t.timing.warm["demosaic"] for t in found.trials if "precision" not in t.settings}
    assert "demosaic" not in whole["diffusion.nodes"]
    assert len(untouched) == 1


def seconds_of_the_plan(self, measurement, plan, repeat):
    """Seconds without a clock: those that the plan expects of every stage."""
    found, own = measurement.run(plan), {}
    for cell in plan.cells.values():
        own[cell.node] = own.get(cell.node, 0.0) + cell_seconds(plan.node(cell.node), cell, plan.precision)
    samples = {stage: (seconds,) for stage, seconds in own.items()}
    return found, Timing(samples, samples, 1, self.effort.by)


def test_the_cheapest_settings_are_those_of_brute_force(camera, monkeypatch):
    """Of 192 combinations, each run and compared, against a search that may try 24 besides each knob alone. The seconds
    are those that plans expect: what a clock says would make the law one of the machine. Coarse bands as in the file,
    so that the cheapest combinations for 1e-3 are on a finer grid than that of the knobs alone.
    """
    monkeypatch.setattr(Trials, "timed", seconds_of_the_plan)
    monkeypatch.setattr(Trials, "again", lambda self, trials: None)
    asked = {
        "scene.bin_width": (100.0, 50.0, 25.0, 12.5),
        "pixel.wavelength_terms": (3, 4, 6, 0),
        "pixel.kept_frequencies": (0.125, 0.1875, 0.25, 0.375, 0.5, 1.0),
        "precision": (),
    }
    wanted = replace(camera, wanted=("photon_rate", "rgb_camera"))
    own, every = (accuracy(wanted, installed_stages(), asked, repeat=1, most=most) for most in (24, 1000))
    assert len(own.trials) <= 1 + 3 + 3 + 5 + 1 + 24
    assert len(every.trials) == 4 * 4 * 6 * 2
    for (tolerance, one), (_, other) in zip(own.cheapest, every.cheapest, strict=True):
        assert (one and one.cost) == (other and pytest.approx(other.cost, rel=1e-9)), tolerance
    assert own.cheapest[2][1].settings["scene.bin_width"] == 12.5


def test_a_run_is_cold_without_tables_and_warm_with_them(camera, monkeypatch):
    """Cold and warm in turns, as often as asked; the least is at most the median."""
    tables, plain = [], Measurement.run

    def run(self, plan):
        tables.append(len(TABLES.entries))
        return plain(self, plan)

    monkeypatch.setattr(Measurement, "run", run)
    found = accuracy(camera, installed_stages(), {"diffusion.nodes": (64, 0)}, repeat=3, most=0)
    cold = [number for number, size in enumerate(tables) if not size]
    assert len(cold) == found.planned.timing.runs + sum(t.timing.runs for t in found.trials)
    assert all(tables[number + 1] for number in cold)
    for trial in found.trials:
        assert trial.timing.runs >= 3
        assert 0 < trial.timing.least() <= trial.timing.median()


@pytest.fixture(scope="module")
def sampled():
    """A small camera with coarser and finer bands and samples, and one knob of its computation."""
    camera = load(BARE, {"scene.bin_width": "25 nm", "wanted": ["photon_rate", "rgb_camera"]})
    asked = {"scene.bin_width": (), "scene.spacing": (), "pixel.kept_frequencies": (0.25, 0.5, 1.0)}
    return camera, accuracy(camera, installed_stages(), asked, repeat=1, most=8)


def test_the_parts_of_an_error_add_up_to_it_and_name_what_was_moved(sampled):
    _, found = sampled
    for trial in (*found.trials, found.planned):
        assert math.fsum(trial.parts.values()) == pytest.approx(trial.error, rel=1e-9, abs=1e-15)
    for trial in found.trials:
        coarse = {"pixel.kept_frequencies"} & trial.settings.keys()
        assert trial.parts.keys() - {"scene.bin_width", "scene.spacing"} <= coarse


def test_an_error_includes_what_the_grid_leaves(sampled):
    """Against the same camera with bands and samples a third as wide as the finest that were tried and all else at its
    reference: at least the true error, and below four times it: what is left behind the finest setting is estimated,
    and parts that have different signs add up. Errors of the coarsest settings may cancel: those of the file only.
    """
    camera, found = sampled
    own = next(t for t in found.trials if not t.settings)
    finest = {c.knob.key: c.knob.settings[-1] for c in found.curves if c.knob.discretisation}
    assert finest.keys() == {"scene.bin_width", "scene.spacing"}
    finer = load(BARE, {"wanted": ["photon_rate", "rgb_camera"], **{key: value / 3 for key, value in finest.items()}})
    plan, other = (Measurement(one, installed_stages(), 1) for one in (camera, finer))
    true = moved(plan, other)[own.variable]
    assert true <= own.error <= 4 * true


def test_the_noise_of_a_frame_is_that_of_its_photons():
    """A uniform scene without other noise: sqrt(charge) of each pixel, of the codes above black. 1024 pixels know it
    to 2 %: 4 of these.
    """
    quiet = {
        "camera.read_noise": 0,
        "camera.dsnu": 0,
        "exposure.prnu": 0,
        "exposure.dark_nonuniformity": 0,
        "wanted": ["raw"],
    }
    pipeline = load(BARE.replace('use = "composite"', 'use = "uniform"'), {**quiet, "camera.integration_time": "1 ms"})
    found = accuracy(pipeline, installed_stages(), {"precision": ()}, repeat=1, most=0)
    charge = Measurement(replace(pipeline, wanted=("charge",)), installed_stages(), 1)
    (arrays,) = charge.truth.arrays.values()
    adc = charge_stage(pipeline)
    expected = adc.dn_per_electron() * math.sqrt(arrays["charge"].mean()) / (2**adc.bits - 1 - adc.black_level)
    assert found.noise_floor == pytest.approx(expected, rel=0.08)
    assert found.noise_of == "raw"


def charge_stage(pipeline):
    plan = Measurement(pipeline, installed_stages(), 1).exact
    return plan.of("adc")[0].stage


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"diffusion.node": ()}, "diffusion.nodes"),
        ({"sharpen.strength": ()}, "no stage of this pipeline has this fidelity parameter"),
        ({"diffusion.nodes": (64,)}, "two or more"),
        ({"diffusion.nodes": (64, "many")}, "many"),
        ({"diffusion.nodes": (-1, 0)}, "at least 0"),
        ({"precision": ("float16", "float64")}, "float32 and float64"),
    ],
)
def test_a_knob_that_is_none_is_refused(camera, asked, message):
    with pytest.raises(RequestError, match=message):
        accuracy(camera, installed_stages(), asked)


def test_a_setting_that_the_stage_refuses_is_noted(camera):
    found = accuracy(camera, installed_stages(), {"pixel.wavelength_terms": (1, 4, 0)}, repeat=1, most=0)
    assert any("wavelength_terms = 1 is refused" in note for note in found.notes)
    assert [t.setting(found.curves[0].knob) for t in found.curves[0].trials] == [4, 0]


def test_a_reference_that_the_stage_refuses_is_the_best_that_it_takes():
    camera = load(BARE, {"camera.noise": "common", "wanted": ["rgb_camera"]})
    found = accuracy(camera, installed_stages(), {"shot_noise.exact_below": ()}, repeat=1, most=0)
    assert 30 < found.curves[0].knob.reference < math.inf
    assert found.trials[0].error == 0


def test_the_command_writes_table_document_and_diagram(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "camera.toml").write_text(text_of(f_number="[2, 4, 8]"))
    words = [
        "accuracy",
        "camera.toml",
        "--want",
        "photon_rate",
        "--knob",
        "diffusion.nodes=32,64,128,0",
        "--knob",
        "precision",
    ]
    done = CliRunner().invoke(main, [*words, "--json", "--repeat", "1", "--verify", "camera.pixel_pitch=2 um"])
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document == {
        **json.loads((tmp_path / "small-accuracy/accuracy.json").read_text()),
        "files": document["files"],
    }
    assert document["at"] == {"f_number": 4}
    assert document["planned"]["error"] is not None
    (curve, _) = document["curves"]
    assert (curve["stage"], curve["knob"], [p["setting"] for p in curve["points"]]) == (
        "diffusion",
        "nodes",
        [32, 64, 128, 0],
    )
    assert {"tolerance", "settings", "error", "seconds", "elsewhere"} <= document["cheapest"][0].keys()
    assert all(one["elsewhere"] is not None for one in document["cheapest"] if one["settings"])
    assert (tmp_path / "small-accuracy/accuracy.png").read_bytes()[:4] == b"\x89PNG"
    rows = (tmp_path / "small-accuracy/accuracy.csv").read_text().splitlines()
    assert len(rows) == 1 + 4 + 2 + len(document["frontier"]) + len(document["points"])
    shown = CliRunner().invoke(main, [*words, "--repeat", "1"])
    assert shown.exit_code == 0
    assert "cheapest settings by tolerance" in shown.stdout
    assert CliRunner().invoke(main, [*words, "--knob", "diffusion.nodes"]).exit_code == 2


@given(st.floats(1, 5), st.floats(1e-6, 1e-2), st.sampled_from([2, 4, 8]))
def test_what_is_left_behind_a_finite_reference_follows_from_its_order(order, error, ratio):
    """Errors C n^-p: the last refinement moves C (n/r)^-p - C n^-p, and C n^-p is left."""
    settings_ = [32, 64, 128, 256, 256 * ratio]
    errors = [error * (n / 32) ** -order for n in settings_]
    found = convergence(settings_[:4], errors[:4])
    if found.order is not None:
        assert remaining(settings_, errors[3] - errors[4], found) == pytest.approx(errors[4], rel=1e-6)
