"""The layout of a plan in an existing archive: stored axes, the position of each cell, and all files except chunks of
cells.

In:  a plan; from earlier runs, the axis values by group, the blocks of variables, and the stored cells.
Out: groups, positions and chunks of cells; the expected store in memory (``tree``).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import repeat
from typing import Any

import numpy as np

from etendue.archive.journaling.entries import EVENTS, Entries
from etendue.archive.read.reading import StoredForm
from etendue.archive.read.tree import Tree
from etendue.archive.records.names import ROW, STATUS
from etendue.archive.sharding.chunks import Chunk
from etendue.archive.sharding.partition import known_chunk
from etendue.archive.structure import layout as layouts
from etendue.archive.structure.cutting import Blocks, Whereabouts, cut
from etendue.archive.structure.groups import ArchivedLayout
from etendue.archive.structure.layout import BOUNDS, STATUS_ATTRIBUTES, GroupLayout, Layout, VariableLayout, layout_of
from etendue.archive.structure.naming import Names, Whole
from etendue.plan.model import Cell, CellRef, Plan
from etendue.types.arrays import Array
from etendue.types.documents import Document

Slot = tuple[str, int, int]


class Laid:
    """The layout of a plan in an archive.

    Attributes
    ----------
    names : the name of each cell in the journal
    axes : by group, the stored axis values, values of earlier runs first
    places : by group and axis, the positions of the plan's values among the stored values
    blocks : by group and variable, the split of the variable into shards, and its codec
    nodes : every group and array, by path
    """

    def __init__(
        self, plan: Plan, stored: Mapping[str, Mapping[str, list[Any]]], blocks: Blocks, entries: Entries
    ) -> None:
        self.plan = plan
        self.names = Names(plan)
        self.layout: Layout = layout_of(
            plan, ArchivedLayout(stored, blocks, lambda ref: entries.first_file(self.names[ref]))
        )
        self.axes: dict[str, dict[str, list[Any]]] = {}
        self.places: dict[str, list[list[int]]] = {}
        for path, group in self.layout.groups.items():
            own = {dim: list(stored.get(path, {}).get(dim, ())) for dim in group.axes}
            # Append new values after the stored ones, whatever their order, so that stored chunks keep their slots.
            for dim, values in group.axes.items():
                known = set(own[dim])
                own[dim] += [v for v in values if v not in known]
            self.axes[path] = own
            self.places[path] = [_positions(own[dim], values) for dim, values in group.axes.items()]
        self.unmoved = {
            path for path, places in self.places.items() if all(own == list(range(len(own))) for own in places)
        }
        self.blocks = cut(plan, self.layout, self.axes, blocks)
        self.same = {path: group.same_as for path, group in self.layout.groups.items() if group.same_as}
        self.nodes = _nodes(self.layout)
        self._rows: tuple[int, Array] | None = None
        self.whereabouts = {
            path: [
                Whereabouts(path, variable, self.blocks[path][variable.name]) for variable in group.variables.values()
            ]
            for path, group in self.layout.groups.items()
        }

    def tree(self, entries: Entries, todo: Collection[CellRef]) -> Tree:
        """Return everything in the store that follows from the plan, except tables; ``todo`` cells count as not
        computed, even if stored.
        """
        axes = {node.name: list(node.axes) for node in self.plan.nodes}
        tree = Tree()
        attrs: Document = {
            "etendue": {"format": 2, "pipeline": self.plan.pipeline.name, "stages": list(axes), "axes": axes}
        }
        if self.plan.pipeline.variant:
            attrs["variant"] = self.plan.pipeline.variant
        tree.put_group("", attrs)
        for path, node_attrs in self.layout.parents.items():
            tree.put_group(path, node_attrs)
        for path, group in self.layout.groups.items():
            tree.put_group(path, group.attrs | self._coordinates(group))
            self._lay_out(tree, path, group)
        self.put_status(tree, entries, todo)
        return tree

    def put_status(
        self, tree: Tree, entries: Entries, todo: Collection[CellRef] = (), ended: Sequence[int] = ()
    ) -> None:
        """Add ``status`` according to the journal; cells in ``todo`` are "not_computed", even if they have chunks.

        ``ended``: by number of a cell, its status + 1 if it has ended in this run, else 0.
        """
        found = self.standing(entries)
        found[[self.plan.numbers.of(ref) for ref in todo]] = -1
        if ended:
            now = np.frombuffer(bytes(ended), np.uint8)
            found = np.where(now > 0, now - 1, found)
        found[found < 0] = STATUS.index("not_computed")
        for path in self.layout.groups:
            numbers, places = self.numbered(path)
            status = np.full(
                tuple(len(values) for values in self.axes[path].values()), STATUS.index("not_computed"), np.uint8
            )
            status[tuple(places.T)] = found[numbers] if status.ndim else found[numbers[0]]
            tree.put_array(path, "status", status, tuple(self.axes[path]), STATUS_ATTRIBUTES)

    def rows(self, entries: Entries) -> Array:
        """Return, by number of the cell, its row in the journal; -1 if it has no row."""
        if self._rows is None or self._rows[0] != len(entries.rows):  # a cell keeps its row
            rows = map(entries.rows.get, self.names.in_order(), repeat(-1)) if entries.rows else repeat(-1)
            self._rows = len(entries.rows), np.fromiter(rows, np.int64, self.plan.numbers.count)
        return self._rows[1]

    def keyed(self, entries: Entries) -> Array:
        """Return, by number of the cell, whether its line in the journal has the wanted key."""
        rows = self.rows(entries)
        stored = np.frombuffer(bytes(entries.key), np.uint64).reshape(-1, 2)
        asked = bytes.fromhex("".join([cell.key for cell in self.plan.cells.values()]))
        known = (stored[rows] == np.frombuffer(asked, np.uint64).reshape(-1, 2)).all(axis=1) if len(stored) else False
        return (rows >= 0) & known & ~np.isin(rows, list(entries.odd_keys))

    def standing(self, entries: Entries) -> Array:
        """Return, by number of the cell, its status in the journal; -1 if it is being recomputed or has no line with
        the wanted key.
        """
        if not entries.rows:
            return np.full(self.plan.numbers.count, -1)
        rows = self.rows(entries)
        event, status = (np.frombuffer(bytes(one), np.uint8)[rows] for one in (entries.event, entries.status))
        return np.where(self.keyed(entries) & (event != EVENTS.index("start")), status.astype(int), -1)

    def numbered(self, path: str) -> tuple[Array, Array]:
        """Return the number of every cell of a group, and its position in the stored arrays."""
        group, plan = self.layout.groups[path], self.plan
        if isinstance(group.cells, Whole):  # the cells of a stage are numbered in the order of their positions
            own = plan.numbers.range(group.node)
            sizes = [len(plan.axis(dim).values) for dim in plan.node(group.node).axes]
            numbers = np.arange(own.start, own.stop)
            index = np.stack(np.unravel_index(numbers - own.start, sizes), axis=1) if sizes else np.empty((1, 0), int)
        else:
            numbers = np.array([plan.numbers.of(ref) for ref in group.cells])
            index = np.array(list(group.cells.values()), int).reshape(len(numbers), -1)
        if path not in self.unmoved:
            places = [np.array(own)[at] for own, at in zip(self.places[path], index.T, strict=True)]
            index = np.stack(places, axis=1)
        return numbers, index

    def _lay_out(self, tree: Tree, path: str, layout: GroupLayout) -> None:
        merged = self.axes[path]
        for name, coordinate in layout.coordinates.items():
            values, attrs = coordinate.values, dict(coordinate.attrs)
            if name in merged:
                values = merged[name]
                if not any(isinstance(v, str) for v in values) and values not in (
                    sorted(values),
                    sorted(values, reverse=True),
                ):
                    attrs["order"] = "as the sweep grew; sort with .sortby"
            elif len(coordinate.dims) == 1 and coordinate.dims[0] in merged:
                dim = coordinate.dims[0]
                known = dict(zip(layout.axes[dim], values, strict=True))
                missing = "" if any(isinstance(value, str) for value in values) else float("nan")  # not in the plan
                values = [known.get(value, missing) for value in merged[dim]]
            elif coordinate.dims[:-1] and coordinate.dims[0] in merged:
                values = self._grown_positions(path, coordinate.dims[:-1], np.asarray(values, dtype=float))
            if name not in layout.variables:
                tree.put_array(path, name, values, coordinate.dims, attrs)
        for variable in layout.variables.values():
            self._lay_out_variable(tree, path, layout, variable, merged)

    @staticmethod
    def _coordinates(group: GroupLayout) -> Document:
        """Return the group attribute that tells xarray the coordinates, if the group has no array that names them."""
        if not group.same_as or group.variables:
            return {}
        beside = [n for n, c in group.coordinates.items() if c.dims != (n,) and not n.endswith((BOUNDS, ROW))]
        return {"coordinates": " ".join(sorted(beside))} if beside else {}

    def _grown_positions(self, path: str, axes: tuple[str, ...], own: Any) -> Any:
        """Return a position coordinate along grown axes: the positions at the values of the plan, and NaN elsewhere."""
        merged, places = self.axes[path], dict(zip(self.axes[path], self.places[path], strict=True))
        whole = np.full((*(len(merged[axis]) for axis in axes), own.shape[-1]), np.nan)
        whole[np.ix_(*(places[axis] for axis in axes), range(own.shape[-1]))] = own
        return whole

    def _lay_out_variable(
        self, tree: Tree, path: str, layout: GroupLayout, variable: VariableLayout, merged: dict[str, list[Any]]
    ) -> None:
        sizes = tuple(len(values) for values in merged.values())
        shape, dims = (*sizes, *variable.shape), (*merged, *variable.dims)
        beside = [
            n
            for n, c in layout.coordinates.items()
            if c.dims != (n,) and not n.endswith((BOUNDS, ROW)) and set(c.dims) <= set(dims)
        ]
        beside += layouts.coordinates_of(layout, variable)
        attrs = variable.attrs | ({"coordinates": " ".join(sorted(beside))} if beside else {})
        one = self.blocks[path][variable.name]
        chunk = known_chunk(variable.shape, one)
        form = StoredForm(variable.dtype, variable.shape, one["codec"], tuple(one["block"]), chunk)
        tree.put_cells(f"{path}/{variable.name}", shape, form, dims, attrs)

    def place(self, path: str, index: tuple[int, ...]) -> tuple[int, ...]:
        """Return the position of a cell in the stored arrays of its group, from its position among the plan's
        values.
        """
        if path in self.unmoved:
            return index
        return tuple([places[i] for places, i in zip(self.places[path], index, strict=True)])

    def chunks(self, cell: Cell) -> tuple[Chunk, ...]:
        """Return the chunks of a cell's kept variables."""
        path = self.layout.home.get(cell.ref)
        if path is None:
            return ()
        place = self.place(path, self.layout.groups[path].cells[cell.ref])
        return tuple([chunk for one in self.whereabouts[path] for chunk in one.chunks(place)])

    def slots(self, ref: CellRef) -> list[Slot]:
        """Return the same as ``chunks``, as (shard, slot, slots of the shard)."""
        path = self.layout.home.get(ref)
        if path is None:
            return []
        place = self.place(path, self.layout.groups[path].cells[ref])
        found = []
        for one in self.whereabouts[path]:
            file, slot = one.at(place)
            found += [(file, slot + number, one.slots) for number in range(one.count)]
        return found


def _nodes(layout: Layout) -> set[str]:
    """Return the paths of all groups and arrays of a layout."""
    found = {*layout.parents, *layout.groups}
    for path, group in layout.groups.items():
        found |= {f"{path}/{name}" for name in (*group.variables, *group.coordinates, "status")}
    return found


def _positions(stored: list[Any], values: list[Any]) -> list[int]:
    where = {value: i for i, value in enumerate(stored)}
    return [where[value] for value in values]
