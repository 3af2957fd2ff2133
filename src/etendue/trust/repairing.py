"""A damaged archive made whole, from itself: only what is damaged is computed.

In:  the folder of an archive; where its inputs may be found, if they are lost too.
Out: what was damaged, what was done, what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

from etendue.archive.again import recorded
from etendue.archive.looking import Told, Verified
from etendue.archive.rebuild import prepare
from etendue.archive.verify import document as of_verified
from etendue.archive.verify import verify
from etendue.contract.ports import Progress
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue.types.documents import Document


@dataclass
class Repaired:
    """What became of a damaged archive.

    Attributes
    ----------
    done : in words, what was put back without computing
    computed, failed : cells
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
    """Find what is damaged, put back what is known, compute the rest again, and look once more.

    Raises
    ------
    ArchiveError
        The folder is no archive, nobody knows what it was asked for, or an input that is needed is nowhere.
    ArchiveInUse, MachineError
        A run is writing to it; the machine is short.
    """
    found = verify(folder, told)
    if found.whole:
        return Repaired(found, found)
    missing = [path for path in sources if not path.exists()]
    if missing:
        raise ArchiveError(f"--from {missing[0]}: there is no such file or folder")
    done = prepare(found, sources)
    plan = make_plan(recorded(folder).pipeline(options.most_cells), installed_stages())
    outcome = execute(
        plan, folder, replace(options, restore=frozenset(found.lost)), progress(plan) if progress else None
    )
    done += [f"{text} was written again" for text in outcome.mended]
    return Repaired(found, verify(folder, told), done, outcome.computed + outcome.restored, len(outcome.failed))


def document(found: Repaired) -> Document:
    """As ``--json`` says it: the archive as it is now, and what was done."""
    return {
        **of_verified(found.after),
        "repaired": of_verified(found.before)["damages"],
        "cells_repaired": list(found.before.lost),
        "done": found.done,
        "computed": found.computed,
        "failed": found.failed,
    }
