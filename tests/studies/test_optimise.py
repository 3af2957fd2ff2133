"""A search meets its limits, finds what a grid of known cells has, and goes on after it was stopped as if it had not
been.
"""

from __future__ import annotations

import json
import random
import sys

import numpy as np
import pytest

from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.evaluation.session import Row, Session
from etendue.session import load
from etendue_lab.search.asked import Goal, Limit, Metric, read_request
from etendue_lab.search.model import Model
from etendue_lab.search.study import Found, Trial, search
from tests.run.small import BARE, command

needs_optuna = pytest.mark.skipif(
    __import__("importlib.util").util.find_spec("optuna") is None, reason="optuna is not installed"
)
REQUEST = {
    "maximise": ["mean_snr"],
    "subject": ["clipped_fraction <= 0.05", "pixel_pitch <= 3"],
    "over": ["f_number=1.4:8", "pixel_pitch=2:6", "integration_time=1 ms:30 ms:log"],
}


def request(**more):
    return read_request(load(BARE), installed_stages(), **{**REQUEST, **more})


@pytest.fixture
def count(monkeypatch):
    """The settings of every evaluation."""
    seen, rows = [], Session.rows

    def counted(self, settings, names):
        seen.extend(settings)
        return rows(self, settings, names)

    monkeypatch.setattr(Session, "rows", counted)
    return seen


@needs_optuna
def test_the_best_meets_all_limits_and_no_allowed_trial_is_better():
    found = search(load(BARE), request(), 30)
    (best,) = found.best
    assert best.allowed
    record = Session(load(BARE)).metrics(["mean_snr", "clipped_fraction"], **best.settings)
    assert best.values == (record["mean_snr"],)
    assert record["clipped_fraction"] <= 0.05
    assert all(one.values[0] <= best.values[0] for one in found.trials if one.allowed)
    assert all(2 <= one.settings["pixel_pitch"] <= 3 for one in found.trials)
    assert sum(one.allowed for one in found.trials) < 30  # the other limit takes effect


def known(x, y):
    """A goal and a limited number in closed form: the limit cuts off the goal's own optimum."""
    return (x - 3.1) ** 2 + 0.5 * (y - 1.2) ** 2 + 0.3 * x * y, x + 0.5 * y


@needs_optuna
def test_a_search_finds_what_a_grid_of_known_cells_has_and_chance_does_not(monkeypatch):
    """The best of 100 x 100 cells within 0.5 %, in 60 trials: in every one of four seeds, by chance in fewer."""

    def rows(self, settings, names):
        for number, own in enumerate(settings):
            found = known(own["f_number"], own["integration_time"])
            yield Row(number, own, dict(zip(("mean_snr", "clipped_fraction"), found, strict=True)))

    monkeypatch.setattr(Session, "rows", rows)
    asked = request(
        maximise=[],
        minimise=["mean_snr"],
        subject=["clipped_fraction >= 2"],
        over=["f_number=0.5:10", "integration_time=0.001:10"],
    )
    every = [known(x, y) for x in np.linspace(0.5, 10, 100) for y in np.linspace(0.001, 10, 100)]
    best = min(value for value, limited in every if limited >= 2)
    met = {
        sampler: sum(
            found[0].values[0] <= 1.005 * best
            for seed in range(4)
            if (found := search(load(BARE), replaced(asked, seed=seed, sampler=sampler), 60).best)
        )
        for sampler in ("model", "random")
    }
    assert met["model"] == 4
    assert met["random"] < 4


def test_the_model_finds_the_front_of_two_goals():
    """Two paraboloids: every point of their front lies between the two minima. Nine tenths of the area that it leaves
    free are reached in 60 trials.
    """
    ends, model = np.array([[0.2, 0.3], [0.8, 0.7]]), Model(2, 5)
    points, goals = np.zeros((0, 2)), np.zeros((0, 2))
    for number in range(60):
        point = model.next(points, goals, np.full((number, 1), -1.0))
        points = np.vstack([points, point])
        goals = np.vstack([goals, ((point - ends) ** 2).sum(axis=1)])

    def area(values):
        reached, total = 0.6, 0.0
        for first, second in sorted(map(tuple, values)):
            if first < 0.6 and second < reached:
                total += (0.6 - first) * (reached - second)
                reached = second
        return total

    share = np.linspace(0, 1, 400)[:, None]
    front = ends[0] + share * (ends[1] - ends[0])
    assert area(goals) > 0.9 * area(((front[:, None, :] - ends) ** 2).sum(axis=2))


def test_the_next_point_follows_from_the_trials_and_their_number():
    draw = np.random.default_rng(3)
    points, goals = draw.random((20, 3)), draw.random((20, 1))
    excess = np.where(draw.random((20, 2)) < 0.3, np.nan, draw.normal(size=(20, 2)))
    first = Model(3, 1).next(points, goals, excess)
    assert np.array_equal(first, Model(3, 1).next(points, goals, excess))
    assert not np.array_equal(first, Model(3, 2).next(points, goals, excess))
    assert ((first >= 0) & (first <= 1)).all()


