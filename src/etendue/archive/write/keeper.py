"""The archive as the storage backend of a run: find finished cells of a plan, store new ones, and close the archive.

In:  the requested plan; reports of cells as they end; tables and pictures at the end.
Out: the cells that remain to be computed; an archive that is consistent even if the run fails.
"""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.archive.journaling.accepting import former_of
from etendue.archive.read import earlier_pictures
from etendue.archive.records import crate, inputs, provenance
from etendue.archive.sharding.chunks import CellFiles
from etendue.archive.write import keeping, moving
from etendue.archive.write.store import ArchiveWriter
from etendue.archive.write.whole_cells import WholeCells
from etendue.contract.ports import CellReport, ContactSheet, Look, Seen
from etendue.errors import ArchiveError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.plan.resume import Work, select
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.session import Options
    from etendue.types.arrays import Array, CellArrays
    from etendue.types.documents import Document


class ArchiveKeeper:
    """A context manager that locks the archive until it is closed."""

    keeps_arrays, draws = False, True

    def __init__(self, folder: Path, options: Options) -> None:
        self.store = ArchiveWriter(folder, options.durable)
        self.folder: Path | None = self.store.folder
        self.scheduler, self.recompute, self.prune = options.scheduler, options.recompute, options.prune
        self.accept_platform = options.accept_platform
        self.restore = options.restore  # in a repair: names of cells of earlier runs that must be restored as well
        self.recorded = False  # whether this run has a record of its own
        self.lock = threading.Lock()
        self.mark: tuple[str, bytes] | None = (str(self.store.folder / "run.id"), self.store.run_id.encode())

    def __enter__(self) -> ArchiveKeeper:
        self.store.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.store.__exit__(*error)

    def begin(self, asked: Plan) -> Work:
        """Determine the layout of a plan together with the stored cells, prepare the archive for the remaining cells,
        and record the run.

        Raises
        ------
        ArchiveError
            The archive belongs to another pipeline or platform, or finished results would be lost. The archive is not
            changed.
        """
        store = self.store
        plan, stay, pruned = keeping.with_stored(asked, store, self.prune)
        cells = keeping.same_cells(asked, plan)
        store.use(plan)
        elsewhere = self._is_elsewhere(store.record, provenance.platform_record())
        if self.accept_platform and store.record is not None and elsewhere:
            store.former = former_of(plan, store.record)
        if store.layout.moves:
            moving.move(store, store.layout.moves)
            store.use(plan)
        self.whole = WholeCells(store, not self.recompute)
        pairs = zip(plan.cells, self.whole.there.tolist(), strict=True)
        finished = set() if self.recompute else {ref for ref, whole in pairs if whole or store.finished(ref)}
        restored = {ref for ref in plan.cells if store.names[ref] in self.restore} if self.restore else set()
        wanted = keeping.computed(asked, cells)
        todo = select(plan, finished, {*wanted, *restored})
        outdated = set(plan.cells) - finished - todo - set(cells.values())
        removed = sum(store.has_files(ref) for ref in outdated)
        reasons = self._reasons(plan, {name for name, _ in todo})  # before the journal drops the old entries
        store.begin(todo, finished, outdated)
        if self.restore is not None:
            store.change()  # also if nothing is left to do: rewrite the journal and manifest
        store.begin_run(*(dict(Counter(name for name, _ in refs)) for refs in (wanted, todo)))
        resolved = inputs.resolve_pipeline(asked)
        store.mended += inputs.copy_inputs(store.folder, resolved.inputs, store.durable)
        if todo or not store.recorded or elsewhere:
            told = {"tolerance": plan.pipeline.tolerance, "scheduler": self.scheduler}
            path = provenance.write_record(store.folder, plan, asked, resolved, told, store.durable)
            store.journal.record(path, (store.folder / path).read_text())
            self.recorded = True
        store.behind.begun()
        return Work(
            plan, cells, todo, finished - todo, reasons, removed, pruned, stay, store.mended, store.blocks.moved
        )

    def _reasons(self, plan: Plan, again: Collection[str]) -> dict[str, str]:
        """Return the reasons why stages are recomputed: their changes or, without changes, the damage."""
        changed = provenance.reasons(self.store.record, plan) if self.store.journal.entries.any_done() else {}
        found = {name: why for name, why in changed.items() if name in again}
        for name, count in self.store.damaged.items():
            cells = f"{count} stored {'cell is' if count == 1 else 'cells are'}"
            found.setdefault(name, f"{cells} missing or damaged on disk")
        return found

    def _is_elsewhere(self, old: DocumentView | None, now: DocumentView) -> bool:
        """Return True if the archive was started on another platform; raise an error if continuing could mix different
        bits.
        """
        folder, mixed = self.store.folder, not (self.accept_platform or self.recompute)
        way_out = "Keep its finished cells with --accept-platform, or recompute everything with --recompute"
        if old is None:
            if mixed and self.store.journal.entries.any_done():
                raise ArchiveError(
                    f"no readable record in {folder / 'runs'} names the platform on which its cells were "
                    f"computed. {way_out}"
                )
            return False
        then = old["platform"]
        if mixed and then != dict(now):
            changed = ", ".join(f"{k} {then.get(k)} -> {now[k]}" for k in now if then.get(k) != now[k])
            raise ArchiveError(f"{folder} was started on another platform ({changed}), so bits may differ. {way_out}")
        return bool(then != dict(now))

    def target(self, cell: Cell) -> CellFiles:
        with self.lock:  # other threads of the run may be reporting what they have written
            return self.store.target(cell)

    def place(self, ref: CellRef, variable: str) -> None: ...

    def starting(self, refs: Iterable[CellRef]) -> None:
        with self.lock:
            self.store.starting(refs)

    def finished(
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, CellArrays]
    ) -> Mapping[CellRef, CellArrays]:
        with self.lock:
            self.store.reported(reports)
        return arrays

    def earlier(self, refs: Iterable[CellRef]) -> Iterator[CellReport]:
        """Yield reports of finished cells from the journal."""
        store = self.store
        entries, number = store.journal.entries, store.plan.numbers.of
        rows, whole, size = store.laid.rows(entries).tolist(), self.whole.there.tolist(), self.whole.bytes.tolist()
        for ref in refs:
            if whole[own := number(ref)]:
                yield entries.report(ref, rows[own], size[own])
                continue
            entry = entries.get(store.names[ref])
            if entry is not None and entry.event == "done":
                kept = {(path, slot) for path, slot, _ in store.laid.slots(ref)}
                yield CellReport(
                    *ref,
                    entry.status,
                    entry.seconds,
                    clipped=entry.clipped,
                    clipped_flux=entry.clipped_flux,
                    floored=entry.floored,
                    platform=entry.platform,
                    size=sum(file.size for file in entry.files if (file.path, file.slot) in kept),
                )

    def stored(
        self, refs: Iterable[CellRef], figures_only: bool = False, named: frozenset[str] | None = None
    ) -> dict[CellRef, dict[str, Array]]:
        """Return arrays of finished cells: all kept variables or, with ``figures_only``, only metrics (no dims but
        ``stage``); ``named`` limits the variables.
        """
        found, plan = {}, self.store.plan
        for ref in refs:
            writes = plan.node(ref[0]).writes
            chosen = [
                v for v in writes if (ref[0], v) in plan.kept and not (figures_only and set(writes[v].dims) - {"stage"})
            ]
            # a variable is stored with the cell, or with the one that has its values
            wanted = {v: plan.cells[plan.stored(ref, v)] for v in chosen if named is None or v in named}
            found[ref] = {v: self.store.target(cell).read(v) for v, cell in wanted.items()}
        return found

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        return others

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool:
        return self.store.shown() != self._keys(shown) or not earlier_pictures.sheet_is_whole(
            self.store.folder, self.store.manifest
        )

    def look_at(self, ref: CellRef, look: Look) -> Seen:
        return look(self.stored([ref])[ref])

    def _keys(self, refs: Iterable[CellRef]) -> list[str]:
        return [self.store.plan.cells[ref].key for ref in refs]

    def interrupted(self, tables: DocumentView, abandoned: bool) -> None:
        """Close an interrupted run so that finished cells can be read and the next run continues from them."""
        if abandoned:
            self.store.abandon()
        self.store.close_run(tables)
        self.store.write_manifest()
        self.store.sweep()

    def close(self, tables: Document, sheet: ContactSheet | None, failed: bool) -> tuple[None, list[Path]]:
        store = self.store
        place = store.folder / "contact_sheet.png"
        if sheet and sheet.table:
            attrs = {**sheet.table.get("attrs", {}), "shown": self._keys(sheet.shown), "at": sheet.at}
            tables = {**tables, "frames": {**sheet.table, "attrs": attrs}}
        if sheet:
            # drawn beside its place and then moved: a link in its place is not followed
            drawn = place.with_name(".contact_sheet.partial.png")
            drawn.unlink(missing_ok=True)
            sheet.draw(drawn)
            store.change()
            os.replace(drawn, place)
        store.close_run(tables)
        if store.touched:
            store.sweep()  # workers that were stopped or repeated a batch may have left files
            crate.write_crate(store.folder, store.plan, store.manifest, self.recorded, store.durable)
        store.write_manifest()
        return None, [place] if place.exists() else []
