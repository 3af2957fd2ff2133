"""Choose the cells of a sweep that are measured: corners, the middle, and places in between; always the same ones.

In:  the axes of a pipeline, and the largest number of places.
Out: places as positions on each axis; the pipeline with its sweep reduced to these values.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Axis
from etendue.types.documents import AxisValue

MOST = 8  # places by default
_BASES = (2, 3, 5, 7, 11, 13, 17, 19)


def places(sizes: Sequence[int], categorical: Sequence[bool] = (), most: int = MOST) -> tuple[tuple[int, ...], ...]:
    """Return positions on axes of these sizes: all of them if few, else both ends, the middle, further corners, and
    places inside. A single one is the middle.

    Every value of a ``categorical`` axis (a swapped stage, a word) is included, whatever ``most`` is: one such value
    tells nothing about another.
    """
    if math.prod(sizes) <= most:
        return tuple(itertools.product(*(range(size) for size in sizes)))
    middle = tuple(n // 2 for n in sizes)
    chosen: dict[tuple[int, ...], None] = {}
    varied = min(len(sizes), 8)
    ends = [(*some, *(0,) * (len(sizes) - varied)) for some in itertools.product((0, 1), repeat=varied)]
    corners = [tuple(end * (size - 1) for end, size in zip(one, sizes, strict=True)) for one in ends]
    ordered = [corners[0], corners[-1], middle] if most > 1 else [middle]
    for number in range(1, len(corners) // 2):  # each together with its opposite
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


def narrowed(pipeline: PipelineFile, axes: Sequence[Axis], chosen: Sequence[dict[str, AxisValue]]) -> PipelineFile:
    """Return the pipeline with its sweep reduced to the values at some places, in the order of the file."""
    sweep = {key: written for key, written in pipeline.sweep.items() if key in {axis.key for axis in axes}}
    for axis in axes:
        needed = {place[axis.dim] for place in chosen}
        numbers = [i for i, value in enumerate(axis.values) if value in needed]
        written = sweep[axis.key]
        sweep[axis.key] = (
            [written[i] for i in numbers] if isinstance(written, list | tuple) else [axis.values[i] for i in numbers]
        )
    return replace(pipeline, sweep=sweep)
