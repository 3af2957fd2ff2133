"""The content of a tree that can be plotted: metrics, curves and pictures of every stage, over the axes of its sweep.

In:  an ``xarray.DataTree`` from ``open_archive``, xarray or ``simulate``.
Out: ``HeldVariable`` by stage and variable; its values over the whole sweep, with the groups of a stage joined, NaN
     where a cell failed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray

from etendue.archive.read.left_out import tree_with_left_out
from etendue.archive.records.names import ROW
from etendue.archive.structure.layout import BOUNDS
from etendue.contract.arrays.variables import Variable, without
from etendue.contract.arrays.variables import variable as known
from etendue.contract.values.names import STUDY, TABLES
from etendue.errors import ArchiveError, EtendueError, RequestError, nearest
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue, AxisValues, Document, DocumentView

PLANE = ("y", "x")
FINISHED = (0, 1)  # values of status: done, left out
FAILED = (2, 3)  # failed, skipped
BESIDE = ("status",)
ANY = "ARCHIVE"
KINDS = ("figure", "curve", "picture", "other")
SHOWN = {"figure": "metric"}  # kinds whose displayed name differs


@dataclass(frozen=True)
class HeldVariable:
    """One variable of one stage."""

    stage: str
    variable: str
    groups: tuple[xarray.Dataset, ...] = field(repr=False)  # one group, or one for each shape
    # order of names along axes, as swept
    order: Mapping[str, Mapping[AxisValue, int]] = field(default_factory=dict, repr=False)
    archive: str = field(default=ANY, repr=False)  # name of the archive in suggested commands

    @property
    def name(self) -> str:
        return f"{self.stage}.{self.variable}"

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of the sweep that affect the variable."""
        first = self.groups[0]
        return tuple(str(dim) for dim in first["status"].dims) if "status" in first else ()

    @property
    def dims(self) -> tuple[str, ...]:
        """The variable's own dims, which follow the axes."""
        return tuple(str(dim) for dim in self.groups[0][self.variable].dims if dim not in self.axes)

    @property
    def attrs(self) -> DocumentView:
        return self.groups[0][self.variable].attrs

    @property
    def units(self) -> str:
        return str(self.attrs.get("units", "1"))

    @property
    def known(self) -> Variable:
        return known(self.variable)

    @property
    def caption(self) -> str:
        """The title of the variable, with its error if measured."""
        return f"{self.title}, {self.error_text}" if self.error_text else self.title

    @property
    def error_text(self) -> str:
        """The error of the variable as text, such as ``\u00b10.03 cycles/mm (bins 0.02)``; '' if unknown."""
        return str(self.attrs.get("error_parts", ""))

    @property
    def title(self) -> str:
        """The title of the variable, without its unit. It names the stages that the metric does not include."""
        own = str(self.attrs.get("long_name", self.variable.replace("_", " ")))
        shown = ", line pairs per mm" if self.units in ("cycles/mm", "mm-1") else ""
        return own.removesuffix(shown) + without(self.attrs)

    @property
    def kind(self) -> str:
        """``figure``: one number per cell, or one per name; ``curve``: numbers over one numeric dim; ``picture``: over
        y and x.
        """
        own = self.dims
        if own[-2:] == PLANE:
            return "picture"
        counted = [dim for dim in own if self.is_counted(dim)]
        return ("figure", "curve")[len(counted)] if len(counted) < 2 else "other"

    def is_counted(self, dim: str) -> bool:
        """Return whether a dim runs over numbers rather than names."""
        coordinate = self.groups[0].get(dim)
        return coordinate is None or coordinate.dtype.kind in "fiu"

    def values_of(self, dim: str) -> list[Any]:
        """Return the values along an axis or a dim in all groups; along an axis, numbers are sorted."""
        found: dict[Any, None] = {}
        for group in self.groups:
            if dim in group.coords:
                found.update(dict.fromkeys(group[dim].values.tolist()))
            else:
                found.update(dict.fromkeys(range(group.sizes[dim])))
        values = list(found)
        if dim not in self.axes:
            return values
        place = self.order.get(dim, {})
        return (
            sorted(values, key=lambda v: place.get(v, len(place)))
            if any(isinstance(v, str) for v in values)
            else sorted(values)
        )

    def units_of(self, dim: str) -> str:
        group = self.groups[0]
        return str(group[dim].attrs.get("units", "1")) if dim in group.coords else "1"

    def key_of(self, dim: str) -> str:
        """Return the parameter that an axis sets: ``pixel.rows`` for ``pixel_rows``."""
        group = self.groups[0]
        return str(group[dim].attrs.get("parameter", dim)) if dim in group.coords else dim

    def values(self, at: AxisValues | None = None) -> xarray.DataArray:
        """Return the values of all cells, or of the cells at the axis values ``at``, as float64 with NaN for missing
        cells.

        Raises
        ------
        ArchiveError
            The stored values cannot be read.
        """
        return self._joined(self.variable, at or {})[0]

    def failed(self, at: AxisValues | None = None) -> xarray.DataArray:
        """Return a mask over the axes: cells that failed, or were skipped because an earlier cell failed."""
        return self._joined(self.variable, at or {})[1]

    def there(self, at: AxisValues | None = None) -> xarray.DataArray:
        """Return a mask over the axes: cells that are finished."""
        return self._joined(self.variable, at or {})[2]

    def _joined(self, variable: str, at: AxisValues) -> tuple[xarray.DataArray, xarray.DataArray, xarray.DataArray]:
        axes = [dim for dim in self.axes if dim not in at]
        labels = {dim: self.values_of(dim) for dim in axes}
        whole: Any = None
        failed = np.zeros([len(own) for own in labels.values()], bool)
        finished = failed.copy()
        dims: tuple[str, ...] = ()
        coords: Document = {}
        for group in self.groups_at(at):
            array, flags = self._cells(group, variable, at, axes)
            dims = tuple(str(dim) for dim in array.dims if dim not in axes)
            coords |= {dim: group[dim] for dim in dims if dim in group.coords}
            own = array.transpose(*axes, *dims).values.astype(np.float64)
            if whole is None:
                whole = np.full((*failed.shape, *own.shape[len(axes) :]), np.nan)
            elif whole.shape[len(axes) :] != own.shape[len(axes) :]:
                raise RequestError(f"{self.name} changes shape along {' and '.join(axes)}: choose one value")
            place: Any = (
                np.ix_(*([labels[dim].index(v) for v in group[dim].values.tolist()] for dim in axes)) if axes else ...
            )
            there = np.isin(flags, FINISHED)
            whole[place] = np.where(there[(..., *[None] * len(dims))], own, whole[place])
            finished[place] |= there
            failed[place] |= np.isin(flags, FAILED)
        if whole is None:
            raise RequestError(f"{self.name} was not computed at {', '.join(f'{k}={v}' for k, v in at.items())}")
        first = self.groups[0]
        over = {dim: _variable((dim,), np.array(own), first[dim].attrs) for dim, own in labels.items()}
        values = xarray.DataArray(
            _variable((*axes, *dims), whole), {**over, **coords}, (*axes, *dims), variable, dict(first[variable].attrs)
        )
        masks = [xarray.DataArray(_variable(axes, own), over, tuple(axes)) for own in (failed, finished)]
        return values, masks[0], masks[1]

    def groups_at(self, at: AxisValues) -> list[xarray.Dataset]:
        """Return the groups that have cells at some values of the axes."""
        own = {dim: value for dim, value in at.items() if dim in self.axes}
        return [
            group for group in self.groups if all(value in group[dim].values.tolist() for dim, value in own.items())
        ]

    def _cells(
        self, group: xarray.Dataset, variable: str, at: AxisValues, axes: Sequence[str]
    ) -> tuple[xarray.DataArray, Array]:
        """Return a variable of a group at some values, and the status of each cell over the axes."""
        chosen = group[[variable, *(["status"] if "status" in group else [])]].sel(
            {k: v for k, v in at.items() if k in group.coords}
        )
        array = _loaded(chosen[variable], self)
        if "status" not in chosen:
            return array, np.zeros([array.sizes[dim] for dim in axes])
        return array, _loaded(chosen["status"], self).transpose(*axes).values


