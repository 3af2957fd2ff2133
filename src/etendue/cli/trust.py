"""Commands that check an archive: ``verify``, ``reproduce``, ``diff``."""

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
UNCHANGED = "interrupted; the archive is unchanged"


@command("reproduce")
@_ARCHIVE
@click.option("--into", type=FOLDER, metavar="DIR", help="Keep the recomputed cells in a new archive.")
@SCHEDULER
@WORKERS
@MOST_CELLS
@click.option("--quiet", is_flag=True, help="Show no progress.")
@JSON
@gather_way
@later("etendue.cli.bodies.recomputing:reproduce", UNCHANGED)
def reproduce() -> None:
    """Recompute an archive, from the archive alone, and compare every cell with the stored cell.

    Everything else in the archive is compared too: coordinates, dims, units, types, attributes, status, tables,
    pictures, journal, records. Facts that cannot be recomputed (seconds, dates, versions, authors) are listed as not
    checked.

    On the same platform every bit must agree. On another platform (processor features, numpy, scipy, Python) a cell may
    differ by the errors that its stage and the stages before it declare. Stages that are not installed are listed, and
    so is code that has changed since the run. Nothing is kept without --into.

    Exit codes: 0 reproduced, 1 not reproduced, 2 the request is invalid, or a stage or input is missing, 4 a run is
    writing to the archive.
    """


@command("diff")
@click.argument("first", type=PLACE, metavar="A")
@click.argument("second", type=PLACE, metavar="B")
@JSON
@later("etendue.cli.bodies.checks:diff", UNCHANGED)
def diff() -> None:
    """List the cells that differ between two archives, with the size of the difference and the parameter,
    code or input that caused it.

    Cells are matched by stage and axis values; an axis that only one archive has is matched at the value that the other
    archive uses. For each stage the largest difference of any cell is given; relative differences are rms over full
    scale.

    Exit codes: 0 equal, 1 different, 2 invalid request.
    """


@command("verify")
@_ARCHIVE
@click.option(
    "--repair",
    is_flag=True,
    help="Restore damaged content from a second copy, or recompute it; move foreign files in data.zarr aside.",
)
@click.option(
    "--from",
    "sources",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="File, folder or archive in which to look for lost inputs, by their content; may be repeated.",
)
@click.option("--digest", is_flag=True, help="Print one SHA-256 of the whole archive; store it in another place.")
@click.option(
    "--accept-platform", is_flag=True, help="Repair even if this platform differs from the platform of the other cells."
)
@SCHEDULER
@WORKERS
@MOST_CELLS
@click.option("--quiet", is_flag=True, help="Show no progress.")
@JSON
@gather_way
@later("etendue.cli.bodies.checks:verify", UNCHANGED)
def verify() -> None:
    """Read every byte of an archive and list what has changed since it was written: arrays and cells, metadata, tables,
    records, inputs, journal.

    No stage needs to be installed, and nothing is changed. With --repair, damaged content is restored from a second
    copy if there is one, or recomputed from the archive's own pipeline; files in data.zarr that no run has written are
    moved to the archive's folder 'strays'.

    `verify` cannot detect a change after which all digests in the archive were rewritten too. `reproduce` detects such
    a change if a result differs from the recomputed result; the digest printed by --digest, if you kept it elsewhere,
    detects any change.

    Exit codes: 0 undamaged (with --repair: after the repair), 1 damaged, 2 invalid request, or the archive lacks what a
    repair needs, 4 a run is writing to the archive.
    """
