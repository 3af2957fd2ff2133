"""Measured global errors: a row for each wanted variable.

In:  what was measured, the tolerance that was asked for.
Out: a document for ``--json``; a table of the worst, on stdout.
"""

from __future__ import annotations

import math
from typing import Any

from etendue.report.terminal import _out, _table, escape, human_seconds, short_axes

SHOWN = 10  # rows; what is smaller is told in one line


def global_error_document(found: Any, tolerance: float) -> dict[str, Any]:
    """``global_error`` by variable, and how it was measured."""
    errors = {}
    for name, error in found.errors.items():
        errors[name] = {"rms": error.rms, "max": error.max, "how": error.how, "held": error.held(tolerance), "at": dict(error.at)}
        if error.linear is not None:
            errors[name]["linear"] = {"rms": error.linear[0], "max": error.linear[1]}
        if error.why:
            errors[name]["why"] = error.why
    told = {"cells": found.cells, "seconds": found.seconds, "remembered": found.remembered, "tolerance": tolerance}
    return {"global_error": errors, "measured": told}


def print_global_error(document: dict[str, Any]) -> None:
    """The worst variables, those that could not be measured, and what it cost."""
    out, told = _out(), document["measured"]
    errors = sorted(document["global_error"].items(), key=lambda item: -math.inf if item[1]["rms"] is None else -item[1]["rms"])
    out.print("")
    rows = _table(
        f"global error against the reference, tolerance {told['tolerance']:g}",
        ("variable", "left"), ("rms", "right"), ("largest", "right"), ("known by", "left"), ("held", "left"), ("worst at", "left"),
        wrap=("worst at",),
    )  # fmt: skip
    short = short_axes(dict.fromkeys(key for _, error in errors for key in error["at"]))
    for name, error in errors[:SHOWN]:
        words = {True: "yes", False: "no", None: "unknown"}
        at = ", ".join(
            f"{short[key]} {value:.4g}" if isinstance(value, float) else f"{short[key]} {value}" for key, value in error["at"].items()
        )
        rows.add_row(escape(name), _number(error["rms"]), _number(error["max"]), error["how"], words[error["held"]], escape(at))
        if "linear" in error:
            rows.add_row("  in front of the encoding", _number(error["linear"]["rms"]), _number(error["linear"]["max"]), "", "", "")
    out.print(rows)
    if len(errors) > SHOWN:
        out.print(f"{len(errors) - SHOWN} further variables, rms at most {_number(errors[SHOWN][1]['rms'])}")
    for why in dict.fromkeys(error["why"] for _, error in errors if "why" in error):
        out.print(f"unknown: {escape(why)}", soft_wrap=True)
    cells = "1 point" if told["cells"] == 1 else f"{told['cells']} points"
    missed = sum(error["held"] is False for _, error in errors)
    if missed:
        out.print(f"not held: {missed} of {len(errors)} variables are further from the reference than the tolerance")
    when = ", as an earlier run measured it" if told["remembered"] else ""
    out.print(f"measured at {cells} of the sweep in {human_seconds(told['seconds'])} of thread time{when}")


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.2g}"
