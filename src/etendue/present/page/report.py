"""``etendue report``: an archive in one HTML file.

In:  the folder of an archive, where to write.
Out: the file, written completely or not at all; its size and contents.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.present.page.brought import sections
from etendue.present.page.document import document
from etendue.present.page.html import page
from etendue.present.page.opened import Opened
from etendue.present.page.shots import shots
from etendue.telling import printable
from etendue.types.documents import Document, DocumentView


@dataclass(frozen=True)
class WrittenReport:
    """Summary of a written report."""

    path: Path
    bytes: int
    cells: int  # with metrics
    pictured: int  # with pictures
    failed: int


# (folder, values of axes by dim) -> document of each stage's share of the losses
Blame = Callable[[Path, DocumentView], DocumentView]


def report(archive: Path, output: Path, blame: Blame | None = None) -> WrittenReport:
    """Write the report of an archive. ``blame``: function that returns each stage's share of the losses in the cell
    that the page shows first.

    Raises
    ------
    ArchiveError
        The folder is not an archive, or the archive is damaged.
    RequestError
        The output is a folder.
    """
    if output.is_dir():
        raise RequestError(f"-o {output} is a folder; give a file, such as {output / 'report.html'}")
    opened = Opened(archive)
    made = reported(opened)
    if blame is not None:
        made["blame"] = {
            **blame(archive, {axis.dim: axis.values[made["start"][axis.dim]] for axis in opened.axes}),
            "at": made["start"],
        }
    text = page(made)
    output.parent.mkdir(parents=True, exist_ok=True)
    partial = output.with_name(f".{output.name}.{os.getpid()}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, output)
    finally:
        partial.unlink(missing_ok=True)
    failed = sum(row["cells"] for row in made["failures"]["rows"])
    return WrittenReport(output, len(text.encode()), made["cells"]["rows"], len(made["pictures"]["places"]), failed)


def reported(opened: Opened) -> Document:
    """Return the document of a report: metrics of all cells, pictures of a few cells."""
    made = document(opened, about_stages(opened))
    made = {**made, "pictures": shots(opened, made["start"])}
    return {**made, "sections": sections(opened), "damaged": sorted(opened.damaged)}


def about_stages(opened: Opened) -> Mapping[str, Mapping[str, str]]:
    """Return the descriptions of an archive's stages that are installed here."""
    registry = installed_stages()
    found = {}
    for use in {str(one) for node in opened.record["nodes"].values() for one in node.get("stage", [])}:
        if use in registry:
            try:
                said = (registry.load(use).__doc__ or "").strip().split("\n\n")[0]
            except Exception:  # a plugin is broken: show less
                continue
            found[use] = {"what": printable(" ".join(said.split()))}
    return found
