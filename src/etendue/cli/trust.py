"""Commands that say whether an archive can be trusted: ``verify``, ``reproduce``, ``diff``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import (
    FOLDER,
    JSON,
    MOST_CELLS,
    PLACE,
    SCHEDULER,
    WORKERS,
    gather_way,
)
from etendue.cli.saying import command, later

_ARCHIVE = click.argument("place", type=PLACE, metavar="ARCHIVE")
UNCHANGED = "interrupted; the archive is as it was"


@command("reproduce")
@_ARCHIVE
@click.option("--into", type=FOLDER, metavar="DIR", help="Keep what is computed in an archive of its own.")
@SCHEDULER
@WORKERS
@MOST_CELLS
@click.option("--quiet", is_flag=True, help="No progress.")
@JSON
@gather_way
@later("etendue.cli.bodies.recomputing:reproduce", UNCHANGED)
def reproduce() -> None:
    """Compute an archive again, from the archive alone, and compare every cell with the stored one while it is
    computed.

    Then everything else that it says: coordinates, dims, units, types, attributes, status, tables, pictures, journal,
    records. What no computing can tell (seconds, dates, versions, authors) is listed as not checked.

    On the same platform every bit has to agree. On another one (processor features, numpy, scipy, Python) a cell may
    differ by what its stage and those in front of it state as their errors. Stages that are not installed are named,
    and so is other code than that of then. Nothing is kept without --into.

    Exit codes: 0 reproduced, 1 not, 2 the request is wrong or something is missing here, 4 a run is writing to the
    archive.
    """


@command("diff")
@click.argument("first", type=PLACE, metavar="A")
@click.argument("second", type=PLACE, metavar="B")
@JSON
@later("etendue.cli.bodies.archives:diff", UNCHANGED)
def diff() -> None:
    """Which cells of two archives differ, by how much, and since which parameter, code or input.

    Cells are matched by stage and axis values; an axis that only one archive has is matched at the value that the other
    has fixed. Figures are those of the worst cell of a stage; relative ones are rms over full scale. Exit codes: 0
    equal, 1 not, 2 the request is wrong.
    """


@command("verify")
@_ARCHIVE
@click.option(
    "--repair", is_flag=True, help="Put back what is known, and compute again what is damaged, and nothing else."
)
@click.option(
    "--from",
    "sources",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Where lost inputs may be found, by their content: files, folders, another archive; may be repeated.",
)
@click.option("--digest", is_flag=True, help="Print one SHA-256 of all of it, to be kept elsewhere.")
@click.option("--accept-platform", is_flag=True, help="Repair with cells computed on another platform than the others.")
@SCHEDULER
@WORKERS
@MOST_CELLS
@click.option("--quiet", is_flag=True, help="No progress.")
@JSON
@gather_way
@later("etendue.cli.bodies.archives:verify", UNCHANGED)
def verify() -> None:
    """Read every byte of an archive and name what is not as it was written: array and cell, metadata, table, record,
    input, journal.

    Needs no stage to be installed and changes nothing. With --repair what is known twice is put back, the rest computed
    again from the archive's own pipeline; what does not belong to the archive is moved to its folder 'strays'.

    Who makes all digests in an archive anew is not found: reproduce finds what does not come out again, and the one
    digest of --digest, kept elsewhere, anything else.

    Exit codes: 0 whole (or whole now), 1 damaged, 2 the request is wrong, or it cannot be repaired from what is there,
    4 in use.
    """