def _variable(dims: Sequence[str], array: Array, attrs: DocumentView | None = None) -> xarray.Variable:
    """Return a variable with a numpy array. Without ``fastpath``, xarray imports dask, which takes 0.2 s."""
    return xarray.Variable(dims, array, attrs, fastpath=True)


def rows_of(group: xarray.Dataset, dim: str) -> xarray.DataArray | None:
    """Return, for every row of a design, its entry along ``dim``, a dim of combinations of factors; None for any other
    dim.
    """
    rows = group.get(f"{dim}{ROW}")
    if rows is None or rows.ndim != 1 or dim not in group.coords or rows.dims[0] not in group.coords:
        return None
    return rows if set(rows.values.tolist()) <= set(group[dim].values.tolist()) else None


def by_row(group: xarray.Dataset) -> xarray.Dataset:
    """Return a group with one entry for every row of a design, instead of one for every combination of factors."""
    for dim in [str(dim) for dim in group.dims]:
        rows = rows_of(group, dim)
        if rows is not None:
            group = group.drop_vars(f"{dim}{ROW}").sel({dim: rows.reset_coords(drop=True)}).drop_vars(dim)
    return group


class Holdings:
    """Everything in a tree that can be plotted."""

    def __init__(self, tree: xarray.DataTree | xarray.Dataset, archive: str = ANY) -> None:
        self.archive = archive
        self.source = str(tree.encoding.get("source", ""))  # where an archive has its arrays; '' in memory
        tree = xarray.DataTree(tree) if isinstance(tree, xarray.Dataset) else tree_with_left_out(tree)
        self.tree = tree
        self.held: dict[tuple[str, str], HeldVariable] = {}
        self.whites: dict[tuple[Any, ...], float | None] = {}  # value shown as white, by picture
        stages = [(stage, [by_row(group) for group in groups]) for stage, groups in _stages(tree)]
        self.order = self._order(group for _, groups in stages for group in groups)
        for stage, groups in stages:
            for name in groups[0].data_vars:
                if str(name) not in BESIDE and not str(name).endswith(BOUNDS) and groups[0][name].dtype.kind in "fiub":
                    own = tuple(group for group in groups if name in group)
                    self.held[stage, str(name)] = HeldVariable(stage, str(name), own, self.order, archive)

    def __iter__(self) -> Iterator[HeldVariable]:
        return iter(self.held.values())

    def of_kind(self, *kinds: str) -> list[HeldVariable]:
        return [one for one in self if one.kind in kinds]

    @property
    def axes(self) -> dict[str, list[Any]]:
        """Every axis of the sweep with its values: names in the order of the sweep, numbers unchanged."""
        found: dict[str, dict[Any, None]] = {}
        for one in self:
            for dim in one.axes:
                found.setdefault(dim, {}).update(dict.fromkeys(one.values_of(dim)))
        for dim, order in self.order.items():
            if dim in found:
                found[dim] = dict.fromkeys(value for value in order if value in found[dim]) | found[dim]
        return {dim: list(values) for dim, values in found.items()}

    def _order(self, groups: Iterable[xarray.Dataset]) -> dict[str, dict[AxisValue, int]]:
        """Return the position of each name along each axis, in the order of the sweep: from the ledger, else from the
        groups, the one with most names first.
        """
        ledger = self.table("ledger")
        found: dict[str, dict[AxisValue, None]] = {}
        along: dict[str, list[list[str]]] = {}
        for group in groups:
            for dim in map(str, group["status"].dims if "status" in group else ()):
                if dim in group.coords and group[dim].dtype.kind not in "fiub":
                    along.setdefault(dim, []).append(list(map(str, group[dim].values.tolist())))
        for dim, lists in along.items():
            told = ledger[f"at_{dim}"].values.tolist() if ledger is not None and f"at_{dim}" in ledger else []
            found[dim] = dict.fromkeys(filter(None, map(str, told)))
            for own in sorted(lists, key=len, reverse=True):
                found[dim].update(dict.fromkeys(own))
        return {dim: {value: place for place, value in enumerate(values)} for dim, values in found.items()}

    def find(self, name: str, *kinds: str) -> HeldVariable:
        """Return a variable by its name, or by ``stage.variable``; if several stages wrote it, the variable of the last
        stage.

        Raises
        ------
        RequestError
            No such variable exists, or it has another kind; the message lists the nearest names.
        """
        stage, _, variable = name.rpartition(".")
        found = [one for one in self if one.variable == variable and stage in ("", one.stage)]
        right = [one for one in found if not kinds or one.kind in kinds]
        if right:
            return right[-1]
        wanted = self.of_kind(*kinds) if kinds else list(self)
        names = [one.name for one in wanted] if stage else [one.variable for one in wanted]
        if found:
            dims = ", ".join((*found[-1].axes, *found[-1].dims)) or "none"
            way = {
                "picture": "; plot it with show or strip",
                "figure": "; plot it with map, curves or pareto",
                "curve": "; plot it with curves",
            }
            own, others = (SHOWN.get(found[-1].kind, found[-1].kind), " or ".join(SHOWN.get(k, k) for k in kinds))
            raise RequestError(f"{name} is a {own} (dims: {dims}), not a {others}{way.get(found[-1].kind, '')}")
        raise RequestError(
            f"unknown variable {name!r}{nearest(name, names)}; to list all: etendue plot {self.archive} --list"
        )

    def table(self, name: str) -> xarray.Dataset | None:
        """Return a table next to the stages: ``ledger``, ``summary``, ``frames``."""
        node = self.tree.children.get(name)
        return node.to_dataset() if node is not None and node.data_vars else None

    @property
    def pipeline(self) -> str:
        own = self.tree.attrs.get("etendue", {})
        return str(self.tree.attrs.get("pipeline") or (own.get("pipeline", "") if isinstance(own, Mapping) else ""))


def _stages(tree: xarray.DataTree) -> list[tuple[str, list[xarray.Dataset]]]:
    """Return the stages in order, each with its non-empty groups."""
    found = []
    tops = [one for name, one in tree.children.items() if name not in TABLES and STUDY not in one.attrs] or [tree]
    if "status" in tree.data_vars or (tree.data_vars and not tree.children):  # a single stage
        tops = [tree]
    for node in sorted(tops, key=lambda node: int(node.attrs.get("order", 10**6))):
        groups = [part.to_dataset(inherit=False) for part in node.subtree if part.data_vars]
        if groups:
            # one shape of a stage
            shape = node.parent is not None and "order" not in node.attrs and "order" in node.parent.attrs
            found.append(
                (str(node.parent.name if shape and node.parent else node.name or node.attrs.get("stage", "")), groups)
            )
    return found


def _loaded(array: xarray.DataArray, held: HeldVariable) -> xarray.DataArray:
    try:
        return array.load()
    except EtendueError:
        raise
    except Exception as error:  # whatever zarr and its codecs raise on bytes that do not match their checksum
        mend = f"Repair it: etendue verify {held.archive} --repair"
        raise ArchiveError(f"{held.name} cannot be read ({error}): the archive is damaged. {mend}") from error
