"""The colour filters of a raw frame, from the pattern in the archive.

In:  a frame of an archive.
Out: one period of the mask from the frame's first pixel, as rows of letters.
"""

from __future__ import annotations

from etendue.errors import ArchiveError
from etendue_camera.export.frames import ArchivedFrame, Shelf
from etendue_camera.sensor import cfa

WELL_KNOWN = ((2, 2), (6, 6))  # periods that LibRaw and programs based on it support


def mask_of(shelf: Shelf, frame: ArchivedFrame) -> tuple[str, ...] | None:
    """Return one period of the mask; None if all pixels have the same filter, or no stage has a pattern.

    A mask is counted from the first pixel of the sensor: in a window that starts at an odd row, the rows of a Bayer
    mask are exchanged.

    Raises
    ------
    ArchiveError
        If the pattern came from a file of which the archive has no copy.
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
    """Return a note on reader support for an unusual mask; '' for common ones."""
    if mask is None or (len(mask), len(mask[0])) in WELL_KNOWN:
        return ""
    return (
        f"the mask of {len(mask)} x {len(mask[0])} pixels is stored as the DNG specification requires, but LibRaw and "
        f"programs based on it "
        "support colours of 2 x 2 and 6 x 6 masks only; the digital numbers are correct for all"
    )


def _first(shelf: Shelf, frame: ArchivedFrame, dim: str, name: str) -> int:
    """Return the sensor row or column at which the frame starts."""
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
        raise ArchiveError(f"{shelf.folder}: the pattern file ({stored[:19]}...) is missing from inputs/")
    return path.read_text(encoding="utf-8-sig")