def replaced(asked, **changes):
    from dataclasses import replace

    return replace(asked, **changes)


@needs_optuna
def test_a_search_that_was_stopped_gives_the_trials_of_one_that_was_not(tmp_path, count):
    whole = search(load(BARE), request(), 20)
    assert search(load(BARE), request(), 8, tmp_path / "a").trials == whole.trials[:8]
    path = tmp_path / "a" / "trials.jsonl"
    path.write_bytes(path.read_bytes()[:-9])  # as a kill in the middle of a line leaves it
    count.clear()
    again = search(load(BARE), request(), 20, tmp_path / "a")
    assert again.trials == whole.trials
    assert (again.recalled, len(count)) == (7, 13)
    count.clear()
    assert search(load(BARE), request(), 20, tmp_path / "a").trials == whole.trials
    assert count == []
    assert [json.loads(line)["number"] for line in path.read_text().splitlines()] == list(range(20))


@needs_optuna
@pytest.mark.parametrize(
    ("text", "differs"),
    [(BARE, "seed"), (BARE.replace('pixel_pitch = "2.6 um"', 'pixel_pitch = "2.7 um"\nread_noise = 7'), "pipeline")],
)
def test_the_folder_of_another_search_is_refused_and_left_alone(tmp_path, text, differs):
    search(load(BARE), request(), 3, tmp_path / "a")
    before = {path: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    other = replaced(request(), seed=1) if differs == "seed" else request()
    with pytest.raises(RequestError, match=rf"holds another search \({differs} differ\)"):
        search(load(text), other, 3, tmp_path / "a")
    assert before == {path: path.read_bytes() for path in (tmp_path / "a").iterdir()}


@needs_optuna
@pytest.mark.parametrize(
    ("goal", "limit", "says"),
    [
        ("mean_snr", "photon_rate[max] >= {}", "cannot be met, according to the declarations of the stage"),
        ("edge_mtf50[mean]", "clipped_fraction <= 0.05", "is beyond the limit, which was computed first"),
    ],
)
def test_what_cannot_meet_a_limit_is_not_computed_and_said(count, goal, limit, says):
    """Undone, by computing the goal too: the limit is exceeded, by the declared excess at least."""
    text = BARE + '[[stages]]\nuse = "edge_resolution"\n' if "edge" in goal else BARE
    session = Session(load(text))
    if "{}" in limit:
        limit = limit.format(0.6 * session.metrics("photon_rate", f_number=1.4)["photon_rate"].max())
    asked = request(maximise=[goal], subject=[limit], over=["f_number=1.4:8", "integration_time=1 ms:60 ms:log"])
    found = search(load(text), asked, 12)
    spared = [one for one in found.trials if one.spared]
    assert 0 < len(spared) < 12
    assert found.document()["spared"] == len(spared)
    assert any(says in note for note in found.document()["notes"])
    for one in spared:
        assert (one.values, one.allowed) == ((), False)
        record = session.metrics(asked.metrics, **one.settings)
        assert asked.limits[0].excess(asked.limits[0].metric.of(record)) >= one.excess[0] > 0


@needs_optuna
def test_a_search_learns_where_the_camera_fails(monkeypatch):
    """Settings fail in nine tenths of the range. By chance one in six searches comes as close to the best as this."""

    def rows(self, settings, names):
        for number, own in enumerate(settings):
            bad = own["f_number"] > 1.4 + 0.1 * 6.6
            yield Row(number, own, {} if bad else {"mean_snr": -abs(own["f_number"] - 1.7)}, "too far" if bad else "")

    monkeypatch.setattr(Session, "rows", rows)
    for seed in range(2):
        found = search(load(BARE), replaced(request(subject=[], over=["f_number=1.4:8"]), seed=seed), 40)
        assert found.best[0].values[0] > -0.01


@needs_optuna
def test_the_setting_that_decides_is_the_important_one(monkeypatch):
    def rows(self, settings, names):
        for number, own in enumerate(settings):
            yield Row(number, own, {"mean_snr": -((own["f_number"] - 3) ** 2) + 0.01 * own["pixel_pitch"]})

    monkeypatch.setattr(Session, "rows", rows)
    found = search(load(BARE), request(subject=[], over=["pixel_pitch=2:6", "f_number=1.4:8"]), 60)
    assert next(iter(found.importance)) == "f_number"
    assert sum(found.importance.values()) == pytest.approx(1)
    assert found.importance["f_number"] > 0.7


@needs_optuna
def test_whole_numbers_and_choices_are_searched_as_such():
    over = ["bits=8:14", "pixel.rows=16,24", "demosaic.use=demosaic_bilinear,demosaic_nearest", "read_noise=1,2.5"]
    found = search(load(BARE), request(over=over, subject=[]), 25)
    assert not [one.failed for one in found.trials if one.failed]
    assert {type(one.settings["bits"]) for one in found.trials} == {int}
    assert {one.settings["read_noise"] for one in found.trials} == {"1", "2.5"}


@needs_optuna
def test_a_cell_that_fails_is_told_as_failed_and_the_search_goes_on(monkeypatch):
    kind = installed_stages().load("exposure")
    right = kind.run

    def broken(self, **given):
        if self.integration_time > 5e-3:
            raise ArithmeticError("too long")
        return right(self, **given)

    monkeypatch.setattr(kind, "run", broken)
    found = search(load(BARE), request(), 20)
    failed = [one for one in found.trials if one.failed]
    assert 0 < len(failed) < 20
    assert all("too long" in one.failed for one in failed)
    assert all(one.values == () for one in failed)
    assert all(one.settings["integration_time"] <= 5e-3 for one in found.best)
    assert any("too long" in note for note in found.document()["notes"])


def test_of_several_goals_the_front_is_kept():
    """Against every pair compared: no trial of the front is beaten, every other one is."""
    draw = random.Random(1)
    goals = (Goal(Metric("a")), Goal(Metric("b"), largest=True))
    asked = replaced(request(), goals=goals)
    trials = tuple(
        Trial(n, {}, (draw.randrange(9), draw.randrange(9)), (draw.uniform(-2, 1),), "" if n % 7 else "no")
        for n in range(60)
    )
    front = Found("x", asked, trials).best
    allowed = [one for one in trials if one.allowed]

    def beats(one, other):
        (a, b), (c, d) = one.values, other.values
        return a <= c and b >= d and (a < c or b > d)

    assert {one.number for one in front} == {
        one.number for one in allowed if not any(beats(other, one) for other in allowed)
    }
    assert [one.values[0] for one in front] == sorted(one.values[0] for one in front)


@pytest.mark.parametrize(
    ("most", "value", "met"), [(True, 2.0, True), (True, 2.5, False), (False, 2.0, True), (False, 1.5, False)]
)
def test_a_limit_says_by_how_much_it_is_exceeded(most, value, met):
    excess = Limit(Metric("x"), most, 2.0).excess(value)
    assert (excess <= 0) is met
    assert met or excess == pytest.approx(0.25)


def test_one_number_of_several_is_named():
    record = {"x": np.array([1.0, 4.0, 7.0]), "y": 3.0}
    assert [Metric("x", pick).of(record) for pick in ("0", "-1", "mean", "min", "max")] == [1, 7, 4, 1, 7]
    assert Metric("y").of(record) == 3
    for pick in ("", "3", "-4"):
        with pytest.raises(RequestError, match=r"x has 3 values; name one of them, x\[0\] to x\[2\]"):
            Metric("x", pick).of(record)


def test_every_fault_of_a_request_is_told_at_once():
    with pytest.raises(RequestError) as refused:
        request(
            minimise=["mean snr"],
            subject=["clipped_fraction = 2", "pixel_pitch <= 1", "bits <= 10", "clipped_fraction <= many"],
            over=["f_numbr=1:2", "pixel_pitch=2:6", "sharpen.strength=1:0", "integration_time=1 kg:2 s", "read_noise"],
        )
    text = str(refused.value)
    for part in (
        "expected the name of a metric",
        "expected METRIC <= NUMBER",
        "cannot be met",
        "bits is not searched",
        "expected a number in the metric's unit",
        "f_numbr: no stage of this pipeline has this parameter; did you mean 'f_number'",
        "expected two ends",
        "unknown unit 'kg'",
        "expected NAME=LOW:HIGH",
    ):
        assert part in text, part


def test_without_optuna_the_way_out_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(RequestError, match=r"pip install 'etendue\[optimise\]'"):
        search(load(BARE), request(), 3)


@needs_optuna
def test_the_command_writes_trials_and_their_picture(tmp_path):
    (tmp_path / "small.toml").write_text(BARE)
    words = ["optimise", tmp_path / "small.toml", "--maximise", "mean_snr", "--subject", "clipped_fraction <= 0.05"]
    words += ["--over", "f_number=1.4:8", "--over", "demosaic.use=demosaic_bilinear,demosaic_nearest", "--trials", "6"]
    done = command(*words, "-o", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert len(document["trials"]) == 6
    assert {one["settings"]["demosaic.use"] for one in document["trials"]} == {"demosaic_bilinear", "demosaic_nearest"}
    assert (tmp_path / "out" / "history.png").read_bytes()[:4] == b"\x89PNG"
    impossible = command(*words, "--subject", "clipped_fraction >= 2", "-o", tmp_path / "none")
    assert impossible.returncode == 3
    assert "no trial meets all limits" in impossible.stdout
    wrong = command(*words[:2], "--minimise", "mean_sn", "--over", "f_number=1:2", "-o", tmp_path / "wrong")
    assert wrong.returncode == 2
    assert "mean_snr" in wrong.stderr
