"""The colour filters of a raw frame, from what the archive says of the pattern.

In:  a frame of an archive.
Out: one period of the mask as the frame's first pixel sees it, rows of letters.
"""

from __future__ import annotations

from etendue.errors import ArchiveError
from etendue_camera.export.frames import ArchivedFrame, Shelf
from etendue_camera.sensor import cfa

WELL_KNOWN = ((2, 2), (6, 6))  # periods that LibRaw, and what is built on it, understands


def mask_of(shelf: Shelf, frame: ArchivedFrame) -> tuple[str, ...] | None:
    """One period of the mask; None where all pixels see the same, or no stage speaks of a pattern.

    A mask belongs to the sensor: a window that begins at an odd row has the rows of a Bayer mask the other way about.

    Raises
    ------
    ArchiveError
        The pattern came from a file of which the archive holds no copy.
    """
    pattern = shelf.parameter(frame, "pattern")
    if pattern is None:
        return None
    mask = cfa.parse_rows(_letters(shelf, pattern)) if str(pattern).startswith("sha256:") else cfa.parse(str(pattern))
    if len(mask.channels) == 1:
        return None
    index = cfa.channel_index(
        mask,
        *mask.period,
        *(_first(shelf, frame, dim, name) for dim, name in (("y", "first_row"), ("x", "first_column"))),
    )
    return tuple("".join(mask.channels[i] for i in row) for row in index)


def note(mask: tuple[str, ...] | None) -> str:
    """What a reader may make of a mask that few cameras have; '' of the usual ones."""
    if mask is None or (len(mask), len(mask[0])) in WELL_KNOWN:
        return ""
    return (
        f"the mask of {len(mask)} x {len(mask[0])} pixels is in the file as the DNG specification says, but LibRaw and "
        f"what is built on it "
        "read the colours of 2 x 2 and 6 x 6 masks only; the digital numbers are right for all"
    )


def _first(shelf: Shelf, frame: ArchivedFrame, dim: str, name: str) -> int:
    """The sensor's row or column at which the frame begins."""
    coordinate = frame.group.data.coords.get(dim)
    if (
        coordinate is not None
        and coordinate.size
        and str(coordinate.attrs.get("long_name", "")).startswith("pixel index")
    ):
        return round(float(coordinate[0]))
    return int(shelf.parameter(frame, name, 0))


def _letters(shelf: Shelf, stored: str) -> str:
    path = next(iter((shelf.folder / "inputs").glob(f"{stored.removeprefix('sha256:')}*")), None)
    if path is None:
        raise ArchiveError(f"{shelf.folder}: the file of the pattern ({stored[:19]}...) is not in inputs/")
    return path.read_text(encoding="utf-8-sig")
