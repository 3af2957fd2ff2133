"""One stage against the laws of the conformance kit, at the ends and in the middle of its declared ranges.

In:  the name of an installed stage.
Out: a row for every law of every case. A clear refusal passes; any other failure does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import nullcontext

from etendue.contract.registry import installed_stages
from etendue.contract.stage import Stage
from etendue.telling import said, without_folders
from etendue.testing import StageConformance
from etendue.testing.bench import FRAME, Bench, LawBroken
from etendue.testing.cases import END, FAR, MIXED, ORDINARY, Case, Untried, cases
from etendue.testing.digits import allowed, compare
from etendue.testing.kept import anew, keeping
from etendue.testing.measured import WorstError, measuring
from etendue.testing.small_changes import parameter_changes
from etendue_lab.stability import references
from etendue_lab.stability.rows import LawCase

MOST_VALUES = 200_000  # largest output of a case; larger ones depend on memory and are left to the planner
WITHIN = "computes or refuses"
MOVED = "parameter moved"
DRAWS = "mean, variance, correlation"
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
    "test_uniform_light_stays_uniform_to_the_rim": "uniform to the rim",
    "test_mirrored_input_gives_the_mirrored_result": "mirror image",
    "test_a_shifted_picture_gives_the_shifted_result": "shifted picture",
    "test_a_window_of_the_whole_is_read_where_it_stands": "window",
    "test_the_far_corner_of_a_large_frame_is_like_the_near_one": "large frame",
    "test_rows_alone_are_the_rows_of_the_whole": "strips",
    "test_bands_alone_are_the_bands_of_the_whole": "bands alone",
    "test_inputs_are_left_alone": "inputs left alone",
    "test_bits_do_not_depend_on_repetition_company_or_thread": "repetition",
    "test_nothing_of_one_picture_reaches_the_next": "one after another",
    "test_two_threads_do_not_notice_each_other": "threads",
    "test_nothing_jumps_over_thirteen_decades_of_light": "jumps in light",
    "test_nothing_jumps_over_the_range_of_a_parameter": "jumps in a parameter",
    "test_codes_stand_in_the_middle_of_their_steps": "steps and codes",
    "test_a_neutral_value_changes_nothing": "neutral value",
    "test_its_mean_is_that_of_its_draws": "mean",
    "test_its_draws_are_those_that_it_declares": DRAWS,
}
# Reported for every stage that has inputs, even without a measured number.
ALWAYS = (
    "extremes stay finite",
    "NaN and infinity",
    "negative input",
    "inputs left alone",
    "repetition",
    "one after another",
    "threads",
)
STATE = ("inputs left alone", "repetition", "one after another", "threads")  # laws that run trials of their own
ONCE = (  # for the ordinary instance only
    "NaN and infinity",
    "negative input",
    "stated error",
    "gain",
    "inputs left alone",
    "repetition",
    "one after another",
    "threads",
    "jumps in light",
    "jumps in a parameter",
    "neutral value",
    "bands alone",
    DRAWS,
)

PLACED = ("uniform to the rim", "mirror image", "shifted picture", "window", "strips")
CHOSEN = (DRAWS, *PLACED, "steps and codes")


def rows_of(name: str) -> Iterator[LawCase]:
    """Yield every case of one installed stage."""
    yield from rows_of_kind(name, installed_stages().load(name))


def rows_of_kind(name: str, kind: type[Stage]) -> Iterator[LawCase]:
    """Yield every case of a class of stages."""
    try:
        every = list(cases(kind))
    except Untried as error:
        yield LawCase(name, WITHIN, "ordinary", None, why=str(error))
        return
    for case in every:
        with keeping():  # the laws of a case share the trials that several of them ask for
            yield from laws_of_case(name, case)


def laws_of_case(name: str, case: Case) -> Iterator[LawCase]:
    """Yield every row of one case."""
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
    yield from references.row_of(name, case)
    if first.ok is not True or first.why:
        return
    if case.where == END and isinstance(getattr(case.stage, case.parameter), float):
        yield from held(name, MOVED, case, lambda: parameter_changes(bench, (case.parameter,)))
    one = type("Conformance", (StageConformance,), {"stage": case.stage, "bench": bench})()
    for law, word in LAWS.items():
        if case.where == ORDINARY or wanted(word, case):
            with anew() if word in STATE else nullcontext():
                yield from held(name, word, case, getattr(one, law), word in ALWAYS and bool(bench.reads))


def wanted(word: str, case: Case) -> bool:
    """Return whether a law is tested on a case other than the ordinary one. Laws of noise and of positions are tested
    for every choice of a text parameter. Laws of positions and means are tested on mixed instances. Most laws are
    tested at the corners and inside of ranges.
    """
    if case.where == FAR:
        return word == "mean kept, bounded"
    if case.where == MIXED:
        return word in (*PLACED, "mean kept, bounded")
    if case.where != END:
        return word not in ONCE
    chosen = isinstance(getattr(case.stage, case.parameter), str) and word in CHOSEN
    return word == "mean kept, bounded" or chosen


def largest_allowed(stage: Stage) -> bool:
    """Return whether the stage accepts its input and the largest variable fits into memory."""
    try:
        return largest(Bench(stage)) <= MOST_VALUES
    except Exception:
        return False


def largest(bench: Bench) -> int:
    """Return the number of values of the largest variable that a case writes."""
    job = bench.job()
    return max((math.prod(job.grids[v].shape(d.dims)) for v, d in bench.writes.items()), default=0)


def computed(name: str, bench: Bench, case: Case) -> LawCase:
    """Check that ordinary input gives finite results in both precisions, equal within the declared error, or is refused
    with a clear message.
    """
    with measuring() as found:
        try:
            inputs = bench.given(bench.arrays("ordinary"), "float32")
            single, double = bench.run(inputs, "float32"), bench.run(inputs, "float64")
            for trial in (double, single):
                if not trial.done:
                    # An error that the engine raises about a result does not count as a refusal.
                    own = type(bench.stage).__name__
                    false = any(f"{own} {verb} " in trial.last_line for verb in ("wrote", "gave", "returned"))
                    words = trial.refused_in_words and not false
                    return LawCase(
                        name, WITHIN, case.name, words, why=f"{'refused: ' if words else ''}{trial.last_line}"
                    )
            bound = sum(allowed(bench, inputs, precision, FRAME) for precision in ("float32", "float64"))
            if bound and bench.steady:
                compare(bench, single, double, "ordinary input", "float32", bound, (9, 12))
        except LawBroken as error:
            return row(name, WITHIN, case, False, found, str(error))
        except Exception as error:  # from a plugin's grid, describe or error
            return LawCase(name, WITHIN, case.name, isinstance(error, ValueError), why=f"refused: {said(error)}")
    return row(name, WITHIN, case, True, found, "")


def held(name: str, law: str, case: Case, check: Callable[[], object], always: bool = False) -> Iterator[LawCase]:
    """Yield the result of one law for one instance; nothing if the law measured nothing."""
    with measuring() as found:
        try:
            check()
        except LawBroken as error:
            yield row(name, law, case, False, found, str(error))
            return
        except Exception as error:  # a stage may fail anywhere, also in grid or describe
            yield row(name, law, case, False, found, said(error))
            return
    if always or found.error is not None or found.condition is not None or found.untried:
        yield row(name, law, case, True, found, found.untried)


def row(name: str, law: str, case: Case, ok: bool, found: WorstError, why: str) -> LawCase:
    text = without_folders(why.removeprefix(f"{case.stage!r}").removeprefix(": ").strip())
    return LawCase(name, law, case.name, ok, found.error, found.bound, found.condition, text)
