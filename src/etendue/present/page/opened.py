"""An archive opened for display: its axes, its stages with their variables, and arrays of single cells, even while a
run is in progress.

In:  the folder of an archive.
Out: ``Opened``. Arrays are read from the places recorded in the journal, and checked against its digests. Nothing is
     written.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from etendue.archive.checks.describe import order_of, progress
from etendue.archive.journaling.entries import Entry
from etendue.archive.read.left_out import with_left_out
from etendue.archive.read.reading import metadata_of
from etendue.archive.read.shard_columns import shard_column
from etendue.archive.read.stored import Stored
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import cell_label
from etendue.archive.records.owner import is_running
from etendue.archive.records.past_runs import latest_record, records
from etendue.archive.sharding.shards import ShardFiles
from etendue.archive.sharding.unfolding import check_group
from etendue.archive.structure.layout import BOUNDS
from etendue.errors import ArchiveError
from etendue.present.plots.holdings import by_row, rows_of
from etendue.present.plots.labels import places_text
from etendue.present.plots.rows import rounded
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue, Document

PLANE = ("y", "x")
FINISHED = ("done", "left_out")


@dataclass(frozen=True)
class ArchivedAxis:
    """One axis of the sweep, over all groups and runs of the archive; numbers are sorted."""

    dim: str
    key: str  # the parameter, such as "sharpen.strength"
    label: str
    units: str
    values: tuple[AxisValue, ...]

    @cached_property
    def places(self) -> Mapping[AxisValue, int]:
        return {value: place for place, value in enumerate(self.values)}

    factors: tuple[str, ...] = ()  # by value: the factors that change along the axis, as text

    @property
    def text(self) -> bool:
        return any(isinstance(value, str) for value in self.values)


@dataclass(frozen=True)
class ShownGroup:
    """One group of the store: a stage, or one shape of it."""

    stage: str
    path: str
    axes: Mapping[str, list[AxisValue]]  # values by dim, as stored
    data: xarray.Dataset
    # for each dim of rows that share combinations of factors: the stored dim, and the combination of each row
    combined: Mapping[str, tuple[str, Mapping[AxisValue, AxisValue]]] = field(default_factory=dict)

    def cell(self, labels: Mapping[str, AxisValue]) -> str:
        """Return the name of a cell in the journal."""
        own = {
            self.combined[dim][0] if dim in self.combined else dim: (
                self.combined[dim][1][value] if dim in self.combined else value
            )
            for dim, value in labels.items()
        }
        return cell_label(self.stage, own)

    @property
    def variables(self) -> dict[str, tuple[str, ...]]:
        """The dims of every variable of one cell, without sweep axes."""
        found = {
            str(name): tuple(str(dim) for dim in own.dims if dim not in self.axes)
            for name, own in self.data.data_vars.items()
        }
        return {
            name: dims
            for name, dims in found.items()
            if name != "status" and not name.endswith(BOUNDS) and not name.endswith("_um")
        }


class Opened:
    """An archive in its current state.

    Attributes
    ----------
    record : the record of the last run: parameters, versions, platform
    running : whether a run is writing to the archive
    ended : whether the last run is finished, so that its tables are valid
    damaged : requested parts that are damaged
    whites : linear value shown as white, by the picture that sets it: stage, variable, positions on its axes
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.running = is_running(folder)
        self.stored = Stored(folder)
        self.damaged: set[str] = set()
        self.whites: dict[tuple[Hashable, ...], float] = {}
        record = latest_record(folder)
        if record is None:
            why = (
                "a run is starting; try again in a moment"
                if self.running
                else "no readable run record; run etendue verify"
            )
            raise ArchiveError(f"{folder}: {why}")
        self.record: Document = record
        self.ended = self.stored.manifest is not None and not self.running
        if self.stored.manifest is not None and not self.running and (changed := self.stored.manifest.changed(folder)):
            raise ArchiveError(
                f"{folder / changed[0]} is missing or has changed since it was written. Repair it: etendue verify "
                f"{folder} --repair"
            )

    @property
    def entries(self) -> Mapping[str, Entry]:
        """The last journal entry of every cell."""
        return self.stored.journal.entries

    @cached_property
    def stages(self) -> list[str]:
        """Stage names in the order of the pipeline."""
        return order_of(self.folder / DATA, self.record)

    @cached_property
    def runs(self) -> list[Document]:
        return records(self.folder)

    @cached_property
    def progress(self) -> Document:
        """How many cells the last run requested and how many are finished; during a run also the rate (cells/s) and the
        remaining time (s).
        """
        return progress(self.stored.journal, str(self.record["began"]) if self.running else "")

    @cached_property
    def groups(self) -> Mapping[str, list[ShownGroup]]:
        """Groups that hold arrays, by stage."""
        found: dict[str, list[ShownGroup]] = {stage: [] for stage in self.stages}
        opened: dict[str, xarray.Dataset] = {}
        for path in self.stored.journal.axes:
            stage = path.split("/")[0]
            if stage not in found or not (self.folder / DATA / path / "zarr.json").is_file():
                continue
            with metadata_of(self.folder):
                check_group(self.folder / DATA / path)
                data = xarray.open_dataset(
                    str(self.folder / DATA), engine="zarr", group=path, chunks=None, consolidated=False
                )
            opened[path] = data
        for path, data in with_left_out(opened).items():
            found[path.split("/")[0]].append(_in_rows(path, self.stored.journal.axes[path], data))
        return found

    @cached_property
    def axes(self) -> tuple[ArchivedAxis, ...]:
        """The axes of all groups, in the order of the sweep."""
        values: dict[str, dict[AxisValue, None]] = {str(dim): {} for dim in self.record["axes"]}
        shown: dict[str, tuple[str, str, str]] = {}
        for group in (one for groups in self.groups.values() for one in groups):
            for dim, own in group.axes.items():
                values.setdefault(dim, {}).update(dict.fromkeys(own))
                attrs = group.data[dim].attrs if dim in group.data.coords else {}
                shown[dim] = tuple(str(attrs.get(name, dim)) for name in ("parameter", "long_name", "units"))  # type: ignore[assignment]
        factors = {dim: words for dim in values if (words := self._factors(dim))}
        found = []
        for dim, known in values.items():
            key, label, units = shown.get(dim, (dim, dim, "1"))
            if ordered := self._ordered(known, key):
                said = tuple(factors[dim].get(value, "") for value in ordered) if dim in factors else ()
                found.append(ArchivedAxis(dim, key, label, "" if units == "1" else units, tuple(ordered), said))
        return tuple(found)

    def _ordered(self, known: Mapping[Any, None], key: str) -> list[AxisValue]:
        """Return numbers in ascending order; names in the order of the sweep, followed by names of earlier runs."""
        if not any(isinstance(value, str) for value in known):
            return sorted(known)
        given = dict.fromkeys(self.record["axes"].get(key, ()))
        return list(dict.fromkeys([*(value for value in given if value in known), *known]))

    def _factors(self, dim: str) -> dict[AxisValue, str]:
        """Return, for each row along a dim, the values of its factors as text; nothing for an ordinary axis."""
        found: dict[AxisValue, dict[str, AxisValue]] = {}
        units: dict[str, str] = {}
        for group in (one for groups in self.groups.values() for one in groups if dim in one.axes):
            for name, own in group.data.coords.items():
                if own.dims == (dim,) and name != dim and "parameter" in own.attrs:
                    units[str(name)] = str(own.attrs.get("units", "1"))
                    for row, value in zip(group.data[dim].to_numpy().tolist(), own.to_numpy().tolist(), strict=True):
                        found.setdefault(row, {})[str(name)] = rounded(value)
        return {row: places_text(values, units) for row, values in found.items()}

    def axis(self, dim: str) -> ArchivedAxis:
        return next(axis for axis in self.axes if axis.dim == dim)

    def reaching(self, stage: str) -> tuple[str, ...]:
        """Return the axes that affect a stage."""
        groups = self.groups.get(stage, [])
        return tuple(groups[0].axes) if groups else ()

    # -- cells ----------------------------------------------------------------------------------------

    def cells(self, group: ShownGroup) -> Iterator[tuple[tuple[int, ...], str]]:
        """Yield every cell of a group: its position on the axes of the sweep, and its name."""
        dims = list(group.axes)
        places = [[self.axis(dim).places[value] for value in group.axes[dim]] for dim in dims]
        shape = tuple(len(own) for own in places)
        for index in np.ndindex(*shape):
            name = group.cell({dim: group.axes[dim][i] for dim, i in zip(dims, index, strict=True)})
            yield tuple(own[i] for own, i in zip(places, index, strict=True)), name

    def find(self, stage: str, at: Mapping[str, int]) -> tuple[ShownGroup, str] | None:
        """Return the group and the name of the stage's cell at positions on the axes; None if there is no such cell."""
        for group in self.groups.get(stage, []):
            labels = {}
            for dim, own in group.axes.items():
                value = self.axis(dim).values[at.get(dim, 0)]
                if value not in own:
                    break
                labels[dim] = own[own.index(value)]  # as it was written: 4 and 4.0 compare equal
            else:
                name = group.cell(labels)
                if name in self.entries:
                    return group, name
        return None

    def status(self, stage: str, at: Mapping[str, int]) -> str:
        found = self.find(stage, at)
        if found is None:
            return "not computed"
        entry = self.entries[found[1]]
        return {"start": "being computed", "removed": "not computed"}.get(entry.event, entry.status.replace("_", " "))

    def has(self, name: str) -> bool:
        entry = self.entries.get(name)
        return entry is not None and entry.event == "done"

    def column(self, group: ShownGroup, variable: str) -> tuple[tuple[Array, ...], Array] | None:
        """Return the values of a variable in all finished cells of a group, and the positions of these cells on each
        axis of the sweep; None if the values must be read cell by cell.
        """
        archive, folder = self.stored.archive, f"{DATA}/{group.path}/{variable}"
        journal = archive.journal
        shards = [path for path in archive.by_shard if path.rpartition("/")[0] == folder]
        if (
            not shards
            or not group.axes
            or group.combined
            or journal.outdated
            or variable in journal.same.get(group.path, ())
        ):
            return None
        with ShardFiles(self.folder) as files:
            found = [shard_column(archive, path, files) for path in shards]
        whole = [own for own in found if own is not None]
        if len(whole) < len(found):
            return None
        places = [[self.axis(dim).places[value] for value in values] for dim, values in group.axes.items()]
        stored = map(np.concatenate, zip(*(archive.positions(path) for path in shards), strict=True))
        return tuple(np.array(own)[at] for own, at in zip(places, stored, strict=True)), np.concatenate(whole)

    def read(self, name: str, variable: str) -> Any:
        """Return the array of a finished cell.

        Raises
        ------
        ArchiveError
            The array was not stored, or it is damaged.
        """
        cell = self.stored.cell(name)
        if variable not in cell.variables:
            raise ArchiveError(f"{self.folder}: {variable} of {name} is not stored")
        try:
            return cell.read(variable)
        except ArchiveError:
            if not self.running:  # if running, a run may be moving it into place
                self.damaged.add(f"{variable} of {name}")
            raise


def _in_rows(path: str, axes: Mapping[str, list[AxisValue]], data: xarray.Dataset) -> ShownGroup:
    """Return a group with one entry per row of a design, even if several rows share a stored combination of factors."""
    stage = path.split("/")[0]
    combined: dict[str, tuple[str, Mapping[AxisValue, AxisValue]]] = {}
    own: dict[str, list[AxisValue]] = {}
    for dim, values in axes.items():
        rows = rows_of(data, dim)
        if rows is None:
            own[dim] = values
            continue
        name = str(rows.dims[0])
        own[name] = data[name].to_numpy().tolist()
        combined[name] = (dim, dict(zip(own[name], rows.to_numpy().tolist(), strict=True)))
    return ShownGroup(stage, path, own, by_row(data) if combined else data, combined)
