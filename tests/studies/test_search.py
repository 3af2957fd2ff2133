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


def added(search):
    """Errors and costs that add up over the knobs, as the search is told them."""
    base = search.at({})

    def predicted(settings):
        own = [search.at({key: value}) for key, value in settings.items()]
        error = sum(one.error - base.error for one in own)
        return base.error + error, base.cost + sum(one.cost - base.cost for one in own)

    return predicted


def alone(search):
    """By knob its settings, all others at their finest."""
    return {
        knob.key: [Setting(knob, v, *error_and_cost(search.at({knob.key: v}))) for v in knob.settings] for knob in KNOBS
    }


@given(FIGURES, st.floats(1e-9, 1))
def test_the_cheapest_setting_of_a_small_grid_is_that_of_brute_force(figures, tolerance):
    """Whatever errors and costs are: they need not add up."""
    search, asked = search_over(figures)
    search.explored(alone(search), [Goal(tolerance)], len(GRID), added(search))
    found = cheapest(search.tried.values(), error_and_cost, tolerance)
    assert (found and found.cost) == min((cost for error, cost in figures if error <= tolerance), default=None)
    assert len(asked) == len(search.tried) == len(GRID)


@given(FIGURES, st.floats(1e-9, 1), st.integers(0, 12))
def test_of_a_larger_grid_no_more_is_tried_than_allowed_and_no_neighbour_is_cheaper(figures, tolerance, most):
    """With a prediction that is right: none in one setting, or in two."""
    search, asked = search_over(figures)
    choices = alone(search)
    before = len(asked)

    def predicted(settings):
        return figures[GRID.index({**FINEST, **settings})]

    search.explored(choices, [Goal(tolerance)], most, predicted)
    assert len(asked) - before <= most
    found = cheapest(search.tried.values(), error_and_cost, tolerance)
    if found and len(asked) - before < most:
        for knob in KNOBS:
            for value in knob.settings:
                error, cost = predicted({**found.settings, knob.key: value})
                assert error > tolerance or cost >= found.cost


@given(
    st.lists(st.lists(st.tuples(st.floats(1e-6, 1), st.floats(1, 10)), min_size=4, max_size=4), min_size=3, max_size=3)
)
def test_a_few_trials_find_the_cheapest_where_costs_multiply_and_errors_add(factors):
    """As those of finer grids do: 64 combinations, of which at most 24 are tried besides each knob alone. The search
    takes no notice of settings that save less than 1 % of the whole: of three knobs 3 %.
    """
    knobs = [Knob("", name, (0, 1, 2, 3)) for name in "abc"]
    own = {
        knob.key: [
            (error if i < 3 else 0.0, cost if i < 3 else 10.0) for i, (error, cost) in enumerate(sorted(some)[::-1])
        ]
        for knob, some in zip(knobs, factors, strict=True)
    }

    def figures(settings):
        chosen = [own[key][settings.get(key, 3)] for key in own]
        return sum(error for error, _ in chosen), math.prod(cost for _, cost in chosen)

    search = Search(lambda settings: Timed(settings, *figures(settings)), {knob.key: 3 for knob in knobs})
    choices = {
        knob.key: [Setting(knob, v, *error_and_cost(search.at({knob.key: v}))) for v in knob.settings] for knob in knobs
    }
    goals = [Goal(10.0**-n) for n in range(6)]
    search.explored(choices, goals, 24, figures)
    every = [figures(dict(zip(own, one, strict=True))) for one in itertools.product(range(4), repeat=3)]
    for goal in goals:
        found = cheapest(search.tried.values(), error_and_cost, goal.most)
        least = min(cost for error, cost in every if error <= goal.most)
        assert found.cost <= least + 0.03 * 1000


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


@pytest.mark.parametrize(
    ("settings", "errors", "why"),
    [
        ([48, 64, 96, 160], [6e-6, 1e-6, 9e-7, 4e-8], "not in the asymptotic regime"),
        ([8, 16, 32, 64], [3e-3, 3e-3, 3e-3, 3e-3], "not in the asymptotic regime"),
        ([8, 16, 32], [0.5, 0.3, 0.2], "not in the asymptotic regime"),
        ([8, 16], [1e-2, 1e-3], "fewer than three settings"),
        ([8, 16, 32], [1e-16, 1e-16, 0.0], "errors at rounding"),
        (["float32", "float64"], [1e-7, 0.0], ""),
        ([8, 16, 32], [8**-2, 16**-2, 32**-2], ""),
    ],
)
def test_where_no_order_is_known_it_is_said_why(settings, errors, why):
    found = convergence(settings, errors)
    assert found.why == why
    assert (found.order is None) == (why != "" or isinstance(settings[0], str))


def test_an_order_that_neighbours_do_not_share_is_none():
    assert convergence([48, 64, 96, 160, 240], [6.3e-6, 1.4e-6, 1.2e-6, 4.6e-8, 2.4e-8]).order is None
    assert convergence([32, 64, 128, 256], [n**-4.0 for n in (32, 64, 128, 256)]).order == pytest.approx(4)
    assert convergence([1, 2, math.inf], [0.01, 0.001, 0.0]).order is None
