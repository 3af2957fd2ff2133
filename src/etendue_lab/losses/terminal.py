"""Terminal output of losses and their shares.

In:  the document of a study of losses.
Out: a table for each loss, and the accuracy of the prediction for pairs.
"""

from __future__ import annotations

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.progress import trying
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.result_files import finite
from etendue.types.documents import Document
from etendue_lab.losses.study import losses as measure

PAIRS = 3  # number of listed pairs with the strongest interactions


def print_losses(document: Document) -> None:
    """Print shares of contrast, signal-to-noise ratio and colour."""
    console = _out()
    console.print(f"{document['pipeline']}: each stage's share of the loss, relative to the camera with ideal stages")
    for loss in document["losses"]:
        orders = loss["orders"]
        columns = (
            ("stage", "left", "stage"),
            ("share of loss", "right", "share", lambda share: f"{100 * share:.1f} %", "-"),
            (f"loss [{loss['unit']}]", "right", lambda row, orders=orders: f"{row['loss']:.3f}{_error(row, orders)}"),
            ("without it", "right", "figure_without", ".4g", "-"),
        )
        table = _table(
            f"{loss['what']}: {loss['figure']} {loss['camera']:.4g}, ideal {loss['ideal']:.4g}; loss "
            f"{loss['loss']:.4g} {loss['unit']}",
            *columns,
            rows=loss["stages"],
        )
        console.print(table)
        how = f"{loss['orders']} random orders" if loss["orders"] else "all sets of stages"
        console.print(f"  shares from {how}: {loss['coalitions']} cameras")
        if loss["pairs"] and loss["lost_before_gains"]:
            pairs = sorted(loss["pairs"], key=lambda pair: -abs(pair["interaction"]))[:PAIRS]
            named = (f"{escape(' and '.join(pair['stages']))} ({pair['interaction']:+.2g})" for pair in pairs)
            worst = max(abs(pair["predicted"] - pair["found"]) for pair in loss["pairs"])
            console.print(
                f"  losses of pairs are predicted within {100 * worst / loss['lost_before_gains']:.1f} % "
                f"of the loss; "
                f"strongest interactions: {', '.join(named)}"
            )
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _error(row: Document, orders: int) -> str:
    return "" if not orders or row["standard_error"] is None else f" +- {row['standard_error']:.1g}"


def losses_command(given: options.Given, reflectance: float, runs: int, seed: int, as_json: bool) -> None:
    pipeline = given.pipeline()
    with trying(silent=as_json) as told:
        found = measure(pipeline, options.installed(), reflectance, runs, seed, None, told)
    tell(as_json, finite(found.document()), print_losses)
