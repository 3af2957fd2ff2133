"""A TIFF writer for one uncompressed picture with arbitrary tags, and a second directory for EXIF.

In:  tags as (code, type, values), the samples of one strip.
Out: the bytes of a classic little-endian TIFF file.
Sources: TIFF revision 6.0; EXIF 2.32 (JEITA CP-3451) for the second directory. TIFF libraries do not write the
photometric interpretation and the directory that DNG requires.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, BinaryIO

BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL = 1, 2, 3, 4, 5, 7, 10
FORMS = {BYTE: "B", UNDEFINED: "B", SHORT: "H", LONG: "I", RATIONAL: "I", SRATIONAL: "i"}
STRIP_OFFSET, STRIP_BYTES, EXIF = 273, 279, 34665
LARGEST = 2**32 - 1

# code, type, and values: text, or numbers (numerators and denominators alternate)
Tag = tuple[int, int, str | int | Sequence[int]]


def _packed(kind: int, values: Any) -> tuple[int, bytes]:
    """Return the number of values, and their bytes."""
    if kind == ASCII:
        data = values.encode("ascii", "replace") + b"\0"
        return len(data), data
    numbers: Sequence[int] = values if isinstance(values, list | tuple) else (values,)
    data = struct.pack(f"<{len(numbers)}{FORMS[kind]}", *numbers)
    return len(numbers) // (2 if kind in (RATIONAL, SRATIONAL) else 1), data


def _directory(tags: Sequence[Tag], at: int) -> bytes:
    """Return one directory at a byte offset of the file, followed by the values that do not fit into it."""
    entries, beside = [], b""
    behind = at + 2 + 12 * len(tags) + 4
    for code, kind, values in sorted(tags, key=lambda tag: tag[0]):
        count, data = _packed(kind, values)
        if len(data) > 4:
            where = behind + len(beside)
            beside += data + b"\0" * (len(data) % 2)
            data = struct.pack("<I", where)
        entries.append(struct.pack("<HHI", code, kind, count) + data.ljust(4, b"\0"))
    return struct.pack("<H", len(tags)) + b"".join(entries) + struct.pack("<I", 0) + beside


def write_picture(file: BinaryIO, samples: bytes, tags: Sequence[Tag], exif: Sequence[Tag] = ()) -> None:
    """Write header, directory, EXIF directory, then the samples in one strip.

    Raises
    ------
    ValueError
        If a tag is given twice, or the file exceeds 4 GiB, the limit of classic TIFF.
    """
    own: list[Tag] = [*tags, (STRIP_OFFSET, LONG, 0), (STRIP_BYTES, LONG, len(samples))]
    own += [(EXIF, LONG, 0)] if exif else []
    codes = [code for code, _, _ in own]
    if len(set(codes)) < len(codes):
        raise ValueError(f"tags {sorted({code for code in codes if codes.count(code) > 1})} are given twice")
    first = 8
    second = first + len(_directory(own, first))
    strip = second + len(_directory(exif, second)) if exif else second
    strip += -strip % 16
    if strip + len(samples) > LARGEST:
        raise ValueError(f"{len(samples)} bytes of samples exceed the 4 GiB of a TIFF file")
    places = {STRIP_OFFSET: strip, EXIF: second}
    own = [(code, kind, places.get(code, values)) for code, kind, values in own]
    head = struct.pack("<2sHI", b"II", 42, first) + _directory(own, first) + (_directory(exif, second) if exif else b"")
    file.write(head.ljust(strip, b"\0"))
    file.write(samples)
