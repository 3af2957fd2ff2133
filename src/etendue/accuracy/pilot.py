"""Choose the cells of a sweep that are measured (corners, the middle and places in between, always the same), and state
an error for the other cells.

In:  the axes of a pipeline, and the largest number of places; errors measured there.
Out: places as positions on each axis; the pipeline with its sweep reduced to these values; for every wanted variable,
     an error that the other cells are unlikely to exceed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from etendue.pipeline.derived import with_rows
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Axis, CellRef, Plan
from etendue.types.documents import AxisValue, AxisValues

if TYPE_CHECKING:
    from etendue.accuracy.measuring import MeasuredErrors

MARGIN = 3.0  # factor on the largest measured error, because a few cells represent many
MOST = 8  # places by default
_BASES = (2, 3, 5, 7, 11, 13, 17, 19)


def places(sizes: Sequence[int], categorical: Sequence[bool] = (), most: int = MOST) -> tuple[tuple[int, ...], ...]:
    """Return positions on axes of these sizes: all positions if there are few, else both ends, the middle, further
    corners, and places inside. If only one position is allowed, it is the middle.

    Every value of a ``categorical`` axis (a swapped stage, a word) is included for any ``most``, because results at one
    value say nothing about another value.
    """
    if math.prod(sizes) <= most:
        return tuple(itertools.product(*(range(size) for size in sizes)))
    middle = tuple(n // 2 for n in sizes)
    chosen: dict[tuple[int, ...], None] = {}
    varied = min(len(sizes), 8)
    ends = [(*some, *(0,) * (len(sizes) - varied)) for some in itertools.product((0, 1), repeat=varied)]
    corners = [tuple(end * (size - 1) for end, size in zip(one, sizes, strict=True)) for one in ends]
    ordered = [corners[0], corners[-1], middle] if most > 1 else [middle]
    for number in range(1, len(corners) // 2):  # add each corner together with the opposite one
        ordered += [corners[number], corners[-1 - number]]
    for place in ordered[: max(most - max(most // 4, 1), 1)]:
        chosen.setdefault(place)
    number = 1
    while len(chosen) < most and number < 64 * most:
        chosen.setdefault(
            tuple(
                min(int(_halton(number, base) * n), n - 1)
                for base, n in zip(itertools.cycle(_BASES), sizes, strict=False)
            )
        )
        number += 1
    for axis, size in enumerate(sizes):
        if axis < len(categorical) and categorical[axis]:
            for value in sorted(set(range(size)) - {place[axis] for place in chosen}):
                chosen.setdefault((*middle[:axis], value, *middle[axis + 1 :]))
    return tuple(chosen)


def _halton(number: int, base: int) -> float:
    share, found = 1.0, 0.0
    while number:
        share /= base
        number, digit = divmod(number, base)
        found += share * digit
    return found


def chosen_places(axes: Sequence[Axis], most: int = MOST) -> tuple[dict[str, AxisValue], ...]:
    """Return the axis values at each place, by dim."""
    categorical = [any(isinstance(value, str | bool) for value in axis.values) for axis in axes]
    found = places([len(a.values) for a in axes], categorical, most)
    return tuple({axis.dim: axis.values[i] for axis, i in zip(axes, place, strict=True)} for place in found)


def narrowed(pipeline: PipelineFile, axes: Sequence[Axis], chosen: Sequence[dict[str, AxisValue]]) -> PipelineFile:
    """Return the pipeline with its sweep reduced to the values at some places, in the order of the file."""
    known = {one.key for axis in axes for one in (axis, *axis.factors)}
    sweep = {key: written for key, written in pipeline.sweep.items() if key in known}
    for axis in axes:
        needed = {place[axis.dim] for place in chosen}
        if axis.rows:
            pipeline = with_rows(pipeline, axis.dim, [value for value in axis.values if value in needed])
            continue
        numbers = [i for i, value in enumerate(axis.values) if value in needed]
        written = sweep[axis.key]
        sweep[axis.key] = (
            [written[i] for i in numbers] if isinstance(written, list | tuple) else [axis.values[i] for i in numbers]
        )
    return replace(pipeline, sweep=sweep)


def stated_elsewhere(plan: Plan, measured: MeasuredErrors, places: Sequence[AxisValues]) -> dict[str, float | None]:
    """Return the stated error by variable, rms relative to full scale; None if unknown, or if every cell was measured.

    The bounds of all decisions on the way to a cell are added. If this sum exceeds the sums of the measured cells, the
    stated error is increased in proportion.
    """
    bounds: dict[CellRef, float] = {}
    for ref, cell in plan.cells.items():
        bounds[ref] = cell.bound + max((bounds[source] for _, source, _ in cell.inputs), default=0.0)
    found: dict[str, float | None] = {}
    for stage, name in plan.wanted:
        key = name if name in measured.errors else f"{stage}.{name}"
        dims = plan.node(stage).axes
        at = [plan.everywhere({a.dim: a.values.index(place[a.dim]) for a in plan.axes}) for place in places]
        seen = {(stage, tuple(one[dim] for dim in dims)) for one in at}
        others = [bounds[cell.ref] for cell in plan.of(stage) if cell.ref not in seen]
        worst = measured.errors[key].rms if key in measured.errors else None
        if worst is None or not others:
            found[key] = None
            continue
        most = max(bounds[ref] for ref in seen)
        found[key] = MARGIN * worst * (max(1.0, max(others) / most) if most > 0 else 1.0)
    return found
