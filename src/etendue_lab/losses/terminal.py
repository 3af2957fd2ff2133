"""What stages of a camera are owed of its losses, on the terminal.

In:  the document of a study of losses.
Out: a table for each loss, and how well pairs are predicted.
"""

from __future__ import annotations

import math

from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document

PAIRS = 3  # with the strongest interactions, that are named


def print_losses(document: Document) -> None:
    """Shares of contrast, signal-to-noise ratio and colour."""
    console = _out()
    console.print(
        f"{document['pipeline']}: what each stage is owed of the losses, against the camera with ideal stages"
    )
    for loss in document["losses"]:
        columns = (
            ("stage", "left"),
            ("of what is lost", "right"),
            (f"loss [{loss['unit']}]", "right"),
            ("without it", "right"),
        )
        table = _table(
            f"{loss['what']}: {loss['figure']} {loss['camera']:.4g}, ideal {loss['ideal']:.4g}; loss "
            f"{loss['loss']:.4g} {loss['unit']}",
            *columns,
        )
        for row in loss["stages"]:
            error = "" if not loss["orders"] or row["standard_error"] is None else f" +- {row['standard_error']:.1g}"
            known = row["share"] is not None and not math.isnan(row["share"])
            share = f"{100 * row['share']:.1f} %" if known else "-"
            table.add_row(row["stage"], share, f"{row['loss']:.3f}{error}", _figure(row["figure_without"]))
        console.print(table)
        how = f"{loss['orders']} random orders" if loss["orders"] else "all sets of stages"
        console.print(f"  shares from {how}: {loss['coalitions']} cameras")
        if loss["pairs"] and loss["lost_before_gains"]:
            pairs = sorted(loss["pairs"], key=lambda pair: -abs(pair["interaction"]))[:PAIRS]
            named = (f"{escape(' and '.join(pair['stages']))} ({pair['interaction']:+.2g})" for pair in pairs)
            worst = max(abs(pair["predicted"] - pair["found"]) for pair in loss["pairs"])
            console.print(
                f"  what two stages lose together is predicted within {100 * worst / loss['lost_before_gains']:.1f} % "
                f"of what is lost; "
                f"most between {', '.join(named)}"
            )
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _figure(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.4g}"
