"""The error of the answer in words: behind a value, and what was measured where.

In:  stored errors (``AnswerErrors.document()``), or one of them.
Out: texts for the end table, captions and the report.
"""

from __future__ import annotations

import math
from typing import Any

from etendue.telling import human_seconds
from etendue.types.documents import DocumentView

MATTERS = 0.02  # of the total: smaller parts are not listed


def parts_text(error: DocumentView) -> str:
    """Return the parts of an error that matter, largest first, as ``bins 0.02, spacing 0.01``."""
    total = number(error["rms"])
    own = sorted(((number(part["rms"]), name) for name, part in error["parts"].items()), reverse=True)
    return ", ".join(f"{name} {value:.1g}" for value, name in own if value > MATTERS * total)


def says_enough(error: DocumentView, complete: bool = False) -> bool:
    """Return whether an error may be shown: everything was measured, or, unless it must be ``complete``, at least one
    discretisation that matters.
    """
    if error["open"] and not complete:
        return any(part["basis"] == "refined" and part["rms"] for part in error["parts"].values())
    return bool(error["parts"]) and not error["open"]


def plus_minus(error: DocumentView | None, unit: str = "") -> str:
    """Return what stands behind a value: ``\u00b10.03 cycles/mm (bins 0.02, spacing 0.01)``; '' if not enough was
    measured.
    """
    if error is None or not says_enough(error):
        return ""
    parts, more = parts_text(error), ", ".join(error["open"])
    inside = "; ".join(text for text in (parts, f"{more} not measured" if more else "") if text)
    noise = f" \u00b1{number(error['noise']):.1g} (noise)" if error.get("noise") else ""
    shown = f"\u00b1{number(error['rms']):.2g} {unit if unit != '1' else ''}".rstrip()
    return f"{shown}{f' ({inside})' if inside else ''}{noise}"


def number(value: Any) -> float:
    """Return a stored number, which may be None or a text."""
    return math.nan if value is None else float(value)


def notes(document: DocumentView) -> list[str]:
    """Return what was measured where, and what was not, with what it would take."""
    errors = document["errors"].values()
    points = document["points"]
    factor = max((one["scaled"] for one in errors), default=1.0)
    where = "" if points == 1 and factor == 1 else f" at {points} point{'s' if points > 1 else ''} of the sweep"
    spread = f"; errors are {factor:g} times the largest of these, for the points between" if factor > 1 else ""
    when = "by an earlier run" if document["remembered"] else f"in {human_seconds(document['seconds'])}"
    said = [f"measured{where} without noise, {when}{spread}"] if any(one["parts"] for one in errors) else []
    fixed = {f"{name}: {why}" for one in errors for name, why in one["fixed"].items()}
    said += [f"not refined: {text}" for text in sorted(fixed)]
    costly = dict.fromkeys(
        name for one in errors for name, why in one["open"].items() if "costs" in why or "memory" in why
    )
    if costly:
        said.append(
            f"not measured: {', '.join(costly)}, which costs about {human_seconds(document['dear'])}: --measure"
        )
    return said
