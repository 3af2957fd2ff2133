"""Measured global errors: a row for each wanted variable.

In:  measured errors, the requested tolerance.
Out: a document for ``--json``; a table of the largest errors on stdout.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from etendue.present.terminal.terminal import _out, _table, escape, short_axes
from etendue.telling import human_seconds
from etendue.types.documents import Document

SHOWN = 10  # rows; smaller errors are summarised in one line


def global_error_document(
    found: Any, tolerance: float, norm: str = "rms", stated: Mapping[str, float | None] | None = None
) -> Document:
    """Return the global error of each variable, and the cost of the measurement; ``stated`` holds, by variable, error
    bounds for the cells that were not measured.
    """
    errors = {}
    for name, error in found.errors.items():
        held = error.held(tolerance, norm)
        errors[name] = {"rms": error.rms, "max": error.max, "how": error.how, "held": held, "at": dict(error.at)}
        if error.linear is not None:
            errors[name]["linear"] = {"rms": error.linear[0], "max": error.linear[1]}
        if error.why:
            errors[name]["why"] = error.why
        if stated is not None:
            errors[name]["elsewhere"] = stated.get(name)
    told = {"cells": found.cells, "seconds": found.seconds, "remembered": found.remembered, "tolerance": tolerance}
    return {"global_error": errors, "measured": told}


def not_held(hold: Document, errors: Any) -> list[str]:
    """Return a text for each variable whose error exceeds its limit: by how much, and for which causes."""
    said = []
    for name in hold["missed"][:SHOWN]:
        own = errors[name] if isinstance(errors[name], dict) else vars(errors[name])
        value = own["rms" if hold["norm"] == "rms" else "max"]
        limit = hold["limits"].get(name, 0.0)
        far = (
            f"{value:.2g}, {value / limit if limit else math.inf:.2g} times the tolerance"
            if value is not None and value > limit
            else own["how"]
        )
        said.append(f"not held: {name}, {far}{': ' + own['why'] if own.get('why') else ''}")
    if hold["missed"] and hold["blame"]:
        blame = ", ".join(f"{name} ({fall:.2g})" for name, fall in hold["blame"].items())
        said.append(f"caused by: {blame}")
    return said


def print_global_error(document: Document) -> None:
    """Print the largest errors, the variables that could not be measured, and the time of the measurement."""
    out, told = _out(), document["measured"]
    errors = sorted(
        document["global_error"].items(), key=lambda item: -math.inf if item[1]["rms"] is None else -item[1]["rms"]
    )
    out.print("")
    short = short_axes(dict.fromkeys(key for _, error in errors for key in error["at"]))
    rows: list[Document] = []
    for name, error in errors[:SHOWN]:
        rows.append({**error, "name": name})
        if "linear" in error:
            rows.append({**error["linear"], "name": "  before the encoding", "how": "", "held": "", "at": {}})
    table = _table(
        f"global error against the reference, tolerance {told['tolerance']:g}",
        ("variable", "left", "name"),
        ("rms", "right", "rms", ".2g", "unknown"),
        ("max", "right", "max", ".2g", "unknown"),
        ("basis", "left", "how"),
        ("held", "left", "held", lambda held: {True: "yes", False: "no"}.get(held, ""), "unknown"),
        ("worst at", "left", "at", lambda at: ", ".join(f"{short[k]} {_plain(v)}" for k, v in at.items())),
        rows=rows,
        wrap=("worst at",),
    )
    out.print(table)
    _print_held(out, document, errors)


def _plain(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _print_held(out: Console, document: Document, errors: list[tuple[str, Document]]) -> None:
    """Print whether the errors of wanted variables are within the tolerance, and where they were measured."""
    told = document["measured"]
    if len(errors) > SHOWN:
        out.print(f"{len(errors) - SHOWN} more variables, rms at most {_number(errors[SHOWN][1]['rms'])}")
    for why in dict.fromkeys(error["why"] for _, error in errors if "why" in error):
        out.print(f"unknown: {escape(why)}", soft_wrap=True)
    cells = "1 point" if told["cells"] == 1 else f"{told['cells']} points"
    missed = sum(error["held"] is False for _, error in errors)
    if "hold" in document:
        hold = document["hold"]
        for text in not_held(hold, document["global_error"]):
            out.print(escape(text), soft_wrap=True)
        if hold["held"]:
            own = [f"{name} within {limit:g}" for name, limit in hold["asked_of"].items()]
            every = [] if hold["asked"] is None else [f"all wanted variables are within {hold['asked']:g}"]
            what = ", ".join([*every, *own])
            whole = hold.get("discretisation") and not hold.get("beyond")
            of = "the same with everything refined" if whole else "the reference"
            out.print(f"held: {escape(what)} of {of}, with local tolerance {hold['tolerance']:g}", soft_wrap=True)
        for text in hold.get("beyond", ()):
            out.print(escape(text))
    elif missed:
        out.print(f"not held: {missed} of {len(errors)} variables differ from the reference by more than the tolerance")
    elsewhere = {name: error["elsewhere"] for name, error in errors if error.get("elsewhere")}
    if elsewhere:
        worst = max(elsewhere, key=lambda name: elsewhere[name])
        out.print(f"cells not measured: error bound {_number(elsewhere[worst])} ({escape(worst)})")
    when = ", by an earlier run" if told["remembered"] else ""
    out.print(f"measured at {cells} of the sweep in {human_seconds(told['seconds'])} of CPU time{when}")


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.2g}"
