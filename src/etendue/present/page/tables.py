"""Tables of an archive for the page: its stages, cells, omissions, failures, measured errors.

In:  an archive opened for display.
Out: plain lists and columns. For an unfinished run they come from the journal; errors are only in the ledger, written
     at the end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray

from etendue.archive.records.manifest import DATA
from etendue.archive.records.remembered import ANSWER, documents, latest
from etendue.archive.sharding.unfolding import check_group
from etendue.present.page.opened import Opened
from etendue.present.plots.summary.cells import each_of, largest, total
from etendue.present.terminal.answer_texts import is_sound, notes, number, parts_text, plus_minus, says_enough
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.types.documents import Scalar

STATUS = ("done", "left_out", "failed", "skipped", "not_computed", "reused")
WORDS = ("stage", "status", "how", "approximated", "why_left_out", "message")
NUMBERS = ("seconds", "error", "bound", "seconds_saved", "clipped")
EXAMPLES = 5
WIDEST = 2000  # characters of a text
Ledger = Document


def ledger(opened: Opened) -> Ledger:
    """Return the ledger as columns, with one row per cell; ``at`` holds the column of every axis."""
    if opened.ended:
        try:
            check_group(opened.folder / DATA / "ledger")
            table = xarray.open_dataset(
                str(opened.folder / DATA), engine="zarr", group="ledger", chunks=None, consolidated=False
            ).load()
        except (OSError, KeyError, ValueError):
            return _from_journal(opened)
        texts = {name: table[name].to_numpy().tolist() for name in WORDS if name in table}
        found: Ledger = {
            name: np.array([str(one)[:WIDEST] for one in own] or [""])[: len(own)] for name, own in texts.items()
        }  # fixed-width text is as wide as its longest entry, so long ones are cut
        found |= {name: table[name].to_numpy().astype(float) for name in NUMBERS if name in table}
        rows = int(table.sizes["cell"])
        for name in WORDS:
            found.setdefault(name, np.full(rows, "", dtype=object))
        for name in NUMBERS:
            found.setdefault(name, np.full(rows, math.nan))
        found["at"] = {
            axis.dim: table[f"at_{axis.dim}"].to_numpy() for axis in opened.axes if f"at_{axis.dim}" in table
        }
        return found
    return _from_journal(opened)


def _from_journal(opened: Opened) -> Ledger:
    rows = [one for one in opened.stored.journal.said.told() if one[1] in ("done", "failed")]
    planned = opened.stored.journal.run.planned if opened.stored.journal.run else {}
    found: Ledger = {
        "stage": np.array([name.split(" ")[0] for name, *_ in rows], dtype=object),
        "status": np.array([status if event == "done" else "failed" for _, event, status, _, _ in rows], dtype=object),
        "seconds": np.array([seconds for _, _, _, seconds, _ in rows], dtype=float),
        "clipped": np.array([clipped for *_, clipped in rows], dtype=float),
        "at": {},
        "planned": dict(planned),
    }
    for name in WORDS:
        found.setdefault(name, np.full(len(rows), "", dtype=object))
    for name in NUMBERS:
        found.setdefault(name, np.full(len(rows), math.nan))
    return found


def stage_rows(opened: Opened, table: Ledger, about: Mapping[str, Mapping[str, str]]) -> list[Document]:
    """Return a row per stage: description, axes, cells, seconds, errors."""
    rows, nodes = [], opened.record["nodes"]
    for place, stage in enumerate(opened.stages):
        own = table["stage"] == stage
        status, error = table["status"][own], table["error"][own]
        node = nodes.get(stage, {})
        use = [str(one) for one in node.get("stage", [stage])]
        known = error[np.isfinite(error)]
        rows.append(
            {
                "name": stage,
                "order": place + 1,
                "use": use,
                "role": [str(r) for r in node.get("role", [])],
                "what": about.get(use[0], {}).get("what", ""),
                "distribution": [str(d) for d in node.get("distributions", [])],
                "axes": list(opened.reaching(stage)),
                "shown": node.get("shown", {}),
                "inputs": node.get("inputs", []),
                "cells": int(table.get("planned", {}).get(stage, own.sum())),
                "done": int(np.isin(status, ("done", "reused")).sum()),
                "left_out": int((status == "left_out").sum()),
                "failed": int((status == "failed").sum()),
                "skipped": int((status == "skipped").sum()),
                "seconds": total(table["seconds"][own]),
                "error": largest(known),
                "error_least": float(known.min()) if known.size else None,
                "bound": largest(table["bound"][own]),
                "how": sorted({str(h) for h in table["how"][own] if h}),
            }
        )
    return rows


def failures(table: Ledger) -> Document:
    """Return failed cells by stage and message, and the number of later cells that were skipped."""
    rows = []
    for stage, message, own in each_of(table, table["status"] == "failed", "message"):
        examples = [
            {dim: _shown(column[row]) for dim, column in table["at"].items() if _shown(column[row]) not in (None, "")}
            for row in np.flatnonzero(own)[:EXAMPLES]
        ]
        rows.append({"stage": stage, "message": message, "cells": int(own.sum()), "examples": examples})
    return {"rows": rows, "skipped": int((table["status"] == "skipped").sum())}


MOST_PICTURES = 3  # with their errors in words


def measured(opened: Opened) -> list[Document]:
    """Return the errors of the wanted variables relative to the reference settings, as ``run --measure`` last measured
    them.
    """
    found: dict[str, Document] = {}
    for document in documents(opened.folder).values():
        errors = document.get("errors") if document.get("kind") is None else None
        for name, one in errors.items() if isinstance(errors, dict) else ():
            if isinstance(one, dict) and isinstance(one.get("rms"), int | float):
                found[str(name)] = {
                    "variable": str(name),
                    "rms": one["rms"],
                    "max": one.get("max"),
                    "how": str(one.get("how", "")),
                }
    return sorted(found.values(), key=lambda one: -one["rms"])


def _shown(value: Any) -> Scalar:
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


# -- the error of the answer -----------------------------------------------------------------------------------------


def answer(opened: Opened) -> Document | None:
    """Return the known errors of an archive's metrics and pictures."""
    stored = latest(opened.folder, ANSWER)
    if stored is None or not is_sound(stored):  # none, or edited
        return None
    at = {dim: tuple(value) if isinstance(value, list) else value for dim, value in stored["at"].items()}
    return {
        "at": {axis.dim: axis.places.get(at.get(axis.dim), -1) for axis in opened.axes},  # -1: not there
        "here": _texts(stored["shown"]),
        "sweep": _texts(stored["errors"]),
        "pictures": _pictures(stored["errors"]),
        "notes": notes(stored),
    }


def _texts(errors: DocumentView) -> Document:
    return {f"{one['stage']}.{one['variable']}": plus_minus(one, one["unit"]) for one in errors.values() if one["unit"]}


def _pictures(errors: DocumentView) -> list[str]:
    """Return sentences about the pictures and curves with the largest errors."""
    own = sorted(
        (one for one in errors.values() if not one["unit"] and says_enough(one) and number(one["rms"])),
        key=lambda one: -number(one["rms"]),
    )
    return [
        f"{one['variable']}: {number(one['rms']):.1g} of full scale rms, {number(one['max']):.1g} at most"
        f"{f' ({parts})' if (parts := parts_text(one)) else ''}"
        for one in own[:MOST_PICTURES]
    ]
