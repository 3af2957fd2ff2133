"""``etendue measure``: all measurements requested on one photograph.

In:  a path, regions, the encoding.
Out: the document: edges, stars, noise, chart, notes; the curves as a plot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from etendue.errors import RequestError
from etendue.present.plots.plot import Plot, new_figure
from etendue.types.documents import Document
from etendue_camera import spectra
from etendue_camera.colour_notes import is_named
from etendue_lab.measure.chart import measured_chart
from etendue_lab.measure.edges import measured_edge
from etendue_lab.measure.noise import measured_noise
from etendue_lab.measure.photograph import ENCODINGS, open_photograph
from etendue_lab.measure.regions import FOUND
from etendue_lab.measure.stars import measured_star

CONFIDENCE = 0.95


@dataclass(frozen=True)
class MeasurementRequest:
    """The measurements to make in a photograph, with regions as written on the command line."""

    edges: tuple[str, ...] = ()
    stars: tuple[str, ...] = ()
    noise: tuple[str, ...] = ()
    chart: str | None = None
    cycles: int | None = None
    channel: str | None = None
    encoding: str = "sRGB"
    space: str = "sRGB"
    pitch: float | None = None  # um


def measure(path: Path, asked: MeasurementRequest) -> Document:
    """Measure a photograph.

    Raises
    ------
    RequestError
        The file is not a picture, or a region is outside the picture or does not show the expected target.
    """
    if asked.encoding not in ENCODINGS:
        raise RequestError(f"--encoding {asked.encoding}: must be one of {', '.join(ENCODINGS)}")
    try:
        spectra.check_rgb_space(asked.space)
        weights = tuple(float(one) for one in spectra.rgb_space_matrix(asked.space)[0][1])
    except ValueError as error:
        raise RequestError(f"--space: {error}") from None
    photograph = open_photograph(path, asked.encoding, weights)
    edges = asked.edges or (() if asked.stars or asked.noise or asked.chart else (FOUND,))
    channel = photograph.channel(asked.channel)
    notes = [
        f"{one.partition(': ')[0]}: values are read as {asked.space}, encoding {asked.encoding} (change with --space, "
        f"--encoding)"
        for one in photograph.notes
        if not is_named(one, asked.space, asked.encoding)
    ]
    chart = measured_chart(photograph, asked.chart, asked.space, CONFIDENCE) if asked.chart else None
    document = {
        "picture": path.name,
        "rows": photograph.rows,
        "columns": photograph.columns,
        "full": photograph.full,
        "encoding": "raw" if photograph.is_raw else asked.encoding,
        "confidence": CONFIDENCE,
        "pitch": asked.pitch,
        "edges": [
            _beside(measured_edge(photograph, one, channel, CONFIDENCE), asked.pitch, photograph.rows) for one in edges
        ],
        "stars": [
            _beside(measured_star(photograph, one, channel, asked.cycles, CONFIDENCE), asked.pitch, photograph.rows)
            for one in asked.stars
        ],
        "noise": [measured_noise(photograph, one, CONFIDENCE) for one in asked.noise],
        "chart": chart,
    }
    return {**document, "notes": [*notes, *(chart.pop("notes") if chart else [])]}


def _beside(row: Document, pitch: float | None, rows: int) -> Document:
    """Add MTF50 in line widths per picture height, and in cycles/mm if the pixel pitch (um) is known."""
    found = {**row, "mtf50_lw_ph": 2 * rows * row["mtf50"]}
    if pitch is not None:
        found |= {f"mtf50{end}_lp_mm": 1e3 * row[f"mtf50{end}"] / pitch for end in ("", "_low", "_high")}
    return found


def curves(document: Document) -> Plot:
    """Return the responses of edges and stars as a plot with its numbers."""
    measured = [("edge", one, one["region"]) for one in document["edges"]] + [
        ("star", one, one["star"]) for one in document["stars"]
    ]
    pitch = document["pitch"]
    figure = new_figure(7.0, 4.6)
    axes = figure.add_subplot()
    rows: list[list[str | float]] = []
    for number, (kind, one, where) in enumerate(measured):
        label = f"{kind} {where}" + ("" if math.isnan(one["mtf50"]) else f": MTF50 {one['mtf50']:.3f}")
        axes.plot(one["frequency"], one["sfr"], color=f"C{number}", lw=1.5, label=label)
        if math.isfinite(one["mtf50_low"]) and math.isfinite(one["mtf50_high"]):
            axes.plot(
                [one["mtf50_low"], one["mtf50_high"]],
                [0.5, 0.5],
                color=f"C{number}",
                lw=4,
                alpha=0.5,
                solid_capstyle="butt",
            )
        rows += [
            [kind, where, one["channel"], f, "" if pitch is None else 1e3 * f / pitch, s]
            for f, s in zip(one["frequency"], one["sfr"], strict=True)
        ]
    axes.axvline(0.5, color="#777777", lw=0.8, ls=":")
    axes.set(
        xlabel="frequency, cycles/pixel", ylabel="response", xlim=(0, 1), ylim=(0, None), title=document["picture"]
    )
    axes.grid(True, color="#dddddd", lw=0.6)
    axes.legend(frameon=False, fontsize=8)
    return Plot(figure, ("kind", "region", "channel", "cycles_per_pixel", "cycles_per_mm", "response"), rows)
