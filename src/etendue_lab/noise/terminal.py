"""Terminal output of noise by stage.

In:  the document of a noise study.
Out: two tables: the mosaic, and every picture made from it.
"""

from __future__ import annotations

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.cells import once
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.noise.study import noise as measure


def _ratio(row: Document) -> str:
    """Return measured over predicted."""
    return f"{row['found'] / row['predicted']:.3f}" if row["predicted"] else ""


def _both(one: Document) -> str:
    return f"{one['predicted']:.2f} / {one['found']:.2f}"


def _between(row: Document) -> str:
    """Return the correlation of one pair of channels for a row of the table. Over the rows each pair appears once: R G,
    G B and, in the row of B, R B.
    """
    pair = next(
        (one for one in row["correlation"] if one.split()[0] == row["channel"]), next(iter(row["correlation"]), "")
    )
    return f"{pair.replace(' ', '')} {_both(row['correlation'][pair])}" if pair else ""


MOSAIC = (
    ("mosaic", "left", "channel"),
    ("electrons", "right", "electrons", ".0f"),
    ("predicted", "right", "predicted", ".3e", "-"),
    ("measured", "right", lambda row: f"{row['found']:.3e} +- {row['standard_error']:.0e}"),
    ("ratio", "right", _ratio),
)
BEHIND = (
    ("stage", "left", "stage"),
    ("", "left", "channel"),
    ("predicted", "right", "predicted", ".2e"),
    ("measured", "right", "found", ".2e"),
    ("ratio", "right", _ratio),
    ("neighbours", "left", "neighbours", _both),
    ("channels", "left", _between),
)


def print_noise(document: Document) -> None:
    """Print predicted and measured noise side by side."""
    console = _out()
    frames = "1 frame" if document["frames"] == 1 else f"{document['frames']} frames"
    console.print(
        f"{document['pipeline']}: grey card of reflectance {document['reflectance']:g}, {frames}; 1 is clipping, or "
        f"white"
    )
    console.print(_table("standard deviation of a pixel", *MOSAIC, rows=document["mosaic"]))
    if document["rows"]:
        title = "after each stage: standard deviation; correlations predicted / measured"
        console.print(_table(title, *BEHIND, rows=once(document["rows"], "stage", "variable")))
    errors = [
        row["standard_error"] / row["found"]
        for row in document["rows"]
        if row["found"] and row["standard_error"] is not None
    ]
    if errors:
        console.print(f"standard error of the measured values: at most {100 * max(errors):.1f} %")
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def noise_command(given: options.Given, reflectance: float, frames: int, as_json: bool) -> None:
    pipeline = given.pipeline()
    found = measure(pipeline, options.installed(), reflectance, frames, None, options.progress(as_json))
    tell(as_json, found.document(), print_noise)
