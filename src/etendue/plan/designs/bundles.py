"""Join axes whose values change together into one axis of rows. A node that depends on only some of these axes gets the
distinct combinations of their values, so that nothing is computed twice.

In:  nodes whose axes are the single factors; the axes that share a dim.
Out: nodes with the axis of rows, or with an axis derived from it; the independent axes; the derived axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from etendue.pipeline.file import PipelineFile
from etendue.pipeline.zipped import Zip
from etendue.plan.model import Axis, Node

MOST_SHARED = 4096  # combinations of levels; of more combinations, hardly any would occur in two rows


class Bundled(NamedTuple):
    """Nodes and axes with rows in the place of single factors."""

    nodes: list[Node]
    axes: list[Axis]
    derived: list[Axis]
    factors: list[Axis]


def bundled(nodes: Sequence[Node], axes: Sequence[Axis], pipeline: PipelineFile) -> Bundled:
    """Return the nodes with an axis of rows for every dim that several axes share."""
    shared: dict[str, list[Axis]] = {}
    for axis in axes:
        if axis.key in pipeline.zipped:
            shared.setdefault(pipeline.zipped[axis.key].dim, []).append(axis)
    if not shared:
        return Bundled(list(nodes), list(axes), [], [])
    dims = {axis.dim: dim for dim, own in shared.items() for axis in own}
    whole = {dim: _rows(dim, own, pipeline) for dim, own in shared.items()}
    derived: dict[str, Axis] = {}
    found = []
    for node in nodes:
        own: dict[str, None] = {}
        for dim in node.axes:
            if dim not in dims:
                own[dim] = None
                continue
            one = whole[dims[dim]]
            chosen = [n for n, factor in enumerate(one.factors) if factor.dim in node.axes]
            part = _part(one, chosen, pipeline)
            own[part.dim] = None
            if part.of:
                derived[part.dim] = part
        found.append(replace(node, axes=tuple(own)))
    order = dict.fromkeys(dims.get(axis.dim, axis.dim) for axis in axes)
    by_dim = {**{axis.dim: axis for axis in axes}, **whole}
    factors = [axis for axis in axes if axis.dim in dims]
    return Bundled(found, [by_dim[dim] for dim in order], list(derived.values()), factors)


def _rows(dim: str, factors: list[Axis], pipeline: PipelineFile) -> Axis:
    """Return the axis of all requested rows; its values are the numbers of the rows."""
    at = [pipeline.zipped[axis.key].at for axis in factors]
    numbers = pipeline.rows.get(dim) or range(len(at[0]))
    rows = tuple(tuple(own[number] for own in at) for number in numbers)
    return _made(dim, tuple(numbers), factors, rows)


def _made(dim: str, numbers: tuple[int, ...], factors: Sequence[Axis], rows: tuple[tuple[int, ...], ...]) -> Axis:
    gives = {}
    for place, axis in enumerate(factors):
        names = axis.gives or ({axis.key: axis.values} if "." not in axis.key else {})
        gives.update({name: tuple(values[row[place]] for row in rows) for name, values in names.items()})
    return Axis(dim, dim, numbers, "", gives, tuple(factors), rows)


def _part(one: Axis, chosen: list[int], pipeline: PipelineFile) -> Axis:
    """Return the axis of a node that depends on only some factors: the distinct combinations of these factors if rows
    of the design share values, else all rows.

    Combinations are numbered in the order in which they first occur in the drawn rows, so that additional rows change
    no number.
    """
    zips = [pipeline.zipped[one.factors[n].key] for n in chosen]
    if len(chosen) == len(one.factors) or not _share(zips):
        return one
    known: dict[tuple[int, ...], int] = {}
    drawn = [known.setdefault(combination, len(known)) for combination in zip(*(z.at for z in zips), strict=True)]
    asked = [drawn[number] for number in one.values]
    numbers = tuple(dict.fromkeys(asked))
    where = {number: place for place, number in enumerate(numbers)}
    combinations = list(known)
    made = _made(
        _name(one, chosen), numbers, [one.factors[n] for n in chosen], tuple(combinations[number] for number in numbers)
    )
    return replace(made, of=one.dim, places=tuple(where[number] for number in asked))


def _share(zips: Sequence[Zip]) -> bool:
    """Return whether rows share values on all of these axes, with at most ``MOST_SHARED`` combinations."""
    most = 1
    for one in zips:
        most *= one.most or 1
    return all(one.shares for one in zips) and most <= MOST_SHARED


def _name(one: Axis, chosen: list[int]) -> str:
    """Return the name of an axis that has only some factors of an axis of rows. The name consists of these factors or,
    if fewer are missing, of the missing factors.
    """
    lacking = [n for n in range(len(one.factors)) if n not in chosen]
    if len(lacking) < len(chosen):
        return f"{one.dim}_without_{'_'.join(one.factors[n].dim for n in lacking)}"
    return f"{one.dim}_{'_'.join(one.factors[n].dim for n in chosen)}"


def position_maps(axes: Mapping[str, Axis]) -> Mapping[tuple[str, str], tuple[int, ...]]:
    """Return, for every pair of axes of the same rows, the map from positions on one to positions on the other."""
    sets: dict[str, list[Axis]] = {}
    for axis in axes.values():
        if axis.rows:
            sets.setdefault(axis.of or axis.dim, []).append(axis)
    found = {}
    for own in sets.values():
        for one in own:
            first: dict[int, int] = {}
            for row, place in enumerate(one.places) if one.of else ((n, n) for n in range(len(one.values))):
                first.setdefault(place, row)
            rows = [first[place] for place in range(len(one.values))]
            for other in own:
                if other is not one:
                    found[one.dim, other.dim] = tuple(other.places[row] if other.of else row for row in rows)
    return found
