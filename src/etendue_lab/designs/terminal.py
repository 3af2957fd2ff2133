"""Terminal output of the commands ``sensitivity`` and ``yield``.

In:  arguments of the command line; documents of both studies.
Out: tables, or JSON.
"""

from __future__ import annotations

from pathlib import Path

from etendue.archive import places
from etendue.cli.saying import say, show
from etendue.present.plots.labels import number_text, unit_text
from etendue.present.plots.places import read_at
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.result_files import finite
from etendue.types.documents import Document
from etendue_lab.designs.samples import samples_of
from etendue_lab.designs.sensitivity import sensitivity
from etendue_lab.designs.stored import store
from etendue_lab.designs.yields import required, yields


def sensitivity_command(place: Path | str, metrics: tuple[str, ...], at: tuple[str, ...], as_json: bool) -> None:
    with places.reading(place) as folder:
        document = finite(sensitivity(samples_of(folder, str(place)), metrics, read_at(at)))
        document["stored"] = store(folder, place, document)
    say(document) if as_json else show(print_sensitivity, document)


def yield_command(place: Path | str, requirements: tuple[str, ...], at: tuple[str, ...], as_json: bool) -> None:
    asked = required(requirements)
    with places.reading(place) as folder:
        document = finite(yields(samples_of(folder, str(place)), asked, read_at(at)))
    say(document) if as_json else show(print_yields, document)


def interval_text(found: Document | None) -> str:
    """Return ``0.31 (0.28..0.34)``."""
    if found is None:
        return "-"
    value, low, high = (f"{found[word]:.2f}".replace("-0.00", "0.00") for word in ("value", "low", "high"))
    return f"{value} ({low}..{high})"


SENSITIVITY = (
    ("factor", "left", "factor"),
    ("first order", "right", lambda row: interval_text(row["first"])),
    ("total", "right", lambda row: interval_text(row["total"])),
    ("main effect", "right", "main_effect", ".2f"),
    ("regression", "right", lambda row: interval_text(row["regression"])),
    ("rank", "right", "rank", ".2f", "-"),
)


def print_sensitivity(document: Document) -> None:
    console = _out()
    notes: dict[str, None] = {}
    for one in document["metrics"]:
        where = f" at {one['said']}" if one["said"] else ""
        unit = unit_text(one["units"])
        spread = f"{number_text(one['mean'])} ± {number_text(one['deviation'])} {unit}".rstrip()
        rows = sorted(one["factors"], key=lambda row: -(row["total"] or {"value": row["main_effect"]})["value"])
        title = escape(f"{one['metric']}{where}: {spread} over {one['samples']} samples")
        absent = ("main effect", "rank") if rows[0]["first"] else ("first order", "total")  # effects without indices
        columns = [column for column in SENSITIVITY if column[0] not in absent]
        console.print(_table(title, *columns, rows=rows))
        console.print(f"  a line through all factors explains {one['explained']:.0%} of the variance")
        for own in one["subjects"] if 1 < len(one["subjects"]) else ():
            closed = f"; together {interval_text(own['closed'])}" if own["closed"] and len(own["factors"]) > 1 else ""
            names = ", ".join(own["factors"])
            console.print(f"  {escape(own['subject'] or 'no stage')}: {own['sum']:.2f} alone{closed} ({escape(names)})")
        for pair in sorted(one["pairs"], key=lambda pair: -pair["share"])[:4]:
            console.print(f"  {escape(' x '.join(pair['factors']))} explains another {pair['share']:.1%}")
        notes |= dict.fromkeys(one["notes"])
    for note in notes:
        console.print(f"note: {escape(note)}")
    if stored := document.get("stored"):
        said = f"stored as {', '.join(stored['groups'])}" if stored["groups"] else f"not stored: {stored['why']}"
        console.print(escape(said), soft_wrap=True)


def print_yields(document: Document) -> None:
    console = _out()
    for one in document["places"]:
        where = f" at {one['said']}" if one["said"] else ""
        own = one["yield"]
        console.print(
            escape(
                f"{document['pipeline']}{where}: {own['value']:.1%} of {one['units']} units pass "
                f"({own['low']:.1%} .. {own['high']:.1%})"
            )
        )
        columns = (
            (
                "requirement",
                "left",
                lambda row: row["requirement"] + (f" at {row['stage']}" if row["stage"] else ""),
            ),
            ("fail", "right", "failed", ".1%"),
            ("fail only this", "right", "alone", ".1%"),
            (
                "margin of the worst 5 %",
                "right",
                lambda row: f"{row['at_risk']:+.3g} {unit_text(row['units'])}".rstrip(),
            ),
        )
        console.print(_table("", *columns, rows=one["fails"]))
        if one["tighter"]:
            tighter = (
                ("spread smaller by a tenth", "left", "factor"),
                ("yield", "right", "yield", ".1%"),
                ("gain", "right", lambda row: _gain(row["gain"])),
                ("effective units", "right", "effective", ".0f"),
            )
            console.print(_table("", *tighter, rows=one["tighter"]))
        for note in one["notes"]:
            console.print(f"note: {escape(note)}")


def _gain(found: Document) -> str:
    value, low, high = (f"{100 * found[word]:+.2f}" for word in ("value", "low", "high"))
    return f"{value} % ({low} .. {high})"
