"""Metrics of an archive: every variable that is not a picture, over all axes that affect it.

In:  an archive opened for display.
Out: ``MetricColumn``s: numbers over axes, then over their own dims (stages, channels, frequencies), with the
     coordinates of these dims.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from etendue.contract.arrays.variables import variable, without
from etendue.errors import ArchiveError
from etendue.present.page.opened import PLANE, Opened, ShownGroup
from etendue.types.arrays import Array

LARGEST = 4096  # numbers per cell; variables with more are neither metric nor curve
MOST = 4_000_000  # numbers of one variable over all cells


@dataclass(frozen=True)
class Coordinate:
    """The positions along a dim: labels or numbers, over the axes on which they depend."""

    name: str
    label: str
    units: str
    axes: tuple[str, ...]
    values: Array  # (axes..., dim)


@dataclass(frozen=True)
class MetricColumn:
    """One variable of one stage over every cell; cells that were not computed are NaN."""

    stage: str
    variable: str
    label: str
    units: str
    axes: tuple[str, ...]
    dims: tuple[str, ...]
    values: Array  # (axes..., dims...)
    coordinates: dict[str, list[Coordinate]] = field(default_factory=dict)
    meanings: tuple[str, ...] = ()  # names of whole numbers that are codes


@dataclass(frozen=True)
class Omitted:
    """A variable that is not shown, and the reason."""

    stage: str
    variable: str
    why: str


def figures(opened: Opened) -> tuple[list[MetricColumn], list[Omitted]]:
    """Return every metric in the order of the stages, and the variables that are too large."""
    found: list[MetricColumn] = []
    omitted: list[Omitted] = []
    for stage in opened.stages:
        groups = opened.groups.get(stage, [])
        names = dict.fromkeys(name for group in groups for name in group.variables)
        for name in names:
            holding = [group for group in groups if name in group.variables]
            dims = holding[0].variables[name]
            if dims[-2:] == PLANE or any(group.variables[name] != dims for group in holding):
                continue
            size = int(np.prod([max(int(group.data.sizes[dim]) for group in holding) for dim in dims], dtype=int))
            cells = int(np.prod([len(opened.axis(dim).values) for dim in opened.reaching(stage)], dtype=int))
            if size > LARGEST or size * cells > MOST:
                omitted.append(Omitted(stage, name, f"{size * cells:,} numbers: read it from the archive"))
            else:
                found.append(_figure(opened, stage, name, holding))
    return found, omitted


def _figure(opened: Opened, stage: str, name: str, groups: list[ShownGroup]) -> MetricColumn:
    axes, dims = opened.reaching(stage), groups[0].variables[name]
    sizes = [max(int(group.data.sizes[dim]) for group in groups) for dim in dims]
    values = np.full([*(len(opened.axis(dim).values) for dim in axes), *sizes], np.nan)
    for group in groups:
        order = [list(group.axes).index(dim) for dim in axes]
        column = opened.column(group, name)
        for places, array in [column] if column else _arrays(opened, group, name):
            own = array.shape[bool(column) :]
            where: tuple[Any, ...] = (*(places[i] for i in order), *(slice(size) for size in own))
            values[where] = array
    widest = max(groups, key=lambda group: sum(int(group.data.sizes[dim]) for dim in dims))
    attrs = groups[0].data[name].attrs
    units = str(attrs.get("units", "1"))
    return MetricColumn(
        stage,
        name,
        str(attrs.get("long_name", name)) + without(attrs),
        "" if units == "1" else units,
        axes,
        dims,
        values,
        {dim: _coordinates(opened, widest, dim) for dim in dims},
        _meanings(groups[0], name),
    )


def _arrays(opened: Opened, group: ShownGroup, name: str) -> Iterator[tuple[tuple[int, ...], Array]]:
    for place, cell in opened.cells(group):
        if opened.has(cell):
            try:
                yield place, np.asarray(opened.read(cell, name), dtype=float)
            except (ArchiveError, IndexError):  # removed by the run in the meantime, or damaged: treat as missing
                continue


def _meanings(group: ShownGroup, name: str) -> tuple[str, ...]:
    """Return the names that whole numbers stand for: the meanings of CF flags 0, 1, 2, .., or the labels of the dim
    into which the number is an index.
    """
    attrs = group.data[name].attrs
    words = str(attrs.get("flag_meanings", "")).split()
    flags = np.atleast_1d(attrs.get("flag_values", range(len(words)))).tolist()
    if words and flags == list(range(len(words))):
        return tuple(words)
    dim = variable(name).names
    if variable(name).index and dim in group.data.coords:
        return tuple(map(str, group.data[dim].to_numpy().tolist()))
    return ()


def _coordinates(opened: Opened, group: ShownGroup, dim: str) -> list[Coordinate]:
    """Return the coordinates along a dim; the coordinate named like the dim comes first."""
    found = []
    for name, own in group.data.coords.items():
        if (
            dim not in own.dims
            or any(other != dim and other not in group.axes for other in own.dims)
            or own.dims[-1] != dim
        ):
            continue
        axes = tuple(str(other) for other in own.dims[:-1])
        values = own.to_numpy()
        for number, axis in enumerate(axes):
            order = [list(group.axes[axis]).index(v) if v in group.axes[axis] else -1 for v in opened.axis(axis).values]
            values = np.take(values, order, axis=number)
        units = str(own.attrs.get("units", "1"))
        label = str(own.attrs.get("long_name", name))
        found.append(Coordinate(str(name), label, "" if units == "1" else units, axes, values))
    if not any(one.name == dim for one in found):
        found.append(Coordinate(dim, dim, "", (), np.arange(int(group.data.sizes[dim]), dtype=float)))
    return sorted(found, key=lambda one: one.name != dim)
