"""The results of a run in memory, as the ``xarray.DataTree`` that an archive would give.

In:  a plan and the arrays of its cells.
Out: the tree that ``xarray.open_datatree`` gives for the archive of the same plan.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import xarray
from xarray.indexes import PandasIndex

from etendue.archive.records.names import ROW, STATUS
from etendue.archive.structure.layout import BOUNDS, STATUS_ATTRIBUTES, GroupLayout, coordinates_of, layout_of
from etendue.contract.ports import CellReport, ContactSheet, Passing
from etendue.plan.model import Cell, CellRef, Plan
from etendue.plan.resume import Work
from etendue.types.arrays import Array, CellArrays
from etendue.types.documents import Document

_Column = tuple[Sequence[str], Array, Document]  # dims, values and attributes


class Standing(Mapping[CellRef, CellArrays]):
    """The arrays of the cells that have ended, as views into the results; ``others``: cells that returned more
    variables than are kept.
    """

    def __init__(self, keeper: MemoryKeeper, others: Mapping[CellRef, dict[str, Array]]) -> None:
        self.keeper, self.others = keeper, others

    def __getitem__(self, ref: CellRef) -> dict[str, Array]:
        if ref in self.others:
            return self.others[ref]
        if ref not in self:
            raise KeyError(ref)
        return self.keeper.placed(ref)

    def __contains__(self, ref: object) -> bool:
        return ref in self.keeper.plan.cells and self.keeper.status[self.keeper.number(ref)] > 0  # type: ignore[arg-type]

    def __iter__(self) -> Iterator[CellRef]:
        return (ref for ref, status in zip(self.keeper.plan.cells, self.keeper.status, strict=True) if status)

    def __len__(self) -> int:
        return len(self.keeper.status) - self.keeper.status.count(0)


class MemoryKeeper(Passing):
    """Arrays of a whole sweep, filled cell by cell as they are computed. Never holds results of an earlier run."""

    keeps_arrays = True

    def __init__(self, pictures: bool = True) -> None:
        self.draws = pictures
        self.whole: dict[tuple[str, str], Any] = {}
        self.missing: dict[tuple[str, str], Any] = {}

    def begin(self, asked: Plan) -> Work:
        """Allocate the arrays of all kept variables."""
        # In memory nothing is copied, also where ``keep`` names it.
        shared = replace(asked, copied=frozenset()) if asked.copied else asked
        asked = shared if shared.same_as else asked
        self.plan, self.layout, self.number = asked, layout_of(asked), asked.numbers.of
        self.status = bytearray(asked.numbers.count)  # by cell: 0, or its status + 1 once it has ended
        for path, group in self.layout.groups.items():
            sizes = tuple(len(values) for values in group.axes.values())
            for variable in group.variables.values():
                self.whole[path, variable.name] = np.empty((*sizes, *variable.shape), dtype=variable.dtype)
                self.missing[path, variable.name] = np.ones(sizes, dtype=bool)
        todo = {ref for ref in asked.cells if ref[0] not in asked.seen_only}
        return Work(asked, {ref: ref for ref in asked.cells}, todo)

    def target(self, cell: Cell) -> None: ...

    def place(self, ref: CellRef, variable: str) -> Array | None:
        path = self.layout.home.get(ref)
        whole = self.whole.get((path, variable)) if path else None
        return None if path is None or whole is None else whole[self.layout.groups[path].cells[ref]]

    def finished(
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, CellArrays]
    ) -> Mapping[CellRef, CellArrays]:
        for report in reports:
            self.status[self.number((report.stage, report.index))] = STATUS.index(report.status) + 1
        return {ref: self._put(ref, found) for ref, found in arrays.items()}

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        return Standing(self, others)

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool:
        return True

    def close(self, tables: Document, sheet: ContactSheet | None, failed: bool) -> tuple[xarray.DataTree, list[Path]]:
        return self._tree({**tables, "frames": sheet.table} if sheet and sheet.table else tables), []

    def placed(self, ref: CellRef) -> dict[str, Array]:
        """Return the arrays of a cell as views into the results."""
        path = self.layout.home.get(ref)
        if path is None:
            return {}
        group = self.layout.groups[path]
        index = group.cells[ref]
        found = {name: self.whole[path, name][index] for name in group.variables if not self.missing[path, name][index]}
        for name in group.same_as if self.status[self.number(ref)] == STATUS.index("left_out") + 1 else ():
            if (array := self.placed(self.plan.stored(ref, name)).get(name)) is not None:
                found[name] = array
        return found

    def _put(self, ref: CellRef, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Copy a cell into its place; return its arrays as views of this place, and variables that are not kept
        unchanged.
        """
        path = self.layout.home.get(ref)
        placed = {}
        for name, array in arrays.items():
            whole: Any = self.whole.get((path, name)) if path else None
            if path is None or whole is None:
                placed[name] = array
                continue
            index = self.layout.groups[path].cells[ref]
            # otherwise the cell has written into its place directly
            if type(array) is not np.ndarray or array.base is not whole:
                whole[index] = array
            self.missing[path, name][index] = False
            placed[name] = whole[index]
        return placed

    def _dataset(self, path: str, layout: GroupLayout, coordinates: _Coordinates) -> xarray.Dataset:
        sizes = tuple(len(values) for values in layout.axes.values())
        data: dict[str, _Column] = {}
        for variable in layout.variables.values():
            whole, missing = self.whole[path, variable.name], self.missing[path, variable.name]
            if missing.any():
                whole[missing] = np.nan if whole.dtype.kind == "f" else 0
            data[variable.name] = ((*variable.axes, *variable.dims), whole, variable.attrs)
        data |= {name: self._shared(layout, name, place) for name, place in layout.same_as.items()}
        flags = np.full(sizes, STATUS.index("not_computed"), np.uint8)
        for ref, index in layout.cells.items():
            if status := self.status[self.number(ref)]:
                flags[index] = status - 1
        data["status"] = (tuple(layout.axes), flags, STATUS_ATTRIBUTES)
        found: dict[str, _Column] = {  # a variable named like its own axis replaces the axis values, as in the store
            name: (c.dims, np.asarray(c.values), c.attrs) for name, c in layout.coordinates.items() if name not in data
        }
        for name in [name for name in found if str(name).endswith((BOUNDS, ROW))]:
            data[name] = found.pop(name)
        beside = {name for variable in layout.variables.values() for name in coordinates_of(layout, variable)}
        found |= {name: data.pop(name) for name in beside}
        return xarray.Dataset(data, coordinates.of(found), layout.attrs)

    def _shared(self, layout: GroupLayout, name: str, place: str) -> _Column:
        """Return a variable whose cells are all left out: a read-only view of the array that has its values, repeated
        along the axes that only this stage has.
        """
        path = place[1:].rpartition("/")[0]
        source, whole = self.layout.groups[path].variables[name], self.whole[path, name]
        missing = self.missing[path, name]
        if missing.any():
            whole[missing] = np.nan if whole.dtype.kind == "f" else 0
        order = [list(layout.axes).index(axis) for axis in source.axes]
        view = whole.transpose(*np.argsort(order), *range(len(order), whole.ndim))
        taken: list[Any] = []
        for number, (axis, values) in enumerate(layout.axes.items()):
            if axis not in source.axes:
                view = np.expand_dims(view, number)
                continue
            own = {value: at for at, value in enumerate(self.layout.groups[path].axes[axis])}
            places = [own[value] for value in values]
            if places != list(range(len(own))):
                taken.append((number, places))
        for number, places in taken:  # the group of one shape may have only some of the axis values
            view = np.take(view, places, number)
        sizes = tuple(len(values) for values in layout.axes.values())
        shared = np.broadcast_to(view, (*sizes, *source.shape))
        return (*layout.axes, *source.dims), shared, source.attrs

    def _tree(self, tables: Mapping[str, Mapping[str, Any]]) -> xarray.DataTree:
        """Return the tree: the groups of all stages, and the tables (ledger, summary, frames) beside them."""
        coordinates = _Coordinates()
        groups: dict[str, xarray.Dataset] = {
            node: xarray.Dataset(attrs=attrs) for node, attrs in self.layout.parents.items()
        }
        groups |= {path: self._dataset(path, group, coordinates) for path, group in self.layout.groups.items()}
        for name, table in tables.items():
            columns = {}
            for column, (dims, values, attrs) in table["arrays"].items():
                array = np.asarray(values)
                # text is not searched for times, which takes pandas longer than all else here
                text = array.dtype == object and all(type(value) is str for value in array.flat)
                columns[column] = xarray.Variable(dims, array.copy() if text else array, attrs, fastpath=text)
            groups[name] = xarray.Dataset(columns, attrs=table.get("attrs", {}))
        tree = _tree_of(groups)
        tree.attrs["pipeline"] = self.plan.pipeline.name
        return tree


