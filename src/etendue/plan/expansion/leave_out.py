"""Omission: decide for every cell, within a local tolerance, whether its stage can be left out for this scene.

A stage may be left out if it reads and writes the same variable on the same grid and the resulting change of its output
is known. A change of exactly zero always qualifies, a bound above zero if it is within the tolerance. For a transfer
function the change is summed over the content of the scene's light at every frequency. Every other stage states the
bound of its change (``negligible``). For a stage that adds noise the bound is the largest share that the stage
contributes to the variance after the converter. Nothing here depends on the rest of a sweep, so a cell is decided in
the same way in every sweep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Bounded, Noisy, Summed, Transfer
from etendue.contract.stage import Stage, reads_of, writes_of
from etendue.plan.model import LeftOut
from etendue.plan.stage_calls import negligible, variance_of
from etendue.transfer import effects

LEVELS = 5  # signal levels, darkest to brightest pixel, at which a noise's share of the variance is evaluated


@dataclass(frozen=True)
class LeaveOutRule:
    """The rule of omission: nothing may be left out (None), or stages may be left out whose change is within a
    tolerance, as rms over the frame or at the pixel with the largest change.
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
    """Return the reason why a cell is left out, with the error bound; None if the cell is computed. ``noises`` gives
    every noise source of the pipeline, or None if they are not all known.
    """
    if rule.tolerance is None or isinstance(stage, Summed) or not isinstance(stage, Bounded | Transfer):
        return None
    port = through(stage, grids_in, grids)
    if port is None:
        return None
    own, grid = _in_norm(facts[port], rule.norm), grids_in[port]
    found = _of_the_stage(stage, own, grid)
    # The cheapest test that can succeed comes first; the sum over the content is made only if it may give a lower
    # bound.
    if (found is None or found.bound > 0) and isinstance(stage, Transfer) and own.content is not None and grid.banded:
        both = (found, _of_the_content(stage, own, grid))
        found = min((one for one in both if one is not None), key=lambda one: one.bound, default=None)
    if found is None and isinstance(stage, Noisy) and rule.tolerance > 0:
        found = _of_the_noise(stage, own, noises, rule.tolerance)
    return found if found is not None and (found.bound == 0 or found.bound <= rule.tolerance) else None


def _in_norm(facts: Facts, norm: str) -> Facts:
    """Return the facts with a content whose changes are measured in a norm."""
    if facts.content is None or facts.content.norm == norm:
        return facts
    return replace(facts, content=replace(facts.content, norm=norm))


def through(stage: Stage, grids_in: Mapping[str, Grid], grids: Mapping[str, Grid]) -> str | None:
    """Return the port through which a stage reads the variable it writes first; None if it writes a variable that it
    does not read, or writes it on another grid.
    """
    ports: dict[str, str] = {}
    for port, declaration in reads_of(type(stage)).items():
        ports.setdefault(declaration.variable, port)
    writes = [d.variable for d in writes_of(type(stage)).values() if not d.optional]
    if any(grids_in.get(ports.get(variable, "")) != grids[variable] for variable in writes):
        return None
    return ports[writes[0]]


def _of_the_stage(stage: Stage, facts: Facts, grid: Grid) -> LeftOut | None:
    """Return the bound that the stage itself states. A stage that multiplies light states a fraction of the value
    before it; the bound is converted to a fraction of the value after it, which is larger.
    """
    if not isinstance(stage, Bounded):
        return None
    answer = negligible(stage, facts, grid)
    if answer is None:
        return None
    bound, why = answer
    if stage.pointwise:
        bound = bound / (1 - bound) if bound < 1 else math.inf
    return LeftOut(bound, why)


def _of_the_content(stage: Transfer, facts: Facts, grid: Grid) -> LeftOut | None:
    """Return the bound summed over the content of the light; None if the stage refuses its values (reported
    elsewhere).
    """
    assert facts.content is not None
    if facts.content.detail == 0:
        dark = facts.content.full == 0
        return LeftOut(0.0, "there is no light" if dark else "the scene is uniform: blur changes nothing")
    try:
        found = effects.change(stage, facts.content, grid)
    except ValueError:
        return None
    return LeftOut(found.whole, "the scene has too little fine detail for the stage to have an effect", found.apart)


def _of_the_noise(stage: Noisy, facts: Facts, noises: Callable[[], list[Noisy] | None], most: float) -> LeftOut | None:
    """Return the largest share of the total variance that one source adds, from the darkest to the brightest pixel."""
    if facts.low is None or facts.high is None:
        return None
    low, high = max(facts.low, 0.0), max(facts.high, 0.0)
    own = variance_of(stage, low)
    # Poisson noise has a variance of one per count; a source with a larger variance is never small
    if low == 0 or own is None or own > low:
        return None
    every = noises()
    if every is None:
        return None
    share = 0.0
    # Steps are quadratic: the share of a constant noise changes fastest in the dark.
    for step in range(LEVELS):
        level = low + (high - low) * (step / (LEVELS - 1)) ** 2
        parts = [variance_of(one, level) for one in every]
        own, total = variance_of(stage, level), math.fsum(part or 0.0 for part in parts)
        if own is None or None in parts:
            return None
        share = max(share, own / total if total > 0 else 1.0)
        if share > most:
            return None
    return LeftOut(share, "the stage adds at most this share of the variance of any pixel")
