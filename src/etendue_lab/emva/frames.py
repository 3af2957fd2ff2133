"""``etendue emva`` on real frames: metrics of every channel, and the photon transfer curve.

In:  a measurement: frames of light and of the dark.
Out: the document, and its table.
"""

from __future__ import annotations

import math
from pathlib import Path

from rich.table import Table

from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.emva.names import NAMES, PERCENT
from etendue_lab.frames import transfer
from etendue_lab.frames.frame_set import Window
from etendue_lab.frames.moments import sites
from etendue_lab.frames.reading import open_frames

STANDARD = "EMVA 1288 release 4, linear"
CONFIDENCE = 0.95


def measured(path: Path, window: str | None, pattern: str | None) -> Document:
    """Measure the frames of a folder, a table or a file.

    Raises
    ------
    RequestError
        The path is not a measurement, or its frames give no photon transfer curve.
    """
    frames = open_frames(path, Window.read(window) if window else None, pattern)
    channels, notes = [], list(frames.notes)
    for name, site in sites(frames).items():
        curve = transfer.curve(frames, site)
        found = transfer.figures(frames, curve, site, CONFIDENCE)
        notes += [one for one in found.notes if one not in notes]
        channels.append(
            {
                "channel": name,
                "figures": [
                    {
                        "figure": key,
                        "value": one.value,
                        "low": one.low,
                        "high": one.high,
                        "unit": one.unit,
                        "needs": found.needs.get(key, ""),
                    }
                    for key in NAMES
                    if (one := found.values.get(key)) is not None
                ],
                "lack_of_fit": found.lack_of_fit,
                "photon_transfer": {
                    "integration_time": [one.time for one in curve.moments],
                    "light": curve.exposure.tolist(),
                    "frames": [one.frames for one in curve.moments],
                    "signal": curve.signal[0].tolist(),
                    "variance": curve.excess[0].tolist(),
                    "dark_mean": curve.dark_mean[0].tolist(),
                    "dark_variance": curve.dark_variance[0].tolist(),
                },
            }
        )
    return {
        "measurement": path.name,
        "standard": STANDARD,
        "confidence": CONFIDENCE,
        "rows": frames.shape[0],
        "columns": frames.shape[1],
        "frames": len(frames.frames),
        "photons": frames.photons,
        "channels": channels,
        "notes": notes,
    }


def print_measured(document: Document) -> None:
    """Print measured values with their intervals. For each missing value, print which frames would determine it."""
    console = _out()
    console.print(
        f"{escape(document['measurement'])}: {document['frames']} frames of {document['columns']} x {document['rows']} "
        f"pixels; {document['standard']}; {100 * document['confidence']:.0f} % intervals"
    )
    for one in document["channels"]:
        levels = len(one["photon_transfer"]["signal"])
        console.print(_figures(f"channel {one['channel']}; {levels} levels", one["figures"]))
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _figures(title: str, rows: list[Document]) -> Table:
    columns = (
        ("metric", "left", lambda row: f"{NAMES[row['figure']]}, {unit_of(row)}".removesuffix(", ")),
        ("measured", "right", lambda row: text_of(row, "value")),
        (
            "interval",
            "left",
            lambda row: " to ".join(own) if any(own := [text_of(row, e) for e in ("low", "high")]) else "",
        ),
        ("needs", "left", "needs"),
    )
    return _table(title, *columns, rows=rows, wrap=("needs",))


def unit_of(row: Document) -> str:
    return "%" if row["figure"] in PERCENT else str(row["unit"])


def text_of(row: Document, name: str) -> str:
    value, scale = row[name], 100.0 if row["figure"] in PERCENT else 1.0
    if value is None or math.isnan(value):
        return ""
    return f"{scale * value:.0f}" if 1e3 <= abs(scale * value) < 1e7 else f"{scale * value:.4g}"
