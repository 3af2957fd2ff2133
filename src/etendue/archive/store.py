"""The archive of a run: one directory, owned by one run at a time.

paper/
  data.zarr/          one Zarr v3 store, one DataTree: opened by ``xarray.open_datatree`` without etendue
  inputs/             every file parameter, by SHA-256
  journal.jsonl       what is finished
  manifest.json       digests of all metadata, written at close
  runs/               a record of every run: pipeline, versions, platform
  lock  run.id        who owns it
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import shutil
import uuid
import warnings
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec

from etendue.archive.chunks import CODEC, LEVEL, CellFiles, ChunkFile
from etendue.archive.journal import Entry, Journal, fit, is_done
from etendue.archive.layout import BOUNDS, STATUS, STATUS_ATTRIBUTES, GroupLayout, Layout, VariableLayout, cell_name, layout_of
from etendue.errors import ArchiveError, ArchiveInUse, MachineError
from etendue.plan.cost import LARGEST_WHOLE
from etendue.plan.model import Cell, CellRef, Plan
from etendue.spec.ports import CellReport

DATA = "data.zarr"
ABANDONED = "abandoned"  # in place of the owner's id: a stage did not end when the run was interrupted
FILL: dict[str, Any] = {"float32": float("nan"), "float64": float("nan"), "uint8": 0, "uint16": 0, "uint32": 0}
TABLES = ("ledger", "summary", "frames")


def _codecs() -> list[Any]:
    return [BloscCodec(cname=CODEC, clevel=LEVEL, shuffle="bitshuffle"), Crc32cCodec()]  # type: ignore[arg-type]


def put_array(group: Any, name: str, values: Any, dims: tuple[str, ...], attrs: Mapping[str, Any]) -> None:
    """Write one whole small array (a coordinate, a status, a column of a table)."""
    values = np.asarray(values)
    text = values.dtype.kind in "UO"
    own: dict[str, Any] = {"dtype": str} if text else {
        "dtype": values.dtype, "fill_value": float("nan") if values.dtype.kind == "f" else 0, "compressors": _codecs(),
        "config": {"write_empty_chunks": True},
    }  # fmt: skip
    array = group.create_array(
        name, shape=values.shape, chunks=tuple(max(s, 1) for s in values.shape), dimension_names=dims, attributes=dict(attrs),
        overwrite=True, **own,
    )  # fmt: skip
    if values.size:
        array[...] = values.astype(object) if text else values


class Archive:
    """An archive opened for a run. Use as a context manager: the lock is held until it is closed.

    Nothing in the store changes before ``begin``: a refused run leaves an archive as it was.
    """

    def __init__(self, folder: Path, plan: Plan, durable: bool = False) -> None:
        self.folder, self.plan, self.durable = folder.absolute(), plan, durable
        self.layout: Layout = layout_of(plan)
        self.names: dict[CellRef, str] = {ref: cell_name(plan, ref) for ref in plan.cells}
        self.axes: dict[str, dict[str, list[Any]]] = {}  # axis values by group as stored: those of earlier runs first
        self.places: dict[str, list[list[int]]] = {}  # by group and axis: where the plan's values are among the stored ones
        self.damaged: dict[str, int] = {}  # by stage: finished cells whose files are missing or changed
        self.run_id = uuid.uuid4().hex

    # -- opening --------------------------------------------------------------------------------------

    def __enter__(self) -> Archive:
        self._check_ours()
        try:
            (self.folder / DATA).mkdir(parents=True, exist_ok=True)
            self.lock = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise MachineError(f"the archive {self.folder} cannot be written: {error.strerror}") from None
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self.lock)
            raise ArchiveInUse(f"{self.folder} is in use by another run") from None
        try:
            self._check_same_stages()
            self.journal = Journal(self.folder / "journal.jsonl", self.durable)
        except BaseException:
            os.close(self.lock)
            raise
        for path, group in self.layout.groups.items():
            stored = self.journal.axes.get(path, {})
            own = {dim: list(stored.get(dim, ())) for dim in group.axes}
            for dim, values in group.axes.items():
                known = set(own[dim])
                own[dim] += [v for v in values if v not in known]
            self.axes[path] = own
            self.places[path] = [_positions(own[dim], values) for dim, values in group.axes.items()]
        return self

    def __exit__(self, *_: object) -> None:
        self.journal.close()
        os.close(self.lock)

    def _check_ours(self) -> None:
        """Refuse a directory that holds something else: an archive's own store is cleared of what a plan no longer has."""
        if not self.folder.exists():
            return
        names = {p.name for p in self.folder.iterdir()} if self.folder.is_dir() else {""}
        known = "etendue" in self._root_attributes()
        begun = names <= {"lock", "journal.jsonl", "run.id", DATA} and not any(p.is_dir() for p in (self.folder / DATA).glob("*"))
        if not known and not begun:
            raise ArchiveError(f"{self.folder} exists and is not an archive; name another with --archive DIR")

    def _root_attributes(self) -> dict[str, Any]:
        try:
            return json.loads((self.folder / DATA / "zarr.json").read_text()).get("attributes", {})
        except (OSError, ValueError):
            return {}

    def _check_same_stages(self) -> None:
        axes = {node.name: list(node.axes) for node in self.plan.nodes}
        known = self._root_attributes().get("etendue")
        if known and known["axes"] != axes:
            old, new = known["axes"], axes
            what = sorted(set(old) ^ set(new)) or [f"the axes of {n}" for n in new if old.get(n) != new[n]]
            raise ArchiveError(
                f"{self.folder} was made with other stages or axes ({', '.join(map(str, what[:4]))}); both are fixed when an archive "
                f"is created. Use another archive: --archive {self.folder.name}-2"
            )

    # -- what is finished -----------------------------------------------------------------------------

    def finished(self, ref: CellRef) -> bool:
        """Whether a cell needs no computing: the journal says done with its key, and its files are as the journal says."""
        cell = self.plan.cells[ref]
        entry = self.journal.entries.get(self.names[ref])
        if entry is None or not is_done(entry, cell.key):
            return False
        if fit(entry, (chunk.path for chunk in self.chunk_paths(cell)), self.folder):
            return True
        self.damaged[ref[0]] = self.damaged.get(ref[0], 0) + 1
        return False

    def has_files(self, ref: CellRef) -> bool:
        """Whether anything of a cell is stored, right or not."""
        return any((self.folder / chunk.path).exists() for chunk in self.chunk_paths(self.plan.cells[ref]))

    # -- beginning ------------------------------------------------------------------------------------

    def begin(self, todo: Collection[CellRef], outdated: Collection[CellRef] = ()) -> None:
        """Make the store ready for a run that computes ``todo``: own it, create and grow arrays, drop what is not planned.

        ``outdated`` cells stand at axis values of earlier runs and would come out differently now: they are removed.
        """
        run_id = self.folder / "run.id"
        ended_well = not run_id.exists() or run_id.read_text() != ABANDONED
        run_id.write_text(self.run_id)
        if not self._drop_consolidated() or not ended_well:
            self.sweep()
        self._drop_unplanned()
        self.journal.set_axes(self.axes)
        self.root = zarr.open_group(str(self.folder / DATA), mode="a", zarr_format=3)
        axes = {node.name: list(node.axes) for node in self.plan.nodes}
        attrs: dict[str, Any] = {"etendue": {"format": 1, "pipeline": self.plan.pipeline.name, "stages": list(axes), "axes": axes}}
        if self.plan.pipeline.variant:
            attrs["variant"] = self.plan.pipeline.variant
        self.root.update_attributes(attrs)
        for path, node_attrs in self.layout.parents.items():
            self.root.require_group(path).update_attributes(node_attrs)
        for path, group in self.layout.groups.items():
            self._create_group(path, group)
        for ref in outdated:
            for chunk in self.chunk_paths(self.plan.cells[ref]):
                (self.folder / chunk.path).unlink(missing_ok=True)
        known = [self.names[ref] for ref in outdated if self.names[ref] in self.journal.entries]
        self.journal.end((name, Entry("removed", self.journal.entries[name].key, (), "not_computed")) for name in known)
        self._put_status(set(todo))

    def _drop_consolidated(self) -> bool:
        """Consolidated metadata would go on serving the old shapes. Whether there was any: the last run ended well."""
        path = self.folder / DATA / "zarr.json"
        if not path.exists():
            return False
        document = json.loads(path.read_text())
        if document.pop("consolidated_metadata", None) is None:
            return False
        temporary = path.with_suffix(".partial")
        temporary.write_text(json.dumps(document, indent=2))
        os.replace(temporary, path)
        return True

    def sweep(self, abandoned: bool = False) -> None:
        """Remove what a killed run or worker left half written; of an abandoned run, whatever is still under way is refused."""
        if abandoned:
            (self.folder / "run.id").write_text(ABANDONED)
        for path in self.folder.rglob("*.partial"):
            path.unlink(missing_ok=True)

    def _drop_unplanned(self) -> None:
        """Groups, variables and cells that the plan no longer has: they must not read as results of it."""
        root = self.folder / DATA
        for node in _folders(root):
            if node in self.layout.parents:
                for shape in _folders(root / node):
                    if f"{node}/{shape}" not in self.layout.groups:
                        shutil.rmtree(root / node / shape)
            elif node not in self.layout.groups and node not in TABLES:
                shutil.rmtree(root / node)
        self.journal.forget_axes([path for path in self.journal.axes if path not in self.layout.groups])
        for path, group in self.layout.groups.items():
            for name in _folders(root / path):
                if name not in group.variables and name not in group.coordinates and name != "status":
                    shutil.rmtree(root / path / name)
            planned = set(itertools.product(*self.places[path]))
            if len(group.cells) < len(planned):
                planned = {self._place(path, index) for index in group.cells.values()}
            for place in itertools.product(*(range(len(values)) for values in self.axes[path].values())):
                if place not in planned:
                    for chunk in _chunks(path, group, place):
                        (self.folder / chunk.path).unlink(missing_ok=True)

    # -- arrays ---------------------------------------------------------------------------------------

    def _create_group(self, path: str, layout: GroupLayout) -> None:
        group = self.root.require_group(path)
        if layout.attrs:
            group.update_attributes(layout.attrs)
        merged = self.axes[path]
        for name, coordinate in layout.coordinates.items():
            values, attrs = coordinate.values, dict(coordinate.attrs)
            if name in merged:
                values = merged[name]
                if not any(isinstance(v, str) for v in values) and values not in (sorted(values), sorted(values, reverse=True)):
                    attrs["order"] = "as the sweep grew; sort with .sortby"
            elif coordinate.dims[:-1] and coordinate.dims[0] in merged:
                values = self._grown_positions(path, coordinate.dims[:-1], np.asarray(values, dtype=float))
            put_array(group, name, values, coordinate.dims, attrs)
        for variable in layout.variables.values():
            self._create_variable(group, layout, variable, merged)

    def _grown_positions(self, path: str, axes: tuple[str, ...], own: Any) -> Any:
        """Positions along axes that have grown: those of the plan in their place, others missing like their cells."""
        merged, places = self.axes[path], dict(zip(self.axes[path], self.places[path], strict=True))
        whole = np.full((*(len(merged[axis]) for axis in axes), own.shape[-1]), np.nan)
        whole[np.ix_(*(places[axis] for axis in axes), range(own.shape[-1]))] = own
        return whole

    def _create_variable(self, group: Any, layout: GroupLayout, variable: VariableLayout, merged: dict[str, list[Any]]) -> None:
        sizes = tuple(len(values) for values in merged.values())
        shape, dims = (*sizes, *variable.shape), (*merged, *variable.dims)
        beside = [n for n, c in layout.coordinates.items() if c.dims != (n,) and n != BOUNDS and set(c.dims) <= set(dims)]
        attrs = variable.attrs | ({"coordinates": " ".join(sorted(beside))} if beside else {})
        if (self.folder / DATA / group.path / variable.name / "zarr.json").exists():
            array = group[variable.name]
            same = array.dtype == np.dtype(variable.dtype) and (array.metadata.dimension_names or ()) == dims
            if same and array.shape[len(sizes) :] == variable.shape and all(a <= b for a, b in zip(array.shape, shape, strict=True)):
                if array.shape != shape:
                    array.resize(shape)
                if dict(array.attrs) != attrs:
                    array.attrs.put(attrs)
                return
        own = tuple(max(n, 1) for n in variable.shape)
        if by_band(variable):
            own = (1, *own[1:])
        group.create_array(
            variable.name, shape=shape, chunks=(*(1 for _ in sizes), *own), dtype=variable.dtype, fill_value=FILL[variable.dtype],
            compressors=_codecs(), dimension_names=dims, config={"write_empty_chunks": True}, overwrite=True, attributes=attrs,
            chunk_key_encoding={"name": "default", "separator": "."},  # no folder per axis: 0.2 ms each
        )  # fmt: skip

    def _place(self, path: str, index: tuple[int, ...]) -> tuple[int, ...]:
        """Position of a cell in the stored arrays of its group, from its position among the plan's values."""
        return tuple(places[i] for places, i in zip(self.places[path], index, strict=True))

    def chunk_paths(self, cell: Cell) -> tuple[ChunkFile, ...]:
        """The chunk files of a cell's kept variables."""
        path = self.layout.home.get(cell.ref)
        if path is None:
            return ()
        group = self.layout.groups[path]
        return _chunks(path, group, self._place(path, group.cells[cell.ref]))

    def target(self, cell: Cell) -> CellFiles:
        return CellFiles(str(self.folder), self.run_id, self.chunk_paths(cell), self.durable)

    # -- progress of a run ----------------------------------------------------------------------------

    def starting(self, refs: Iterable[CellRef]) -> None:
        self.journal.start((self.names[ref], self.plan.cells[ref].key) for ref in refs)

    def reported(self, reports: Iterable[CellReport]) -> None:
        """Journal what became of cells. A cell without a result keeps no file of an earlier one."""
        lines = []
        for report in reports:
            ref = (report.stage, report.index)
            event = "done" if report.status in ("done", "left_out") else "failed"
            if event == "failed":
                for chunk in self.chunk_paths(self.plan.cells[ref]):
                    (self.folder / chunk.path).unlink(missing_ok=True)
            told = (report.written, report.status, report.seconds, report.clipped, report.clipped_flux, report.floored)
            lines.append((self.names[ref], Entry(event, self.plan.cells[ref].key, *told)))
        self.journal.end(lines)

    # -- closing --------------------------------------------------------------------------------------

    def _put_status(self, todo: Collection[CellRef] = ()) -> None:
        """Write ``status`` as the journal has it; cells still to be computed are not computed, whatever their chunks hold."""
        for path, layout in self.layout.groups.items():
            status = np.full(tuple(len(values) for values in self.axes[path].values()), STATUS.index("not_computed"), np.uint8)
            for ref, index in layout.cells.items():
                entry = self.journal.entries.get(self.names[ref])
                if ref not in todo and entry is not None and entry.key == self.plan.cells[ref].key and entry.event != "start":
                    status[self._place(path, index)] = STATUS.index(entry.status)
            put_array(self.root[path], "status", status, tuple(self.axes[path]), STATUS_ATTRIBUTES)

    def close_run(self, tables: Mapping[str, Mapping[str, Any]]) -> None:
        """Write status and tables, then consolidate: readers see a finished run or the one before."""
        self._put_status()
        for name, columns in tables.items():
            group = self.root.create_group(name, overwrite=True)
            for column, (dims, values, attrs) in columns["arrays"].items():
                put_array(group, column, values, dims, attrs)
            group.update_attributes(dict(columns.get("attrs", {})))  # last: a table with attributes is whole
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*[Cc]onsolidated metadata.*")
            zarr.consolidate_metadata(self.root.store)

    def table_attributes(self, name: str) -> dict[str, Any]:
        """Attributes of a table of an earlier run; none where there is no whole one."""
        path = self.folder / DATA / name / "zarr.json"
        return json.loads(path.read_text()).get("attributes", {}) if path.exists() else {}

    def free_bytes(self) -> int:
        return shutil.disk_usage(self.folder).free


