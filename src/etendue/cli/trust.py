"""Commands that say whether an archive can be trusted: ``verify``, ``reproduce``, ``diff``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from etendue import interrupts
from etendue.cli.options import JSON, SCHEDULER, WORKERS
from etendue.cli.saying import command, tell

_ARCHIVE = click.argument("folder", type=click.Path(path_type=Path), metavar="ARCHIVE")
UNCHANGED = "interrupted; the archive is as it was"


@command("reproduce")
@_ARCHIVE
@click.option("--into", type=click.Path(path_type=Path), metavar="DIR", help="Keep what is computed in an archive of its own.")
@SCHEDULER
@WORKERS
@click.option("--quiet", is_flag=True, help="No progress.")
@JSON
def reproduce(folder: Path, into: Path | None, scheduler: str, workers: int | None, quiet: bool, as_json: bool) -> None:
    """Compute an archive again, from the archive alone, and compare every cell with the stored one while it is computed.

    On the same platform every bit has to agree. On another one (processor features, numpy, scipy, Python) a cell may differ by
    what its stage and those in front of it state as their errors. Stages that are not installed are named, and so is other code
    than that of then. Nothing is kept without --into.

    Exit codes: 0 reproduced, 1 not, 2 the request is wrong or something is missing here, 4 a run is writing to the archive.
    """
    interrupts.say(UNCHANGED)
    here = Path.cwd()  # a plugin may change it
    from etendue.report.terminal import TerminalProgress
    from etendue.report.trust import print_reproduction
    from etendue.session import Options, check_scheduler
    from etendue.studies.reproducing import document
    from etendue.studies.reproducing import reproduce as again

    options = Options(check_scheduler(scheduler), workers or 0)
    found = again(here / folder, options, None if quiet or as_json else TerminalProgress, here / into if into else None)
    tell(as_json, document(found), print_reproduction)
    sys.exit(0 if found.reproduced else 1)


@command("diff")
@click.argument("first", type=click.Path(path_type=Path), metavar="A")
@click.argument("second", type=click.Path(path_type=Path), metavar="B")
@JSON
def diff(first: Path, second: Path, as_json: bool) -> None:
    """Which cells of two archives differ, by how much, and since which parameter, code or input.

    Cells are matched by stage and axis values; an axis that only one archive has is matched at the value that the other has fixed.
    Figures are those of the worst cell of a stage; relative ones are rms over full scale. Exit codes: 0 equal, 1 not, 2 the request
    is wrong.
    """
    interrupts.say(UNCHANGED)
    from etendue.archive.differences import differences, document
    from etendue.report.trust import print_differences

    found = document(first, second, differences(first, second))
    tell(as_json, found, print_differences)
    sys.exit(0 if found["equal"] else 1)


@command("verify")
@_ARCHIVE
@click.option("--repair", is_flag=True, help="Put back what is known, and compute again what is damaged, and nothing else.")
@click.option(
    "--from", "sources", multiple=True, type=click.Path(path_type=Path), metavar="PATH",
    help="Where lost inputs may be found, by their content: files, folders, another archive; may be repeated.",
)  # fmt: skip
@click.option("--accept-platform", is_flag=True, help="Repair with cells computed on another platform than the others.")
@SCHEDULER
@WORKERS
@click.option("--quiet", is_flag=True, help="No progress.")
@JSON
def verify(
    folder: Path, repair: bool, sources: tuple[Path, ...], accept_platform: bool, scheduler: str, workers: int | None, quiet: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Read every byte of an archive and name what is not as it was written: array and cell, metadata, table, record, input, journal.

    Needs no stage to be installed and changes nothing. With --repair what is known twice is put back, the rest computed again from
    the archive's own pipeline; what does not belong to the archive is moved to its folder 'strays'.

    Exit codes: 0 whole (or whole now), 1 damaged, 2 the request is wrong, or it cannot be repaired from what is there, 4 in use.
    """
    interrupts.say(interrupts.INTACT if repair else UNCHANGED)
    here = Path.cwd()  # a plugin may change it
    from etendue.report.trust import print_repaired, print_verified, reading

    with reading(silent=quiet or as_json) as told:
        if not repair:
            from etendue.archive.verify import document as of_verified
            from etendue.archive.verify import verify as look

            checked = of_verified(look(here / folder, told))
        else:
            from etendue.report.terminal import TerminalProgress
            from etendue.session import Options, check_scheduler
            from etendue.studies.repairing import document as of_repaired
            from etendue.studies.repairing import repair as mend

            options = Options(check_scheduler(scheduler), workers or 0, accept_platform=accept_platform)
            places = [here / path for path in sources]
            checked = of_repaired(mend(here / folder, places, options, None if quiet or as_json else TerminalProgress, told))
    tell(as_json, checked, print_repaired if repair else print_verified)
    sys.exit(0 if checked["whole"] else 1)
