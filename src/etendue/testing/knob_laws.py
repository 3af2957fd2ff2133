"""The laws of what a plan relies on to trade error for time: means of draws, settings of knobs.

In:  the bench of a stage, the grids and scales on which it was tried.
Out: nothing, or a broken law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from etendue.contract.capabilities import Sampled
from etendue.contract.grid import Coordinate, Grid
from etendue.contract.stage import Stage, parameters_of
from etendue.testing.bench import Bench, LawBroken
from etendue.testing.checks import along_ladder
from etendue.testing.mean_checks import check_mean
from etendue.testing.measured import hold


class KnobLaws:
    """Mixed into ``StageConformance``."""

    bench: Bench
    stage: Stage
    grids: ClassVar[Mapping[str, Grid]]
    scales: ClassVar[Mapping[str, float]]
    coordinates: ClassVar[Mapping[str, Coordinate]]

    def test_its_mean_is_that_of_its_draws(self) -> None:
        """A stage that draws or rounds and says its mean: on average it gives that, within what so many draws know
        of it.
        """
        if issubclass(self.bench.kind, Sampled):
            check_mean(self.bench)

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
                    continue  # a setting that the stage refuses on this grid
                if bound is None:
                    raise LawBroken(f"{stage!r} states no error, but may with another {name}")
                hold(
                    bound <= last,
                    f"{bench.name} states {bound:.3g} with {name} = {value}, but {last:.3g} with the cheaper {before}",
                )
                last, before = bound, value
