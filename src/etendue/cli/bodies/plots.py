"""``plot``."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from etendue import streams
from etendue.archive import places
from etendue.cli.saying import say, show
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.kinds import draw, kind_of, listed
from etendue.present.plots.opening import opened
from etendue.present.plots.places import read_at
from etendue.present.plots.plot import check_suffix
from etendue.present.terminal.looking import plots_text


def plot(
    place: Path | str,
    words: tuple[str, ...],
    output: Path | None,
    listing: bool,
    blame: bool,
    as_json: bool,
    **sides: Any,
) -> None:
    sides |= {name: _parts(sides[name]) for name in ("panels", "better")} | {"at": read_at(sides["at"])}
    asked = PlotRequest((), **sides)
    if output is not None:
        check_suffix(output)
    with places.reading(place) as folder:
        holdings = Holdings(opened(folder), shlex.quote(str(place)))
        if listing:
            document = listed(holdings)
            say(document) if as_json else show(click.echo, "\n".join(plots_text(document)))
            return
        kind, figures = kind_of(holdings, words[0] if words else "", words[1:])
        if blame and kind != "budget":
            raise click.UsageError(f"--blame is for budget, not for {kind}")
        start = found = None
        if blame:
            from etendue.cli.bodies.pages import begun_at, blaming

            with blaming(blame, as_json) as shares:
                start = begun_at(folder)
                found = shares(folder, start)
        made = draw(holdings, kind, replace(asked, figures=figures, blame=found, blamed_at=start))
        path = made.save(
            output
            or Path("-".join([folder.resolve().name, kind, *(name.replace(".", "-") for name in figures)]) + ".png")
        )
    if as_json:
        say(
            {
                "file": str(path),
                "kind": kind,
                "columns": list(made.columns),
                "rows": [list(row) for row in made.rows],
                "notes": made.notes,
            }
        )
        return
    with streams.results():
        click.echo(str(path))
    for text in made.notes:
        click.echo(f"note: {text}", err=True)


def _parts(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())
