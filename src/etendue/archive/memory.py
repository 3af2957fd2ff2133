"""The same tree without an archive: results in memory as an ``xarray.DataTree``.

In:  the layout of a plan and the arrays of its cells.
Out: what ``xarray.open_datatree`` gives for the archive of the same plan.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray

from etendue.archive.layout import BOUNDS, STATUS, STATUS_ATTRIBUTES, GroupLayout, layout_of
from etendue.plan.model import CellRef, Plan


def _dataset(layout: GroupLayout, arrays: Mapping[CellRef, Mapping[str, Any]], status: Mapping[CellRef, str]) -> xarray.Dataset:
    sizes = tuple(len(values) for values in layout.axes.values())
    data: dict[str, Any] = {}
    for variable in layout.variables.values():
        fill = np.nan if variable.dtype.startswith("float") else 0
        whole = np.empty((*sizes, *variable.shape), dtype=variable.dtype)
        missing = np.ones(sizes, dtype=bool)
        for ref, index in layout.cells.items():
            if variable.name in arrays.get(ref, {}):
                whole[index] = arrays[ref][variable.name]
                missing[index] = False
        if missing.any():
            whole[missing] = fill
        data[variable.name] = ((*variable.axes, *variable.dims), whole, variable.attrs)
    flags = np.full(sizes, 4, np.uint8)
    for ref, index in layout.cells.items():
        if ref in status:
            flags[index] = STATUS.index(status[ref])
    data["status"] = (tuple(layout.axes), flags, STATUS_ATTRIBUTES)
    coordinates = {name: (c.dims, np.asarray(c.values), c.attrs) for name, c in layout.coordinates.items()}
    if BOUNDS in coordinates:
        data[BOUNDS] = coordinates.pop(BOUNDS)
    return xarray.Dataset(data, coordinates, layout.attrs)


def tree_of(
    plan: Plan,
    arrays: Mapping[CellRef, Mapping[str, Any]],
    status: Mapping[CellRef, str],
    tables: Mapping[str, Mapping[str, Any]],
) -> xarray.DataTree:
    """Groups by stage, with ledger, summary and frames beside them."""
    layout = layout_of(plan)
    groups: dict[str, xarray.Dataset] = {node: xarray.Dataset(attrs=attrs) for node, attrs in layout.parents.items()}
    groups |= {path: _dataset(group, arrays, status) for path, group in layout.groups.items()}
    for name, table in tables.items():
        columns = {column: (dims, np.asarray(values), attrs) for column, (dims, values, attrs) in table["arrays"].items()}
        groups[name] = xarray.Dataset(columns, attrs=table.get("attrs", {}))
    tree = xarray.DataTree.from_dict({f"/{path}": dataset for path, dataset in groups.items()})
    tree.attrs["pipeline"] = plan.pipeline.name
    return tree
