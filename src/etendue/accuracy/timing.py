"""Seconds of repeated runs, by stage: cold, when every table is computed again, and warm, with the tables of the
previous run.

In:  seconds of every run.
Out: minimum and median, of some stages or of all.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

COLD, WARM = "cold", "warm"
RunSeconds = Mapping[str, float]  # seconds of one run, by stage
Samples = Mapping[str, tuple[float, ...]]  # by stage, the seconds of every run


@dataclass(frozen=True)
class Timing:
    """CPU time (s) by stage. The sum of the minima over stages is the time of a run on an idle machine; the sum of the
    medians is its time on this machine.

    ``by``: the kind of runs to compare, ``cold`` or ``warm``.
    """

    cold: Samples = field(default_factory=dict)
    warm: Samples = field(default_factory=dict)
    runs: int = 0  # number of runs of this trial, each way; samples of the same work in other trials count too
    by: str = WARM

    def least(self, how: str = "", stages: Collection[str] | None = None) -> float:
        return self._sum(min, how, stages)

    def median(self, how: str = "", stages: Collection[str] | None = None) -> float:
        return self._sum(statistics.median, how, stages)

    def by_stage(self) -> dict[str, float]:
        """Return the minimum seconds of every stage."""
        return {name: min(own) for name, own in (self.cold if self.by == COLD else self.warm).items()}

    def and_(self, other: Timing) -> Timing:
        """Return a timing with the samples of both timings."""
        cold, warm = (
            {name: (*own.get(name, ()), *more.get(name, ())) for name in {**own, **more}}
            for own, more in ((self.cold, other.cold), (self.warm, other.warm))
        )
        return replace(self, cold=cold, warm=warm, runs=self.runs + other.runs)

    def _sum(self, of: Callable[[Sequence[float]], float], how: str, stages: Collection[str] | None) -> float:
        samples = self.cold if (how or self.by) == COLD else self.warm
        return math.fsum(of(own) for name, own in samples.items() if own and (stages is None or name in stages))


def samples_of(runs: Sequence[RunSeconds]) -> dict[str, tuple[float, ...]]:
    """Return the seconds of several runs by stage."""
    names = dict.fromkeys(name for run in runs for name in run)
    return {name: tuple(run[name] for run in runs if name in run) for name in names}
