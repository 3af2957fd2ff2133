"""One stage against the laws of the conformance kit, at the ends and in the middle of its declared ranges.

In:  the name of an installed stage.
Out: a row for every law of every case. A clear refusal passes; any other failure does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage
from etendue.telling import said, without_folders
from etendue.testing import StageConformance
from etendue.testing.bench import Bench, LawBroken
from etendue.testing.cases import END, ORDINARY, Case, Untried, cases
from etendue.testing.digits import compare
from etendue.testing.measured import WorstError, measuring
from etendue.testing.small_changes import parameter_changes
from etendue_lab.stability.rows import LawCase

MOST_VALUES = 200_000  # largest output of a case; the planner, which knows the memory, handles larger ones
WITHIN = "computes or refuses"
MOVED = "parameter moved"
LAWS = {  # numerical laws of the kit, and their names in the table
    "test_extremes_stay_finite_or_are_refused_clearly": "extremes stay finite",
    "test_undefined_input_meets_the_declared_policy": "NaN and infinity",
    "test_negative_input_meets_the_declared_policy": "negative input",
    "test_the_stated_error_is_true_of_single_against_double_precision": "stated error",
    "test_digits_are_kept_in_every_precision": "digits",
    "test_errors_grow_by_no_more_than_the_gain": "gain",
    "test_leaving_it_out_is_no_worse_than_negligible_says": "leaving out",
    "test_carried_facts_are_true_of_what_is_written": "declared range",
    "test_a_transfer_function_keeps_the_mean_and_a_real_image_real": "mean kept, bounded",
    "test_a_small_change_of_what_is_read_changes_little": "input moved",
    "test_a_small_change_of_a_parameter_changes_little": MOVED,
    "test_the_unit_of_light_does_not_matter": "unit of light",
    "test_the_order_that_it_keeps_is_kept": "order kept",
    "test_the_sum_that_it_keeps_is_kept": "sum kept",
    "test_the_noise_has_the_variance_that_it_says": "variance",
    "test_what_it_solves_costs_no_more_digits_than_its_condition": "matrix",
}
ALWAYS = (
    "extremes stay finite",
    "NaN and infinity",
    "negative input",
)  # reported even without a number, for every stage that reads
ONCE = ("NaN and infinity", "negative input", "stated error", "gain")  # for the ordinary instance only


def rows_of(name: str) -> Iterator[LawCase]:
    """Yield every case of one stage."""
    kind = installed_stages().load(name)
    try:
        every = list(cases(kind))
    except Untried as error:
        yield LawCase(name, WITHIN, "ordinary", None, why=str(error))
        return
    for case in every:
        yield from rows_of_case(name, kind, case)


def rows_of_case(name: str, kind: type[Stage], case: Case) -> Iterator[LawCase]:
    if case.stage is None:
        yield LawCase(
            name, WITHIN, case.name, not case.broke, why=case.refused if case.broke else f"refused: {case.refused}"
        )
        return
    bench = Bench(case.stage)
    too_large, first = False, None
    try:
        too_large = largest(bench) > MOST_VALUES
    except ValueError as error:
        first = LawCase(name, WITHIN, case.name, True, why=f"refused: {error}")
    except Exception as error:
        first = LawCase(name, WITHIN, case.name, False, why=said(error))
    if too_large:
        return
    if first is None:
        first = computed(name, bench, case)
    yield first
    if first.ok is not True or first.why:
        return
    if case.where == END and isinstance(getattr(case.stage, case.parameter), float):
        yield from held(name, MOVED, case, lambda: parameter_changes(bench, (case.parameter,)))
    one = type("Conformance", (StageConformance,), {"stage": case.stage})()
    for law, word in LAWS.items():
        if case.where == ORDINARY or (word not in ONCE and (case.where != END or word == "mean kept, bounded")):
            yield from held(name, word, case, getattr(one, law), word in ALWAYS and bool(bench.reads))


def largest(bench: Bench) -> int:
    """Return the number of values of the largest variable that a case writes."""
    job = bench.job()
    return max((math.prod(job.grids[v].shape(d.dims)) for v, d in bench.writes.items()), default=0)


def computed(name: str, bench: Bench, case: Case) -> LawCase:
    """Run ordinary input in both precisions: finite, equal within the declared error, or refused with a clear
    message.
    """
    with measuring() as found:
        try:
            inputs = bench.given(bench.arrays("ordinary"), "float32")
            single, double = bench.run(inputs, "float32"), bench.run(inputs, "float64")
            for trial in (double, single):
                if not trial.done:
                    words = trial.refused_in_words and " wrote " not in trial.last_line
                    return LawCase(
                        name, WITHIN, case.name, words, why=f"{'refused: ' if words else ''}{trial.last_line}"
                    )
            bound = sum(bench.own_error(inputs, precision) or 0.0 for precision in ("float32", "float64"))
            if bound and bench.steady:
                compare(bench, single, double, "ordinary input", "float32", bound, (9, 12))
        except LawBroken as error:
            return row(name, WITHIN, case, False, found, str(error))
        except Exception as error:  # from a plugin's grid, describe or error
            return LawCase(name, WITHIN, case.name, isinstance(error, ValueError), why=f"refused: {said(error)}")
    return row(name, WITHIN, case, True, found, "")


def held(name: str, law: str, case: Case, check: Callable[[], object], always: bool = False) -> Iterator[LawCase]:
    """Yield one law of one instance; nothing if it measured nothing."""
    with measuring() as found:
        try:
            check()
        except LawBroken as error:
            yield row(name, law, case, False, found, str(error))
            return
        except Exception as error:  # a stage may fail anywhere, also in grid or describe
            yield row(name, law, case, False, found, said(error))
            return
    if always or found.error is not None or found.condition is not None:
        yield row(name, law, case, True, found, "")


def row(name: str, law: str, case: Case, ok: bool, found: WorstError, why: str) -> LawCase:
    text = without_folders(why.removeprefix(f"{case.stage!r}").removeprefix(": ").strip())
    return LawCase(name, law, case.name, ok, found.error, found.bound, found.condition, text)
