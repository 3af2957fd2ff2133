"""One search finds settings: against brute force, each combination once, and no further than its budget allows."""

import itertools
import math
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.accuracy.orders import convergence
from etendue.plan.expansion.search import (
    Goal,
    Knob,
    Means,
    OverBudget,
    Search,
    Setting,
    Trial,
    cheapest,
    error_and_cost,
)

KNOBS = (
    Knob("blur", "nodes", (8, 16, 32)),
    Knob("sum", "terms", (1, 2, 0)),
    Knob("", "precision", ("float32", "float64")),
)
FINEST = {knob.key: knob.settings[-1] for knob in KNOBS}
GRID = [dict(zip(FINEST, own, strict=True)) for own in itertools.product(*(knob.settings for knob in KNOBS))]
FIGURES = st.lists(st.tuples(st.floats(1e-9, 1), st.floats(1e-3, 10)), min_size=len(GRID), max_size=len(GRID))
LADDER = Knob("", "tolerance", (0.3, 0.1, 0.03, 0.01, 0.0))


@dataclass(frozen=True)
class Timed(Trial):
    seconds: float

    @property
    def cost(self):
        return self.seconds


def search_over(figures):
    """A search over the grid, and how often each combination was evaluated."""
    asked = []

    def evaluate(settings):
        asked.append(dict(settings))
        return Timed(settings, *figures[GRID.index({**FINEST, **settings})])

    return Search(evaluate, FINEST), asked


def alone(search):
    """By knob its settings, all others at their finest."""
    return {
        knob.key: [Setting(knob, v, *error_and_cost(search.at({knob.key: v}))) for v in knob.settings] for knob in KNOBS
    }


@given(FIGURES, st.floats(1e-9, 1))
def test_the_cheapest_setting_of_a_small_grid_is_that_of_brute_force(figures, tolerance):
    """Whatever errors and costs are: they need not add up."""
    search, asked = search_over(figures)
    search.explored(alone(search), [Goal(tolerance)], len(GRID))
    found = cheapest(search.tried.values(), error_and_cost, tolerance)
    assert (found and found.cost) == min((cost for error, cost in figures if error <= tolerance), default=None)
    assert len(asked) == len(search.tried) == len(GRID)


@given(FIGURES, st.floats(1e-9, 1), st.integers(0, 12))
def test_of_a_larger_grid_no_more_is_tried_than_allowed_and_no_neighbour_tried_is_cheaper(figures, tolerance, most):
    search, asked = search_over(figures)
    choices = alone(search)
    before = len(asked)
    search.explored(choices, [Goal(tolerance)], most)
    assert len(asked) - before <= most
    found = cheapest(search.tried.values(), error_and_cost, tolerance)
    if found and len(asked) - before < most:
        for knob in KNOBS:
            for value in knob.coarser(found.settings.get(knob.key, FINEST[knob.key]))[:1]:
                near = search.at({**found.settings, knob.key: value})
                assert near.error > tolerance or near.cost >= found.cost


@given(st.lists(st.floats(0, 1), min_size=5, max_size=5), st.floats(0, 1))
def test_bisection_finds_the_first_setting_within_the_goal_where_errors_fall(errors, most):
    falling = dict(zip(LADDER.settings, sorted(errors, reverse=True), strict=True))
    search = Search(lambda settings: Trial(settings, falling[settings["tolerance"]] if settings else 2.0))
    found, chosen = search.loosened([LADDER], Goal(most))
    first = next((value for value in LADDER.settings if falling[value] <= most), None)
    assert found.settings == ({} if first is None else {"tolerance": first})
    assert [one.value for one in chosen] == ([] if first is None else [first])


@given(st.lists(st.floats(0, 1), min_size=5, max_size=5), st.floats(0, 1), st.sampled_from(LADDER.settings))
def test_steps_go_coarser_while_the_goal_is_met_else_finer_until_it_is(errors, most, start):
    by_value = dict(zip(LADDER.settings, errors, strict=True))
    search = Search(lambda settings: Trial(settings, by_value[settings["tolerance"]]))
    found = search.stepped(LADDER, start, Goal(most))
    if by_value[start] <= most:
        expected = [start, *itertools.takewhile(lambda value: by_value[value] <= most, LADDER.coarser(start))][-1]
    else:
        expected = next((value for value in LADDER.finer(start) if by_value[value] <= most), None)
    assert (found and found.settings["tolerance"]) == expected


def test_a_search_ends_before_what_it_may_not_spend_and_says_what_that_is():
    def evaluate(settings):
        value = settings["tolerance"]
        search.afford(Means(1 / (value + 0.01), 0.0), 10.0 * len(search.tried))
        return Trial(settings, value)

    search = Search(evaluate, budget=Means(40.0, 10.0))
    assert search.stepped(LADDER, 0.3, Goal(0.0)) is None
    assert [trial.error for trial in search.tried.values()] == [0.3, 0.1]
    assert search.lacking == Means(pytest.approx(25), 0.0)
    with pytest.raises(OverBudget):
        search.afford(Means(0.0, 11.0), 0.0)


@pytest.mark.parametrize(
    "errors", [(0.018, 0.0051, 0.0013, 3.6e-5, 1.5e-7, 1.1e-8), (0.09, 0.03, 0.01, 0.0033, 0.0011)]
)
def test_fractions_show_no_factor_for_each_of_them(errors):
    """What falls by 4 from one fraction to the next would fall by 5e4 for each unit, which no setting is apart."""
    assert convergence([0.125, 0.1875, 0.25, 0.375, 0.5, 0.75][: len(errors)], errors).law != "geometric"


def test_an_order_that_neighbours_do_not_share_is_none():
    assert convergence([48, 64, 96, 160, 240], [6.3e-6, 1.4e-6, 1.2e-6, 4.6e-8, 2.4e-8]).order is None
    assert convergence([32, 64, 128, 256], [n**-4.0 for n in (32, 64, 128, 256)]).order == pytest.approx(4)
    assert convergence([1, 2, math.inf], [0.01, 0.001, 0.0]).order is None
