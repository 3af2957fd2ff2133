"""Command that describes an archive: ``show``."""

from __future__ import annotations

from pathlib import Path

from etendue.archive import places
from etendue.archive.checks.describe import describe_archive
from etendue.cli.saying import tell
from etendue.present.terminal.stored import print_archive


def show_archive(place: Path | str, as_json: bool) -> None:
    with places.reading(place, inputs=False) as folder:
        described = places.named(describe_archive(folder), folder, place)
    tell(as_json, described, print_archive)
