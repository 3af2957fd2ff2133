"""The laws on declarations with which a plan trades error for time: means of draws, settings of knobs.

In:  the bench of a stage, with the grids and scales used for testing.
Out: nothing, or a broken law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from etendue.contract.arrays.grid import Coordinate, Grid
from etendue.contract.capabilities import Sampled, is_random, mean_arguments_of, rounds
from etendue.contract.stage import Stage, parameters_of
from etendue.testing.behaviour import statistics
from etendue.testing.bench import Bench, LawBroken
from etendue.testing.checks import along_ladder
from etendue.testing.means import events, mean_of
from etendue.testing.measured import hold
from etendue.testing.seeds import seed_of
from etendue.types.arrays import Array

DRAWS = 24
ERRORS = 6.7  # standard errors of the mean over these draws: p = 1e-6 for the t distribution of 23 degrees of freedom
LEVEL = 0.3  # of full scale; far from clipping


class KnobLaws:
    """Mix-in of ``StageConformance``."""

    bench: Bench
    stage: Stage
    grids: ClassVar[Mapping[str, Grid]]
    scales: ClassVar[Mapping[str, float]]
    coordinates: ClassVar[Mapping[str, Coordinate]]

    def test_its_mean_is_that_of_its_draws(self) -> None:
        """The average result of a stage that draws or rounds equals the mean that the stage states, within the
        uncertainty of the draws.
        """
        if issubclass(self.bench.kind, Sampled):
            check_mean(self.bench)

    def test_its_draws_are_those_that_it_declares(self) -> None:
        """Mean, variance and correlation of two million draws at several levels are as declared, at p = 1e-6."""
        statistics.drawn_as_declared(self.bench)

    def test_a_finer_setting_states_no_larger_error(self) -> None:
        """Along the settings of a knob, from the cheapest to the reference, the stated error never grows."""
        bench = self.bench
        if bench.kind.error is Stage.error:
            return
        for name, (parameter, _, _) in parameters_of(bench.kind).items():
            if parameter.studied:
                continue
            last, before = math.inf, None
            for value, stage in along_ladder(self.stage, name):
                try:
                    bound = Bench(stage, self.grids, self.scales, self.coordinates).own_error(
                        bench.arrays("ordinary"), "float64"
                    )
                except ValueError:
                    continue  # the stage refuses this setting on this grid
                if bound is None:
                    raise LawBroken(f"{stage!r} states no error, although it states an error with another {name}")
                hold(
                    bound <= last,
                    f"{bench.name} states {bound:.3g} with {name} = {value}, but {last:.3g} with the cheaper {before}",
                )
                last, before = bound, value


def check_mean(bench: Bench) -> None:
    """Check that, for a uniform input, ``mean`` agrees with the mean of each variable over draws and places at p =
    1e-6, within another half code if the stage rounds.
    """
    kind = bench.kind
    assert issubclass(kind, Sampled)
    try:
        mean_arguments_of(kind)
    except TypeError as error:
        raise LawBroken(str(error)) from None
    inputs = bench.arrays("uniform", factor=LEVEL)
    expected = mean_of(bench, inputs)
    drawn: dict[str, list[Array]] = {}
    for seed in range(DRAWS):
        for name, array in bench.result(inputs, seed=seed_of(f"draw {seed}")).arrays.items():
            drawn.setdefault(name, []).append(np.asarray(array, np.float64))
    for name, declaration in bench.writes.items():
        if declaration.dtype != "float" and declaration.unit == "1":
            continue  # a map of drawn events has no mean
        every, said = np.array(drawn[name]), float(np.mean(expected[name], dtype=np.float64))
        values = every.reshape(DRAWS, -1).mean(axis=1)
        if is_random(kind) and (not values.std() or events(every)):
            continue  # a kind of drawn events may be too rare to occur in so few pixels
        room = ERRORS * values.std(ddof=1) / np.sqrt(DRAWS) + 1e-6 * abs(said) + (0.5 if rounds(kind) else 0.0)
        hold(
            abs(values.mean() - said) <= room,
            f"{bench.name} gives {name} = {values.mean():.6g} on average over {DRAWS} draws, but mean() is {said:.6g}",
        )
