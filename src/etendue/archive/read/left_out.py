"""Add variables without an array to trees that xarray has opened: the group of each variable names the array with its
values.

In:  the groups of a tree, opened by plain xarray or from an object store.
Out: the same groups, with lazy variables for variables whose cells are all left out.

The named array must have the same name, be stored in a group of the same tree, and have no other axes; an array that
was itself added in this way is not accepted. Therefore changed attributes cannot cause an endless loop or lead out of
the tree.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core import indexing

from etendue.archive.records.names import SAME_AS, paths_of


def with_left_out(groups: Mapping[str, xarray.Dataset]) -> dict[str, xarray.Dataset]:
    """Return groups by path, each with its variables without an array."""
    found = dict(groups)
    for path, group in groups.items():
        for text in paths_of(group.attrs):
            there, _, name = text.strip("/").rpartition("/")
            source = groups.get(there)
            if source is None or name not in source.data_vars or name in group.variables or "status" not in group:
                continue
            shared = _shared(group, source, name)
            if shared is not None:
                found[path] = found[path].assign({name: shared})
    return found


def tree_with_left_out(tree: xarray.DataTree) -> xarray.DataTree:
    """Return a tree in which the variables without an array are added; the same tree if there are none."""
    named = [node.path for node in tree.subtree if SAME_AS in node.attrs]
    if not named:
        return tree
    groups = {node.path.strip("/"): node.to_dataset(inherit=False) for node in tree.subtree}
    found = with_left_out(groups)
    whole = xarray.DataTree.from_dict({f"/{path}": data for path, data in found.items()})
    whole.encoding.update(tree.encoding)
    return whole


def _shared(group: xarray.Dataset, source: xarray.Dataset, name: str) -> xarray.Variable | None:
    """Return the variable of another group, extended to the axes of this group; None if their coordinates differ."""
    variable, axes = source.variables[name], [str(dim) for dim in group["status"].dims]
    there = [str(dim) for dim in source["status"].dims] if "status" in source else []
    if not set(there) <= set(axes) or any(dim not in group.sizes for dim in variable.dims):
        return None
    places: dict[str, Any] = {}
    for dim in map(str, variable.dims):
        if dim in there:
            known = {value: at for at, value in enumerate(source[dim].values.tolist())}
            wanted = [known.get(value) for value in group[dim].values.tolist()]
            if None in wanted:
                return None
            places[dim] = np.array(wanted)
        elif group.sizes[dim] != source.sizes[dim]:
            return None
    dims = (*axes, *(str(dim) for dim in variable.dims if dim not in axes))
    lazy = _Repeated(variable, dims, tuple(group.sizes[dim] for dim in dims), places)
    return xarray.Variable(dims, indexing.LazilyIndexedArray(lazy), variable.attrs)


class _Repeated(BackendArray):
    """A lazy variable, repeated along axes that it lacks."""

    def __init__(
        self, variable: xarray.Variable, dims: tuple[str, ...], shape: tuple[int, ...], places: Mapping[str, Any]
    ) -> None:
        self.variable, self.dims, self.shape, self.places = variable, dims, shape, places
        self.dtype = variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._part)

    def _part(self, key: tuple[Any, ...]) -> Any:
        picks = dict(zip(self.dims, key, strict=True))
        own = {d: self.places[d][picks[d]] if d in self.places else picks[d] for d in map(str, self.variable.dims)}
        part = self.variable.isel(own)
        left = [
            (d, np.arange(n)[picks[d]].size)
            for d, n in zip(self.dims, self.shape, strict=True)
            if np.ndim(np.arange(n)[picks[d]])
        ]
        values = np.asarray(part.transpose(*(d for d, _ in left if d in part.dims)).values)
        values = values[tuple(slice(None) if d in part.dims else None for d, _ in left)]
        return np.broadcast_to(values, tuple(n for _, n in left))
