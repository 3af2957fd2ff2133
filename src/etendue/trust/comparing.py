"""Compare two documents or arrays of an archive completely, except for a list of contents that cannot be recomputed.

In:  archived and recomputed documents or arrays.
Out: a ``Difference`` for each place where they disagree; contents that are not compared, with the reasons.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.archive.read.stored import Stored
from etendue.archive.records.manifest import DATA
from etendue.trust.remade import Again
from etendue.trust.sayings import Deviation

if TYPE_CHECKING:
    from etendue.types.arrays import Array

ELSEWHERE = 1e-6  # relative tolerance of numbers in metadata on another platform


@dataclass(frozen=True)
class NotChecked:
    """A content that is not compared, and the reason; ``pattern`` matches file and place as ``FILE#WHERE``."""

    what: str
    why: str
    pattern: str = ""


NOT_CHECKED = (
    NotChecked(
        "seconds",
        "another run takes different times; the times in ledger and journal are compared with each other, and "
        "the summary contains only the times of the last run",
        rf"{DATA}/summary/seconds/c/.*",
    ),
    NotChecked(
        "dates",
        "they cannot be recomputed",
        r"runs/\d+\.json#began|ro-crate-metadata\.json#.*\b(endTime|datePublished)",
    ),
    NotChecked(
        "recorded versions, platform and code",
        "differences from the installed versions are listed, but do not count as errors",
        r"runs/\d+\.json#(platform|libraries|distributions)\b.*"
        rf"|(runs/\d+\.json#nodes|{DATA}/zarr\.json#consolidated_metadata\.metadata|{DATA})\b.*[./#]distributions?\b.*"
        r"|ro-crate-metadata\.json#.*\b(softwareVersion|version)",
    ),
    NotChecked("how a run was done", "the scheduler changes no bit", r"runs/\d+\.json#options\.scheduler"),
    NotChecked(
        "names, texts, licence and authors",
        "texts by the author cannot be recomputed",
        rf"{DATA}/zarr\.json#attributes\.(etendue\.pipeline|variant)|ro-crate-metadata\.json#(\./|#run-\d+|runs/\d+\.toml)?"
        r"\.(name|description|license|author)\b.*|ro-crate-metadata\.json#.*\.(agent|license|author)\b.*|ro-crate-metadata\.json#(https?:|#author|"
        r"#affiliation|#license|CITATION).*",
    ),
    NotChecked("messages of failed cells", "a cell may fail again with a different message"),
    NotChecked(
        "what was reused or accepted",
        "for cells of an earlier platform, only the journal knows this state; there is nothing to compare it with",
    ),
    NotChecked(
        "contact_sheet.png, CITATION.cff, measured.json",
        "derived from compared data; run --measure measures the errors again",
    ),
    NotChecked(
        "foreign files",
        "no run has written these files and groups (strays/ among them), so there is nothing to compare them with",
    ),
)


def unchecked(stored: Stored, again: Again, elsewhere: bool, software: bool, into: bool) -> list[NotChecked]:
    """Return the contents that are not compared: ``NOT_CHECKED``, and contents that cannot be compared in this archive,
    with their number.
    """
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
                f"{len(lacking)} cells that the archive does not hold",
                f"{lacking[0]} ...: not requested, interrupted, failed, or removed",
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
                f"{len(strange)} journal lines of cells that the pipeline does not have",
                f"{strange[0]} ...: they have no files",
            )
        )
    if stored.manifest is None:
        found.append(
            NotChecked("status, tables, pictures", "its last run was interrupted; complete it with: etendue rerun")
        )
    elif again.sheet is None:
        why = (
            "it has none"
            if f"{DATA}/frames/zarr.json" not in stored.manifest.metadata
            else "another platform"
            if elsewhere
            else "--into"
            if into
            else "they show cells that are no longer stored, or some of their cells were not computed"
        )
        found.append(NotChecked("pictures (frames)", why))
    if software:
        found.append(NotChecked("keys, and digests of code", "the code has changed"))
    if elsewhere:
        found.append(NotChecked("what was clipped", "another platform; other numbers may differ by a relative 1e-6"))
    return found


def skipped(file: str, where: str) -> bool:
    return any(one.pattern and re.fullmatch(one.pattern, f"{file}#{where}" if where else file) for one in NOT_CHECKED)


def differences(file: str, says: Any, has: Any, loose: float, *at: str) -> Iterator[Deviation]:
    """Yield the differences of two documents, field by field; ``at``: the fields that lead to these parts."""
    if len(at) == 1 and repr(says) == repr(has):
        return  # fast path: most parts are identical, including the sign of zero
    if isinstance(says, Mapping) and isinstance(has, Mapping):
        for key in dict.fromkeys((*has, *says)):
            yield from differences(file, says.get(key, NOTHING), has.get(key, NOTHING), loose, *at, str(key))
    elif isinstance(says, list) and isinstance(has, list) and len(says) == len(has):
        for number, (one, other) in enumerate(zip(says, has, strict=True)):
            yield from differences(file, one, other, loose, *at, str(number))
    elif type(says) is not type(has) or not alike(says, has, loose):
        # Checked only for values that differ: most of the thousands of values agree.
        if not any(skipped(file, ".".join(at[:depth])) for depth in range(len(at) + 1)):
            yield Deviation(file, ".".join(at), shown(says), shown(has))


NOTHING = object()


def alike(one: Any, other: Any, loose: float) -> bool:
    """Return True if two values agree; 0 and -0 differ unless numbers may deviate."""
    if isinstance(one, float):
        if one == other:
            return loose > 0 or math.copysign(1, one) == math.copysign(1, other)
        return (one != one and other != other) or (loose > 0 and math.isclose(one, other, rel_tol=loose, abs_tol=1e-30))
    return bool(one == other)


def shown(value: Any) -> str:
    text = "" if value is NOTHING else value if isinstance(value, str) else repr(value)
    return text if len(text) <= 120 else f"{text[:117]}..."


def of_array(file: str, old: Array, fresh: Array, loose: float) -> Iterator[Deviation]:
    pairs = zip(old.ravel().tolist(), fresh.ravel().tolist(), strict=True)
    off = [n for n, (one, other) in enumerate(pairs) if not alike(one, other, loose)]
    if off:
        at = [int(n) for n in np.unravel_index(off[0], fresh.shape)] if fresh.ndim else []
        more = f" and {len(off) - 1} more" if len(off) > 1 else ""
        yield Deviation(file, f"{at}{more}", shown(old.ravel().tolist()[off[0]]), shown(fresh.ravel().tolist()[off[0]]))
