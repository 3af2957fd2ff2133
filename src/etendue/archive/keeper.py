"""An archive as the keeper of a run: what of a plan it has already, what becomes of the rest, and how it is closed.

In:  what is asked for; reports of cells as they end; tables and pictures at the end.
Out: what is left to do; an archive in order, whatever happens.
"""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.archive import crate, frames, inputs, keeping, moving, provenance
from etendue.archive.accepting import former_of
from etendue.archive.chunks import CellFiles
from etendue.archive.store import Archive
from etendue.contract.ports import CellReport, Sheet
from etendue.errors import ArchiveError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.plan.resume import Work, select
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.session import Options
    from etendue.types.arrays import Array


class ArchiveKeeper:
    """Use as a context manager: the archive is owned until it is closed."""

    keeps_arrays, draws = False, True

    def __init__(self, folder: Path, options: Options) -> None:
        self.store = Archive(folder, options.durable)
        self.folder: Path | None = self.store.folder
        self.scheduler, self.recompute, self.prune = options.scheduler, options.recompute, options.prune
        self.accept_platform = options.accept_platform
        self.restore = options.restore  # of a repair: names of cells of earlier runs that are to be there as well
        self.recorded = False  # whether this run has a record of its own
        self.lock = threading.Lock()
        self.mark: tuple[str, bytes] | None = (str(self.store.folder / "run.id"), self.store.run_id.encode())

    def __enter__(self) -> ArchiveKeeper:
        self.store.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.store.__exit__(*error)

    def begin(self, asked: Plan) -> Work:
        """Lay a plan out over what is there, make the archive ready for the rest, and record the run.

        Raises
        ------
        ArchiveError
            The archive is of another pipeline or platform, or finished results would be lost. It is as it was.
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
        finished = set() if self.recompute else {ref for ref in plan.cells if store.finished(ref)}
        restored = {ref for ref in plan.cells if store.names[ref] in self.restore} if self.restore else set()
        todo = select(plan, finished, {*cells.values(), *restored})
        outdated = set(plan.cells) - finished - todo - set(cells.values())
        removed = sum(store.has_files(ref) for ref in outdated)
        reasons = self._reasons(plan, {name for name, _ in todo})  # before the journal forgets what was done
        store.begin(todo, finished, outdated)
        if self.restore is not None:
            store.change()  # also where nothing is left to do: what vouches for the rest is written anew
        store.begin_run(*(dict(Counter(name for name, _ in refs)) for refs in (cells.values(), todo)))
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
        """Why stages are computed again: what of them has changed, else what is damaged."""
        changed = provenance.reasons(self.store.record, plan) if self.store.journal.entries.any_done() else {}
        found = {name: why for name, why in changed.items() if name in again}
        for name, count in self.store.damaged.items():
            cells = f"{count} stored {'cell is' if count == 1 else 'cells are'}"
            found.setdefault(name, f"{cells} missing or damaged on disk")
        return found

    def _is_elsewhere(self, old: DocumentView | None, now: DocumentView) -> bool:
        """Whether the archive was begun on another platform, which is refused where it may mix bits."""
        folder, mixed = self.store.folder, not (self.accept_platform or self.recompute)
        way_out = "Go on with its finished cells: --accept-platform; compute all again: --recompute"
        if old is None:
            if mixed and self.store.journal.entries.any_done():
                raise ArchiveError(
                    f"no record in {folder / 'runs'} can be read, which say on what its cells were computed. {way_out}"
                )
            return False
        then = old["platform"]
        if mixed and then != dict(now):
            changed = ", ".join(f"{k} {then.get(k)} -> {now[k]}" for k in now if then.get(k) != now[k])
            raise ArchiveError(f"{folder} was begun on another platform ({changed}), where bits may differ. {way_out}")
        return bool(then != dict(now))

    def target(self, cell: Cell) -> CellFiles:
        with self.lock:  # in a thread of the run, while another tells what it has written
            return self.store.target(cell)

    def place(self, ref: CellRef, variable: str) -> None: ...

    def starting(self, refs: Iterable[CellRef]) -> None:
        with self.lock:
            self.store.starting(refs)

    def finished(
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, dict[str, Any]]
    ) -> Mapping[CellRef, dict[str, Any]]:
        with self.lock:
            self.store.reported(reports)
        return arrays

    def earlier(self, refs: Iterable[CellRef]) -> Iterator[CellReport]:
        """What the journal says of finished cells."""
        store = self.store
        for ref in refs:
            entry = store.journal.entries.get(store.names[ref])
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
        """Arrays of finished cells; all that are kept, or plain figures only, or of these those that are named."""
        found, plan = {}, self.store.plan
        for ref in refs:
            target, writes = self.store.target(plan.cells[ref]), plan.node(ref[0]).writes
            chosen = [
                v for v in writes if (ref[0], v) in plan.kept and not (figures_only and set(writes[v].dims) - {"stage"})
            ]
            found[ref] = {v: target.read(v) for v in chosen if named is None or v in named}
        return found

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        return others

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool:
        return self.store.shown() != self._keys(shown) or not frames.sheet_is_whole(
            self.store.folder, self.store.manifest
        )

    def _keys(self, refs: Iterable[CellRef]) -> list[str]:
        return [self.store.plan.cells[ref].key for ref in refs]

    def interrupted(self, tables: DocumentView, abandoned: bool) -> None:
        """What is finished can be looked at, and the next run goes on from it."""
        if abandoned:
            self.store.abandon()
        self.store.close_run(tables)
        self.store.write_manifest()
        self.store.sweep()

    def close(self, tables: dict[str, Any], sheet: Sheet | None, failed: bool) -> tuple[Any, list[Path]]:
        store = self.store
        place = store.folder / "contact_sheet.png"
        if sheet and sheet.table:
            attrs = {**sheet.table.get("attrs", {}), "shown": self._keys(sheet.shown), "at": sheet.at}
            tables = {**tables, "frames": {**sheet.table, "attrs": attrs}}
        if sheet:
            drawn = place.with_name(".contact_sheet.partial.png")  # beside its place: a link there is not followed
            drawn.unlink(missing_ok=True)
            sheet.draw(drawn)
            store.change()
            os.replace(drawn, place)
        store.close_run(tables)
        if store.touched:
            store.sweep()  # a worker that was stopped, or had to do a batch again, may have left something
            crate.write_crate(store.folder, store.plan, store.manifest, self.recorded, store.durable)
        store.write_manifest()
        return None, [place] if place.exists() else []
