"""Search for jumps along a path of inputs: find the steps with unusual changes and subdivide them.

In:  ``Walk``: results at several places of a path.
Out: the size of a jump, and where it is.

A step is unusual if its change differs from the change of a polynomial through its neighbours. The step is subdivided
until it is a billionth of its position; the remaining change is a jump.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from etendue.testing.measured import ratio_of, untried
from etendue.types.arrays import Array

PARTS = 4  # number of parts into which a step is divided
DEPTH = 17  # divisions: 4^17 = 2e10
SHALLOW = 4  # for a stage with expensive runs
NEAR, TINY = 1e-9, 1e-100  # fractions of the first step from 0
FALLS = 6  # number of divisions over which the change at a jump stays constant, while that of a square root falls
LEAST = 1e-6  # of full scale; the change of a smooth stage with a condition number of 1,000 over a billionth
ENOUGH = 4.0  # times smaller than allowed: not subdivided further
RANK = 4.0  # a step is subdivided if its curvature exceeds that of its neighbours by this factor
AROUND = 13  # number of neighbouring steps with which a step is compared
Results = Mapping[str, Array]
Walk = Callable[[Array], Sequence[Results | None]]  # results at several places of a path; None where refused
Jump = tuple[float, float, float]  # size relative to the largest value, and the two places between which it lies


def jumps_along(
    walk: Walk, places: Array, variables: Sequence[str], allowed: float, worth: int, rank: float = RANK
) -> dict[str, Jump]:
    """Return the largest jump of each variable along a path, relative to its value, and the ends of the step with the
    jump; a jump far below ``allowed`` counts as 0. ``worth``: how many unusual steps are subdivided for each of the
    three ``summaries``; if 0, one step is subdivided a few times.
    """
    found = {variable: (0.0, float(places[0]), float(places[-1])) for variable in variables}
    trials = walk(places)
    for variable in variables:
        values = [None if one is None else one.get(variable) for one in trials]
        beginning = (
            beside_zero(walk, variable, float(places[1]), allowed) if len(places) > 1 and places[0] == 0 else None
        )
        if beginning:
            found[variable] = beginning
        steps = outstanding(places, values, max(worth, 1), rank)
        for step in steps if worth else steps[:1]:
            depth, high = DEPTH if worth else SHALLOW, float(places[step + 1])
            ends = (float(places[step]) or NEAR * high, high)  # the step next to 0 was compared above
            jump = narrowed(walk, variable, *ends, allowed / ENOUGH, depth)
            if jump[0] > found[variable][0]:
                found[variable] = jump
    return found


def outstanding(places: Array, values: Sequence[Array | None], worth: int, rank_at_least: float) -> list[int]:
    """Return the unusual steps: those whose change differs most from a polynomial through the changes of the
    neighbouring steps.
    """
    if len(places) < 2:
        return []
    table = summaries(values)
    valid: Array = np.asarray(np.isfinite(table).all(axis=1))
    usable = valid[:-1] & valid[1:]
    found: list[int] = []
    half = AROUND // 2
    for column in range(table.shape[1]):
        change = np.where(usable, np.diff(table[:, column]), 0.0)
        wide = np.pad(change, 3, mode="edge")
        others = 15 * (wide[2:-4] + wide[4:-2]) - 6 * (wide[1:-5] + wide[5:-1]) + wide[:-6] + wide[6:]
        bent = np.abs(change - others / 20)  # from what a polynomial through the three steps on either side gives
        around = np.pad(bent, half, mode="reflect" if bent.size > half else "edge")
        quiet = np.median(sliding_window_view(around, AROUND), axis=-1)
        ranks = np.where(usable, bent / (quiet + 1e-10), -1.0)
        order = [int(n) for n in np.argsort(-ranks) if ranks[n] > rank_at_least]
        inside = [n for n in order if 3 <= n < change.size - 3]
        found += [*inside[:worth], *[n for n in order if n not in inside][:1]]  # few neighbours at the ends
    return list(dict.fromkeys(found))


def beside_zero(walk: Walk, variable: str, first: float, allowed: float) -> Jump | None:
    """Compare the result at 0 with the results at two small numbers. Up to the smaller number even a square root
    changes less than up to the larger one, but a jump is equally large.
    """
    trials = walk(np.array([0.0, first * TINY, first * NEAR]))
    values = [np.asarray(one[variable], dtype=float) for one in trials if one is not None]
    if len(values) < len(trials) or any(value.shape != values[0].shape for value in values):
        return None
    zero, tiny, near = values
    sizes = [float(np.abs(value - zero).max(initial=0.0)) for value in (tiny, near)]
    scale = max(float(np.abs(value).max(initial=0.0)) for value in (zero, tiny))
    off = ratio_of(sizes[0], scale)
    return (off, 0.0, first * TINY) if off > allowed and sizes[0] > 0.5 * sizes[1] else None


def summaries(values: Sequence[Array | None]) -> Array:
    """Return three numbers for each array: its largest value, and two weighted sums relative to that value. If the
    array jumps along the path, these numbers jump too.
    """
    shapes = [np.shape(value) for value in values if value is not None]
    usual = max(set(shapes), key=shapes.count) if shapes else ()
    blank = np.full(usual, np.nan)
    same = [blank if value is None or np.shape(value) != usual else value for value in values]
    table = np.asarray(same, dtype=float).reshape(len(values), -1)
    if not table.shape[1]:
        return np.full((len(values), 3), np.nan)
    top = np.abs(table).max(axis=1)
    scale = np.where(top > 0, top, 1.0)[:, None]
    with np.errstate(all="ignore"):
        relative = table / scale
        logs = np.where(top > 0, np.log(top), np.where(np.isnan(top), np.nan, -700.0))
    return np.stack([logs, relative @ np.cos(np.arange(table.shape[1])), relative.mean(axis=1)], axis=1)


def narrowed(walk: Walk, variable: str, low: float, high: float, least: float, depth: int = DEPTH) -> Jump:
    """Subdivide a step repeatedly, and keep the part whose change differs most from the change of the other parts. If
    there is a jump, that part contains the whole jump.
    """
    none = (0.0, low, high)
    jump, sizes = none, list[float]()
    known: dict[float, Array | None] = {}
    for _ in range(depth):
        places = np.linspace(low, high, PARTS + 1)
        if np.unique(places).size < PARTS + 1:
            break
        new = [float(t) for t in places if float(t) not in known]
        for t, one in zip(new, walk(np.array(new)), strict=True):
            known[t] = None if one is None else np.asarray(one[variable], dtype=float)
        values = [value for t in places if (value := known[float(t)]) is not None]
        if len(values) < places.size or any(value.shape != values[0].shape for value in values):
            return none  # refused in between, or of another size
        changes = np.array([(after - before).ravel() for before, after in itertools.pairwise(values)])
        if not np.isfinite(changes).all():
            return none
        off = np.abs(changes - np.median(changes, axis=0)).max(axis=1, initial=0.0)
        part = int(off.argmax()) if off.max() > 0 else PARTS - 1
        low, high = float(places[part]), float(places[part + 1])
        scale = max(float(np.abs(values[part]).max(initial=0.0)), float(np.abs(values[part + 1]).max(initial=0.0)))
        sizes.append(float(np.abs(changes[part]).max(initial=0.0)))
        jump = (ratio_of(sizes[-1], scale), low, high)
        if ratio_of(float(off.max(initial=0.0)), scale) < least:
            return none  # smooth; a bend falls by 4 with every division, a curve by 16
    if depth < DEPTH:
        untried(f"{variable} between {low:.6g} and {high:.6g} was not divided any further")
        return none
    if len(sizes) > FALLS and sizes[-1] < 0.5 * sizes[-1 - FALLS]:
        return none  # steep like a square root at 0, but the change falls with every division
    return jump