class _Coordinates:
    """The coordinates of groups. Indexes with the same numbers share one read-only array, because creating an array
    takes ten times as long.
    """

    def __init__(self) -> None:
        self.known: dict[tuple[str, str, bytes], tuple[pandas.Index[Any], xarray.Variable]] = {}

    def of(self, found: Mapping[str, _Column]) -> xarray.Coordinates:
        variables: dict[str, xarray.Variable] = {}
        indexes: dict[str, PandasIndex] = {}
        for name, (dims, values, attrs) in found.items():
            if tuple(dims) == (name,):
                indexes[name], shown = self._index(name, values)
                variables[name] = shown.copy(deep=False)
                variables[name].attrs.update(attrs)
            else:
                variables[name] = xarray.Variable(dims, values, attrs)
        return xarray.Coordinates(variables, indexes)

    def _index(self, name: str, values: Array) -> tuple[PandasIndex, xarray.Variable]:
        """Return a new index of a coordinate, and a variable without attributes that holds it. Indexes with the same
        numbers share one array.
        """
        given = {name: xarray.Variable((name,), values)}
        if values.dtype.kind not in "fiu":  # pandas stores text in its own array types
            index = PandasIndex.from_variables(given, options={})
            return index, index.create_variables(given)[name]
        key = name, values.dtype.str, values.tobytes()
        if key not in self.known:
            frozen = values.copy()
            frozen.setflags(write=False)
            bare = pandas.Index(frozen, copy=False)
            self.known[key] = bare, PandasIndex(bare, name, values.dtype).create_variables(given)[name]
        bare, shown = self.known[key]
        return PandasIndex(bare.rename(name), name, values.dtype), shown


def _tree_of(groups: Mapping[str, xarray.Dataset]) -> xarray.DataTree:
    """Return the same tree as ``DataTree.from_dict``, which would copy every group twice."""
    children: dict[str, dict[str, xarray.DataTree]] = {"": {}}
    for path, dataset in groups.items():
        parent, _, name = path.rpartition("/")
        children.setdefault(parent, {})[name] = xarray.DataTree(dataset)
    tree = xarray.DataTree()
    tree.children = children.pop("")
    for parent, own in children.items():
        tree.children[parent].children = own
    return tree
