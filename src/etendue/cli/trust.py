"""Commands that check an archive: ``verify``, ``reproduce``, ``diff``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from etendue import interrupts
from etendue.cli.options import (
    FOLDER,
    JSON,
    MOST_CELLS,
    PLACE,
    SCHEDULER,
    WORKERS,
    Way,
    from_here,
    gather_way,
    progress,
)
from etendue.cli.saying import command, tell

_ARCHIVE = click.argument("place", type=PLACE, metavar="ARCHIVE")
UNCHANGED = "interrupted; the archive is as it was"


@command("reproduce")
@_ARCHIVE
@click.option("--into", type=FOLDER, metavar="DIR", help="Keep the recomputed cells in a new archive.")
@SCHEDULER
@WORKERS
@MOST_CELLS
@click.option("--quiet", is_flag=True, help="Show no progress.")
@JSON
@gather_way
def reproduce(place: Path | str, into: Path | None, way: Way, most_cells: int | None) -> None:
    """Recompute an archive, from the archive alone, and compare every cell with the stored one.

    Everything else in the archive is compared too: coordinates, dims, units, types, attributes, status, tables,
    pictures, journal, records. What cannot be recomputed (seconds, dates, versions, authors) is listed as not checked.

    On the same platform every bit must agree. On another one (processor features, numpy, scipy, Python) a cell may
    differ by the errors that its stage and those before it declare. Stages that are not installed are listed, and so is
    code that has changed since. Nothing is kept without --into.

    Exit codes: 0 reproduced, 1 not reproduced, 2 invalid request or something missing here, 4 a run is writing to the
    archive.
    """
    interrupts.say(UNCHANGED)
    here = Path.cwd()  # a plugin may change it
    from etendue.archive import places
    from etendue.present.terminal.trust import print_reproduction
    from etendue.trust.reproducing import document
    from etendue.trust.reproducing import reproduce as again

    options = way.options(most_cells=most_cells)
    place = from_here(here, place)
    with places.reading(place, exact=True) as folder:
        found = again(folder, options, progress(way.silent), here / into if into else None)
        said = places.named(document(found), folder, place)
    tell(way.as_json, said, print_reproduction)
    sys.exit(0 if found.reproduced else 1)


@command("diff")
@click.argument("first", type=PLACE, metavar="A")
@click.argument("second", type=PLACE, metavar="B")
@JSON
def diff(first: Path | str, second: Path | str, as_json: bool) -> None:
    """List the cells that differ between two archives, by how much, and which parameter, code or input caused it.

    Cells are matched by stage and axis values; an axis that only one archive has is matched at the value fixed in the
    other. Values are those of the worst cell of a stage; relative ones are rms over full scale.

    Exit codes: 0 equal, 1 different, 2 invalid request.
    """
    interrupts.say(UNCHANGED)
    from etendue.archive import places
    from etendue.archive.read.differences import differences, document
    from etendue.present.terminal.trust import print_differences

    with places.reading(first, inputs=False) as a, places.reading(second, inputs=False) as b:
        found = places.named(places.named(document(a, b, differences(a, b)), a, first), b, second)
    tell(as_json, found, print_differences)
    sys.exit(0 if found["equal"] else 1)


@command("verify")
@_ARCHIVE
@click.option(
    "--repair", is_flag=True, help="Restore what is stored twice and recompute what is damaged, nothing else."
)
@click.option(
    "--from",
    "sources",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Where to look for lost inputs, by content: files, folders, another archive; may be repeated.",
)
@click.option("--digest", is_flag=True, help="Print one SHA-256 of the whole archive, to keep elsewhere.")
@click.option(
    "--accept-platform", is_flag=True, help="Repair even if this platform differs from that of the other cells."
)
@SCHEDULER
@WORKERS
@MOST_CELLS
@click.option("--quiet", is_flag=True, help="Show no progress.")
@JSON
@gather_way
def verify(place: Path | str, repair: bool, sources: tuple[Path, ...], digest: bool, way: Way, **how: Any) -> None:
    """Read every byte of an archive and list what has changed since it was written: arrays and cells, metadata, tables,
    records, inputs, journal.

    No stage needs to be installed, and nothing is changed. With --repair, what is stored twice is restored and the rest
    recomputed from the archive's own pipeline; files that do not belong to the archive are moved to its folder
    'strays'.

    Someone who rewrites all digests in an archive is not detected: `reproduce` finds results that do not come out
    again, and the digest printed by --digest, kept elsewhere, finds any other change.

    Exit codes: 0 whole (or whole now), 1 damaged, 2 invalid request, or repair is impossible from what is there, 4 in
    use.
    """
    interrupts.say(interrupts.INTACT if repair else UNCHANGED)
    here = Path.cwd()  # a plugin may change it
    from etendue.archive import places
    from etendue.archive.checks.verify import sha256_of
    from etendue.present.terminal.trust import print_repaired, print_verified, reading

    place = from_here(here, place)
    with reading(silent=way.silent) as told:
        if not repair:
            from etendue.archive.checks.verify import document as of_verified
            from etendue.archive.checks.verify import verify as look

            with places.reading(place, exact=True) as folder:
                checked = places.named(of_verified(look(folder, told)), folder, place)
                checked |= {"sha256": sha256_of(folder)} if digest else {}
        else:
            from etendue.run.schedulers import far
            from etendue.trust.repairing import document as of_repaired
            from etendue.trust.repairing import repair as mend

            options, sought = way.options(**how), [here / path for path in sources]
            with places.writing(place, far(way.scheduler), exact=True) as folder:
                mended = mend(folder, sought, options, progress(way.silent), told)
                checked = places.named(of_repaired(mended), folder, place)
                checked |= {"sha256": sha256_of(folder)} if digest else {}
    tell(way.as_json, checked, print_repaired if repair else print_verified)
    sys.exit(0 if checked["whole"] else 1)
