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
import json
import os
import shutil
import uuid
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec

from etendue.archive.chunks import CODEC, LEVEL, CellFiles, ChunkFile
from etendue.archive.journal import Entry, Journal, finished
from etendue.archive.layout import STATUS, GroupLayout, Layout, VariableLayout, cell_name, layout_of
from etendue.errors import ArchiveError, ArchiveInUse, MachineError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.spec.ports import CellReport

DATA = "data.zarr"
FILL: dict[str, Any] = {"float32": float("nan"), "float64": float("nan"), "uint8": 0, "uint16": 0, "uint32": 0}
LARGEST_CHUNK = 128 << 20
TABLES = ("ledger", "summary", "frames")


def _codecs() -> list[Any]:
    return [BloscCodec(cname=CODEC, clevel=LEVEL, shuffle="bitshuffle"), Crc32cCodec()]


def put_array(group: Any, name: str, values: Any, dims: tuple[str, ...], attrs: Mapping[str, Any]) -> None:
    """Write one whole small array (a coordinate, a status, a column of a table)."""
    values = np.asarray(values)
    if values.dtype.kind in "UO":
        array = group.create_array(name, shape=values.shape, chunks=tuple(max(s, 1) for s in values.shape), dtype=str, dimension_names=dims, overwrite=True)
        if values.size:
            array[...] = values.astype(object)
    else:
        fill = float("nan") if values.dtype.kind == "f" else 0
        array = group.create_array(
            name, shape=values.shape, chunks=tuple(max(s, 1) for s in values.shape), dtype=values.dtype, fill_value=fill,
            compressors=_codecs(), dimension_names=dims, config={"write_empty_chunks": True}, overwrite=True,
        )  # fmt: skip
        if values.size:
            array[...] = values
    array.attrs.update(dict(attrs))


