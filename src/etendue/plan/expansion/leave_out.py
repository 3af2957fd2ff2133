"""Leaving out: what a scene does not need, decided per cell, within a local tolerance.

A stage may be left out where it reads and writes the same variable on the same grid, and what that changes in its own
output is known: an exact zero is always taken, a bound above zero where it is within the tolerance. Of a transfer
function the change is the sum over what the scene's light holds at every frequency; of any other stage it is what the
stage says (``negligible``); of one that adds noise, the share of the variance behind the converter that it brings, at
the level where that is most. Nothing here depends on what else is swept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Bounded, Noisy, Summed, Transfer
from etendue.contract.stage import Stage, reads_of, writes_of
from etendue.plan.model import LeftOut
from etendue.plan.stage_calls import negligible, variance_of
from etendue.transfer import effects

LEVELS = 5  # between the darkest and the brightest pixel, at which the share of a noise is looked at


@dataclass(frozen=True)
class LeaveOutRule:
    """What may be left out: nothing (None), or changes within a tolerance, rms over the frame or of the largest
    pixel.
    """

    tolerance: float | None
    norm: str = "rms"


def decide(
    rule: LeaveOutRule,
    stage: Stage,
    facts: Mapping[str, Facts],
    grids_in: Mapping[str, Grid],
    grids: Mapping[str, Grid],
    noises: Callable[[], list[Noisy] | None],
) -> LeftOut | None:
    """Whether one cell is left out, and with which bound. ``noises``: every source of noise of the pipeline, or
    None: not known.
    """
    if rule.tolerance is None or isinstance(stage, Summed) or not isinstance(stage, Bounded | Transfer):
        return None
    port = _through(stage, grids_in, grids)
    if port is None:
        return None
    own, grid = facts[port], grids_in[port]
    found = _of_the_stage(rule, stage, own, grid)
    if (found is None or found.bound > 0) and isinstance(stage, Transfer) and own.content is not None and grid.banded:
        both = (found, _of_the_content(rule, stage, own, grid))
        found = min((one for one in both if one is not None), key=lambda one: one.bound, default=None)
    if found is None and isinstance(stage, Noisy) and rule.tolerance > 0:
        found = _of_the_noise(stage, own, noises, rule.tolerance)
    return found if found is not None and (found.bound == 0 or found.bound <= rule.tolerance) else None


def _through(stage: Stage, grids_in: Mapping[str, Grid], grids: Mapping[str, Grid]) -> str | None:
    """The port by which a stage reads what it writes first; None where it writes something that it does not read, or
    on another grid.
    """
    ports: dict[str, str] = {}
    for port, declaration in reads_of(type(stage)).items():
        ports.setdefault(declaration.variable, port)
    writes = [d.variable for d in writes_of(type(stage)).values() if not d.optional]
    if any(grids_in.get(ports.get(variable, "")) != grids[variable] for variable in writes):
        return None
    return ports[writes[0]]


def _of_the_stage(rule: LeaveOutRule, stage: Stage, facts: Facts, grid: Grid) -> LeftOut | None:
    """What the stage itself says; of a factor, times the light that it acts on."""
    if not isinstance(stage, Bounded):
        return None
    answer = negligible(stage, facts, grid)
    if answer is None:
        return None
    bound, why = answer
    if stage.pointwise and facts.content is not None and rule.norm == "rms":
        bound *= min(1.0, facts.content.rms)
    return LeftOut(bound, why)


def _of_the_content(rule: LeaveOutRule, stage: Transfer, facts: Facts, grid: Grid) -> LeftOut | None:
    """The sum over what the light holds; None where the stage refuses to answer: it says why in its own place."""
    assert facts.content is not None
    if facts.content.detail == 0:
        dark = facts.content.full == 0
        return LeftOut(0.0, "there is no light" if dark else "the scene is uniform: blur changes nothing")
    try:
        bound = effects.change(stage, grid.bands().edges, facts.content, rule.norm)
    except ValueError:
        return None
    return LeftOut(bound, "the scene holds so little detail that is fine enough for it")


def _of_the_noise(stage: Noisy, facts: Facts, noises: Callable[[], list[Noisy] | None], most: float) -> LeftOut | None:
    """The largest share of all variance that one source brings, between the darkest and the brightest pixel."""
    if facts.low is None or facts.high is None:
        return None
    low, high = max(facts.low, 0.0), max(facts.high, 0.0)
    own = variance_of(stage, low)
    if low == 0 or own is None or own > low:  # counts scatter by as much, and this is more
        return None
    every = noises()
    if every is None:
        return None
    share = 0.0
    for step in range(LEVELS):
        level = low + (high - low) * (step / (LEVELS - 1)) ** 2
        parts = [variance_of(one, level) for one in every]
        own, total = variance_of(stage, level), math.fsum(part or 0.0 for part in parts)
        if own is None or None in parts:
            return None
        share = max(share, own / total if total > 0 else 1.0)
        if share > most:
            return None
    return LeftOut(share, "of the variance of any pixel it brings no more than this")
