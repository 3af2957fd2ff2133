"""``Archive.export``: pictures of an archive as files for other programs, from Python."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.archive import places
from etendue.errors import RequestError, nearest

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
    """Pictures as files for other programs.

    Parameters
    ----------
    kind : "png", "tiff" or "dng"
    output : a folder, or the file for one picture; ./ARCHIVE-export where none is given
    variables : what PNG and TIFF files show; display values and raw numbers where none is given
    stage : take them from this one
    everything : also more than 64 files
    force : write over files that exist
    at : values of axes; of an axis that is not named all

    Returns
    -------
    list of Path
        The files; cells that failed have none.

    Raises
    ------
    RequestError
        A kind, variable or value that there is not.
    """
    from etendue_camera.export.command import SUFFIXES, ExportRequest, export

    if kind not in SUFFIXES:
        raise RequestError(f"{kind!r} is no kind of file{nearest(kind, SUFFIXES)}")
    names = (variables,) if isinstance(variables, str) else tuple(variables)
    where = tuple(f"{axis}={value}" for axis, value in at.items())
    to = Path(output) if output is not None else None
    with places.reading(archive.place) as folder:
        done = export(
            ExportRequest(
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
