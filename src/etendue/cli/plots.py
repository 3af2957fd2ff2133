"""The ``plot`` command: plots of an archive."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from etendue import streams
from etendue.cli.options import JSON, PLACE
from etendue.cli.saying import blaming, command, say, show


@command("plot")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.argument("words", nargs=-1, metavar="[KIND] [VARIABLE]...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=".png, .svg, .pdf, or .csv for the numbers. Default: ./ARCHIVE-KIND.png.",
)
@click.option("--list", "listing", is_flag=True, help="List kinds, variables and axes, then exit.")
@click.option(
    "--at", multiple=True, metavar="DIM=VALUE", help="Select along an axis: gain=2.8, stage=filter; may be repeated."
)
@click.option("--x", default="", metavar="DIM", help="Axis to show along x.")
@click.option("--y", default="", metavar="DIM", help="Axis to show along y of a map.")
@click.option("--lines", default="", metavar="DIM", help="Axis to show as separate lines.")
@click.option("--panels", default="", metavar="DIM,DIM", help="Axes to show as panels, at most two.")
@click.option(
    "--better", default="", metavar="WORD,WORD", help="For pareto: higher or lower, for each metric in order."
)
@click.option("--blame", is_flag=True, help="For budget: add each stage's share of the loss; computed now.")
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
    """Plot what an archive holds: maps and curves of metrics, Pareto fronts, pictures, budgets.

    \b
    etendue plot sweep                                    the plot that fits best
    etendue plot sweep --list                             list metrics and axes
    etendue plot sweep map METRIC -o map.svg              a metric over two axes, a third as panels
    etendue plot sweep pareto METRIC METRIC               Pareto front of two metrics, labelled
    etendue plot sweep curves METRIC --x time --lines gain
    etendue plot sweep strip                              pictures of all stages, each with an enlarged detail
    etendue plot sweep show PICTURE --at gain=2.8 --at spacing=4um --at time=10ms
    etendue plot sweep budget                             time, error, omissions by stage; --blame adds losses

    Plugins may add kinds: --list names them.
    """
    from etendue.archive import places
    from etendue.present.plots.asked import PlotRequest
    from etendue.present.plots.holdings import Holdings
    from etendue.present.plots.kinds import draw, kind_of, listed
    from etendue.present.plots.opening import opened
    from etendue.present.plots.places import read_at
    from etendue.present.plots.plot import check_suffix

    sides |= {name: _parts(sides[name]) for name in ("panels", "better")} | {"at": read_at(sides["at"])}
    asked = PlotRequest((), **sides)
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


def _begun_at(folder: Path) -> dict[str, Any]:
    """Return the axis values of the cell with which the report of an archive starts, as does its contact sheet."""
    from etendue.present.page.document import start_of
    from etendue.present.page.opened import Opened

    opened = Opened(folder)
    start = start_of(opened)
    return {axis.dim: axis.values[start[axis.dim]] for axis in opened.axes}
