"""Terminal output of a measured sensor.

In:  the document of ``emva``.
Out: a table for each channel: metric, measured, interval, expected.
"""

from __future__ import annotations

import sys

from rich.table import Table

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.errors import RequestError
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.emva.frames import measured, print_measured, text_of, unit_of
from etendue_lab.emva.names import NAMES
from etendue_lab.emva.study import of_archive, of_pipeline
from etendue_lab.frames.reading import are_frames

SENSORS = 900  # docs/emva.md


def print_emva(document: Document) -> None:
    """Print measured values beside expected values."""
    console = _out()
    console.print(
        f"{escape(document['pipeline'])}: {document['standard']}; {100 * document['confidence']:.0f} % intervals"
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
                f"channel {one['channel']}: rounding hides the noise of the dark, so these are not covered: "
                f"{', '.join(hidden)}"
            )
    judged = [row["held"] for one in document["channels"] if not one["why"] for row in one["figures"]]
    held, known = sum(one is True for one in judged), sum(one is not None for one in judged)
    if known:
        least, most = (100 * (1 - share) for share in reversed(document["simulated"]))
        console.print(
            f"{held} of {known} intervals contain the expected value; on average, one in twenty does not ({least:.0f} "
            f"to {most:.0f} %, depending on the metric, for {SENSORS} simulated sensors of two kinds)"
        )
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")


def _figures(title: str, rows: list[Document]) -> Table:
    columns = (
        ("metric", "left", lambda row: f"{NAMES[row['figure']]}, {unit_of(row)}".removesuffix(", 1")),
        ("measured", "right", lambda row: text_of(row, "value")),
        (
            "interval",
            "left",
            lambda row: " to ".join(own) if any(own := [text_of(row, end) for end in ("low", "high")]) else "",
        ),
        ("expected", "right", lambda row: text_of(row, "expected")),
        ("held", "left", "held", lambda held: "yes" if held else "no"),
    )
    return _table(title, *columns, rows=rows)


def emva_command(given: options.Given, pixels: int, window: str | None, pattern: str | None, as_json: bool) -> None:
    if are_frames(given.file):
        if given.settings:
            raise RequestError("--set: real frames have no values to change; omit it")
        tell(as_json, measured(given.file, window, pattern), print_measured)
        return
    if window or pattern:
        raise RequestError("--window and --pattern are for real frames; for a pipeline give --pixels")
    if given.file.is_dir():
        if given.settings:
            raise RequestError("--set: cannot change an archive; give its pipeline file instead")
        found = of_archive(given.file, options.installed())
    else:
        found = of_pipeline(given.pipeline(), options.installed(), pixels, None, options.progress(as_json))
    tell(as_json, found.document(), print_emva)
    sys.exit(3 if any(channel.why for channel in found.channels) else 0)
