"""Measured global errors: a row for each wanted variable.

In:  what was measured, the tolerance that was asked for.
Out: a document for ``--json``; a table of the worst, on stdout.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from etendue.present.terminal.terminal import _out, _table, escape, human_seconds, short_axes
from etendue.types.documents import Document

SHOWN = 10  # rows; what is smaller is told in one line


def global_error_document(
    found: Any, tolerance: float, norm: str = "rms", stated: Mapping[str, float | None] | None = None
) -> Document:
    """``global_error`` by variable, and how it was measured; ``stated`` for cells that were not."""
    errors = {}
    for name, error in found.errors.items():
        errors[name] = {
            "rms": error.rms,
            "max": error.max,
            "how": error.how,
            "held": error.held(tolerance, norm),
            "at": dict(error.at),
        }
        if error.linear is not None:
            errors[name]["linear"] = {"rms": error.linear[0], "max": error.linear[1]}
        if error.why:
            errors[name]["why"] = error.why
        if stated is not None:
            errors[name]["elsewhere"] = stated.get(name)
    told = {"cells": found.cells, "seconds": found.seconds, "remembered": found.remembered, "tolerance": tolerance}
    return {"global_error": errors, "measured": told}


def held_document(held: Any, stated: Mapping[str, float | None]) -> Document:
    """What ``--hold`` found beside the errors that it measured."""
    document = global_error_document(held.measured, held.asked, held.norm, stated)
    document["measured"] |= {"seconds": held.seconds, "remembered": held.remembered}
    return {**document, "hold": held.document()}


def say_held(held: Any) -> list[str]:
    """In front of a run: the tolerance that was found, and what cannot be held."""
    when = "found by an earlier run" if held.remembered else f"measured in {human_seconds(held.seconds)} of thread time"
    said = [f"hold {held.asked:g}: local tolerance {held.tolerance:g}, {when}"]
    return said + _not_held(held.document(), held.measured.errors)


def _not_held(hold: Document, errors: Any) -> list[str]:
    """Which variables are not held, by how much, and what is to blame."""
    said = []
    for name in hold["missed"][:SHOWN]:
        own = errors[name] if isinstance(errors[name], dict) else vars(errors[name])
        value = own["rms" if hold["norm"] == "rms" else "max"]
        far = (
            f"{value:.2g}, {value / hold['asked']:.2g} times as far"
            if value is not None and value > hold["asked"]
            else own["how"]
        )
        said.append(f"not held: {name}, {far}{': ' + own['why'] if own.get('why') else ''}")
    if hold["missed"] and hold["blame"]:
        blame = ", ".join(f"{name} ({fall:.2g})" for name, fall in hold["blame"].items())
        said.append(f"to blame: {blame}")
    return said


def print_global_error(document: Document) -> None:
    """The worst variables, those that could not be measured, and what it cost."""
    out, told = _out(), document["measured"]
    errors = sorted(
        document["global_error"].items(), key=lambda item: -math.inf if item[1]["rms"] is None else -item[1]["rms"]
    )
    out.print("")
    rows = _table(
        f"global error against the reference, tolerance {told['tolerance']:g}",
        ("variable", "left"),
        ("rms", "right"),
        ("largest", "right"),
        ("known by", "left"),
        ("held", "left"),
        ("worst at", "left"),
        wrap=("worst at",),
    )
    short = short_axes(dict.fromkeys(key for _, error in errors for key in error["at"]))
    for name, error in errors[:SHOWN]:
        words = {True: "yes", False: "no", None: "unknown"}
        at = ", ".join(
            f"{short[key]} {value:.4g}" if isinstance(value, float) else f"{short[key]} {value}"
            for key, value in error["at"].items()
        )
        rows.add_row(
            escape(name), _number(error["rms"]), _number(error["max"]), error["how"], words[error["held"]], escape(at)
        )
        if "linear" in error:
            rows.add_row(
                "  in front of the encoding",
                _number(error["linear"]["rms"]),
                _number(error["linear"]["max"]),
                "",
                "",
                "",
            )
    out.print(rows)
    _print_held(out, document, errors)


def _print_held(out: Console, document: Document, errors: list[tuple[str, Document]]) -> None:
    """Whether what is wanted is within its tolerance, and where that was measured."""
    told = document["measured"]
    if len(errors) > SHOWN:
        out.print(f"{len(errors) - SHOWN} further variables, rms at most {_number(errors[SHOWN][1]['rms'])}")
    for why in dict.fromkeys(error["why"] for _, error in errors if "why" in error):
        out.print(f"unknown: {escape(why)}", soft_wrap=True)
    cells = "1 point" if told["cells"] == 1 else f"{told['cells']} points"
    missed = sum(error["held"] is False for _, error in errors)
    if "hold" in document:
        hold = document["hold"]
        for text in _not_held(hold, document["global_error"]):
            out.print(escape(text), soft_wrap=True)
        if hold["held"]:
            out.print(
                f"held: everything wanted is within {hold['asked']:g} of the reference, with local tolerance "
                f"{hold['tolerance']:g}"
            )
    elif missed:
        out.print(f"not held: {missed} of {len(errors)} variables are further from the reference than the tolerance")
    elsewhere = {name: error["elsewhere"] for name, error in errors if error.get("elsewhere")}
    if elsewhere:
        worst = max(elsewhere, key=lambda name: elsewhere[name])
        out.print(f"of cells that were not measured at most {_number(elsewhere[worst])} is stated ({escape(worst)})")
    when = ", as an earlier run measured it" if told["remembered"] else ""
    out.print(f"measured at {cells} of the sweep in {human_seconds(told['seconds'])} of thread time{when}")


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.2g}"
