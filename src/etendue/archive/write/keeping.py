"""What an archive holds that a run would not keep: finished results are removed only when that is asked for.

In:  a plan over all stored axis values, what the archive has, what its journal says.
Out: the variables that stay because they are right, and what would be lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from etendue.archive.journaling.entries import Entries, Entry
from etendue.archive.records.inputs import sweep_of
from etendue.archive.records.provenance import records
from etendue.archive.structure.naming import Names
from etendue.archive.write.store import ArchiveWriter
from etendue.errors import ArchiveError
from etendue.plan.model import CellRef, Node, Plan
from etendue.plan.resume import is_of_names, with_stored_values


def with_stored(asked: Plan, store: ArchiveWriter, prune: bool) -> tuple[Plan, list[str], int]:
    """The plan over what an archive holds as well; the stages kept for that reason alone, and how many cells are given
    up.

    Raises
    ------
    ArchiveError
        It was made with other stages or axes; finished results would be lost, and nobody has asked for that.
    """
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


def same_cells(asked: Plan, plan: Plan) -> dict[CellRef, CellRef]:
    """Each cell of what is asked for in a plan over more values; nothing where one is not there."""
    if plan.cells is asked.cells:
        return {ref: ref for ref in asked.cells}
    by_name = {name: ref for ref, name in Names(plan).items()}
    found = {ref: by_name.get(name) for ref, name in Names(asked).items()}
    return {} if None in found.values() else found  # type: ignore[return-value]


@dataclass
class RemovedCells:
    """Finished cells by stage, and their bytes."""

    cells: dict[str, int] = field(default_factory=dict)
    bytes: int = 0

    def add(self, stage: str, entries: Iterable[Entry]) -> None:
        for entry in entries:
            self.cells[stage] = self.cells.get(stage, 0) + 1
            self.bytes += sum(file.size for file in entry.files)

    def refuse(self, folder: str) -> None:
        """Say what would be lost, and how to go on."""
        stages = [f"{stage} ({count} {'cell' if count == 1 else 'cells'})" for stage, count in self.cells.items()]
        shown = ", ".join(stages[:8]) + (f" and {len(stages) - 8} more stages" if len(stages) > 8 else "")
        total = sum(self.cells.values())
        raise ArchiveError(
            f"{folder} holds finished results that this run neither keeps nor replaces: {shown}; "
            f"{total} {'cell' if total == 1 else 'cells'}, {self.bytes} bytes in all. "
            f"Remove them: --prune; keep them: name them under 'keep' and in the sweep, or use another archive, "
            f"--archive DIR"
        )


def staying(plan: Plan, entries: Entries, stored: set[tuple[str, str]]) -> tuple[Plan, list[str], RemovedCells]:
    """The plan that also keeps what is stored and right; the stages that are kept for that reason alone; what would be
    lost.

    A stage of which something is kept goes on with all that is stored of it: one status holds for all its variables.
    """
    plan = replace(plan, nodes=tuple(_with_optional(node, stored) for node in plan.nodes))
    lost, kept, stay = RemovedCells(), set(plan.kept), list[str]()
    if not entries:
        return plan, stay, lost
    names = Names(plan)
    for name in entries.done_beside(names):
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
    """A stage that goes on writing what was once asked for."""
    back = {v: d for v, d in node.optional.items() if (node.name, v) in stored}
    rest = {v: d for v, d in node.optional.items() if v not in back}
    return replace(node, writes={**node.writes, **back}, optional=rest) if back else node


def pruned(plan: Plan, entries: Mapping[str, Entry]) -> RemovedCells:
    """What goes when only what a run keeps is to stay."""
    names = set(Names(plan).values())
    gone = RemovedCells()
    for name, entry in entries.items():
        stage = name.split(" ")[0]
        kept = {v for s, v in plan.kept if s == stage}
        unkept = [f for f in entry.files if f.path.split("/")[-2] not in kept]
        if entry.event == "done" and entry.files and (name not in names or unkept):
            gone.add(stage, [entry if name not in names else replace(entry, files=tuple(unkept))])
    return gone