class Archive:
    """An archive opened for a run. Use as a context manager: the lock is held until it is closed."""

    def __init__(self, folder: Path, plan: Plan, durable: bool = False) -> None:
        self.folder, self.plan, self.durable = folder.absolute(), plan, durable
        self.layout: Layout = layout_of(plan)
        self.names: dict[CellRef, str] = {ref: cell_name(plan, ref) for ref in plan.cells}
        self.axes: dict[str, dict[str, list[Any]]] = {}  # stored axis values by group
        self.run_id = uuid.uuid4().hex

    # -- opening --------------------------------------------------------------------------------------

    def __enter__(self) -> Archive:
        existed = (self.folder / DATA).exists()
        if self.folder.exists() and not existed and any(p.name not in ("lock",) for p in self.folder.iterdir()):
            raise ArchiveError(f"{self.folder} exists and is not an archive; name another with --archive DIR")
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
            (self.folder / "run.id").write_text(self.run_id)
            self.journal = Journal(self.folder / "journal.jsonl", self.durable)
            self._drop_consolidated()
            self.root = zarr.open_group(str(self.folder / DATA), mode="a", zarr_format=3)
            self._check_same_stages(existed)
            self._create()
        except BaseException:
            os.close(self.lock)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.journal.close()
        os.close(self.lock)

    def _drop_consolidated(self) -> None:
        """Consolidated metadata would go on serving the old shapes."""
        path = self.folder / DATA / "zarr.json"
        if path.exists():
            document = json.loads(path.read_text())
            if document.pop("consolidated_metadata", None) is not None:
                temporary = path.with_suffix(".partial")
                temporary.write_text(json.dumps(document, indent=2))
                os.replace(temporary, path)

    def _check_same_stages(self, existed: bool) -> None:
        stages = [node.name for node in self.plan.nodes]
        axes = {node.name: list(node.axes) for node in self.plan.nodes}
        known = self.root.attrs.get("etendue")
        if existed and known and (known["axes"] != axes):
            old, new = known["axes"], axes
            what = sorted(set(old) ^ set(new)) or [f"the axes of {n}" for n in new if old.get(n) != new[n]]
            raise ArchiveError(
                f"{self.folder} was made with other stages or axes ({', '.join(map(str, what[:4]))}); both are fixed when an archive "
                f"is created. Use another archive: --archive {self.folder.name}-2"
            )
        self.root.attrs["etendue"] = {"format": 1, "pipeline": self.plan.pipeline.name, "stages": stages, "axes": axes}
        if self.plan.pipeline.variant:
            self.root.attrs["variant"] = self.plan.pipeline.variant

    # -- arrays ---------------------------------------------------------------------------------------

    def _create(self) -> None:
        for node, attrs in self.layout.parents.items():
            self.root.require_group(node).attrs.update(attrs)
        for path, group in self.layout.groups.items():
            self._create_group(path, group)

    def _create_group(self, path: str, layout: GroupLayout) -> None:
        group = self.root.require_group(path)
        if layout.attrs:
            group.attrs.update(layout.attrs)
        stored = {dim: _values(group[dim]) if dim in group else [] for dim in layout.axes}
        merged = {dim: [*stored[dim], *(v for v in values if v not in stored[dim])] for dim, values in layout.axes.items()}
        self.axes[path] = merged
        grown = any(stored[dim] and merged[dim] != stored[dim] for dim in merged)
        for name, coordinate in layout.coordinates.items():
            values, attrs = coordinate.values, dict(coordinate.attrs)
            if name in merged:
                values = merged[name]
                numbers = [v for v in values if not isinstance(v, str)]
                if numbers != sorted(numbers) and numbers != sorted(numbers, reverse=True):
                    attrs["order"] = "as the sweep grew; sort with .sortby"
            elif coordinate.dims[:-1] and coordinate.dims[0] in merged:
                values = self._merged_positions(group, name, coordinate, layout, merged)
            put_array(group, name, values, coordinate.dims, attrs)
        for variable in layout.variables.values():
            self._create_variable(group, variable, merged, grown)
        shape = tuple(len(values) for values in merged.values())
        if "status" not in group or group["status"].shape != shape:
            put_array(group, "status", np.full(shape, 4, np.uint8), tuple(merged), _status_attributes())

    def _merged_positions(self, group: Any, name: str, coordinate: Any, layout: GroupLayout, merged: dict[str, list[Any]]) -> Any:
        """Positions along axes that have grown: old rows kept, new ones put in their place."""
        axes = coordinate.dims[:-1]
        new = np.asarray(coordinate.values, dtype=float)
        whole = np.full((*(len(merged[a]) for a in axes), new.shape[-1]), np.nan)
        if name in group:
            old = np.asarray(group[name][...])
            whole[tuple(slice(0, n) for n in old.shape)] = old
        index = np.ix_(*([merged[a].index(v) for v in layout.axes[a]] for a in axes), range(new.shape[-1]))
        whole[index] = new
        return whole

    def _create_variable(self, group: Any, layout: VariableLayout, merged: dict[str, list[Any]], grown: bool) -> None:
        sizes = tuple(len(merged[axis]) for axis in layout.axes)
        shape = (*sizes, *layout.shape)
        if layout.name in group:
            array = group[layout.name]
            if array.shape == shape and array.dtype == np.dtype(layout.dtype):
                return
            if array.dtype == np.dtype(layout.dtype) and array.shape[len(sizes) :] == layout.shape and grown:
                array.resize(shape)
                return
        own = tuple(1 if by_band and i == 0 else max(n, 1) for i, n in enumerate(layout.shape)) if (by_band := _by_band(layout)) else tuple(
            max(n, 1) for n in layout.shape
        )
        array = group.create_array(
            layout.name, shape=shape, chunks=(*(1 for _ in sizes), *own), dtype=layout.dtype, fill_value=FILL[layout.dtype],
            compressors=_codecs(), dimension_names=(*layout.axes, *layout.dims), config={"write_empty_chunks": True}, overwrite=True,
        )  # fmt: skip
        coordinates = [n for n in group if n.endswith("_um") or n == "wavelength_bounds"]
        usable = [n for n in coordinates if set(self.layout.groups[group.path].coordinates[n].dims) - {"bound"} <= {*layout.axes, *layout.dims} and n != "wavelength_bounds"]
        array.attrs.update(layout.attrs | ({"coordinates": " ".join(sorted(usable))} if usable else {}))

    def chunk_paths(self, cell: Cell) -> tuple[ChunkFile, ...]:
        """The chunk files of a cell's kept variables."""
        if cell.ref not in self.layout.home:
            return ()
        path = self.layout.home[cell.ref]
        group = self.layout.groups[path]
        labels = self.plan.labels(cell.ref)
        position = [self.axes[path][dim].index(labels[dim]) for dim in group.axes]
        chunks = []
        for variable in group.variables.values():
            bands = range(variable.shape[0]) if _by_band(variable) else [None]
            for band in bands:
                own = [band or 0, *[0] * (len(variable.shape) - 1)] if variable.shape else []
                where = "/".join(["c", *map(str, [*position, *own])])
                shape = variable.shape if band is None else variable.shape[1:]
                chunks.append(ChunkFile(variable.name, f"{DATA}/{path}/{variable.name}/{where}", variable.dtype, shape, band))
        return tuple(chunks)

    def target(self, cell: Cell) -> CellFiles:
        return CellFiles(str(self.folder), self.run_id, self.chunk_paths(cell), self.durable)

    # -- progress of a run ----------------------------------------------------------------------------

    def finished(self, ref: CellRef) -> bool:
        cell = self.plan.cells[ref]
        entry = self.journal.entries.get(self.names[ref])
        if not finished(entry, cell.key, self.folder):
            return False
        assert entry is not None
        return {c.path for c in self.chunk_paths(cell)} <= {f.path for f in entry.files}

    def starting(self, refs: Iterable[CellRef]) -> None:
        self.journal.start((self.names[ref], self.plan.cells[ref].key) for ref in refs)

    def reported(self, reports: Iterable[CellReport]) -> None:
        lines = []
        for report in reports:
            ref = (report.stage, report.index)
            event = "done" if report.status in ("done", "left_out") else "failed"
            lines.append(
                (self.names[ref], Entry(event, self.plan.cells[ref].key, report.written, report.status, report.seconds, report.clipped, report.clipped_flux))
            )
        self.journal.end(lines)

    # -- closing --------------------------------------------------------------------------------------

    def close_run(self, tables: Mapping[str, Mapping[str, Any]]) -> None:
        """Write status and tables, then consolidate: readers see a finished run or the one before."""
        for path, layout in self.layout.groups.items():
            shape = tuple(len(v) for v in self.axes[path].values())
            status = np.full(shape, 4, np.uint8)
            for ref in layout.cells:
                labels = self.plan.labels(ref)
                index = tuple(self.axes[path][dim].index(labels[dim]) for dim in layout.axes)
                entry = self.journal.entries.get(self.names[ref])
                if entry is not None and entry.key == self.plan.cells[ref].key and entry.event != "start":
                    status[index] = STATUS.index(entry.status)
            group = self.root[path]
            put_array(group, "status", status, tuple(self.axes[path]), _status_attributes())
        for name, columns in tables.items():
            group = self.root.create_group(name, overwrite=True)
            group.attrs.update(columns.get("attrs", {}))
            for column, (dims, values, attrs) in columns["arrays"].items():
                put_array(group, column, values, dims, attrs)
        self._drop_old_groups()
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*[Cc]onsolidated metadata.*")
            zarr.consolidate_metadata(self.root.store)

    def _drop_old_groups(self) -> None:
        """Shapes and stages that the plan no longer has are not part of this archive."""
        for node in list(self.root):
            if node in TABLES:
                continue
            if node not in self.layout.parents and node not in self.layout.groups:
                shutil.rmtree(self.folder / DATA / node, ignore_errors=True)

    def free_bytes(self) -> int:
        return shutil.disk_usage(self.folder).free


def _by_band(layout: VariableLayout) -> bool:
    size = int(np.prod(layout.shape)) * np.dtype(layout.dtype).itemsize
    return bool(layout.dims) and layout.dims[0] == "wavelength" and len(layout.dims) > 1 and size > LARGEST_CHUNK


def _values(array: Any) -> list[Any]:
    return [v.item() if hasattr(v, "item") else str(v) for v in np.asarray(array[...])]


def _status_attributes() -> dict[str, Any]:
    return {
        "long_name": "what became of the cell",
        "flag_values": [0, 1, 2, 3, 4],
        "flag_meanings": " ".join(STATUS),
    }
