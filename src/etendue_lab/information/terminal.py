"""Terminal output of information along a camera.

In:  the document of an information study.
Out: two tables: bits per pixel up to each stage, and NEQ of every linear picture, predicted and measured.
"""

from __future__ import annotations

from functools import partial

from rich.console import Console

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.cells import once
from etendue.present.terminal.terminal import _out, _print_whole, escape
from etendue.result_files import finite
from etendue.types.documents import Document
from etendue_lab.information.study import information as measure

KINDS = {"photons": "shot noise alone, no blur", "blur": "blurs", "noise": "adds noise"}

BITS = "bits_per_pixel_of_a_line"
COLUMNS = (
    ("stage", "left", "stage"),
    ("", "left", "what", lambda what: KINDS.get(what, what)),
    ("bits/pixel", "right", "bits_per_pixel", ".3f"),
    ("lost", "right", "lost", lambda lost: f"{lost:.3f}" if abs(lost) >= 5e-4 else "0"),
    ("line bits", "right", BITS, ".3f"),
    ("NEQ 0", "right", lambda row: f"{row['neq'][0]['quanta_per_pixel']:.4g}"),
    ("NEQ 1/4", "right", lambda row: f"{row['neq'][1]['quanta_per_pixel']:.4g}"),
    ("NEQ 1/2", "right", lambda row: f"{row['neq'][2]['quanta_per_pixel']:.4g}"),
    ("SNRi", "right", "snri", ".2f"),
    ("channels alone", "left", "channels", lambda own: " ".join(f"{c} {bits:.2f}" for c, bits in own.items())),
)


def print_information(document: Document) -> None:
    """Print how many bits are lost at every stage, and how measurement and prediction differ."""
    console = _out()
    electrons = ", ".join(f"{channel} {value:.0f}" for channel, value in document["electrons"].items())
    console.print(
        f"{document['pipeline']}: grey detail of {document['contrast_ratio']:g}:1 on a card of reflectance "
        f"{document['reflectance']:g}; "
        f"photoelectrons {electrons}"
    )
    alone = any(row["channels"] for row in document["rows"])
    title = "information up to each stage, all channels together"
    _print_whole(console, title, COLUMNS if alone else COLUMNS[:-1], document["rows"])
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
        ("stage", "left", "stage"),
        ("", "left", "channel"),
        *((f"{frequency[i]:g}", "right", partial(_beside, at=i)) for i in shown),
        ("line bits", "right", BITS, lambda bits: f"{bits['predicted']:.3f}"),
        ("measured", "right", BITS, lambda bits: f"{bits['found']:.3f}"),
        ("max difference", "right", "largest_difference", lambda share: f"{100 * share:.1f} %"),
    )
    title = "NEQ of the linear pictures along x, measured on noise and an edge (ratio to prediction)"
    _print_whole(console, title, columns, once(curves, "stage"), 2)
    error, fewest = max(c["standard_error"] for c in curves), min(c["periodograms"] for c in curves)
    console.print(
        f"at least {fewest} periodograms per value; standard error of the measured noise power at most "
        f"{100 * error:.1f} %"
    )


def _beside(curve: Document, at: int) -> str:
    found, predicted = curve["found"][at], curve["predicted"][at]
    return f"{found:.4g} ({f'{found / predicted:.3f}' if predicted else '-'})"


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
