"""Information along a camera, on the terminal.

In:  the document of an information study.
Out: two tables: bits a pixel up to each stage, and NEQ of every linear picture, predicted and found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from etendue.present.terminal.terminal import _out, _print_whole, escape
from etendue.types.documents import Document

if TYPE_CHECKING:
    from rich.console import Console

KINDS = {"photons": "shot noise alone, no blur", "blur": "blurs", "noise": "adds noise"}


def print_information(document: Document) -> None:
    """Where bits are lost, and how far what was found lies from what was predicted."""
    console = _out()
    electrons = ", ".join(f"{channel} {value:.0f}" for channel, value in document["electrons"].items())
    console.print(
        f"{document['pipeline']}: grey detail of {document['contrast_ratio']:g}:1 on a card of reflectance "
        f"{document['reflectance']:g}; "
        f"photoelectrons {electrons}"
    )
    rows = document["rows"]
    columns: tuple[tuple[str, str], ...] = (
        ("stage", "left"),
        ("", "left"),
        ("bits/pixel", "right"),
        ("lost", "right"),
        ("along a line", "right"),
        ("NEQ 0", "right"),
        ("NEQ 1/4", "right"),
        ("NEQ 1/2", "right"),
        ("SNRi", "right"),
        ("channels alone", "left"),
    )
    told = []
    for row in rows:
        lost = "" if row["lost"] is None else f"{row['lost']:.3f}" if abs(row["lost"]) >= 5e-4 else "0"
        alone = " ".join(f"{c} {bits:.2f}" for c, bits in row["channels"].items())
        quanta = [f"{point['quanta_per_pixel']:.4g}" for point in row["neq"]]
        along, snri = f"{row['bits_per_pixel_of_a_line']:.3f}", f"{row['snri']:.2f}"
        told.append(
            (
                row["stage"],
                KINDS.get(row["what"], row["what"]),
                f"{row['bits_per_pixel']:.3f}",
                lost,
                along,
                *quanta,
                snri,
                alone,
            )
        )
    if not any(row[-1] for row in told):
        columns, told = columns[:-1], [row[:-1] for row in told]
    _print_whole(console, "information up to each stage, all channels together", columns, told)
    spot = document["object"]
    console.print(
        f"NEQ in quanta a pixel at 0, 1/4 and 1/2 cycles/pixel along x; SNRi of a spot {spot['width_pixels']:g} pixels "
        f"wide with a "
        f"contrast of {100 * spot['contrast']:g} %"
    )
    if document["neq"]:
        _print_curves(console, document["neq"])
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _print_curves(console: Console, curves: list[Document]) -> None:
    frequency = curves[0]["cycles_per_pixel"]
    shown = [min(range(len(frequency)), key=[abs(f - at) for f in frequency].__getitem__) for at in (0.125, 0.25, 0.5)]
    columns = (
        ("stage", "left"),
        ("", "left"),
        *((f"{frequency[i]:g}", "right") for i in shown),
        ("line bits", "right"),
        ("found", "right"),
        ("largest difference", "right"),
    )
    told, last = [], None
    for curve in curves:
        stage, last = ("" if last == curve["stage"] else curve["stage"]), curve["stage"]
        cells = [f"{curve['found'][i]:.4g} ({_ratio(curve['found'][i], curve['predicted'][i])})" for i in shown]
        bits = curve["bits_per_pixel_of_a_line"]
        away = f"{100 * curve['largest_difference']:.1f} %"
        told.append((stage, curve["channel"], *cells, f"{bits['predicted']:.3f}", f"{bits['found']:.3f}", away))
    _print_whole(
        console,
        "NEQ of the linear pictures along x, found in noise and an edge (ratio to the prediction)",
        columns,
        told,
        2,
    )
    error, fewest = max(c["standard_error"] for c in curves), min(c["periodograms"] for c in curves)
    console.print(
        f"{fewest} periodograms and more behind a value; standard error of the noise power found: {100 * error:.1f} % "
        f"at most"
    )


def _ratio(found: float, predicted: float) -> str:
    return f"{found / predicted:.3f}" if predicted else "-"
