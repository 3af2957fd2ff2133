"""Repair a damaged archive from its own content; only damaged cells are recomputed.

In:  the folder of an archive; places where its inputs may be found, if they are also lost.
Out: the damage found, the repairs made, and the damage that remains.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from etendue.archive.checks.rebuild import prepare
from etendue.archive.checks.verify import document as of_verified
from etendue.archive.checks.verify import verify
from etendue.archive.read.inspection import Told, Verified
from etendue.archive.records.rerun import recorded
from etendue.contract.ports import Progress
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue.types.documents import Document


@dataclass
class Repaired:
    """The result of a repair.

    Attributes
    ----------
    done : texts that describe what was restored without computing
    computed, failed : number of cells that were recomputed, and of cells that failed
    """

    before: Verified
    after: Verified
    done: list[str] = field(default_factory=list)
    computed: int = 0
    failed: int = 0


def repair(
    folder: Path,
    sources: Iterable[Path],
    options: Options,
    progress: Callable[[Plan], Progress] | None = None,
    told: Told = lambda done, total: None,
) -> Repaired:
    """Find the damage, restore content that is stored twice, recompute the rest, and verify again.

    Raises
    ------
    ArchiveError
        The folder is not an archive, its pipeline is unknown, or a needed input is missing.
    ArchiveInUse, MachineError
        A run is writing to the archive, or memory or disk does not suffice.
    """
    found = verify(folder, told)
    if found.whole:
        return Repaired(found, found)
    missing = [path for path in sources if not path.exists()]
    if missing:
        raise ArchiveError(f"--from {missing[0]}: no such file or folder")
    done = prepare(found, sources)
    plan = make_plan(recorded(folder).pipeline(options.most_cells), installed_stages())
    outcome = execute(
        plan, folder, replace(options, restore=frozenset(found.lost)), progress(plan) if progress else None
    )
    done += [f"{text} was rewritten" for text in outcome.mended]
    return Repaired(found, verify(folder, told), done, outcome.computed + outcome.restored, len(outcome.failed))


def document(found: Repaired) -> Document:
    """Return the document that ``--json`` prints: the present state of the archive, and the steps of the repair."""
    return {
        **of_verified(found.after),
        "repaired": of_verified(found.before)["damages"],
        "cells_repaired": list(found.before.lost),
        "done": found.done,
        "computed": found.computed,
        "failed": found.failed,
    }
