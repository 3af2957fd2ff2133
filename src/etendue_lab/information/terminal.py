"""Terminal output of information along a camera.

In:  the document of an information study.
Out: two tables: bits per pixel up to each stage, and NEQ of every linear picture, predicted and measured.
"""

from __future__ import annotations

from rich.console import Console

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.terminal import _out, _print_whole, escape
from etendue.result_files import finite
from etendue.types.documents import Document
from etendue_lab.information.study import information as measure

KINDS = {"photons": "shot noise alone, no blur", "blur": "blurs", "noise": "adds noise"}


def print_information(document: Document) -> None:
    """Print where bits are lost, and how far measurement and prediction differ."""
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
        ("line bits", "right"),
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
        "NEQ in quanta per pixel at 0, 1/4 and 1/2 cycles/pixel along x; line bits: bits/pixel along a line; SNRi "
        f"of a spot {spot['width_pixels']:g} pixels wide with a contrast of {100 * spot['contrast']:g} %"
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
        ("measured", "right"),
        ("max difference", "right"),
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
        "NEQ of the linear pictures along x, measured on noise and an edge (ratio to prediction)",
        columns,
        told,
        2,
    )
    error, fewest = max(c["standard_error"] for c in curves), min(c["periodograms"] for c in curves)
    console.print(
        f"at least {fewest} periodograms per value; standard error of the measured noise power at most "
        f"{100 * error:.1f} %"
    )


def _ratio(found: float, predicted: float) -> str:
    return f"{found / predicted:.3f}" if predicted else "-"


def information_command(
    given: options.Given,
    reflectance: float,
    contrast_ratio: float,
    size: float,
    object_contrast: float,
    frames: int,
    as_json: bool,
) -> None:
    progress = options.progress(as_json)
    pipeline = given.pipeline()
    found = measure(
        pipeline, options.installed(), reflectance, contrast_ratio, size, object_contrast, frames, None, progress
    )
    tell(as_json, finite(found.document()), print_information)
