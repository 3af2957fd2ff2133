"""The archive of a run: one directory, owned by one run at a time.

paper/
  data.zarr/          one Zarr v3 store, one DataTree: opened by ``xarray.open_datatree`` without etendue
  inputs/             every file parameter, by SHA-256
  journal.jsonl       what is finished
  manifest.json       digests of all metadata, written at close
  runs/               a record of every run: pipeline, versions, platform
  lock  run.id        who owns it

Chunks of cells are trusted where the journal names them and they lie where it says; everything else in the store is
known from the plan (``tree``), compared with what is there, and written again where it differs. Nothing is removed but
by its name, and nothing is written where nothing has changed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from etendue.archive import disk, frames, left
from etendue.archive.accepting import Former, accepted
from etendue.archive.blocks import Blocks, Slots, Stored
from etendue.archive.chunks import CellFiles
from etendue.archive.clearing import CHUNK, dims_on_disk, nodes_on_disk, remove_node, sweep
from etendue.archive.entries import Entry
from etendue.archive.finding import Finder
from etendue.archive.frames import FRAMES
from etendue.archive.journal import Journal, is_done
from etendue.archive.laid import Laid
from etendue.archive.layout import STATUS
from etendue.archive.manifest import DATA, read_manifest, write_manifest
from etendue.archive.owner import ABANDONED, behind, fresh_id, take
from etendue.archive.parts import PARTS
from etendue.archive.provenance import latest_record, record_paths
from etendue.archive.shards import Place, part_path
from etendue.archive.strangers import check_folder, known_axes, other_stages, refuse_strangers
from etendue.archive.tree import ROOT, incompatible
from etendue.contract.names import TABLES
from etendue.contract.ports import CellReport, Written
from etendue.errors import ArchiveError, ArchiveInUse, MachineError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.types.documents import DocumentView


class Archive:
    """An archive opened for a run. Use as a context manager: the lock is held until it is closed.

    ``use`` gives it a plan. Nothing in the store changes before ``begin``: a refused run leaves an archive as it was.
    """

    def __init__(self, folder: Path, durable: bool = False) -> None:
        self.durable = durable
        try:
            self.folder = folder.resolve()  # the archive itself may be named by a link; inside there is none
        except (OSError, RuntimeError) as error:
            raise ArchiveError(f"{folder} leads nowhere: {error}") from None
        if self.folder.is_symlink():  # Python 3.13 gives a circle of links back as it is
            raise ArchiveError(f"{folder} leads nowhere: it is a link to itself")
        self.damaged: dict[str, int] = {}  # by stage: finished cells whose files are missing or changed
        # of cells of which more is asked for than is stored: what stays
        self.held: dict[CellRef, tuple[Written, ...]] = {}
        self.touched = False  # whether anything has been changed
        self.mended: list[str] = []  # what was missing or changed and has been written again
        self.former = Former()  # of the platform of the last run, where that is accepted
        self.run_id = fresh_id()
        self.place = str(self.folder)
        self.behind = behind(self.folder)

    # -- opening --------------------------------------------------------------------------------------

    def __enter__(self) -> Archive:
        if self.folder.exists():
            check_folder(self.folder)
        try:
            (self.folder / DATA).mkdir(parents=True, exist_ok=True)
            if self.durable:
                disk.sync_folder(self.folder.parent)
            self.lock = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise MachineError(f"the archive {self.folder} cannot be written: {error.strerror}") from None
        try:
            try:
                take(self.lock)
                if not os.path.samestat(os.fstat(self.lock), os.stat(self.folder / "lock")):
                    raise BlockingIOError  # the archive was written anew between the two
            except BlockingIOError:
                raise ArchiveInUse(
                    f"{self.folder} is in use by another run: wait for it (etendue show says how far it is), or give "
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
                f"journal.jsonl ({self.journal.damaged} of its lines: what they named is computed again)"
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
        """Refuse a plan of other stages or axes than those the archive was made with."""
        new = {node.name: list(node.axes) for node in plan.nodes}
        old = known_axes(self.folder, self.manifest, self.record)
        if old is not None and old != new:
            raise ArchiveError(other_stages(self.folder, old, new, plan.pipeline.wanted, self.record))

    def use(self, plan: Plan) -> None:
        """Lay the plan out over what the archive has.

        Raises
        ------
        ArchiveError
            Somebody else's things stand in the place of the plan's.
        """
        if self.journal.files_a_cell:
            raise ArchiveError(
                f"{self.folder} has a file for every cell, as earlier versions wrote it: it can be looked at, and "
                f"nothing can be added. "
                f"Make one of the present form of it: etendue compact {self.folder} {self.folder.name}-2"
            )
        self.plan, self.laid = plan, Laid(plan, self.journal.axes, self.journal.blocks, self.journal.entries)
        self.finder = Finder(self.folder, self.journal)
        self.blocks = Blocks(self.folder, self.journal, self.finder, self.durable)
        self.layout, self.names, self.nodes = self.laid.layout, self.laid.names, self.laid.nodes
        refuse_strangers(self.folder, self.listing, {node.name for node in plan.nodes}, self.ours)
        for node in self.nodes:
            if self.listing.has(f"{DATA}/{node}"):
                raise disk.in_place_of_folder(self.folder, f"{DATA}/{node}")
        for path, group in self.layout.groups.items():
            for name in group.variables:
                folder = f"{DATA}/{path}/{name}"
                for found in filter(CHUNK.fullmatch, self.listing.folders.get(folder, ())):
                    raise disk.in_place_of_file(self.folder, f"{folder}/{found}")

    # -- what is finished -----------------------------------------------------------------------------

    def stored(self) -> set[tuple[str, str]]:
        """The (stage, variable) pairs of which the archive has an array."""
        there = [
            node
            for node in self.ours
            if node.rpartition("/")[2] in self.listing.folders.get(f"{DATA}/{node}".rpartition("/")[0], ())
        ]
        return {(node.split("/")[0], node.rpartition("/")[2]) for node in there if "/" in node}

    def finished(self, ref: CellRef) -> bool:
        """Whether a cell needs no computing: the journal says done with its key, and its files are as the journal
        says.
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
        if found:  # more is asked for than there is: the rest is added to it; else it was computed, and not kept
            self.held[ref] = tuple(file for file, _ in found.values())
        return False

    def _found(self, entry: Entry, chunks: Slots) -> Stored | None:
        """Of the chunks of a cell those that its entry names, as they were written and where they lie; None where
        one is lost.
        """
        known = {(file.path, file.slot): file for file in entry.files}
        found: dict[tuple[str, int], tuple[Written, Place]] = {}
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
        """Whether anything of a cell is stored, right or not."""
        states = [(slot, self.finder.state(path, slots)) for path, slot, slots in self.laid.slots(ref)]
        return any(state is not None and slot in (state.index or {}) for slot, state in states)

    # -- beginning ------------------------------------------------------------------------------------

    def begin(
        self, todo: Collection[CellRef], finished: Collection[CellRef], outdated: Collection[CellRef] = ()
    ) -> None:
        """Make the store ready for a run that computes ``todo``: own it, create and grow arrays, drop what is not
        planned.

        ``outdated`` cells stand at axis values of earlier runs and would come out differently now: they are removed.
        """
        was = ((ref, self.journal.entries[self.names[ref]]) for ref in finished)
        if fresh := accepted(self.former, self.plan, was):
            self.change()
            self.journal.end((self.names[ref], entry) for ref, entry in fresh)
        blocks = self.blocks
        for ref in todo:
            blocks.expect(self.laid.slots(ref), self.held.get(ref, ()))
        for ref in outdated:
            blocks.drop(self.laid.slots(ref))
        self.todo = todo
        self.ended = bytearray(self.plan.numbers.count)  # of cells that have ended: their status, from 1
        gone = [self.names[ref] for ref in outdated if self.names[ref] in self.journal.entries]
        gone += self.journal.entries.done_beside(self.names)
        self.tree = self.laid.tree(self.journal.entries, todo)
        if todo or gone or blocks.unsettled() or not left.in_order(self):
            self._change(gone)

    def _change(self, gone: Iterable[str]) -> None:
        """Make the store that of the plan; ``gone``: cells that are not to be there any more."""
        self.change()
        names = {
            path: [node[len(path) + 1 :] for node in self.nodes if node.rpartition("/")[0] == path]
            for path in self.layout.groups
        }
        earlier = {
            group: [node.rpartition("/")[2] for node in self.ours if node.rpartition("/")[0] == group]
            for group in self.laid.axes
        }
        self.journal.set_arrays({path: [*own, *earlier.get(path, ())] for path, own in names.items()})
        keys = ((self.names[ref], self.plan.cells[ref].key) for ref in self.todo)
        self.journal.set_outdated(self.journal.entries.done_otherwise(keys))
        self.journal.give_up(gone)
        self.mended += left.damaged(self)
        self._put({ROOT: self.tree.files()[ROOT]})  # consolidated metadata would go on serving the old shapes
        entries = self.journal.entries
        shards = self.journal.shards  # of a copy also those that it has not yet: their chunks lie in parts still
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
        self._put(self.tree.files())
        self.blocks.put(self.blocks.unsettled())

    def begin_run(self, planned: Mapping[str, int], todo: Mapping[str, int]) -> None:
        """Say what a run is asked for, and what of it is to be computed."""
        if self.journal.begins(planned, todo):
            self.change()
            self.journal.begin_run(planned, todo)

    def abandon(self) -> None:
        """Whatever is still under way is refused from now on."""
        disk.write(self.folder, "run.id", ABANDONED.encode(), self.durable)

    def change(self) -> None:
        """The archive is the run's own from now on, and not in order until it has ended."""
        if not self.touched:
            self.behind.own()
            self.touched = True
            self.journal.open()
            disk.write(self.folder, "run.id", self.run_id.encode(), self.durable)
            disk.remove(self.folder, "manifest.json")

    def sweep(self) -> None:
        """Remove what a run or worker has left half written."""
        self.listing = disk.Listing(self.folder)
        sweep(self.folder, self.listing, self.blocks.parts())

    def _drop_unplanned(self) -> None:
        """Groups, variables and shards that the plan no longer has: they must not read as results of it."""
        for node in sorted(self.ours - self.nodes, key=lambda node: -node.count("/")):
            if node.split("/")[0] not in TABLES:
                remove_node(self.folder, self.listing, node)
        files = self.tree.files()
        for path, group in self.layout.groups.items():
            for name, coordinate in group.coordinates.items():
                there = dims_on_disk(self.listing, f"{path}/{name}")
                if there not in (0, len(coordinate.dims)):  # files where there will be folders
                    remove_node(self.folder, self.listing, f"{path}/{name}")
            for name in group.variables:
                folder = f"{DATA}/{path}/{name}"
                old = disk.read_document(self.folder / folder / ROOT)
                fresh = incompatible(old, json.loads(files[f"{path}/{name}/{ROOT}"]))
                for file in filter(CHUNK.fullmatch, self.listing.files.get(folder, ())):
                    own = self.blocks.wanted.get(f"{folder}/{file}")
                    if own is None or (fresh and not own):  # of another form go those without finished cells
                        disk.remove(self.folder, f"{folder}/{file}")
                        self.finder.states[f"{folder}/{file}"] = None

    def _put(self, files: Mapping[str, bytes]) -> None:
        """Files of the store in their places, where others are there; what describes the rest of a group or array
        comes last.
        """
        for path in sorted(files, key=lambda path: (path.endswith(ROOT), -path.count("/"))):
            if disk.content_of(self.folder / DATA / path) != files[path]:
                self.change()
                disk.write(self.folder, f"{DATA}/{path}", files[path], self.durable)

    def target(self, cell: Cell) -> CellFiles:
        held: tuple[Written, ...] = self.held.get(cell.ref, ())
        chunks = self.laid.chunks(cell)
        found: dict[tuple[str, int], tuple[Written, Place | None]] = dict(
            self.blocks.found((c.path, c.slot) for c in chunks)
        )
        return CellFiles(self.place, self.run_id, chunks, self.durable, held, found)

    # -- progress of a run ----------------------------------------------------------------------------

    def starting(self, refs: Iterable[CellRef]) -> None:
        self.journal.start((self.names[ref], self.plan.cells[ref].key) for ref in refs)

    def reported(self, reports: Iterable[CellReport]) -> None:
        """Journal what became of cells. A cell without a result keeps no file of an earlier one."""
        lines, complete = [], []
        for report in reports:
            ref = (report.stage, report.index)
            event = "done" if report.status in ("done", "left_out") else "failed"
            written = report.written if event == "done" else ()
            told = (written, report.status, report.seconds, report.clipped, report.clipped_flux, report.floored)
            lines.append((self.names[ref], Entry(event, self.plan.cells[ref].key, *told)))
            self.ended[self.plan.numbers.of(ref)] = STATUS.index(report.status) + 1
            complete += self.blocks.ended(self.laid.slots(ref), written)
        self.journal.end(lines, remember=False)
        self.blocks.put(complete)
        self.behind.sealed(complete)

    # -- closing --------------------------------------------------------------------------------------

    def shown(self) -> Any:
        """The keys of the cells whose pictures an earlier run has left; None where there are no whole ones."""
        return frames.attributes(frames.stored(self.folder, self.listing)).get("shown")

    def close_run(self, tables: Mapping[str, DocumentView]) -> None:
        """Put shards in their places, write status and tables, then consolidate: readers see a finished run or the
        one before.
        """
        lacking = (ref for ref in self.todo if not self.ended[self.plan.numbers.of(ref)] and ref not in self.held)
        entries = self.journal.entries
        self.journal.give_up(entries.done_among(self.names[ref] for ref in lacking))  # shards are made without them
        self.blocks.close()
        self.laid.put_status(self.tree, entries, self.todo, self.ended)
        self._put({path: data for path, data in self.tree.files().items() if "/status/" in path})
        for name in TABLES:
            if name in tables:
                self._put_table(name, tables[name])
            elif name == FRAMES:
                self.tree.take(frames.stored(self.folder, self.listing))
        others: dict[str, bytes] = {}
        for folder in self.listing.folders.get(DATA, ()):
            if folder not in self.nodes and folder not in TABLES and folder not in self.ours:
                nodes = nodes_on_disk(self.listing, folder)
                others |= {f"{node}/{ROOT}": disk.content_of(self.folder / DATA / node / ROOT) or b"" for node in nodes}
        self.root = self.tree.consolidated(others)
        self._put({ROOT: self.root})

    def _put_table(self, name: str, table: DocumentView) -> None:
        """A table in its place; of one of an earlier run no column stays that this one has not."""
        for column, (dims, values, attrs) in table["arrays"].items():
            self.tree.put_array(name, column, values, dims, attrs)
        attrs = dict(table.get("attrs", {}))
        self.tree.put_group(name, attrs)
        if name == FRAMES:  # which is not made again by every run
            self.tree.take(frames.sealed(self.tree.files(name), attrs))
        own = self.tree.files(name)
        on_disk = nodes_on_disk(self.listing, name)
        stale = [node for node in on_disk if f"{node}/{ROOT}" not in own and node in self.ours]
        for node in sorted(stale, key=lambda node: -node.count("/")):
            remove_node(self.folder, self.listing, node)
        self._put(own)

    def write_manifest(self) -> None:
        """The last act of a run: from now on what differs was changed by somebody else."""
        if not self.touched:
            return
        self.journal.closed()
        own = {f"{DATA}/{path}": data for path, data in {**self.tree.files(), ROOT: self.root}.items()}
        write_manifest(self.folder, own, self.durable)
