"""Commands that check archives: ``diff``, ``verify``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from etendue import interrupts
from etendue.archive import places
from etendue.archive.checks import verify as checks
from etendue.archive.read import differences
from etendue.cli.options import Way, from_here, progress
from etendue.cli.saying import tell
from etendue.present.terminal.trust import print_differences, print_repaired, print_verified, reading
from etendue.run.schedulers import far


def diff(first: Path | str, second: Path | str, as_json: bool) -> None:
    with places.reading(first, inputs=False) as a, places.reading(second, inputs=False) as b:
        found = places.named(
            places.named(differences.document(a, b, differences.differences(a, b)), a, first), b, second
        )
    tell(as_json, found, print_differences)
    sys.exit(0 if found["equal"] else 1)


def verify(place: Path | str, repair: bool, sources: tuple[Path, ...], digest: bool, way: Way, **how: Any) -> None:
    if repair:
        interrupts.say(interrupts.INTACT)
    here = Path.cwd()  # a plugin may change it
    place = from_here(here, place)
    with reading(silent=way.silent) as told:
        if not repair:
            with places.reading(place, exact=True) as folder:
                checked = places.named(checks.document(checks.verify(folder, told)), folder, place)
                checked |= {"sha256": checks.sha256_of(folder)} if digest else {}
        else:
            from etendue.trust import repairing

            options, sought = way.options(**how), [here / path for path in sources]
            with places.writing(place, far(way.scheduler), exact=True) as folder:
                mended = repairing.repair(folder, sought, options, progress(way.silent), told)
                checked = places.named(repairing.document(mended), folder, place)
                checked |= {"sha256": checks.sha256_of(folder)} if digest else {}
    tell(way.as_json, checked, print_repaired if repair else print_verified)
    sys.exit(0 if checked["whole"] else 1)
