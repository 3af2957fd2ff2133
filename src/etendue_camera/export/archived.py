"""``Archive.export``: export pictures of an archive from Python."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.archive import places
from etendue.errors import RequestError, nearest
from etendue_camera.export import command

if TYPE_CHECKING:
    from etendue.builder.archives import Archive

Words = str | Iterable[str]


def export(
    archive: Archive,
    kind: str = "png",
    output: str | Path | None = None,
    *,
    variables: Words = (),
    stage: str = "",
    everything: bool = False,
    force: bool = False,
    **at: Any,
) -> list[Path]:
    """Export pictures as files for other programs.

    Parameters
    ----------
    kind : "png", "tiff" or "dng"
    output : a folder, or a file for a single picture; default ./ARCHIVE-export
    variables : variables for PNG and TIFF files; default display values and raw digital numbers
    stage : stage to read from
    everything : allow more than 64 files
    force : overwrite existing files
    at : values of axes; all values of an axis that is not given

    Returns
    -------
    list of Path
        The files; failed cells have no picture.

    Raises
    ------
    RequestError
        If a kind, variable or value does not exist.
    """
    if kind not in command.SUFFIXES:
        raise RequestError(f"unknown kind of file {kind!r}{nearest(kind, command.SUFFIXES)}")
    names = (variables,) if isinstance(variables, str) else tuple(variables)
    where = tuple(f"{axis}={value}" for axis, value in at.items())
    to = Path(output) if output is not None else None
    with places.reading(archive.place) as folder:
        done = command.export(
            command.ExportRequest(
                folder,
                **{kind: True},
                variables=names,
                at=where,
                stage=stage,
                output=to,
                everything=everything,
                force=force,
            )
        )
    return done.files
