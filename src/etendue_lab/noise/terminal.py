"""Noise by stage, on the terminal.

In:  the document of a noise study.
Out: two tables: the mosaic, and every picture made of it.
"""

from __future__ import annotations

from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document


def print_noise(document: Document) -> None:
    """Predicted and found, side by side."""
    console = _out()
    frames = "1 frame" if document["frames"] == 1 else f"{document['frames']} frames"
    console.print(
        f"{document['pipeline']}: a grey card of reflectance {document['reflectance']:g}, {frames}; 1 is clipping, or "
        f"white"
    )
    columns = (
        ("mosaic", "left"),
        ("electrons", "right"),
        ("predicted", "right"),
        ("found", "right"),
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
        ("found", "right"),
        ("ratio", "right"),
        ("neighbours", "left"),
        ("channels", "left"),
    )
    table = _table("behind each stage: standard deviation; correlations predicted / found", *behind)
    last = None
    for row in document["rows"]:
        stage, last = ("" if last == (row["stage"], row["variable"]) else row["stage"]), (row["stage"], row["variable"])
        pairs = [*row["correlation"]]  # one a row, so that all stand once: of three, R G, G B, and R B beside B
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
        console.print(f"standard error of what was found: {100 * max(errors):.1f} % at most")
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _found(row: Document) -> str:
    return f"{row['found']:.3e} +- {row['standard_error']:.0e}"


def _ratio(row: Document) -> str:
    """Found over predicted."""
    return f"{row['found'] / row['predicted']:.3f}" if row["predicted"] else ""
