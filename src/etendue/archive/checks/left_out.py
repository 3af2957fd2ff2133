"""Examine the variables without an array: check that the archive has the arrays that their groups name.

In:  an archive open for reading, and its groups on disk.
Out: the damage: groups that name another array than the journal does, arrays that cannot have the values, cells whose
     values are lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.read.following import Followed, fault_of
from etendue.archive.read.inspection import Damage
from etendue.archive.read.stored import Stored
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import SAME_AS, cell_label, paths_of


def left_out_damage(stored: Stored) -> Iterator[Damage]:
    """Yield the faults of the variables without an array."""
    yield from _named_otherwise(stored)
    reached = {cell.name for one in stored.archive.followed for cell, _ in one.cells.values()}
    for one in stored.archive.followed:
        node = f"{one.group}/{one.variable}"
        why = fault_of(stored.journal, one.group, one.variable) or _other_shape(stored, one)
        if why:
            yield Damage("changed", JOURNAL, f"{node} has no array of its own, and {why}", node)
        for name in _cells(stored, one):
            if name not in reached:
                yield Damage("changed", JOURNAL, f"no cell with an equal key in {one.path} has its values", node, name)


def _named_otherwise(stored: Stored) -> Iterator[Damage]:
    """Yield groups whose attribute ``same_as`` differs from the journal."""
    for group in sorted(stored.journal.axes.keys() | stored.journal.same.keys()):
        path = f"{DATA}/{group}/zarr.json"
        document = disk.read_document(stored.folder / path)
        attrs = document.get("attributes") if document else None
        if not isinstance(attrs, dict):
            continue  # reported as missing or changed
        said, known = paths_of(attrs), list(stored.journal.same.get(group, {}).values())
        if said != known:
            yield Damage(
                "changed", path, f"its {SAME_AS} is {said or 'missing'}, but the journal says {known or 'none'}"
            )


def _other_shape(stored: Stored, one: Followed) -> str:
    """Return a text that says how the shape of an array differs from the coordinates of its group; '' if it does not
    differ.
    """
    document = disk.read_document(stored.folder / DATA / one.path[1:] / "zarr.json") or {}
    dims, axes = document.get("dimension_names") or [], stored.journal.axes[one.source]
    inner = [str(dim) for dim in dims if dim not in axes]
    shape = stored.archive.form(one.source, one.variable).shape
    for dim, size in zip(inner, shape, strict=False):
        own = disk.read_document(stored.folder / DATA / one.group / dim / "zarr.json") or {}
        if own.get("shape") not in (None, [size]):
            return f"{one.path} has {size} values along {dim}, not {own['shape']}"
    return "" if len(inner) == len(shape) else f"{one.path} has another number of dims than its chunks"


def _cells(stored: Stored, one: Followed) -> Iterator[str]:
    """Yield the names of the finished cells of a group that were left out."""
    axes = stored.journal.axes.get(one.group, {})
    for at in product(*(range(len(values)) for values in axes.values())) if one.group in stored.journal.axes else ():
        labels = {dim: values[i] for i, (dim, values) in zip(at, axes.items(), strict=True)}
        name = cell_label(one.group.split("/")[0], labels)
        cell = stored.archive.cells.get(name)
        if cell is not None and cell.entry.status == "left_out":
            yield name
