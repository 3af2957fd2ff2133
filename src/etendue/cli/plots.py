"""Plots of an archive: ``plot``."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from etendue import streams
from etendue.cli.options import JSON, PLACE
from etendue.cli.saying import blaming, command, say, show
from etendue.types.documents import Document


@command("plot")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.argument("words", nargs=-1, metavar="[KIND] [VARIABLE]...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=".png, .svg, .pdf, or .csv: the numbers. Default ./ARCHIVE-KIND.png.",
)
@click.option("--list", "listing", is_flag=True, help="Say which kinds, variables and axes there are.")
@click.option("--at", multiple=True, metavar="DIM=VALUE", help="gain=2.8, stage=filter; may be repeated.")
@click.option("--x", default="", metavar="DIM", help="What runs along x.")
@click.option("--y", default="", metavar="DIM", help="What runs along y of a map.")
@click.option("--lines", default="", metavar="DIM", help="What lines of curves tell apart.")
@click.option("--panels", default="", metavar="DIM,DIM", help="What panels tell apart, at most two.")
@click.option(
    "--better", default="", metavar="WORD,WORD", help="Of a front: higher or lower, for each figure in order."
)
@click.option("--blame", is_flag=True, help="Of a budget: also what each stage is owed of what is lost; computed now.")
@JSON
def plot(
    place: Path | str,
    words: tuple[str, ...],
    output: Path | None,
    listing: bool,
    blame: bool,
    as_json: bool,
    **sides: Any,
) -> None:
    """Draw what an archive holds: figures over axes, curves, fronts, pictures, budgets.

    \b
    etendue plot sweep                                    what fits what it holds
    etendue plot sweep --list                             which figures and axes there are
    etendue plot sweep map FIGURE -o map.svg              numbers over two axes, a third as panels
    etendue plot sweep pareto FIGURE FIGURE               the front of two figures, named
    etendue plot sweep curves FIGURE --x time --lines gain
    etendue plot sweep strip                              all stages as pictures, a part of each enlarged
    etendue plot sweep show PICTURE --at gain=2.8 --at spacing=4um --at time=10ms
    etendue plot sweep budget                             run time, error, omissions by stage; --blame: and losses

    Other kinds come with what is installed: --list names them.
    """
    from etendue.archive import places
    from etendue.present.plots.asked import Asked
    from etendue.present.plots.holdings import Holdings
    from etendue.present.plots.kinds import draw, kind_of, listed
    from etendue.present.plots.opening import opened
    from etendue.present.plots.places import read_at
    from etendue.present.plots.plot import check_suffix

    sides |= {name: _parts(sides[name]) for name in ("panels", "better")} | {"at": read_at(sides["at"])}
    asked = Asked((), **sides)
    if output is not None:
        check_suffix(output)
    with places.reading(place) as folder:
        holdings = Holdings(opened(folder), shlex.quote(str(place)))
        if listing:
            from etendue.present.terminal.looking import plots_text

            document = listed(holdings)
            say(document) if as_json else show(click.echo, "\n".join(plots_text(document)))
            return
        kind, figures = kind_of(holdings, words[0] if words else "", words[1:])
        if blame and kind != "budget":
            raise click.UsageError(f"--blame is for budget, not for {kind}")
        with blaming(blame, as_json) as shares:
            start = _begun_at(folder) if shares else None
            found = shares(folder, start) if shares else None
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


def _begun_at(folder: Path) -> Document:
    """The axis values of the cell where the report of an archive begins, which is that of its contact sheet."""
    from etendue.present.page.document import start_of
    from etendue.present.page.opened import Opened

    opened = Opened(folder)
    start = start_of(opened)
    return {axis.dim: axis.values[start[axis.dim]] for axis in opened.axes}
