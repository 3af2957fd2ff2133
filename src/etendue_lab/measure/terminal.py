"""A photograph that was measured, on the terminal.

In:  the document of ``measure``.
Out: a table each for edges, stars, noise and the chart.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document

if TYPE_CHECKING:
    from rich.console import Console

FLAGS = {
    "above_nyquist": "above Nyquist",
    "not_reached": "MTF50 not reached",
    "clipped": "clipped",
    "noisy": "wide interval",
}
DOUBTS = {
    "bent": "it is bent",
    "changes": "its step changes along it",
    "pattern": "beside it is a pattern",
    "no_plateau": "it leaves no even fields beside it",
    "line": "it rises and falls as a line does",
    "double": "it rises twice",
}
UNTRIED = {
    "sharp": "edges so sharp",
    "blurred": "edges so blurred",
    "noise": "so much noise",
    "coarse": "JPEG of so low a quality",
    "colour": "one colour of a JPEG",
}


def print_photograph(document: Document) -> None:
    """Every figure with its interval."""
    console = _out()
    console.print(
        f"{escape(document['picture'])}: {document['columns']} x {document['rows']} pixels, {document['encoding']}; "
        f"intervals of {100 * document['confidence']:.0f} %"
    )
    if document["edges"]:
        _print_responses(console, "slanted edges", "region", document["edges"], document["pitch"])
    if document["stars"]:
        _print_responses(console, "Siemens stars", "star", document["stars"], document["pitch"])
    for one in document["noise"]:
        _print_noise(console, one)
    if document["chart"]:
        _print_chart(console, document["chart"])
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _print_responses(console: Console, title: str, where: str, rows: list[Document], pitch: float | None) -> None:
    edges = where == "region"
    columns = [
        (where, "left"),
        ("angle" if edges else "cycles", "right"),
        ("MTF50", "right"),
        ("interval", "left"),
        ("MTF10", "right"),
    ]
    columns += [("cycles/mm", "right")] if pitch else []
    columns += [("LW/PH", "right")]
    channels = sorted({row["channel"] for row in rows})
    table = _table(f"{title}, {', '.join(channels)}; cycles/pixel", *columns)
    for row in rows:
        turn = f"{row['angle']:.2f}°" if edges else str(row["cycles"])
        between = f"{_text(row['mtf50_low'], 4)} to {_text(row['mtf50_high'], 4)}"
        cells = [row[where], turn, _text(row["mtf50"], 4), between, _text(row["mtf10"], 4)]
        cells += [_text(row["mtf50_lp_mm"], 4)] if pitch else []
        table.add_row(*cells, _text(row["mtf50_lw_ph"], 4))
    console.print(table)
    for row in rows:
        if row["flags"]:
            console.print(f"{row[where]}: {', '.join(FLAGS[flag] for flag in row['flags'])}")
        if row.get("doubts"):
            console.print(
                f"{row[where]}: hardly one straight edge between two even fields: "
                f"{', '.join(DOUBTS[one] for one in row['doubts'])}"
            )
        if row.get("conservative"):
            console.print(
                f"{row[where]}: conservative: no noise moves it, the interval is an upper bound of the method's error"
            )
        if row.get("not_covered"):
            console.print(
                f"{row[where]}: not covered: intervals were not tried on "
                f"{', '.join(UNTRIED[one] for one in row['not_covered'])}"
            )


def _print_noise(console: Console, patch: Document) -> None:
    columns = (
        ("channel", "left"),
        ("mean", "right"),
        ("sigma", "right"),
        ("interval", "left"),
        ("SNR", "right"),
        ("SNR interval", "left"),
    )
    for kind, title, scale in (
        ("linear", "linear light, % of full scale", 100.0),
        ("encoded", "numbers of the file", 1.0),
    ):
        table = _table(f"noise of {patch['region']}, {title}", *columns)
        for row in patch["channels"]:
            own = row[kind]
            if own is None:
                continue
            cells = [
                _text(scale * own["mean"]["value"]),
                _text(scale * own["sigma"]["value"], 4),
                _range(own["sigma"], scale),
            ]
            table.add_row(row["channel"], *cells, _text(own["snr"]["value"], 4), _range(own["snr"]))
        console.print(table)
    if patch["hidden"] and not patch["not_covered"]:
        console.print(
            f"{patch['region']}: below the steps of the file, which hide how much it is: {', '.join(patch['hidden'])}"
        )
    if patch["not_covered"]:
        console.print(f"{patch['region']}: not covered: noise that JPEG has taken off is not known")


def _print_chart(console: Console, chart: Document) -> None:
    columns = (
        ("patch", "left"),
        ("as it stands", "right"),
        ("interval", "left"),
        ("exposed", "right"),
        ("exposed interval", "left"),
    )
    table = _table(f"ColorChecker in {escape(chart['space'])}: Delta E 2000 under {chart['white']}", *columns)
    both = [(row, "delta_e", row, "exposed", row["patch"]) for row in chart["patches"]]
    both += [(chart["as_is"], word, chart["exposed"], word, word) for word in ("mean", "max")]
    for one, name, other, exposed, what in both:
        table.add_row(what, f"{one[name]:.2f}", _apart(one, name), f"{other[exposed]:.2f}", _apart(other, exposed))
    console.print(table)
    console.print(f"exposed: times {chart['gain']:.4g}, with which the greys are as bright as they should be")


def _apart(row: Document, name: str) -> str:
    return f"{row[f'{name}_low']:.2f} to {row[f'{name}_high']:.2f}"


def _range(estimate: Document, scale: float = 1.0) -> str:
    return f"{_text(scale * estimate['low'], 4)} to {_text(scale * estimate['high'], 4)}"


def _text(value: float, digits: int = 3) -> str:
    if value is None or math.isnan(value):
        return ""
    return "inf" if math.isinf(value) else f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"
