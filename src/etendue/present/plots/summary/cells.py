"""Progress of a run and status of its cells: from the ledger, from the journal of a run that has no ledger yet, else
from statuses.

In:  holdings; the ledger, the journal, the folder of an archive, as far as they exist.
Out: words, counts, rows of failed cells and of omissions.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray

from etendue.archive.checks.describe import progress
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import read
from etendue.archive.records.manifest import read_manifest
from etendue.archive.records.names import STATUS
from etendue.archive.records.owner import is_running
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.labels import places_text
from etendue.present.terminal.terminal import human_rate
from etendue.telling import human_seconds
from etendue.types.arrays import Array
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.archive.journaling.journal import Read

UNKNOWN = "unknown"  # status of a cell whose row of the ledger is lost: a fill value


def state_of(folder: Path | None, record: DocumentView, counts: Mapping[str, int]) -> str:
    lost = counts.get("failed", 0)
    ended = f"{lost} {'cell' if lost == 1 else 'cells'} failed" if lost else "complete"
    if unknown := counts.get(UNKNOWN, 0):
        ended = f"damaged: no ledger entry for {unknown} {'cell' if unknown == 1 else 'cells'}"
    if folder is None:
        return ended
    if is_running(folder):
        far = progress(read(folder / JOURNAL), str(record.get("began", "")))
        words = [f"running: {far['finished']} of {far['planned']} cells" if far["planned"] else "running"]
        words += [human_rate(far["rate"])] if far["rate"] else []
        words += [f"about {human_seconds(max(round(far['left']), 1))} left"] if far["left"] is not None else []
        return ", ".join(words)
    if read_manifest(folder) is None:
        far = progress(read(folder / JOURNAL))
        return f"interrupted: {far['finished']} of {far['planned']} cells" if far["planned"] else "interrupted"
    open_, cells = counts.get("not_computed", 0), sum(counts.values())
    return f"interrupted: {cells - open_} of {cells} cells" if open_ else ended


def stages_of(holdings: Holdings, ledger: xarray.Dataset | None) -> list[str]:
    """Return the names of all stages, stored or not."""
    if ledger is not None:
        return list(dict.fromkeys(filter(None, map(str, ledger["stage"].values.tolist()))))
    own = holdings.tree.attrs.get("etendue", {})
    said = own.get("stages") if isinstance(own, Mapping) else None
    return list(map(str, said)) if isinstance(said, list) else list(dict.fromkeys(one.stage for one in holdings))


def counts_of(holdings: Holdings, ledger: xarray.Dataset | None, journal: Read | None) -> dict[str, int]:
    if ledger is not None:
        found = Counter("done" if one == "reused" else str(one) or UNKNOWN for one in ledger["status"].values.tolist())
    elif journal is not None:
        found = Counter()
        for (_, status), number in journal.said.counts(journal.outdated).items():
            found[status] += number
    else:
        found = Counter()
        for groups in {one.stage: one.groups for one in holdings}.values():
            for group in groups:
                if "status" in group:
                    numbers = np.bincount(np.ravel(group["status"].values).astype(int), minlength=len(STATUS))
                    found.update(dict(zip(STATUS, map(int, numbers), strict=False)))
    order = [*STATUS, *sorted(set(found) - set(STATUS))]
    return {status: found[status] for status in order if found.get(status)}


def failed_cells(
    holdings: Holdings, ledger: xarray.Dataset | None, journal: Read | None, units: Mapping[str, str]
) -> list[tuple[str, str, str]]:
    """Return (stage, where, message) of every cell that failed."""
    if ledger is not None:
        return _failed_of(ledger, units)
    if not journal:
        return _failed_by_status(holdings, units)
    told = [name for name, event, status, *_ in journal.said.told() if event == status == "failed"]
    # the reason is written when the run ends
    return [(stage, where, "") for stage, _, where in (name.partition(" ") for name in told)]


def _failed_of(ledger: xarray.Dataset, units: Mapping[str, str]) -> list[tuple[str, str, str]]:
    rows = np.flatnonzero(ledger["status"].values.astype(object) == "failed")
    named = [*(f"at_{dim}" for dim in units), *(str(name) for name in ledger.data_vars if str(name).startswith("at_"))]
    axes = [name for name in dict.fromkeys(named) if name in ledger]
    found = []
    for row in rows:
        one = {name.removeprefix("at_"): ledger[name].values[row] for name in axes}
        known = {dim: v for dim, v in one.items() if v != "" and not (isinstance(v, float) and math.isnan(v))}
        found.append(
            (
                str(ledger["stage"].values[row]),
                places_text(known, dict(units)),
                str(ledger["message"].values[row]).strip().rpartition("\n")[2].strip(),  # the rest is in the ledger
            )
        )
    return found


def _failed_by_status(holdings: Holdings, units: Mapping[str, str]) -> list[tuple[str, str, str]]:
    found = []
    for stage, one in {one.stage: one for one in holdings}.items():
        for group in one.groups:
            if "status" not in group:
                continue
            status = group["status"]
            for place in np.argwhere(status.values == STATUS.index("failed")):
                at = {str(dim): status[dim].values[i].item() for dim, i in zip(status.dims, place, strict=True)}
                found.append((stage, places_text(at, dict(units)), ""))
    return found


def omissions(table: DocumentView) -> list[Document]:
    """Return the omissions and approximations: a row per stage and reason."""
    rows = []
    for kind, column in (("left out", "why_left_out"), ("coarser", "approximated")):
        for stage, why, own in each_of(table, table[column] != "", column):
            rows.append(
                {
                    "kind": kind,
                    "stage": stage,
                    "why": why,
                    "cells": int(own.sum()),
                    "of": int((table["stage"] == stage).sum()),
                    "bound": largest(table["bound"][own]),
                    "saved": total(table["seconds_saved"][own]),
                }
            )
    return rows


def each_of(table: DocumentView, which: Array, column: str) -> list[tuple[str, str, Array]]:
    pairs = dict.fromkeys(zip(table["stage"][which].tolist(), table[column][which].tolist(), strict=True))
    return [
        (str(stage), str(text), which & (table["stage"] == stage) & (table[column] == text)) for stage, text in pairs
    ]


def total(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.sum()) if known.size else None


def largest(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else None
