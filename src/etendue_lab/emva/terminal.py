"""A sensor that was measured, on the terminal.

In:  the document of ``emva``.
Out: a table for each channel: figure, measured, interval, expected.
"""

from __future__ import annotations

import math

from rich.table import Table

from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document

NAMES = {
    "gain": "system gain K",
    "read_noise": "read noise",
    "dark_current": "dark current",
    "full_well": "full well",
    "dsnu": "DSNU1288",
    "prnu": "PRNU1288",
    "linearity_error": "linearity error",
    "saturation_capacity": "saturation capacity",
    "absolute_sensitivity": "sensitivity limit",
    "dynamic_range": "dynamic range",
    "snr_max": "SNR max",
    "quantum_efficiency": "quantum efficiency",
}
SENSORS = 900  # docs/emva.md
PERCENT = ("prnu", "linearity_error", "quantum_efficiency")


def print_emva(document: Document) -> None:
    """Measured beside expected."""
    console = _out()
    console.print(
        f"{escape(document['pipeline'])}: {document['standard']}; intervals of {100 * document['confidence']:.0f} %"
    )
    for one in document["channels"]:
        at = ", ".join(f"{key} = {value}" for key, value in one["at"].items())
        curve = one["photon_transfer"]
        title = f"channel {one['channel']}" + (f" at {escape(at)}" if at else "")
        if one["why"]:
            console.print(f"{title}: not measured: {escape(one['why'])}")
            continue
        times = curve["integration_time"]
        title += f"; {len(times)} exposures of {1e3 * times[0]:.3g} to {1e3 * times[-1]:.3g} ms"
        console.print(_figures(title, one["figures"]))
        if hidden := [NAMES[row["figure"]] for row in one["figures"] if not row["covered"]]:
            console.print(
                f"channel {one['channel']}: not covered: rounding to whole numbers hides the noise of the dark: "
                f"{', '.join(hidden)}"
            )
    judged = [row["held"] for one in document["channels"] if not one["why"] for row in one["figures"]]
    held, known = sum(one is True for one in judged), sum(one is not None for one in judged)
    if known:
        least, most = (100 * (1 - share) for share in reversed(document["simulated"]))
        counted = f"of {SENSORS} simulated sensors of two kinds {least:.0f} to {most:.0f} %"
        console.print(
            f"{held} of {known} intervals hold what is expected; of 95 % intervals one in twenty does not ({counted})"
        )
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _figures(title: str, rows: list[Document]) -> Table:
    columns = (
        ("figure", "left"),
        ("measured", "right"),
        ("interval", "left"),
        ("expected", "right"),
        ("held", "left"),
    )
    table = _table(title, *columns)
    for row in rows:
        unit = "%" if row["figure"] in PERCENT else "" if row["unit"] == "1" else row["unit"]
        scale = 100.0 if row["figure"] in PERCENT else 1.0
        word = "" if row["held"] is None else "yes" if row["held"] else "no"
        cells = [_text(row[name], scale) for name in ("value", "low", "high", "expected")]
        interval = f"{cells[1]} to {cells[2]}" if cells[1] or cells[2] else ""
        table.add_row(NAMES[row["figure"]] + (f", {unit}" if unit else ""), cells[0], interval, cells[3], word)
    return table


def _text(value: float | None, scale: float) -> str:
    if value is None or math.isnan(value):
        return ""
    return f"{scale * value:.0f}" if 1e3 <= abs(scale * value) < 1e7 else f"{scale * value:.4g}"
