"""The tree of a run in which some cells are in memory already.

In:  a plan, the results of earlier evaluations.
Out: the ``Outcome`` of a run, as if all of its cells had been computed now.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from etendue.archive.write.memory import MemoryKeeper
from etendue.contract.ports import CellReport, Look, Seen
from etendue.evaluation.asking import raise_failed
from etendue.evaluation.evaluating import Evaluated, evaluate
from etendue.evaluation.plans import Plans
from etendue.evaluation.results import Results
from etendue.plan.model import CellRef, Plan
from etendue.plan.resume import Work
from etendue.plan.shown import shown_cells
from etendue.session import Options, Outcome, execute

if TYPE_CHECKING:
    from etendue.types.arrays import Array

SEEN = "seen"  # name under which the pickled reduction of a cell is kept
IN_A_LOOP = 256 << 20  # bytes of results that ``simulate`` keeps between its calls


@dataclass(frozen=True)
class Memory:
    """Results and plans of earlier calls of one process."""

    results: Results
    plans: Plans

    def clear(self, most: int | None = None) -> None:
        """Forget everything; ``most``: the new bound in bytes, 0 to keep nothing."""
        self.results.clear(most)
        self.plans.clear()


MEMORY = Memory(Results(IN_A_LOOP), Plans())


class RememberingKeeper(MemoryKeeper):
    """Keeps the results of a run in memory, together with results of earlier evaluations."""

    def __init__(self, results: Results, options: Options) -> None:
        super().__init__(options.pictures)
        self.results, self.options, self.found = results, options, Evaluated()

    def begin(self, asked: Plan) -> Work:
        work = super().begin(asked)
        plan = work.plan
        stored = {
            node.name: frozenset(name for name in node.writes if (node.name, name) in plan.with_arrays)
            for node in plan.nodes
        }
        wanted = {ref: stored[ref[0]] for ref in work.todo}
        if self.draws:
            wanted |= {ref: frozenset(plan.node(ref[0]).writes) for ref in shown_cells(plan).values() if ref in wanted}
        self.found = evaluate(plan, wanted, self.results, self.options)
        own = {ref: {n: a for n, a in some.items() if n in stored[ref[0]]} for ref, some in self.found.arrays.items()}
        self.finished(tuple(self.found.reports.values()), own)
        return replace(work, todo=set(), reused=set(self.found.reports))

    def earlier(self, refs: Iterable[CellRef]) -> Iterable[CellReport]:
        return [self.found.reports[ref] for ref in refs]

    def stored(
        self, refs: Iterable[CellRef], figures_only: bool = False, named: frozenset[str] | None = None
    ) -> dict[CellRef, dict[str, Array]]:
        return {} if figures_only else {ref: self.found.arrays.get(ref, {}) for ref in refs}

    def look_at(self, ref: CellRef, look: Look) -> Seen:
        """Return the reduction ``look`` of a cell, from memory if the same reduction of an equal cell is kept: to make
        a small picture of light in many bands takes longer than the stages that a loop changes.
        """
        cell, report = self.plan.cells[ref], self.found.reports[ref]
        if not cell.key:
            return super().look_at(ref, look)
        key = f"{cell.key} seen {hashlib.blake2b(pickle.dumps(look)).hexdigest()}"
        kept = self.results.seen(key)
        if kept is not None and SEEN in kept.arrays:
            self.results.used(key, report, kept.arrays)
            found: Seen = pickle.loads(kept.arrays[SEEN].tobytes())
            return found
        found = super().look_at(ref, look)
        self.results.put(key, report, {SEEN: np.frombuffer(pickle.dumps(found), np.uint8)})
        return found


def remembered(plan: Plan, results: Results, options: Options) -> Outcome:
    """Return the outcome of a run in memory. A run that is too large to be kept is computed without earlier results.

    Raises
    ------
    EtendueError
        If cells failed; the message names the first failed cell.
    """
    if 2 * bytes_of(plan) > results.most:
        outcome = execute(plan, None, options)
        raise_failed(plan, outcome.failed)
        return outcome
    into = RememberingKeeper(results, options)
    outcome = execute(plan, None, options, into=into)
    raise_failed(plan, into.found.failed)
    return outcome


def bytes_of(plan: Plan) -> int:
    """Return an upper bound of the size, in bytes, of all variables that a plan keeps."""
    width = 4 if plan.precision == "float32" else 8
    kept = {node.name: [name for name in node.writes if (node.name, name) in plan.kept] for node in plan.nodes}
    return width * sum(cell.grids[name].count for cell in plan.cells.values() for name in kept[cell.node])
