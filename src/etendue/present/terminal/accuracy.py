"""Report of ``etendue accuracy``: error against run time.

In:  the result of the study.
Out: a document for ``--json``, a table, a plot, and the same on stdout.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.contract.wording import words as called
from etendue.present.terminal.cells import Column
from etendue.present.terminal.global_error import _number
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.present.terminal.work_precision import Bar, Series, TimedError, diagrams
from etendue.types.documents import Document, DocumentView

SHADES, LEAST = "█▓▒░", 0.005  # of the bar; share of an error that is named
UNBOUNDED = 132  # columns when stdout is not a terminal
if TYPE_CHECKING:
    from rich.console import Console

COLD, WARM = "cold", "warm"
TABLE, DOCUMENT, DIAGRAM = "accuracy.csv", "accuracy.json", "accuracy.png"


def document(found: Any) -> Document:
    """Return all curves, trials and choices; errors are rms relative to full scale, seconds are CPU time."""
    knobs = {curve.knob.key: curve.knob for curve in found.curves}
    elsewhere = {tolerance: error for tolerance, error, _ in found.verified}

    def point(trial: Any) -> Document:
        settings = {key: trial.setting(knob) for key, knob in knobs.items()}
        timed = {"runs": trial.timing.runs, **_times(trial.timing)}
        parts = dict(sorted(trial.parts.items(), key=lambda part: -part[1]))
        return {"settings": settings, "error": trial.error, "variable": trial.variable, **timed, "parts": parts}

    nothing = dict.fromkeys(point(found.planned))

    return {
        "pipeline": found.pipeline,
        "at": dict(found.at),
        "by": found.by,
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
                **(point(trial) if trial else nothing),
                **({"elsewhere": elsewhere.get(tolerance)} if found.verified_at else {}),
            }
            for tolerance, trial in found.cheapest
        ],
        "verified_at": dict(found.verified_at) or None,
        "notes": list(found.notes),
    }


def _times(timing: Any, stages: Collection[str] | None = None) -> Document:
    """Return the minimum and median time (s) of the compared runs, the warm runs and the cold runs."""
    return {
        "seconds": timing.least("", stages),
        "median_seconds": timing.median("", stages),
        "warm_seconds": timing.least(WARM, stages),
        "warm_median_seconds": timing.median(WARM, stages),
        "cold_seconds": timing.least(COLD, stages),
        "cold_median_seconds": timing.median(COLD, stages),
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
        "order_why": curve.convergence.why or None,
        "discretisation": knob.discretisation or None,
        "points": [
            {
                "setting": trial.setting(knob),
                **_times(trial.timing, curve.affected),
                "runs": trial.timing.runs,
                "error": curve.error(trial)[0],
                "stage_error": curve.stage_error(trial),
                "variable": curve.error(trial)[1],
                "whole_seconds": trial.cost,
            }
            for trial in curve.trials
        ],
    }


def csv_text(document: DocumentView) -> str:
    """Return a row for each setting of each knob varied alone, and for each combination on the Pareto front."""
    text = io.StringIO()
    rows = csv.writer(text)
    times = ("warm_seconds", "warm_median_seconds", "cold_seconds", "cold_median_seconds", "runs")
    names = ("setting", "stage_error", "error", "variable", *times, "whole_seconds")
    rows.writerow(["part", "knob", *names, "order", "parts"])
    for curve in document["curves"]:
        for p in curve["points"]:
            rows.writerow(
                ["alone", _key(curve), *(p[name] for name in names), curve["order"] or curve["order_why"], ""]
            )
    for part in ("frontier", "points"):
        for p in document[part]:
            own = (_settings(p["settings"]), "", p["error"], p["variable"], *(p[name] for name in times), p["seconds"])
            rows.writerow([part, "", *own, "", "; ".join(f"{name} {error:.3g}" for name, error in p["parts"].items())])
    return text.getvalue()


def files_of(document: DocumentView) -> dict[str, bytes]:
    """Return the files of a document that contains no NaN or infinity."""
    return {
        TABLE: csv_text(document).encode(),
        DOCUMENT: (json.dumps(document, indent=1, allow_nan=False) + "\n").encode(),
        DIAGRAM: diagram(document),
    }


def diagram(document: DocumentView) -> bytes:
    """Plot the results. Left: for each knob varied alone, the error of its stage against the run time of the stages
    that the knob affects. Middle: all trials. Right: each knob's part of the error, for each combination on the Pareto
    front. Error bars reach from the shortest time to the median.
    """
    floor, by = document["reference_floor"], document["by"]
    colours = _colours(document)
    alone = []
    for curve in document["curves"]:
        points = [(p["seconds"], p["stage_error"], p["median_seconds"]) for p in curve["points"] if p["stage_error"]]
        if len(points) > 1:
            alone.append(Series(f"{_key(curve)}{_law(curve)}", points, colour=colours[_key(curve)]))

    def of(points: Sequence[DocumentView], how: str = "") -> list[TimedError]:
        least, median = f"{how}seconds", f"{how}median_seconds"
        return [(p[least], max(p["error"], floor), p[median]) for p in points if p["error"] is not None]

    every, front, planned = document["points"], document["frontier"], document["planned"]
    bars = [Bar(f"{_number(p['error'])} in {_seconds(p['seconds'])}", p["parts"]) for p in front]
    bars.append(Bar(f"as planned: {_number(planned['error'])} in {_seconds(planned['seconds'])}", planned["parts"]))
    return diagrams(
        f"{document['pipeline']}: error against run time",
        [
            (
                "each knob alone: error of its stage",
                f"CPU time of the stages it affects, {by}, s",
                alone,
                None,
                None,
            ),
            (
                f"the whole {called()['whole']}: error of the wanted variables",
                "CPU time, s",
                [
                    Series("tried", of(every), "dots"),
                    Series(f"Pareto front, {by}", of(front), "front"),
                    *([Series("the same, cold", of(front, "cold_"), "cold")] if by != COLD else []),
                    Series("as planned", of([planned]), "star"),
                ],
                (document["noise_floor"], f"noise of one frame, {document['noise_floor_of']}"),
                (floor, "uncertainty of the reference"),
            ),
        ],
        ("share of the error, by its cause", bars, colours),
    )


def _colours(document: DocumentView) -> dict[str, str]:
    """Return a colour for each cause of errors: first the knobs that cause an error by themselves, then the others."""
    alone = [_key(c) for c in document["curves"] if any(p["stage_error"] for p in c["points"])]
    others = [name for p in (*document["frontier"], document["planned"]) for name in p["parts"]]
    return {name: f"C{order % 10}" for order, name in enumerate(dict.fromkeys([*alone, *others]))}


def print_accuracy(document: Document, files: list[Path]) -> None:
    """Print the results of every knob varied alone, the Pareto front, the cheapest setting for each tolerance, and
    notes.
    """
    console = _out()
    if not console.is_terminal:
        console.width = max(console.width, UNBOUNDED)
    at = ", ".join(f"{key} {value}" for key, value in document["at"].items())
    warm, cold = (
        (f"{how} {what}", "right", lambda p, how=how: _spread(p, how)) for how, what in ((WARM, "time"), (COLD, "time"))
    )
    rows = _table(
        f"{escape(document['pipeline'])}: each knob alone{escape(f', at {at}') if at else ''}; time of the stages it "
        "affects, least/median",
        ("knob", "left", lambda p: "" if p["rest"] else _key(p["curve"])),
        ("setting", "right", lambda p: _value(p["setting"])),
        ("stage error", "right", lambda p: "finest" if p["last"] else _number(p["stage_error"])),
        ("final error", "right", lambda p: "" if p["last"] else _number(p["error"])),
        warm,
        cold,
        ("runs", "right", lambda p: str(p["runs"])),
        ("order", "left", lambda p: "" if p["rest"] else _law(p["curve"]).strip(", ") or p["curve"]["order_why"] or ""),
        rows=[
            {**p, "curve": curve, "rest": number > 0, "last": number == len(curve["points"]) - 1}
            for curve in document["curves"]
            for number, p in enumerate(curve["points"])
        ],
        wrap=("order",),
    )
    console.print(rows)
    reference = {_key(curve): _reference(curve) for curve in document["curves"]}
    error = ("error", "right", "error", ".2g", "unknown")
    settings = ("left", "settings", lambda own: _settings(own, reference), "none")
    came = ("error from", "left", lambda p: _split(p["parts"] or {}))
    of = ("of", "left", "variable", "", "")
    columns: list[Column] = [error, of, warm, cold, came, ("settings", *settings)]
    title = f"Pareto front by {document['by']} time"
    console.print(_table(title, *columns, rows=document["frontier"], wrap=("error from", "settings")))
    elsewhere = [("elsewhere", "right", "elsewhere", ".2g", "unknown")] if document["verified_at"] else []
    columns = [("tolerance", "right", "tolerance", ".0e"), error, *elsewhere, warm, ("cheapest settings", *settings)]
    console.print(
        _table("cheapest settings by tolerance", *columns, rows=document["cheapest"], wrap=("cheapest settings",))
    )
    _print_lines(console, document, files)


def _print_lines(console: Console, document: DocumentView, files: list[Path]) -> None:
    """Print the facts that apply to all settings, the notes and the files."""
    planned = document["planned"]
    own = f"error {_number(planned['error'])} of {planned['variable']}"
    times = f"warm {_spread(planned, WARM)}, cold {_spread(planned, COLD)}"
    console.print(f"as planned  {own}, {times}; {_split(planned['parts'])}", soft_wrap=True)
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
    console.print(f"reference   accurate to {document['reference_floor']:.1g}; smaller errors count as this value")
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


def _reference(curve: DocumentView) -> Any:
    """Return the reference setting of a knob, its finest; None for a discretisation, which has none."""
    return None if curve["discretisation"] else curve["reference"]


def _split(parts: DocumentView) -> str:
    """Return a bar of ten characters, shaded by cause, and the causes with their shares of the error (%), largest
    first.
    """
    whole = math.fsum(parts.values())
    if not whole:
        return "nothing"
    shares = [(name, part / whole) for name, part in sorted(parts.items(), key=lambda p: -p[1]) if part > LEAST * whole]
    ends = [round(10 * math.fsum(share for _, share in shares[: i + 1])) for i in range(len(shares))]
    bar = "".join(SHADES[min(i, 3)] * (ends[i] - (ends[i - 1] if i else 0)) for i in range(len(shares)))
    return f"{bar:█<10.10} {', '.join(f'{name} {100 * share:.0f} %' for name, share in shares)}"


def _spread(p: DocumentView, how: str) -> str:
    """Return minimum and median time as text: '9.8/10.1 ms'."""
    least, median = p[f"{how}_seconds"], p[f"{how}_median_seconds"]
    if least is None:
        return "-"
    return (
        f"{_seconds(least).partition(' ')[0]}/{_seconds(median)}"
        if (least < 1) == (median < 1)
        else (f"{_seconds(least)}/{_seconds(median)}")
    )


def _value(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _settings(settings: DocumentView, reference: Mapping[str, Any] = {}) -> str:
    """Return, as text, the settings that differ from their reference values."""
    moved = {key: value for key, value in settings.items() if key not in reference or value != reference[key]}
    return ", ".join(f"{key} = {_value(value)}" for key, value in moved.items()) or "the reference"


def _seconds(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.3g} ms" if value < 1 else f"{value:.3g} s"
