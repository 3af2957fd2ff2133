"""The archive of a run: one directory, owned by one run at a time.

paper/
  data.zarr/          one Zarr v3 store, one DataTree: opened by ``xarray.open_datatree`` without etendue
  inputs/             every file parameter, by SHA-256
  journal.jsonl       what is finished
  manifest.json       digests of all metadata, written at close
  runs/               a record of every run: pipeline, versions, platform
  lock  run.id        who owns it

Chunks of cells are trusted where the journal names them and they are what it names; everything else in the store is known
from the plan (``tree``), compared with what is there, and written again where it differs. Nothing is removed but by its name.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import re
import shutil
import uuid
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from etendue.archive import disk, frames
from etendue.archive.chunks import CellFiles
from etendue.archive.frames import FRAMES
from etendue.archive.journal import Entry, Journal, fit, is_done
from etendue.archive.laid import Laid, chunks_at
from etendue.archive.manifest import DATA, digest_of, read_manifest, write_manifest
from etendue.archive.provenance import latest_record, record_paths
from etendue.archive.tree import ROOT, incompatible
from etendue.errors import ArchiveError, ArchiveInUse, MachineError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.spec.names import TABLES
from etendue.spec.ports import CellReport, Written

ABANDONED = "abandoned"  # in place of the owner's id: a stage did not end when the run was interrupted
CHUNK = re.compile(r"c(\.\d+)*")


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
        self.held: dict[CellRef, tuple[Written, ...]] = {}  # of cells of which more is asked for than is stored: what stays
        self.mended: list[str] = []  # what was missing or changed and has been written again
        self.run_id = uuid.uuid4().hex

    # -- opening --------------------------------------------------------------------------------------

    def __enter__(self) -> Archive:
        if self.folder.exists():
            self._check_ours()
            disk.Listing(self.folder)  # refuses links
        try:
            (self.folder / DATA).mkdir(parents=True, exist_ok=True)
            self.lock = os.open(self.folder / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise MachineError(f"the archive {self.folder} cannot be written: {error.strerror}") from None
        try:
            try:
                fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ArchiveInUse(f"{self.folder} is in use by another run") from None
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
            self.mended.append(f"journal.jsonl ({self.journal.damaged} of its lines: what they named is computed again)")
        made = self.journal.arrays.items()
        self.ours = (self.manifest.nodes() if self.manifest else set()) | {f"{group}/{name}" for group, names in made for name in names}
        self.ours |= {"/".join(path.split("/")[:n]) for path in self.ours for n in range(1, path.count("/") + 1)}
        return self

    def __exit__(self, *_: object) -> None:
        self.journal.close()
        os.close(self.lock)

    def _check_ours(self) -> None:
        """Refuse a directory that holds something else."""
        names = set(os.listdir(self.folder)) if self.folder.is_dir() else {""}
        begun = names <= {"lock", "journal.jsonl", "run.id", DATA} and not any(p.is_dir() for p in (self.folder / DATA).glob("*"))
        if begun or "etendue" in self._root_attributes():
            return
        known = DATA in names and (latest_record(self.folder) or _is_journal(self.folder / "journal.jsonl"))
        if not known:
            raise ArchiveError(f"{self.folder} exists and is not an archive; name another with --archive DIR")

    def _root_attributes(self) -> dict[str, Any]:
        found = (disk.read_document(self.folder / DATA / ROOT) or {}).get("attributes")
        return found if isinstance(found, dict) else {}

    def _known_axes(self) -> dict[str, Any] | None:
        """The stages and the names of their axes, as the archive was created: from what is undamaged."""
        root: Any = self._root_attributes().get("etendue")
        axes = root.get("axes") if isinstance(root, dict) else None
        whole = isinstance(axes, dict) and all(isinstance(names, list) for names in axes.values())
        path = f"{DATA}/{ROOT}"
        if whole and self.manifest and self.manifest.metadata.get(path) == digest_of(self.folder / path):
            return axes
        recorded = (self.record or {}).get("stages")
        return recorded if isinstance(recorded, dict) else axes if whole else None

    def check_stages(self, plan: Plan) -> None:
        """Refuse a plan of other stages or axes than those the archive was made with."""
        new = {node.name: list(node.axes) for node in plan.nodes}
        old = self._known_axes()
        if old is not None and old != new:
            what = sorted(set(old) ^ set(new)) or [f"the axes of {n}" for n in new if old.get(n) != new[n]]
            raise ArchiveError(
                f"{self.folder} was made with other stages or axes ({', '.join(map(str, what[:4]))}); both are fixed when an archive "
                f"is created. Use another archive: --archive {self.folder.name}-2"
            )

    def use(self, plan: Plan) -> None:
        """Lay the plan out over what the archive has.

        Raises
        ------
        ArchiveError
            Somebody else's things stand in the place of the plan's.
        """
        self.plan, self.laid = plan, Laid(plan, self.journal.axes)
        self.layout, self.names, self.nodes = self.laid.layout, self.laid.names, self.laid.nodes
        self._refuse_strangers({node.name for node in plan.nodes})
        for node in self.nodes:
            if self.listing.has(f"{DATA}/{node}"):
                raise disk.in_place_of_folder(self.folder, f"{DATA}/{node}")
        for path, group in self.layout.groups.items():
            for name in group.variables:
                folder = f"{DATA}/{path}/{name}"
                for found in filter(CHUNK.fullmatch, self.listing.folders.get(folder, ())):
                    raise disk.in_place_of_file(self.folder, f"{folder}/{found}")

    def _refuse_strangers(self, stages: set[str]) -> None:
        """A group of somebody else beside ours may stay; in the place of ours, or in them, it would be lost or break the tree."""
        for folder in sorted(self.listing.folders.get(DATA, ())):
            found = [folder] if folder not in stages and folder not in TABLES else []
            if found and folder not in self.ours:
                document = disk.read_document(self.folder / DATA / folder / ROOT)
                if document is None or document.get("node_type") == "group":
                    continue
            else:
                inside = self._nodes_on_disk(folder) if self.ours and folder not in TABLES else []
                found = [node for node in inside if node not in self.ours]
            if found:
                raise ArchiveError(
                    f"{self.folder / DATA / found[0]} was not written by a run of this archive, and stands where its own results do; "
                    f"move it elsewhere (a group of your own may stand in {DATA} itself)"
                )

    def _nodes_on_disk(self, path: str) -> list[str]:
        """Groups and arrays at and below a folder of the store."""
        own = [path] if self.listing.has(f"{DATA}/{path}/{ROOT}") else []
        for name in sorted(self.listing.folders.get(f"{DATA}/{path}", ())):
            own += self._nodes_on_disk(f"{path}/{name}")
        return own

    # -- what is finished -----------------------------------------------------------------------------

    def stored(self) -> set[tuple[str, str]]:
        """The (stage, variable) pairs of which the archive has an array."""
        there = [node for node in self.ours if node.rpartition("/")[2] in self.listing.folders.get(f"{DATA}/{node}".rpartition("/")[0], ())]
        return {(node.split("/")[0], node.rpartition("/")[2]) for node in there if "/" in node}

    def finished(self, ref: CellRef) -> bool:
        """Whether a cell needs no computing: the journal says done with its key, and its files are as the journal says."""
        cell = self.plan.cells[ref]
        entry = self.journal.entries.get(self.names[ref])
        if entry is None or not is_done(entry, cell.key):
            return False
        paths = [chunk.path for chunk in self.laid.chunk_paths(cell)]
        if fit(entry, paths, self.folder):
            return True
        known = {file.path: file for file in entry.files if file.path in paths}
        if known and fit(entry, known, self.folder):  # more is asked for than there is: the rest is added to it
            self.held[ref] = tuple(known.values())
        elif known:  # else it was computed, and not kept
            self.damaged[ref[0]] = self.damaged.get(ref[0], 0) + 1
        return False

    def has_files(self, ref: CellRef) -> bool:
        """Whether anything of a cell is stored, right or not."""
        return any((self.folder / chunk.path).exists() for chunk in self.laid.chunk_paths(self.plan.cells[ref]))

    # -- beginning ------------------------------------------------------------------------------------

    def begin(self, todo: Collection[CellRef], finished: Collection[CellRef], outdated: Collection[CellRef] = ()) -> None:
        """Make the store ready for a run that computes ``todo``: own it, create and grow arrays, drop what is not planned.

        ``outdated`` cells stand at axis values of earlier runs and would come out differently now: they are removed.
        """
        self.journal.open()
        disk.write(self.folder, "run.id", self.run_id.encode(), self.durable)
        names = {path: [node[len(path) + 1 :] for node in self.nodes if node.rpartition("/")[0] == path] for path in self.layout.groups}
        earlier = {group: [node.rpartition("/")[2] for node in self.ours if node.rpartition("/")[0] == group] for group in self.laid.axes}
        self.journal.set_arrays({path: [*own, *earlier.get(path, ())] for path, own in names.items()})
        planned = set(self.names.values())
        left = [self.names[ref] for ref in outdated if self.names[ref] in self.journal.entries]
        left += [name for name, entry in self.journal.entries.items() if name not in planned and entry.event == "done"]
        self.journal.end((name, Entry("removed", self.journal.entries[name].key, (), "not_computed")) for name in left)
        self.tree = self.laid.tree(self.journal.entries, todo)
        self._say_what_was_damaged()
        disk.remove(self.folder, "manifest.json")
        self._put({ROOT: self.tree.files()[ROOT]})  # consolidated metadata would go on serving the old shapes
        self._sweep()
        self._drop_unplanned(set(finished))
        self.journal.forget_axes([path for path in self.journal.axes if path not in self.layout.groups])
        self.journal.set_axes(self.laid.axes)
        for ref in outdated:
            for chunk in self.laid.chunk_paths(self.plan.cells[ref]):
                disk.remove(self.folder, chunk.path)
        self._put(self.tree.files())

    def _say_what_was_damaged(self) -> None:
        """What differs from the manifest, or is no document: nobody who knows the archive has written it so."""
        known = self.manifest.metadata if self.manifest else {}
        found: dict[str, None] = {}
        for path in known or [f"{DATA}/{path}" for path in self.tree.held]:
            own = path.removeprefix(f"{DATA}/")
            if own in self.tree.held or own.split("/")[0] in TABLES:
                data = disk.content_of(self.folder / path)
                if (known and hashlib.sha256(data or b"").hexdigest() != known[path]) or (
                    data is not None and own.endswith(ROOT) and disk.read_document(self.folder / path) is None
                ):
                    found[re.sub(r"(/zarr\.json|/c(/\d+)*)$", "", path)] = None
        self.mended += found
        if self.manifest:
            self.mended += [path for path in self.manifest.changed(self.folder) if path in self.manifest.files]

    def sweep(self, abandoned: bool = False) -> None:
        """Remove what a run or worker has left half written; of an abandoned run, whatever is still under way is refused."""
        if abandoned:
            disk.write(self.folder, "run.id", ABANDONED.encode(), self.durable)
        self.listing = disk.Listing(self.folder)
        self._sweep()

    def _sweep(self) -> None:
        """Remove what a killed run left half written."""
        for folder, names in self.listing.files.items():
            for name in names:
                if name.startswith(".") and name.endswith(disk.PARTIAL):
                    disk.remove(self.folder, f"{folder}/{name}")
        for name in os.listdir(self.folder):
            if re.fullmatch(r"\..*\.\d+\.\d+\.partial", name):
                disk.remove(self.folder, name)

    def _drop_unplanned(self, finished: set[CellRef]) -> None:
        """Groups, variables and cells that the plan no longer has: they must not read as results of it."""
        for node in sorted(self.ours - self.nodes, key=lambda node: -node.count("/")):
            if node.split("/")[0] not in TABLES:
                self._remove_node(node)
        files = self.tree.files()
        for path, group in self.layout.groups.items():
            fresh = set()  # variables whose stored chunks are of another form, those of finished cells aside
            for name in group.variables:
                old = disk.read_document(self.folder / DATA / path / name / ROOT)
                if incompatible(old, json.loads(files[f"{path}/{name}/{ROOT}"])):
                    fresh.add(name)
            allowed: dict[str, set[str]] = {f"{DATA}/{path}/{name}": set() for name in group.variables}
            for ref, index in group.cells.items():
                for chunk in chunks_at(path, group, self.laid.place(path, index)):
                    if chunk.variable not in fresh or ref in finished:
                        folder, _, file = chunk.path.rpartition("/")
                        allowed[folder].add(file)
            for folder, own in allowed.items():
                for file in self.listing.files.get(folder, ()):
                    if CHUNK.fullmatch(file) and file not in own:
                        disk.remove(self.folder, f"{folder}/{file}")

    def _remove_node(self, node: str) -> None:
        """Remove a group or array: metadata and chunks, by name; what somebody else put beside them stays."""
        folder = f"{DATA}/{node}"
        for name in self.listing.files.get(folder, ()):
            if name == ROOT or CHUNK.fullmatch(name):
                disk.remove(self.folder, f"{folder}/{name}")
        if "c" in self.listing.folders.get(folder, ()):
            self._remove_digits(f"{folder}/c")
        if folder in self.listing.files:
            disk.remove_folder(self.folder, folder)

    def _remove_digits(self, folder: str) -> None:
        for name in self.listing.files.get(folder, ()):
            if name.isdigit():
                disk.remove(self.folder, f"{folder}/{name}")
        for name in self.listing.folders.get(folder, ()):
            if name.isdigit():
                self._remove_digits(f"{folder}/{name}")
        disk.remove_folder(self.folder, folder)

    def _put(self, files: Mapping[str, bytes]) -> None:
        """Files of the store in their places, where others are there; what describes the rest of a group or array comes last."""
        for path in sorted(files, key=lambda path: (path.endswith(ROOT), -path.count("/"))):
            if disk.content_of(self.folder / DATA / path) != files[path]:
                disk.write(self.folder, f"{DATA}/{path}", files[path], self.durable)

    def target(self, cell: Cell) -> CellFiles:
        return CellFiles(str(self.folder), self.run_id, self.laid.chunk_paths(cell), self.durable, self.held.get(cell.ref, ()))

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
                for chunk in self.laid.chunk_paths(self.plan.cells[ref]):
                    disk.remove(self.folder, chunk.path)
            told = (report.written, report.status, report.seconds, report.clipped, report.clipped_flux, report.floored)
            lines.append((self.names[ref], Entry(event, self.plan.cells[ref].key, *told)))
        self.journal.end(lines)

    # -- closing --------------------------------------------------------------------------------------

    def _frames(self) -> dict[str, bytes]:
        """The files of the pictures of an earlier run; none where they are not whole."""
        folder = f"{DATA}/{FRAMES}"
        files = {path.removeprefix(f"{DATA}/"): disk.content_of(self.folder / path) or b"" for path in self.listing.below(folder)}
        return files if frames.whole(files) else {}

    def shown(self) -> Any:
        """The keys of the cells whose pictures an earlier run has left; None where there are no whole ones."""
        return frames.attributes(self._frames()).get("shown")

    def sheet_is_whole(self) -> bool:
        """Whether the contact sheet of an earlier run is there as it was written."""
        known = self.manifest.files.get("contact_sheet.png") if self.manifest else None
        data = disk.content_of(self.folder / "contact_sheet.png") or b""
        if known is not None:
            return hashlib.sha256(data).hexdigest() == known
        return data.startswith(b"\x89PNG") and data.endswith(b"IEND\xaeB`\x82")

    def close_run(self, tables: Mapping[str, Mapping[str, Any]]) -> None:
        """Write status and tables, then consolidate: readers see a finished run or the one before."""
        self.laid.put_status(self.tree, self.journal.entries)
        self._put({path: data for path, data in self.tree.files().items() if "/status/" in path})
        for name in TABLES:
            if name not in tables:
                self.tree.take(self._frames() if name == FRAMES else {})
                continue
            for column, (dims, values, attrs) in tables[name]["arrays"].items():
                self.tree.put_array(name, column, values, dims, attrs)
            attrs = dict(tables[name].get("attrs", {}))
            self.tree.put_group(name, attrs)
            if name == FRAMES:  # which is not made again by every run
                self.tree.take(frames.sealed(self.tree.files(name), attrs))
            own = self.tree.files(name)
            stale = [node for node in self._nodes_on_disk(name) if f"{node}/{ROOT}" not in own and node in self.ours]
            for node in sorted(stale, key=lambda node: -node.count("/")):
                self._remove_node(node)
            self._put(own)
        others: dict[str, bytes] = {}
        for folder in self.listing.folders.get(DATA, ()):
            if folder not in self.nodes and folder not in TABLES and folder not in self.ours:
                nodes = self._nodes_on_disk(folder)
                others |= {f"{node}/{ROOT}": disk.content_of(self.folder / DATA / node / ROOT) or b"" for node in nodes}
        self.root = self.tree.consolidated(others)
        self._put({ROOT: self.root})

    def write_manifest(self) -> None:
        """The last act of a run: from now on what differs was changed by somebody else."""
        own = {f"{DATA}/{path}": data for path, data in {**self.tree.files(), ROOT: self.root}.items()}
        write_manifest(self.folder, own, self.durable)

    def free_bytes(self) -> int:
        return shutil.disk_usage(self.folder).free


def _is_journal(path: Path) -> bool:
    """Whether a file begins like a journal of ours."""
    return re.match(rb'\{"event":"(axes|arrays|start|done|run)"', disk.content_of(path) or b"") is not None
