"""``reproduce``."""

from __future__ import annotations

import sys
from pathlib import Path

from etendue.archive import places
from etendue.cli.options import Way, from_here, progress
from etendue.cli.saying import tell
from etendue.present.terminal.trust import print_reproduction
from etendue.trust.reproducing import document
from etendue.trust.reproducing import reproduce as again


def reproduce(place: Path | str, into: Path | None, way: Way, most_cells: int | None) -> None:
    here = Path.cwd()  # a plugin may change it
    options = way.options(most_cells=most_cells)
    place = from_here(here, place)
    with places.reading(place, exact=True) as folder:
        found = again(folder, options, progress(way.silent), here / into if into else None)
        said = places.named(document(found), folder, place)
    tell(way.as_json, said, print_reproduction)
    sys.exit(0 if found.reproduced else 1)
