"""Split an error among knobs, and predict error and seconds of a combination of settings.

In:  curves of single knobs.
Out: parts of the error of a trial; predictions for the search.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from etendue.accuracy.sampling import MOST
from etendue.plan.expansion.search import Setting, Settings, Value

if TYPE_CHECKING:
    from etendue.accuracy.trials import SettingCurve, SettingTrial, Trials

Sampled = Mapping[str, Mapping[Value, Mapping[str, float]]]  # by knob, setting and variable
TOGETHER = "together"  # an error that no knob causes alone
DECISIONS = "left out and coarser"


def split(trial: SettingTrial, curves: Sequence[SettingCurve], sampled: Sampled) -> SettingTrial:
    """Return a trial with the error of its worst variable split into parts, which add up to this error.

    The error of knobs that leave the grid unchanged is split in proportion to the error of each knob alone; errors of
    the grid are added.
    """
    own = trial.computed.get(trial.variable)
    if own is None:
        return trial
    alone = {
        c.knob.key: c.changes.get(trial.setting(c.knob), {}).get(trial.variable, 0.0)
        for c in curves
        if not c.knob.discretisation and trial.setting(c.knob) != c.knob.reference
    }
    whole = math.fsum(alone.values())
    parts = {key: own * part / whole for key, part in alone.items() if part} if whole else {}
    if own and not parts:
        parts[TOGETHER] = own
    settings = {c.knob.key: trial.setting(c.knob) for c in curves}
    return replace(trial, parts={**parts, **_of_grid(trial.variable, settings, sampled)})


def split_as_planned(trial: SettingTrial, sampled: Sampled) -> SettingTrial:
    """Return the trial of the pipeline as planned, with its parts; all decisions of the planner form one part."""
    own = trial.computed.get(trial.variable, 0.0)
    decided = {DECISIONS: own} if own else {}
    return replace(trial, parts={**decided, **_of_grid(trial.variable, trial.settings, sampled)})


def _of_grid(variable: str, settings: Settings, sampled: Sampled) -> dict[str, float]:
    found = {key: by_value.get(settings[key], {}).get(variable, 0.0) for key, by_value in sampled.items()}
    return {key: part for key, part in found.items() if part}


def choices(study: Trials, curves: Sequence[SettingCurve]) -> dict[str, list[Setting]]:
    """Return, by knob, its settings with the error of each setting alone (including the whole error of a grid) and the
    seconds of the stages that the knob affects.
    """
    found = {}
    for c in curves:
        whole = study.sampled.get(c.knob.key, {})
        found[c.knob.key] = [
            Setting(c.knob, value, error, t.timing.least(stages=c.affected))
            for t in c.trials
            for value in (t.setting(c.knob),)
            if (error := max((whole.get(value) or t.computed).values(), default=None)) is not None
        ]
    return found


class Prediction:
    """Predicted error and seconds of a combination, from the error and seconds of each setting alone.

    The squares of errors of different knobs add, as for independent causes; a sum of bounds would exclude too many
    combinations. The seconds of a stage are taken from a trial with the same work; otherwise they are its seconds in
    the reference times the factor of each knob alone. Error and seconds are infinite on a grid whose reference takes
    too long.
    """

    def __init__(
        self, study: Trials, curves: Sequence[SettingCurve], possible: Mapping[str, Sequence[Setting]]
    ) -> None:
        self.study = study
        self.errors = {key: {one.value: one.error for one in own} for key, own in possible.items()}
        self.base = study.search.at({}).timing.by_stage()
        asked = any(k.key in study.given for k in study.sampling)  # the request names these grids
        self.most = math.inf if asked else MOST * math.fsum(self.base.values())
        self.alone = {c.knob.key: {t.setting(c.knob): t.timing.by_stage() for t in c.trials} for c in curves}

    def __call__(self, settings: Settings) -> tuple[float, float]:
        knobs = self.study.knobs
        if self._of_grid(settings) > self.most:
            return math.inf, math.inf
        own = [self.errors[k.key][settings.get(k.key, k.reference)] for k in knobs if k.key in self.errors]
        error = math.sqrt(math.fsum(e * e for e in own))
        return error, math.fsum(self._seconds(stage, settings) for stage in self.base)

    def _of_grid(self, settings: Settings) -> float:
        """Return the seconds of the reference on the grid of a combination."""
        own = {k.key: settings[k.key] for k in self.study.sampling if k.key in settings}
        return math.fsum(self._seconds(stage, own) for stage in self.base)

    def _seconds(self, stage: str, settings: Settings) -> float:
        known = self.study.least(settings, stage)
        if known is not None:
            return known
        base = seconds = self.base[stage]
        for k in self.study.knobs:
            alone = self.alone.get(k.key, {}).get(settings.get(k.key, k.reference))
            if stage in self.study.affected[k.key] and alone is not None and base > 0:
                seconds *= alone.get(stage, base) / base
        return seconds
