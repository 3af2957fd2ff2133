"""Two documents or arrays of an archive held against each other: as wholes, but for a list of what no computing can
tell.

In:  what an archive says, what is made again.
Out: a ``Difference`` for each place in which they are not one; what is not compared, and why not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.archive.read.stored import Stored
from etendue.archive.records.manifest import DATA
from etendue.trust.remade import Again
from etendue.trust.sayings import Deviation

ELSEWHERE = 1e-6  # relative: how far numbers of metadata may be on another platform


@dataclass(frozen=True)
class NotChecked:
    """What is not compared, and why not; ``pattern``: of file and place in it, ``FILE#WHERE``."""

    what: str
    why: str
    pattern: str = ""


NOT_CHECKED = (
    NotChecked(
        "seconds",
        "another run takes others; ledger and journal are held against each other, the summary's are of the last run "
        "alone",
        rf"{DATA}/summary/seconds/c/.*",
    ),
    NotChecked(
        "dates",
        "nobody else has seen the clock",
        r"runs/\d+\.json#began|ro-crate-metadata\.json#.*\b(endTime|datePublished)",
    ),
    NotChecked(
        "versions, platform and code of then",
        "what differs from what is installed here is said, and not judged",
        r"runs/\d+\.json#(platform|libraries|distributions)\b.*"
        rf"|(runs/\d+\.json#nodes|{DATA}/zarr\.json#consolidated_metadata\.metadata|{DATA})\b.*[./#]distributions?\b.*"
        r"|ro-crate-metadata\.json#.*\b(softwareVersion|version)",
    ),
    NotChecked("how a run was done", "the scheduler changes no bit", r"runs/\d+\.json#options\.scheduler"),
    NotChecked(
        "names, texts, licence and authors",
        "what an author says of a pipeline nothing computes",
        rf"{DATA}/zarr\.json#attributes\.(etendue\.pipeline|variant)|ro-crate-metadata\.json#(\./|#run-\d+|runs/\d+\.toml)?"
        r"\.(name|description|license|author)\b.*|ro-crate-metadata\.json#.*\.(agent|license|author)\b.*|ro-crate-metadata\.json#(https?:|#author|"
        r"#affiliation|#license|CITATION).*",
    ),
    NotChecked("messages of failed cells", "a cell that fails again may say so in other words"),
    NotChecked(
        "what was reused or accepted", "a cell of an earlier platform stands in the tables as the journal has it"
    ),
    NotChecked(
        "contact_sheet.png, CITATION.cff, measured.json",
        "drawings and texts of what is compared; run --measure measures again",
    ),
    NotChecked("what is beside it", "files and groups that no run has written, strays/"),
)


def unchecked(stored: Stored, again: Again, elsewhere: bool, software: bool, into: bool) -> list[NotChecked]:
    """Of one archive: the list, and what else of it cannot be compared, with how much."""
    found = list(NOT_CHECKED)
    entries, gone = stored.journal.entries, stored.journal.outdated
    lacking = [
        name
        for name in again.names.values()
        if (one := entries.get(name)) is None or one.event != "done" or name in gone
    ]
    if lacking:
        found.append(
            NotChecked(
                f"{len(lacking)} cells that it does not hold",
                f"{lacking[0]} ...: not asked for, broken off, failed, or removed",
            )
        )
    known = set(again.names.values())
    said = stored.journal.said
    strange = [
        name for name in said if name not in known and not said.first_file(name) and said[name].event != "removed"
    ]
    if strange:
        found.append(
            NotChecked(
                f"{len(strange)} lines of cells that its pipeline does not have",
                f"{strange[0]} ...: they have no files",
            )
        )
    if stored.manifest is None:
        found.append(NotChecked("status, tables, pictures", "its last run was broken off: etendue rerun ends it"))
    elif again.sheet is None:
        why = (
            "it has none"
            if f"{DATA}/frames/zarr.json" not in stored.manifest.metadata
            else "another platform"
            if elsewhere
            else "--into"
            if into
            else "they are of cells that it no longer holds, or not all of them came out"
        )
        found.append(NotChecked("pictures (frames)", why))
    if software:
        found.append(NotChecked("keys, and digests of code", "the code is another than then"))
    if elsewhere:
        found.append(NotChecked("what was clipped", "another platform; other numbers may differ by 1e-6 of themselves"))
    return found


def skipped(file: str, where: str) -> bool:
    return any(one.pattern and re.fullmatch(one.pattern, f"{file}#{where}" if where else file) for one in NOT_CHECKED)


def differences(file: str, says: Any, has: Any, loose: float, *at: str) -> Iterator[Deviation]:
    """Of two documents, field by field; ``at``: the fields on the way from the whole document to these."""
    if len(at) == 1 and repr(says) == repr(has):
        return  # most parts are the same, down to the sign of a zero
    if isinstance(says, Mapping) and isinstance(has, Mapping):
        for key in dict.fromkeys((*has, *says)):
            yield from differences(file, says.get(key, NOTHING), has.get(key, NOTHING), loose, *at, str(key))
    elif isinstance(says, list) and isinstance(has, list) and len(says) == len(has):
        for number, (one, other) in enumerate(zip(says, has, strict=True)):
            yield from differences(file, one, other, loose, *at, str(number))
    elif type(says) is not type(has) or not alike(says, has, loose):
        # Asked of what differs alone: of documents by the thousand most is the same.
        if not any(skipped(file, ".".join(at[:depth])) for depth in range(len(at) + 1)):
            yield Deviation(file, ".".join(at), shown(says), shown(has))


NOTHING = object()


def alike(one: Any, other: Any, loose: float) -> bool:
    """Whether two values are one; 0 and -0 are two."""
    if isinstance(one, float):
        if one == other:
            return loose > 0 or math.copysign(1, one) == math.copysign(1, other)
        return (one != one and other != other) or (loose > 0 and math.isclose(one, other, rel_tol=loose, abs_tol=1e-30))
    return bool(one == other)


def shown(value: Any) -> str:
    text = "" if value is NOTHING else value if isinstance(value, str) else repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def of_array(file: str, old: Any, fresh: Any, loose: float) -> Iterator[Deviation]:
    pairs = zip(old.ravel().tolist(), fresh.ravel().tolist(), strict=True)
    off = [n for n, (one, other) in enumerate(pairs) if not alike(one, other, loose)]
    if off:
        at = [int(n) for n in np.unravel_index(off[0], fresh.shape)] if fresh.ndim else []
        more = f" and {len(off) - 1} more" if len(off) > 1 else ""
        yield Deviation(file, f"{at}{more}", shown(old.ravel().tolist()[off[0]]), shown(fresh.ravel().tolist()[off[0]]))
