"""The archive of a run: one directory, owned by one run at a time.

paper/
  data.zarr/          one Zarr v3 store, one DataTree: opened by ``xarray.open_datatree`` without etendue
  inputs/             every file parameter, by SHA-256
  journal.jsonl which cells are finished
  manifest.json       digests of all metadata, written at close
  runs/               a record of every run: pipeline, versions, platform
  lock  run.id        which run owns it

A chunk of a cell is trusted if the journal names it and it is at the recorded place. Everything else in the store
follows from the plan (``tree``): it is compared with the files and rewritten if they differ. Files are removed only by
name, and nothing is written if nothing has changed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from etendue.archive.journaling.accepting import Former, accepted
from etendue.archive.journaling.blocks import Blocks, Slots, Stored
from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import Journal, is_done
from etendue.archive.read import earlier_pictures, last_run
from etendue.archive.read.earlier_pictures import FRAMES
from etendue.archive.read.tree import content_first, incompatible
from etendue.archive.records import disk
from etendue.archive.records.folders import in_place_of_file, in_place_of_folder
from etendue.archive.records.manifest import DATA, read_manifest, write_manifest
from etendue.archive.records.names import ROOT, STATUS
from etendue.archive.records.owner import ABANDONED, behind, fresh_id, take
from etendue.archive.records.past_runs import latest_record, record_paths
from etendue.archive.sharding.chunks import CellFiles
from etendue.archive.sharding.finding import Finder
from etendue.archive.sharding.segments import PARTS
from etendue.archive.sharding.shards import ChunkPlace, part_path
from etendue.archive.write.clearing import CHUNK, dims_on_disk, nodes_on_disk, remove_node, sweep
from etendue.archive.write.foreign_files import check_folder, known_axes, other_stages, refuse_strangers
from etendue.archive.write.placement import Laid
from etendue.contract.ports import CellReport, WrittenChunk
from etendue.contract.values.names import TABLES
from etendue.errors import ArchiveError, ArchiveInUse, MachineError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.types.documents import DocumentView


class ArchiveWriter:
    """An archive opened for a run: a context manager that holds the lock until it is closed.

    ``use`` gives it a plan. Nothing in the store changes before ``begin``: a refused run leaves the archive unchanged.
    """

    def __init__(self, folder: Path, durable: bool = False) -> None:
        self.durable = durable
        try:
            self.folder = folder.resolve()  # the archive itself may be given by a link; inside it there are none
        except (OSError, RuntimeError) as error:
            raise ArchiveError(f"{folder} cannot be resolved: {error}") from None
        if self.folder.is_symlink():  # Python 3.13 returns a circular link unresolved
            raise ArchiveError(f"{folder} cannot be resolved: it is a link to itself")
        self.damaged: dict[str, int] = {}  # by stage: finished cells whose files are missing or changed
        # By cell that needs more variables than are stored: the stored chunks, which stay.
        self.held: dict[CellRef, tuple[WrittenChunk, ...]] = {}
        self.touched = False  # whether anything has been changed
        self.mended: list[str] = []  # missing or changed files that have been rewritten
        self.former = Former()  # keys on the platform of the last run, if that is accepted
        self.run_id = fresh_id()
        self.place = str(self.folder)
        self.behind = behind(self.folder)

    # -- opening --------------------------------------------------------------------------------------

    def __enter__(self) -> ArchiveWriter:
        if self.folder.exists():
            check_folder(self.folder)
        try:
            (self.folder / DATA).mkdir(parents=True, exist_ok=True)
            if self.durable:
                disk.sync_folder(self.folder.parent)
            self.lock = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise MachineError(f"cannot write the archive {self.folder}: {error.strerror}") from None
        try:
            try:
                take(self.lock)
                if not os.path.samestat(os.fstat(self.lock), os.stat(self.folder / "lock")):
                    raise BlockingIOError  # compacting has replaced the archive between the two calls
            except BlockingIOError:
                raise ArchiveInUse(
                    f"{self.folder} is in use by another run: wait for it (etendue show reports its progress), or use "
                    f"another --archive"
                ) from None
            self.listing = disk.Listing(self.folder)
            self.manifest = read_manifest(self.folder)
            self.record = latest_record(self.folder, self.manifest)
            newest = record_paths(self.folder)[-1:]
            self.recorded = self.record is not None and [disk.read_document(path) for path in newest] == [self.record]
            self.journal = Journal(self.folder, self.durable)
        except BaseException:
            os.close(self.lock)
            raise
        if self.manifest is None and (self.folder / "manifest.json").exists():
            self.mended.append("manifest.json")
        if self.journal.damaged:
            self.mended.append(
                f"journal.jsonl ({self.journal.damaged} damaged lines: the cells they named are recomputed)"
            )
        made = self.journal.arrays.items()
        self.ours = (self.manifest.nodes() if self.manifest else set()) | {
            f"{group}/{name}" for group, names in made for name in names
        }
        self.ours |= {"/".join(path.split("/")[:n]) for path in self.ours for n in range(1, path.count("/") + 1)}
        return self

    def __exit__(self, *_: object) -> None:
        PARTS.close(str(self.folder))
        self.journal.close()
        os.close(self.lock)

    def check_stages(self, plan: Plan) -> None:
        """Raise ``ArchiveError`` if the plan and the archive have different stages or axes."""
        new = {node.name: list(node.axes) for node in plan.nodes}
        old = known_axes(self.folder, self.manifest, self.record)
        if old is not None and old != new:
            raise ArchiveError(other_stages(self.folder, old, new, plan.pipeline.wanted, self.record))

    def use(self, plan: Plan) -> None:
        """Determine the layout of the plan, given the groups and arrays in the archive.

        Raises
        ------
        ArchiveError
            The archive has the old format, or there are foreign files at the place of the plan's results.
        """
        if self.journal.files_a_cell:
            raise ArchiveError(
                f"{self.folder} has one file per cell, the format of earlier versions: it can be read, but "
                f"nothing can be added. "
                f"Convert it with: etendue compact {self.folder} {self.folder.name}-2"
            )
        self.plan, self.laid = plan, Laid(plan, self.journal.axes, self.journal.blocks, self.journal.entries)
        self.finder = Finder(self.folder, self.journal)
        self.blocks = Blocks(self.folder, self.journal, self.finder, self.durable)
        self.layout, self.names, self.nodes = self.laid.layout, self.laid.names, self.laid.nodes
        refuse_strangers(self.folder, self.listing, {node.name for node in plan.nodes}, self.ours)
        for node in self.nodes:
            if self.listing.has(f"{DATA}/{node}"):
                raise in_place_of_folder(self.folder, f"{DATA}/{node}")
        for path, group in self.layout.groups.items():
            for name in group.variables:
                folder = f"{DATA}/{path}/{name}"
                for found in filter(CHUNK.fullmatch, self.listing.folders.get(folder, ())):
                    raise in_place_of_file(self.folder, f"{folder}/{found}")

    # -- what is finished -----------------------------------------------------------------------------

    def stored(self) -> set[tuple[str, str]]:
        """Return the (stage, variable) pairs for which the archive has an array."""
        there = [
            node
            for node in self.ours
            if node.rpartition("/")[2] in self.listing.folders.get(f"{DATA}/{node}".rpartition("/")[0], ())
        ]
        found = {(node.split("/")[0], node.rpartition("/")[2]) for node in there if "/" in node}
        return found | {(group.split("/")[0], name) for group, own in self.journal.same.items() for name in own}

    def finished(self, ref: CellRef) -> bool:
        """Return True if a cell need not be computed: it is done in the journal with this key, and its files are
        intact.
        """
        entry, key = self.journal.entries.get(self.names[ref]), self.plan.cells[ref].key
        if entry is None or not (is_done(entry, key) or is_done(entry, self.former.keys.get(ref, key))):
            return False
        chunks = self.laid.slots(ref)
        found = self._found(entry, chunks)
        if found is None:
            self.damaged[ref[0]] = self.damaged.get(ref[0], 0) + 1
            return False
        self.blocks.keep(chunks, found)
        if len(found) == len(chunks):
            return True
        if found:  # some variables are missing: only these are added. None stored: it was computed but not kept
            self.held[ref] = tuple(file for file, _ in found.values())
        return False

    def _found(self, entry: Entry, chunks: Slots) -> Stored | None:
        """Return the chunks that the entry of a cell names, as written and with their present places; None if one is
        lost.
        """
        known = {(file.path, file.slot): file for file in entry.files}
        found: dict[tuple[str, int], tuple[WrittenChunk, ChunkPlace]] = {}
        for path, slot, slots in chunks:
            file = known.get((path, slot))
            if file is None:
                continue
            place = self.finder.find(file, slots, entry.fresh)
            if place is None:
                return None
            found[path, slot] = file, place
        return found

    def has_files(self, ref: CellRef) -> bool:
        """Return True if any chunk of a cell is stored, valid or not."""
        states = [(slot, self.finder.state(path, slots)) for path, slot, slots in self.laid.slots(ref)]
        return any(state is not None and slot in (state.index or {}) for slot, state in states)

    # -- beginning ------------------------------------------------------------------------------------

    def begin(
        self, todo: Collection[CellRef], finished: Collection[CellRef], outdated: Collection[CellRef] = ()
    ) -> None:
        """Prepare the store for a run that computes ``todo``: take ownership, create and extend arrays, and remove
        arrays that are not planned.

        ``outdated`` cells lie at axis values of earlier runs and would give other results if they were computed now;
        they are removed.
        """
        was = ((ref, self.journal.entries[self.names[ref]]) for ref in finished)
        if fresh := accepted(self.former, self.plan, was):
            self.change()
            self.journal.end((self.names[ref], entry) for ref, entry in fresh)
        blocks = self.blocks
        for ref in todo:
            blocks.expect(self.laid.slots(ref), self.held.get(ref, ()))
        for path, slot, slots in (one for ref in outdated for one in self.laid.slots(ref)):
            blocks.contents(path, slots).pop(slot, None)
        self.todo = todo
        self.ended = bytearray(self.plan.numbers.count)  # by cell: 0, or its status + 1 once it has ended
        gone = [self.names[ref] for ref in outdated if self.names[ref] in self.journal.entries]
        gone += self.journal.entries.done_beside(self.names.in_order())
        self.tree = self.laid.tree(self.journal.entries, todo)
        # A run that has nothing to do changes no file, so that digests and dates of the archive stay as they are.
        if todo or gone or blocks.unsettled() or not last_run.in_order(self):
            self._change(gone)

    def _change(self, gone: Iterable[str]) -> None:
        """Make the store match the plan; ``gone``: cells to remove."""
        self.change()
        # The journal first says which arrays are ours and which results are replaced or given up; only then do files
        # change. A run that is killed in between leaves nothing that wrongly reads as a result.
        arrays: dict[str, list[str]] = {path: [] for path in self.layout.groups}
        for path, _, name in (node.rpartition("/") for node in self.nodes | self.ours):
            if path in arrays:
                arrays[path].append(name)
        self.journal.set_arrays(arrays)
        keys = ((self.names[ref], self.plan.cells[ref].key) for ref in self.todo)
        self.journal.set_outdated(self.journal.entries.done_otherwise(keys))
        self.journal.give_up(gone)
        self.mended += last_run.damaged(self)
        self._put({ROOT: self.tree.files()[ROOT]})  # drop consolidated metadata, which would still have the old shapes
        entries = self.journal.entries
        # a copied archive may lack shards that the journal names: their chunks are still in parts
        shards = self.journal.shards
        of_done = {
            part_path(file)
            for name in entries.done()
            for file in entries.written(entries.rows[name])
            if file.path not in shards or shards[file.path].at(file) is None
        }
        sweep(self.folder, self.listing, of_done | self.blocks.parts())
        self._drop_unplanned()
        self.journal.forget_axes([path for path in self.journal.axes if path not in self.layout.groups])
        self.journal.set_axes(self.laid.axes)
        self.journal.set_blocks(self.laid.blocks)
        self.journal.set_same(self.laid.same)
        self._put(self.tree.files())
        self.blocks.put(self.blocks.unsettled())

    def begin_run(self, planned: Mapping[str, int], todo: Mapping[str, int]) -> None:
        """Record in the journal the cells that a run requests, and the number of cells that it must compute."""
        if self.journal.begins(planned, todo):
            self.change()
            self.journal.begin_run(planned, todo)

    def abandon(self) -> None:
        """Mark the archive so that any worker still running is refused from now on."""
        disk.write(self.folder, "run.id", ABANDONED.encode(), self.durable)

    def change(self) -> None:
        """Take ownership before the first change; the archive counts as unfinished until the run has ended."""
        if not self.touched:
            self.behind.own()
            self.touched = True
            self.journal.open()
            # From here on, workers of an earlier run that still try to write are refused.
            disk.write(self.folder, "run.id", self.run_id.encode(), self.durable)
            disk.remove(self.folder, "manifest.json")

    def sweep(self) -> None:
        """Remove half-written files of a run or worker."""
        self.listing = disk.Listing(self.folder)
        sweep(self.folder, self.listing, self.blocks.parts())

    def _drop_unplanned(self) -> None:
        """Remove groups, variables and shards that are not in the plan, so that they are not read as its results."""
        for node in sorted(self.ours - self.nodes, key=lambda node: -node.count("/")):
            if node.split("/")[0] not in TABLES:
                remove_node(self.folder, self.listing, node)
        files = self.tree.files()
        for path, group in self.layout.groups.items():
            for name, coordinate in group.coordinates.items():
                there = dims_on_disk(self.listing, f"{path}/{name}")
                if there not in (0, len(coordinate.dims)):  # a file is where a folder is needed
                    remove_node(self.folder, self.listing, f"{path}/{name}")
            for name in group.variables:
                folder = f"{DATA}/{path}/{name}"
                shards = list(filter(CHUNK.fullmatch, self.listing.files.get(folder, ())))
                if not shards:
                    continue
                old = disk.read_document(self.folder / folder / ROOT)
                fresh = incompatible(old, json.loads(files[f"{path}/{name}/{ROOT}"]))
                for file in shards:
                    own = self.blocks.wanted.get(f"{folder}/{file}")
                    if own is None or (fresh and not own):  # after a change of form, drop shards without finished cells
                        disk.remove(self.folder, f"{folder}/{file}")
                        self.finder.states[f"{folder}/{file}"] = None

    def _put(self, files: Mapping[str, bytes]) -> None:
        """Write files of the store that differ from those on disk; the metadata of a group or array is written after
        its content.
        """
        order = sorted(files, key=content_first)
        disk.put(self.folder, ((f"{DATA}/{path}", files[path]) for path in order), self.durable, self.change)

    def target(self, cell: Cell) -> CellFiles:
        held: tuple[WrittenChunk, ...] = self.held.get(cell.ref, ())
        chunks = self.laid.chunks(cell)
        found: dict[tuple[str, int], tuple[WrittenChunk, ChunkPlace | None]] = dict(
            self.blocks.found((c.path, c.slot) for c in chunks)
        )
        return CellFiles(self.place, self.run_id, chunks, self.durable, held, found)

    # -- progress of a run ----------------------------------------------------------------------------

    def starting(self, refs: Iterable[CellRef]) -> None:
        self.journal.start((self.names[ref], self.plan.cells[ref].key) for ref in refs)

    def reported(self, reports: Iterable[CellReport]) -> None:
        """Record the results of cells in the journal. A cell without a result keeps no files of an earlier result."""
        lines, complete = [], []
        for report in reports:
            ref = (report.stage, report.index)
            event = "done" if report.status in ("done", "left_out") else "failed"
            written = report.written if event == "done" else ()
            told = (written, report.status, report.seconds, report.clipped, report.clipped_flux, report.floored)
            lines.append((self.names[ref], Entry(event, self.plan.cells[ref].key, *told)))
            self.ended[self.plan.numbers.of(ref)] = STATUS.index(report.status) + 1
            complete += self.blocks.ended(self.laid.slots(ref), written)
        # ``self.ended`` holds the state of these cells in one byte each; an entry takes about a hundred.
        self.journal.end(lines, remember=False)
        self.blocks.put(complete)
        self.behind.sealed(complete)

    # -- closing --------------------------------------------------------------------------------------

    def shown(self) -> list[str] | None:
        """Return the keys of the cells in the pictures of an earlier run; None if these are not intact."""
        return earlier_pictures.attributes(earlier_pictures.stored(self.folder, self.listing)).get("shown")

    def close_run(self, tables: Mapping[str, DocumentView]) -> None:
        """Complete shards, write status and tables, then consolidate: readers see either this finished run or the
        previous run.
        """
        lacking = (ref for ref in self.todo if not self.ended[self.plan.numbers.of(ref)] and ref not in self.held)
        entries = self.journal.entries
        # so that shards are completed without them
        self.journal.give_up(entries.done_among(self.names[ref] for ref in lacking))
        self.blocks.close()
        self.laid.put_status(self.tree, entries, self.todo, self.ended)
        self._put({path: data for path, data in self.tree.files().items() if "/status/" in path})
        for name in TABLES:
            if name in tables:
                self._put_table(name, tables[name])
            elif name == FRAMES:
                self.tree.take(earlier_pictures.stored(self.folder, self.listing))
        others: dict[str, bytes] = {}
        for folder in self.listing.folders.get(DATA, ()):
            if folder not in self.nodes and folder not in TABLES and folder not in self.ours:
                nodes = nodes_on_disk(self.listing, folder)
                others |= {f"{node}/{ROOT}": disk.content_of(self.folder / DATA / node / ROOT) or b"" for node in nodes}
        self.root = self.tree.consolidated(others)
        self._put({ROOT: self.root})

    def _put_table(self, name: str, table: DocumentView) -> None:
        """Write a table; remove columns of an earlier run that the new table lacks."""
        for column, (dims, values, attrs) in table["arrays"].items():
            self.tree.put_array(name, column, values, dims, attrs)
        attrs = dict(table.get("attrs", {}))
        self.tree.put_group(name, attrs)
        if name == FRAMES:  # not every run rewrites this table
            self.tree.take(earlier_pictures.sealed(self.tree.files(name), attrs))
        own = self.tree.files(name)
        on_disk = nodes_on_disk(self.listing, name)
        stale = [node for node in on_disk if f"{node}/{ROOT}" not in own and node in self.ours]
        for node in sorted(stale, key=lambda node: -node.count("/")):
            remove_node(self.folder, self.listing, node)
        self._put(own)

    def write_manifest(self) -> None:
        """End the run: any later difference from the manifest was not caused by a run."""
        if not self.touched:
            return
        self.journal.closed()
        own = {f"{DATA}/{path}": data for path, data in {**self.tree.files(), ROOT: self.root}.items()}
        write_manifest(self.folder, own, self.durable)
