"""Terminal output of a measured photograph.

In:  the document of ``measure``.
Out: a table each for edges, stars, noise and the chart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.contract.values.units import UnitError, to_unit
from etendue.errors import RequestError
from etendue.present.plots.plot import check_suffix
from etendue.present.terminal.cells import Column
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.measure import study
from etendue_lab.measure.drawn import drawn

FLAGS = {
    "above_nyquist": "above Nyquist",
    "not_reached": "MTF50 not reached",
    "clipped": "clipped",
    "noisy": "wide interval",
}
DOUBTS = {
    "bent": "it is bent",
    "changes": "its step changes along it",
    "pattern": "there is a pattern beside it",
    "no_plateau": "there are no uniform fields beside it",
    "line": "it rises and falls like a line",
    "double": "it rises twice",
}
# Columns of the chart: keys of a patch, of the mean and of the maximum.
BOTH = (("delta_e", "as_is"), ("exposed", "exposed"))
UNTRIED = {
    "sharp": "edges this sharp",
    "blurred": "edges this blurred",
    "noise": "this much noise",
    "coarse": "JPEG of this low quality",
    "colour": "single colours of a JPEG",
}


def print_photograph(document: Document) -> None:
    """Print every metric with its interval."""
    console = _out()
    console.print(
        f"{escape(document['picture'])}: {document['columns']} x {document['rows']} pixels, {document['encoding']}; "
        f"{100 * document['confidence']:.0f} % intervals"
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
    turn = ("angle", "right", "angle", "{:.2f}°".format) if where == "region" else ("cycles", "right", "cycles")
    columns = (
        (where, "left", where),
        turn,
        ("MTF50", "right", "mtf50", _text),
        ("interval", "left", lambda row: f"{_text(row['mtf50_low'])} to {_text(row['mtf50_high'])}"),
        ("MTF10", "right", "mtf10", _text),
        *((("cycles/mm", "right", "mtf50_lp_mm", _text),) if pitch else ()),
        ("LW/PH", "right", "mtf50_lw_ph", _text),
    )
    channels = sorted({row["channel"] for row in rows})
    console.print(_table(f"{title}, {', '.join(channels)}; cycles/pixel", *columns, rows=rows))
    for row in rows:
        if row["flags"]:
            console.print(f"{row[where]}: {', '.join(FLAGS[flag] for flag in row['flags'])}")
        if row.get("doubts"):
            console.print(
                f"{row[where]}: may not be one straight edge: {', '.join(DOUBTS[one] for one in row['doubts'])}"
            )
        if row.get("conservative"):
            console.print(
                f"{row[where]}: conservative: without noise, the interval is an upper bound of the method's error"
            )
        if row.get("not_covered"):
            console.print(
                f"{row[where]}: not covered: intervals were not tested on "
                f"{', '.join(UNTRIED[one] for one in row['not_covered'])}"
            )


def _print_noise(console: Console, patch: Document) -> None:
    for kind, title, scale in (
        ("linear", "linear light, % of full scale", 100.0),
        ("encoded", "numbers of the file", 1.0),
    ):
        rows = [row for row in patch["channels"] if row[kind]]
        console.print(_table(f"noise of {patch['region']}, {title}", *_levels(kind, scale), rows=rows))
    if patch["hidden"] and not patch["not_covered"]:
        console.print(
            f"{patch['region']}: noise below the steps of the file cannot be measured: {', '.join(patch['hidden'])}"
        )
    if patch["not_covered"]:
        console.print(f"{patch['region']}: not covered: noise removed by JPEG is unknown")


def _print_chart(console: Console, chart: Document) -> None:
    columns = (
        ("patch", "left", "patch"),
        ("as photographed", "right", "delta_e", ".2f"),
        ("interval", "left", "{delta_e_low:.2f} to {delta_e_high:.2f}".format_map),
        ("exposed", "right", "exposed", ".2f"),
        ("exposed interval", "left", "{exposed_low:.2f} to {exposed_high:.2f}".format_map),
    )
    whole = [
        {"patch": word}
        | {f"{name}{end}": chart[own][f"{word}{end}"] for name, own in BOTH for end in ("", "_low", "_high")}
        for word in ("mean", "max")
    ]
    title = f"ColorChecker in {escape(chart['space'])}: Delta E 2000 under {chart['white']}"
    console.print(_table(title, *columns, rows=[*chart["patches"], *whole]))
    console.print(
        f"exposed: after a gain of {chart['gain']:.4g}, which matches the greys to their reference luminances"
    )


def _levels(kind: str, scale: float) -> tuple[Column, ...]:
    def text(name: str, part: str, digits: int = 4) -> Callable[[Document], str]:
        return lambda row: _text((1.0 if name == "snr" else scale) * row[kind][name][part], digits)

    def between(name: str) -> Callable[[Document], str]:
        return lambda row: " to ".join(text(name, part)(row) for part in ("low", "high"))

    return (
        ("channel", "left", "channel"),
        ("mean", "right", text("mean", "value", 3)),
        ("sigma", "right", text("sigma", "value")),
        ("interval", "left", between("sigma")),
        ("SNR", "right", text("snr", "value")),
        ("SNR interval", "left", between("snr")),
    )


def _text(value: float | None, digits: int = 4) -> str:
    if value is None or math.isnan(value):
        return ""
    return "inf" if math.isinf(value) else f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"


def measure_command(
    picture: Path, pitch: str | None, as_json: bool, output: Path | None, shown: Path | None, **words: Any
) -> None:
    try:
        length = None if pitch is None else to_unit(options.number(pitch), "um")
    except UnitError as error:
        raise RequestError(f"--pitch {error}") from None
    if length is not None and not length > 0:
        raise RequestError(f"--pitch {pitch}: must be a length greater than 0, such as 4um")
    asked = study.MeasurementRequest(**words, pitch=length)
    if output is not None:
        check_suffix(output)
        if (asked.noise or asked.chart) and not (asked.edges or asked.stars):
            raise RequestError("-o: only edges and stars have curves; give --edge or --star")
    if shown is not None:
        check_suffix(shown)
    document = study.measure(picture, asked)
    plot = None if output is None else study.curves(document)
    if plot is not None and output is not None:
        plot.save(output)
    if shown is not None:
        drawn(picture, document).save(shown)
    tell(as_json, document, print_photograph)
