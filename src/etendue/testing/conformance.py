"""The laws that every stage must satisfy: one test method each.

In:  an instance of a stage.
Out: nothing, or a broken law that names the stage, the values and a remedy.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.compute.bands import run_bands
from etendue.contract.arrays import dims
from etendue.contract.arrays.grid import Coordinate, Grid
from etendue.contract.capabilities import Banded, Bounded, is_source, is_transfer
from etendue.contract.stage import Stage
from etendue.testing.bench import (
    EXTREMES,
    FRAME,
    LARGE,
    ODD_FRAMES,
    PRECISIONS,
    ROUNDING,
    SMALL,
    Bench,
    Finding,
    LawBroken,
    digests,
    largest_difference,
)
from etendue.testing.checks import (
    bound_of,
    check_facts,
    check_gain,
    in_a_fresh_thread,
    levels_of,
    must_survive,
    perturbations_of,
    stated_error_of,
    with_value,
    worst_signs_of,
)
from etendue.testing.laws.extreme_laws import ExtremeLaws
from etendue.testing.laws.knob_laws import KnobLaws
from etendue.testing.laws.place_laws import PlaceLaws
from etendue.testing.laws.range_laws import RangeLaws
from etendue.testing.laws.row_laws import RowLaws
from etendue.testing.laws.state_laws import StateLaws
from etendue.testing.laws.window_laws import WindowLaws
from etendue.testing.laws.word_laws import WordLaws
from etendue.testing.measured import hold, ratio_of, within
from etendue.testing.transfer_checks import check_mixture, check_single_bands, check_transfer


class StageConformance(WordLaws, ExtremeLaws, KnobLaws, RowLaws, WindowLaws, PlaceLaws, StateLaws, RangeLaws):
    """Subclass it and set ``stage``; pytest then tests the stage against each law.

    Attributes
    ----------
    stage : the instance to test (set it in a fixture if it needs files)
    grids : grids by port, for dims that the kit cannot guess
    scales : full scale by port, in its unit
    coordinates : coordinates by dim, if a stage needs a particular size: {"polariser": Labels((0.0, 45.0, 90.0,
    135.0))}
    """

    stage: Stage
    grids: ClassVar[Mapping[str, Grid]] = {}
    scales: ClassVar[Mapping[str, float]] = {}
    coordinates: ClassVar[Mapping[str, Coordinate]] = {}

    @property
    def bench(self) -> Bench:  # type: ignore[override]
        return Bench(self.stage, self.grids, self.scales, self.coordinates)

    # -- what it does

    def test_it_writes_what_it_declares(self) -> None:
        """Outputs have the declared names, shapes and dtypes, and finite values unless declared otherwise, by the
        engine's own check, in both precisions.
        """
        bench = self.bench
        for precision in PRECISIONS:
            for summed in (False, True) if bench.looks else (False,):
                trial = bench.result(bench.arrays("ordinary"), precision, summed=summed)
                for variable, declaration in bench.writes.items():
                    wanted, found = (
                        precision if declaration.dtype == "float" else declaration.dtype,
                        trial.arrays[variable].dtype,
                    )
                    hold(found == wanted, f"{bench.name} wrote {variable} as {found}, not {wanted}")

    def test_inputs_are_left_alone(self) -> None:
        bench = self.bench
        for precision in PRECISIONS:
            trial = bench.run(bench.arrays("ordinary"), precision)
            forced = "read-only" in trial.last_line or "WRITEABLE" in trial.last_line
            hold(not forced, f"{bench.name} writes into its input: {trial.last_line}")
            hold(not trial.touched, f"{bench.name} changes its input {', '.join(trial.touched)}")

    def test_bits_do_not_depend_on_repetition_company_or_thread(self) -> None:
        """Computing the same cell again, after others, or as an equal instance in a fresh thread gives the same
        bits.
        """
        bench = self.bench
        for precision in PRECISIONS:
            inputs = bench.arrays("ordinary")
            first = digests(bench.result(inputs, precision).arrays)
            again = digests(bench.result(inputs, precision).arrays)
            hold(again == first, f"{bench.name} gives different bits when run again in {precision}")
            for other in ("decades", "uniform", "zeros"):
                bench.run(bench.arrays(other), precision)
            if not is_source(bench.kind):
                for frame in (SMALL, (FRAME[0] + 1, FRAME[1])):
                    try:
                        bench.run(bench.arrays("ordinary", frame), precision, frame)
                    except ValueError:
                        continue  # it refuses the grid: tested by another law
            again = digests(bench.result(inputs, precision).arrays)
            hold(again == first, f"{bench.name} gives different bits after other cells in {precision}")
            twin = Bench(dataclasses.replace(bench.stage), bench.given_grids, bench.scales, bench.coordinates)
            again = digests(in_a_fresh_thread(twin, inputs, precision).arrays)
            hold(again == first, f"{bench.name} gives different bits in a fresh thread in {precision}")

    def test_extremes_stay_finite_or_are_refused_clearly(self) -> None:
        """Results stay finite or are refused clearly for zeros, 1e-30, a million times full scale, a point or a hole,
        and for frames of one pixel, one row, one column or odd sizes.
        """
        bench = self.bench
        for precision in PRECISIONS:
            for what in EXTREMES if bench.reads else ():
                must_survive(bench, bench.arrays(what), precision, FRAME, what)
                for port in bench.reads if len(bench.reads) > 1 else ():
                    must_survive(
                        bench,
                        {**bench.arrays("ordinary"), port: bench.array(port, what)},
                        precision,
                        FRAME,
                        f"{what} in {port}",
                    )
            for frame in ODD_FRAMES if bench.reads and not bench.given_grids else ():
                for what in ("ordinary", "zeros"):
                    must_survive(
                        bench, bench.arrays(what, frame), precision, frame, f"{what} on {frame[0]} x {frame[1]}"
                    )

    # -- policies

    def test_undefined_input_meets_the_declared_policy(self) -> None:
        bench = self.bench
        for port, declaration in bench.reads.items():
            for bad in (math.nan, math.inf) if declaration.dtype == "float" else ():
                trial = bench.run({**bench.arrays("ordinary"), port: with_value(bench.array(port, "ordinary"), bad)})
                if bench.stage.nan == "keep":
                    hold(
                        trial.done,
                        f"{bench.name} declares nan = 'keep', but fails on {bad} in {port}: {trial.last_line}",
                    )
                else:
                    hold(not trial.done, f"{bench.name} accepts {bad} in {port}; declare nan = 'keep' if intended")

    def test_negative_input_meets_the_declared_policy(self) -> None:
        bench = self.bench
        policy = bench.stage.negative
        for port, declaration in bench.reads.items():
            if declaration.dtype != "float":
                continue
            ordinary = bench.arrays("ordinary")
            below = with_value(ordinary[port], -0.01 * bench.scale(port))
            trial = bench.run({**ordinary, port: below})
            if policy == "keep":
                hold(
                    not trial.undefined,
                    f"{bench.name} declares negative = 'keep', but returns NaN for negative {port}: {trial.last_line}",
                )
                clear = trial.done or trial.refused_in_words
                hold(clear, f"{bench.name} declares negative = 'keep', but fails on it in {port}: {trial.last_line}")
            elif policy == "clip":
                same = bench.result({**ordinary, port: np.maximum(below, 0)})
                kept = trial.done and digests(trial.arrays) == digests(same.arrays) and trial.report.clipped > 0
                hold(
                    kept,
                    f"{bench.name} declares negative = 'clip', but does not treat negative {port} as 0 and count it",
                )
            else:
                hint = (
                    "; a transfer function applies to any sign: declare negative = 'keep'"
                    if is_transfer(bench.kind)
                    else ""
                )
                hold(
                    not trial.done,
                    f"{bench.name} accepts negative {port}{hint or '; declare negative = keep if that is intended'}",
                )

    # -- claims

    def test_the_stated_error_is_true_of_single_against_double_precision(self) -> None:
        """The stated bound holds: results in single and double precision differ by at most the sum of their bounds.

        Errors are relative to full scale: the largest value of the result in double precision, or a converter's top
        code.
        """
        bench = self.bench
        if bench.kind.error is Stage.error:
            return
        bounds: dict[str, float] = {}
        for precision in PRECISIONS:
            bound, how = stated_error_of(bench, precision)
            hold(
                how in ("proved", "fitted", "measured", "unknown"),
                f"{bench.name}.error states the basis {how!r}; allowed: proved, fitted, measured",
            )
            hold(
                bound is None or 0 <= bound < math.inf,
                f"{bench.name}.error returned {bound}; allowed: None and finite numbers of at least 0",
            )
            if bound is not None:
                bounds[precision] = bound
        if len(bounds) < 2 or not bench.steady:
            return
        hold(
            bounds["float64"] <= bounds["float32"],
            f"{bench.name}.error is larger in double precision than in single: {bounds}",
        )
        large = [("ordinary", 1.0, LARGE)] if bench.reads and not bench.given_grids else []
        for what, factor, frame in (*((*level, FRAME) for level in levels_of(bench)), *large):
            inputs = bench.given(bench.arrays(what, frame, factor), "float32")
            allowed = sum(bound_of(bench, inputs, precision, frame=frame) for precision in PRECISIONS)
            single, double = bench.run(inputs, "float32", frame), bench.run(inputs, "float64", frame)
            if not (single.done and double.done):
                continue  # refused: tested by another law
            for variable, exact in double.arrays.items():
                apart, scale = (
                    largest_difference(single.arrays[variable], exact),
                    bench.full_scale(variable, exact, frame),
                )
                within(
                    ratio_of(apart, scale),
                    allowed,
                    f"{bench.name}: single and double precision of {variable} differ by {ratio_of(apart, scale):.2g} "
                    f"of full scale on "
                    f"{what} input x {factor:g} of {frame[0]} x {frame[1]}, but error() allows {allowed:.2g}; "
                    "state the true error, or find where digits are lost",
                )

    def test_leaving_it_out_is_no_worse_than_negligible_says(self) -> None:
        bench = self.bench
        if not issubclass(bench.kind, Bounded):
            return
        main = next(iter(bench.writes))
        port = next((p for p, d in bench.reads.items() if d.variable == main), None)
        hold(port is not None, f"{bench.name} defines negligible, but does not read {main}, which it writes")
        assert port is not None
        for what, factor in (*levels_of(bench), ("point", 1.0), ("hole", 1.0)):
            inputs = bench.arrays(what, factor=factor)
            answer = bench.stage.negligible(bench.facts(inputs)[port], bench.input_grids()[port])  # type: ignore[attr-defined]
            if answer is None:
                continue
            bound, why = answer
            hold(bound >= 0 and bool(why), f"{bench.name}.negligible returned {answer}; expected (bound, reason)")
            if bound > 0 and not bench.steady:
                continue
            trial = bench.result(inputs)
            for variable in (v for v, d in bench.writes.items() if not d.optional):
                own = next(p for p, d in bench.reads.items() if d.variable == variable)
                scale = full_scale(inputs[own])
                apart = largest_difference(trial.arrays[variable], inputs[own])
                slack = bound_of(bench, inputs, "float64", ROUNDING)
                within(
                    ratio_of(apart, scale),
                    bound + slack,
                    f"{bench.name}: leaving it out changes {variable} by {ratio_of(apart, scale):.2g} of full scale on "
                    f"{what} input, "
                    f"but negligible() states {bound:.2g} ({why})",
                )

    def test_errors_grow_by_no_more_than_the_gain(self) -> None:
        """The difference between two outputs is at most ``gain`` times the difference between the inputs. The two
        inputs differ by random errors, by a shift, or by errors with the worst-case signs, at several levels and sizes
        of the errors.

        Errors are relative to full scale: for the input its largest value; for the output its largest value for this
        input, or for a uniform field as bright as the brightest point of the input. The error that the stage itself
        states is added to the bound.
        """
        bench = self.bench
        port = bench.one_array
        if bench.stage.gain is None or port is None or not bench.steady:
            return
        main = next(iter(bench.writes))
        frames = (FRAME, SMALL)
        for frame in frames:
            worst = worst_signs_of(bench, port, main) if frame == SMALL else None
            for level in (1e-2, 1.0, 1e2):
                for what in ("ordinary", "decades"):
                    inputs = bench.arrays(what, frame, level)
                    for size in (0.1, 1e-4):
                        for signs in perturbations_of(inputs[port].shape, worst):
                            check_gain(bench, port, main, inputs, size * signs, frame)

    def test_a_transfer_function_keeps_the_mean_and_a_real_image_real(self) -> None:
        """A transfer function is 1 at zero frequency, Hermitian, and never above 1 unless a larger ``gain`` is
        declared.
        """
        bench = self.bench
        if not is_transfer(bench.kind):
            return
        check_transfer(bench)

    def test_bands_alone_are_the_bands_of_the_whole(self) -> None:
        """A stage with ``by_band`` gives the same bits for some of its bands, and with ``in_rows`` for some rows of
        them; a transfer function has the same values at some bands.
        """
        bench = self.bench
        if is_transfer(bench.kind):
            check_single_bands(bench)
        if not issubclass(bench.kind, Banded):
            return
        job = bench.job()
        given_arrays = bench.given(bench.arrays("ordinary"), "float64")
        whole_run = bench.result(bench.arrays("ordinary")).arrays
        if is_source(bench.kind):
            check_mixture(bench, whole_run[next(iter(bench.writes))])
        every = slice(None)
        for bands, rows in ((slice(0, 1), every), (slice(2, 4), every), (slice(1, 2), slice(2, 5))):
            if rows != every and not bench.stage.in_rows():  # type: ignore[attr-defined]
                continue
            part = run_bands(job, given_arrays, bands, rows=rows)
            for variable, declaration in bench.writes.items():
                if dims.banded(declaration.dims[:1]):
                    whole = whole_run[variable][bands]
                    whole = whole[..., rows, :] if declaration.dims[-2:] == ("y", "x") else whole
                    same = np.array_equal(np.asarray(part[variable], dtype="float64"), whole)
                    how = "by band" if rows == every else "for some rows of a band"
                    hold(same, f"{bench.name} gives different values of {variable} {how} than for all bands together")

    def test_carried_facts_are_true_of_what_is_written(self) -> None:
        """The stated range, uniformity and contrast hold for the first output; for a source, the facts that
        ``describe`` states.
        """
        bench = self.bench
        main = next(iter(bench.writes))
        if is_source(bench.kind):
            facts, grids = bench.stage.describe()  # type: ignore[attr-defined]
            hold(set(grids) <= set(bench.writes), f"{bench.name}.describe returns variables that it does not write")
            trial = bench.result({})
            check_facts(bench, facts, trial.arrays[main], 1e-9, "what it draws")
            return
        if bench.kind.carry is Stage.carry or not bench.steady:
            return
        for what, factor in (*levels_of(bench), ("point", 1.0), ("hole", 1.0)):
            inputs = bench.arrays(what, factor=factor)
            trial = bench.run(inputs)
            if trial.done:
                facts = bench.stage.carry(bench.facts(inputs), bench.input_grids())
                check_facts(
                    bench, facts, trial.arrays[main], bound_of(bench, inputs, "float64", ROUNDING), f"{what} input"
                )


def laws() -> list[str]:
    """Return the names of the laws, in order."""
    return [name for kind in StageConformance.__mro__ for name in vars(kind) if name.startswith("test_")]


def check_stage(
    stage: Stage,
    grids: Mapping[str, Grid] | None = None,
    scales: Mapping[str, float] | None = None,
    coordinates: Mapping[str, Coordinate] | None = None,
) -> list[Finding]:
    """Test one stage against every law and return the findings, none if it conforms. A class that is not a valid stage
    gives one finding.
    """
    words = {"stage": stage, "grids": grids or {}, "scales": scales or {}, "coordinates": coordinates or {}}
    one = type("Conformance", (StageConformance,), words)()
    try:
        _ = one.bench
    except LawBroken as error:
        return [Finding("test_the_declaration_is_well_formed", str(error))]
    findings = []
    for law in laws():
        try:
            getattr(one, law)()
        except Exception as error:  # a stage may break anywhere, in grid or describe too
            text = str(error) if isinstance(error, LawBroken) else f"{type(error).__name__}: {error}"
            findings.append(Finding(law, text))
    return findings