def _positions(stored: list[Any], values: list[Any]) -> list[int]:
    where = {value: i for i, value in enumerate(stored)}
    return [where[value] for value in values]


def _folders(path: Path) -> list[str]:
    return [entry.name for entry in os.scandir(path) if entry.is_dir()] if path.is_dir() else []


def by_band(variable: VariableLayout) -> bool:
    """Whether a variable is stored one wavelength band per chunk: Blosc refuses 2 GiB."""
    size = int(np.prod(variable.shape)) * np.dtype(variable.dtype).itemsize
    return variable.dims == ("wavelength", "y", "x") and size > LARGEST_WHOLE


def _chunks(path: str, group: GroupLayout, place: tuple[int, ...]) -> tuple[ChunkFile, ...]:
    """The chunk files at one position of the axes of a group."""
    chunks = []
    for variable in group.variables.values():
        banded = by_band(variable)
        for band in range(variable.shape[0]) if banded else [None]:
            own = [band or 0, *[0] * (len(variable.shape) - 1)] if variable.shape else []
            where = ".".join(["c", *map(str, [*place, *own])])
            shape = variable.shape if band is None else variable.shape[1:]
            chunks.append(ChunkFile(variable.name, f"{DATA}/{path}/{variable.name}/{where}", variable.dtype, shape, band))
    return tuple(chunks)
