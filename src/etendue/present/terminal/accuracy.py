"""Report of ``etendue accuracy``: error against run time.

In:  the result of the study.
Out: a document for ``--json``, a table, a plot, and the same on stdout.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.contract.wording import words as called
from etendue.present.terminal.global_error import _number
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.present.terminal.work_precision import Series, diagrams
from etendue.types.documents import Document, DocumentView

UNBOUNDED = 132  # columns when stdout is not a terminal
TABLE, DOCUMENT, DIAGRAM = "accuracy.csv", "accuracy.json", "accuracy.png"


def document(found: Any) -> Document:
    """Return all curves, trials and choices; errors are rms relative to full scale, seconds are thread time."""
    knobs = {curve.knob.key: curve.knob for curve in found.curves}
    elsewhere = {tolerance: error for tolerance, error, _ in found.verified}

    def point(trial: Any) -> Document:
        settings = {key: trial.setting(knob) for key, knob in knobs.items()}
        return {"settings": settings, "error": trial.error, "variable": trial.variable, "seconds": trial.cost}

    return {
        "pipeline": found.pipeline,
        "at": dict(found.at),
        "curves": [_curve(curve) for curve in found.curves],
        "points": [point(trial) for trial in found.trials if not trial.why],
        "frontier": [point(trial) for trial in found.frontier],
        "planned": {**point(found.planned), "settings": dict(found.planned.settings)},
        "noise_floor": found.noise_floor,
        "noise_floor_of": found.noise_of or None,
        "reference_floor": found.floor,
        "cheapest": [
            {
                "tolerance": tolerance,
                **(point(trial) if trial else {"settings": None, "error": None, "variable": None, "seconds": None}),
                **({"elsewhere": elsewhere.get(tolerance)} if found.verified_at else {}),
            }
            for tolerance, trial in found.cheapest
        ],
        "verified_at": dict(found.verified_at) or None,
        "notes": list(found.notes),
    }


def _curve(curve: Any) -> Document:
    knob = curve.knob
    return {
        "stage": knob.stage or None,
        "knob": knob.name,
        "use": knob.use or None,
        "reference": knob.reference,
        "units": None if knob.units in ("", "1") else knob.units,
        "measured_at": curve.measured_at,
        "order": curve.convergence.order,
        "law": curve.convergence.law or None,
        "order_from": list(curve.convergence.settings),
        "points": [
            {
                "setting": trial.setting(knob),
                "seconds": curve.seconds(trial),
                "error": trial.error,
                "stage_error": trial.stage_errors.get(knob.key),
                "variable": trial.variable,
                "whole_seconds": trial.cost,
            }
            for trial in curve.trials
        ],
    }


def csv_text(document: DocumentView) -> str:
    """Return a row for each setting of each knob alone, and for each combination on the front."""
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(["part", "knob", "setting", "stage_error", "error", "variable", "seconds", "whole_seconds", "order"])
    for curve in document["curves"]:
        for p in curve["points"]:
            own = (p[name] for name in ("setting", "stage_error", "error", "variable", "seconds", "whole_seconds"))
            rows.writerow(["alone", _key(curve), *own, curve["order"]])
    for part in ("frontier", "points"):
        for p in document[part]:
            rows.writerow([part, "", _settings(p["settings"]), "", p["error"], p["variable"], "", p["seconds"], ""])
    return text.getvalue()


def files_of(document: DocumentView) -> dict[str, bytes]:
    """Return the files of a document that contains no NaN or infinity."""
    return {
        TABLE: csv_text(document).encode(),
        DOCUMENT: (json.dumps(document, indent=1, allow_nan=False) + "\n").encode(),
        DIAGRAM: diagram(document),
    }


def diagram(document: DocumentView) -> bytes:
    """Plot the results. Left: each knob alone, error of its stage against the time of the stages it affects. Right: all
    trials.
    """
    floor = document["reference_floor"]
    alone = []
    for curve in document["curves"]:
        points = [(p["seconds"], p["stage_error"]) for p in curve["points"] if p["stage_error"]]
        if len(points) > 1:
            alone.append(Series(f"{_key(curve)}{_law(curve)}", points))
    whole = [(p["seconds"], max(p["error"], floor)) for p in document["points"] if p["error"] is not None]
    front = [(p["seconds"], max(p["error"], floor)) for p in document["frontier"]]
    planned = [(document["planned"]["seconds"], max(document["planned"]["error"] or 0.0, floor))]
    return diagrams(
        f"{document['pipeline']}: error against run time",
        [
            ("each knob alone: error of its stage", "thread time of the stages it affects, s", alone, None, None),
            (
                f"the whole {called()['whole']}: error of the wanted variables",
                "thread time, s",
                [
                    Series("tried", whole, "dots"),
                    Series("Pareto front", front, "front"),
                    Series("as planned", planned, "star"),
                ],
                (document["noise_floor"], f"noise of one frame, {document['noise_floor_of']}"),
                (floor, "uncertainty of the reference"),
            ),
        ],
    )


def print_accuracy(document: Document, files: list[Path]) -> None:
    """Print every knob alone, the front, the cheapest setting for each tolerance, and notes."""
    console = _out()
    if not console.is_terminal:
        console.width = max(console.width, UNBOUNDED)
    at = ", ".join(f"{key} {value}" for key, value in document["at"].items())
    rows = _table(
        f"{escape(document['pipeline'])}: each knob alone{escape(f', at {at}') if at else ''}",
        ("knob", "left", lambda p: "" if p["rest"] else _key(p["curve"])),
        ("setting", "right", lambda p: _value(p["setting"])),
        ("stage error", "right", lambda p: "reference" if p["last"] else _number(p["stage_error"])),
        ("final error", "right", lambda p: "" if p["last"] else _number(p["error"])),
        ("time", "right", lambda p: _seconds(p["seconds"])),
        ("order", "left", lambda p: "" if p["rest"] else _law(p["curve"]).strip(", ")),
        rows=[
            {**p, "curve": curve, "rest": number > 0, "last": number == len(curve["points"]) - 1}
            for curve in document["curves"]
            for number, p in enumerate(curve["points"])
        ],
    )
    console.print(rows)
    reference = {_key(curve): curve["reference"] for curve in document["curves"]}
    error, time = ("error", "right", "error", ".2g", "unknown"), ("time", "right", lambda p: _seconds(p["seconds"]))
    settings = ("left", "settings", lambda own: _settings(own, reference), "none")
    title = "Pareto front"
    console.print(_table(title, error, time, ("settings", *settings), rows=document["frontier"], wrap=("settings",)))
    elsewhere = [("elsewhere", "right", "elsewhere", ".2g", "unknown")] if document["verified_at"] else []
    columns = [("tolerance", "right", "tolerance", ".0e"), error, *elsewhere, time, ("cheapest settings", *settings)]
    console.print(
        _table("cheapest settings by tolerance", *columns, rows=document["cheapest"], wrap=("cheapest settings",))
    )
    planned = document["planned"]
    console.print(f"as planned  error {_number(planned['error'])}, {_seconds(planned['seconds'])}")
    if document["verified_at"]:
        console.print(
            escape(f"elsewhere   {', '.join(f'{key} = {value}' for key, value in document['verified_at'].items())}"),
            soft_wrap=True,
        )
    if document["noise_floor"] is not None:
        console.print(
            f"noise       of one frame {document['noise_floor']:.2g} in {document['noise_floor_of']}: smaller errors "
            f"are invisible in a single frame"
        )
    console.print(f"reference   accurate to {document['reference_floor']:.1g}; smaller errors count as that")
    for text in document["notes"]:
        console.print(f"note        {escape(text)}", soft_wrap=True)
    for path in files:
        console.print(f"file        {escape(str(path))}", soft_wrap=True)


def _key(curve: DocumentView) -> str:
    return f"{curve['stage']}.{curve['knob']}" if curve["stage"] else curve["knob"]


def _law(curve: DocumentView) -> str:
    """Return ', order 4.0' or ', a factor 3.1 each' for the observed convergence."""
    if curve["order"] is None:
        return ""
    return (
        f", order {curve['order']:.1f}"
        if curve["law"] == "algebraic"
        else f", a factor {math.exp(min(curve['order'], 700)):.2g} each"
    )


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _settings(settings: DocumentView, reference: Mapping[str, Any] = {}) -> str:
    """Return settings as text, omitting those at their reference."""
    moved = {key: value for key, value in settings.items() if key not in reference or value != reference[key]}
    return ", ".join(f"{key} = {_value(value)}" for key, value in moved.items()) or "the reference"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"
