"""Terminal output of noise by stage.

In:  the document of a noise study.
Out: two tables: the mosaic, and every picture made from it.
"""

from __future__ import annotations

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.noise.study import noise as measure


def print_noise(document: Document) -> None:
    """Print predicted and measured noise side by side."""
    console = _out()
    frames = "1 frame" if document["frames"] == 1 else f"{document['frames']} frames"
    console.print(
        f"{document['pipeline']}: grey card of reflectance {document['reflectance']:g}, {frames}; 1 is clipping, or "
        f"white"
    )
    columns = (
        ("mosaic", "left"),
        ("electrons", "right"),
        ("predicted", "right"),
        ("measured", "right"),
        ("ratio", "right"),
    )
    table = _table("standard deviation of a pixel", *columns)
    for row in document["mosaic"]:
        electrons = "" if row["electrons"] is None else f"{row['electrons']:.0f}"
        table.add_row(
            row["channel"],
            electrons,
            "-" if row["predicted"] is None else f"{row['predicted']:.3e}",
            _found(row),
            _ratio(row),
        )
    console.print(table)
    behind = (
        ("stage", "left"),
        ("", "left"),
        ("predicted", "right"),
        ("measured", "right"),
        ("ratio", "right"),
        ("neighbours", "left"),
        ("channels", "left"),
    )
    table = _table("after each stage: standard deviation; correlations predicted / measured", *behind)
    last = None
    for row in document["rows"]:
        stage, last = ("" if last == (row["stage"], row["variable"]) else row["stage"]), (row["stage"], row["variable"])
        pairs = [
            *row["correlation"]
        ]  # one pair per row, so that each appears once: of three R G, G B, and R B in the row of B
        pair = next((one for one in pairs if one.split()[0] == row["channel"]), pairs[0] if pairs else "")
        c = row["correlation"].get(pair)
        between = f"{pair.replace(' ', '')} {c['predicted']:.2f} / {c['found']:.2f}" if c else ""
        beside = f"{row['neighbours']['predicted']:.2f} / {row['neighbours']['found']:.2f}"
        table.add_row(
            stage, row["channel"], f"{row['predicted']:.2e}", f"{row['found']:.2e}", _ratio(row), beside, between
        )
    if document["rows"]:
        console.print(table)
    errors = [
        row["standard_error"] / row["found"]
        for row in document["rows"]
        if row["found"] and row["standard_error"] is not None
    ]
    if errors:
        console.print(f"standard error of the measured values: at most {100 * max(errors):.1f} %")
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _found(row: Document) -> str:
    return f"{row['found']:.3e} +- {row['standard_error']:.0e}"


def _ratio(row: Document) -> str:
    """Return measured over predicted."""
    return f"{row['found'] / row['predicted']:.3f}" if row["predicted"] else ""


def noise_command(given: options.Given, reflectance: float, frames: int, as_json: bool) -> None:
    pipeline = given.pipeline()
    found = measure(pipeline, options.installed(), reflectance, frames, None, options.progress(as_json))
    tell(as_json, found.document(), print_noise)
