"""Finished results in an archive that a run would not keep. They are removed only on request.

In:  a plan over all stored axis values, the archive, and its journal.
Out: the variables that stay because they are still valid, and the results that would be lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from etendue.archive.journaling.entries import Entries, Entry
from etendue.archive.records.inputs import sweep_of
from etendue.archive.records.past_runs import records
from etendue.archive.structure.naming import Names
from etendue.archive.write.store import ArchiveWriter
from etendue.errors import ArchiveError
from etendue.plan.model import CellRef, Node, Plan
from etendue.plan.resume import is_of_names, with_stored_values
from etendue.types.documents import DocumentView


def with_stored(asked: Plan, store: ArchiveWriter, prune: bool) -> tuple[Plan, list[str], int]:
    """Return the plan extended by the stored variables of an archive, the stages that are kept only for this reason,
    and the number of cells to remove.

    Raises
    ------
    ArchiveError
        The archive was made with other stages or axes, or finished results would be lost without ``prune``.
    """
    refuse_regrown(asked, store.record, str(store.folder))
    swapped = any(is_of_names(axis.key) for axis in asked.axes)
    sweeps = [sweep_of(record, store.folder) for record in records(store.folder)] if swapped else []
    plan = with_stored_values(asked, store.journal.axes, sweeps)
    if not same_cells(asked, plan):
        plan = asked
    store.check_stages(plan)
    entries, stored = store.journal.entries, store.stored()
    if prune:
        return plan, [], sum(pruned(plan, entries).cells.values())
    plan, stay, lost = staying(plan, entries, stored)
    if lost.cells:
        lost.refuse(str(store.folder))
    return plan, stay, 0


def refuse_regrown(asked: Plan, record: DocumentView | None, folder: str) -> None:
    """Refuse a Latin hypercube with another number of points than the stored one, because the two have no rows in
    common.

    Raises
    ------
    ArchiveError
        The design is a Latin hypercube, and the archive holds another one.
    """
    own, sweep = asked.pipeline.design, sweep_of(record, Path(folder), "design") if record else {}
    if own.get("method") == "lhs" == sweep.get("method") and own.get("points") != sweep.get("points"):
        raise ArchiveError(
            f"{folder} holds a Latin hypercube of {sweep.get('points')} points. It cannot be extended to "
            f"{own.get('points')}, because every row would change. Use another archive with --archive DIR; designs "
            f"with method 'sobol', 'halton', 'random', 'saltelli' or 'list' can be extended"
        )


def same_cells(asked: Plan, plan: Plan) -> dict[CellRef, CellRef]:
    """Map each requested cell to its cell in a plan over more values; empty if a cell is missing there."""
    if plan.cells is asked.cells:
        return {ref: ref for ref in asked.cells}
    by_name = {name: ref for ref, name in Names(plan).items()}
    found = {ref: by_name.get(name) for ref, name in Names(asked).items()}
    return {} if None in found.values() else found  # type: ignore[return-value]


def computed(asked: Plan, cells: Mapping[CellRef, CellRef]) -> list[CellRef]:
    """Return the requested cells that must be finished, because their values are stored or another cell reads them."""
    return [own for ref, own in cells.items() if ref[0] not in asked.seen_only]


@dataclass
class RemovedCells:
    """The finished cells that a run would remove: their number by stage, and their total size in bytes."""

    cells: dict[str, int] = field(default_factory=dict)
    bytes: int = 0

    def add(self, stage: str, entries: Iterable[Entry]) -> None:
        for entry in entries:
            self.cells[stage] = self.cells.get(stage, 0) + 1
            self.bytes += sum(file.size for file in entry.files)

    def refuse(self, folder: str) -> None:
        """Raise an error that names the results that would be lost, and how to proceed."""
        stages = [f"{stage} ({count} {'cell' if count == 1 else 'cells'})" for stage, count in self.cells.items()]
        shown = ", ".join(stages[:8]) + (f" and {len(stages) - 8} more stages" if len(stages) > 8 else "")
        total = sum(self.cells.values())
        raise ArchiveError(
            f"{folder} holds finished results that this run neither keeps nor replaces: {shown}; "
            f"{total} {'cell' if total == 1 else 'cells'}, {self.bytes} bytes in total. "
            f"Remove them with --prune; keep them by naming them under 'keep' and in the sweep; or use another archive "
            f"with --archive DIR"
        )


def staying(plan: Plan, entries: Entries, stored: set[tuple[str, str]]) -> tuple[Plan, list[str], RemovedCells]:
    """Return the plan extended to keep valid stored variables, the stages that are kept for that reason alone, and the
    results that would be lost.

    If a stage keeps any variable, it keeps all its stored variables, because the status of a cell applies to all of
    them.
    """
    plan = replace(plan, nodes=tuple(_with_optional(node, stored) for node in plan.nodes))
    lost, kept, stay = RemovedCells(), set(plan.kept), list[str]()
    if not entries:
        return plan, stay, lost
    names = Names(plan)
    for name in entries.done_beside(names.in_order()):
        if entries.first_file(name):
            lost.add(name.split(" ")[0], [entries[name]])
    for node in plan.nodes:
        extra = {(node.name, v) for v in node.writes} & stored - plan.kept
        if not extra:
            continue
        if not any((node.name, v) in plan.kept for v in node.writes):
            own = ((cell, entries.get(names[cell.ref])) for cell in plan.of(node.name))
            wrong = [
                entry
                for cell, entry in own
                if entry and entry.event == "done" and entry.files and entry.key != cell.key
            ]
            if wrong:
                lost.add(node.name, wrong)
                continue
            stay.append(node.name)
        kept |= extra
    return replace(plan, kept=frozenset(kept)), stay, lost


def _with_optional(node: Node, stored: set[tuple[str, str]]) -> Node:
    """Return a stage that also writes the optional variables that are stored already."""
    back = {v: d for v, d in node.optional.items() if (node.name, v) in stored}
    rest = {v: d for v, d in node.optional.items() if v not in back}
    return replace(node, writes={**node.writes, **back}, optional=rest) if back else node


def pruned(plan: Plan, entries: Mapping[str, Entry]) -> RemovedCells:
    """Return the cells that must be removed to keep only the results of this run."""
    names = set(Names(plan).values())
    gone = RemovedCells()
    for name, entry in entries.items():
        stage = name.split(" ")[0]
        kept = {v for s, v in plan.kept if s == stage}
        unkept = [f for f in entry.files if f.path.split("/")[-2] not in kept]
        if entry.event == "done" and entry.files and (name not in names or unkept):
            gone.add(stage, [entry if name not in names else replace(entry, files=tuple(unkept))])
    return gone
