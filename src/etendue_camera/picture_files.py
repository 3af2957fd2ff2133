"""Pictures of files as they are: every bit of them, or a refusal that says what the file holds.

In:  a PNG, JPEG or TIFF file: grey or colour, 1 to 32 bits or floats, sRGB-encoded.
Out: its size before it is decoded; its values, 0 to 1, (rows, columns, 1 or 3), still in the file's own numbers.
"""

from __future__ import annotations

import lzma
import math
import os
import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from etendue import plain_files, require
from etendue.contract.bounds import beyond
from etendue.process import unwarned
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.colour_notes import colour_note, exif_note, png_note

MOST_DIRECTORIES = 10_000  # of a TIFF file
MOST_PIXELS = 50_000_000  # a gigabyte while it is read
MOST_PARTS = 2000  # of a PNG, beside its picture
UNCHECKED = 32 << 20  # bytes that any file may unfold to
FOLD = 4000  # times that a larger picture may be larger than its file
_UNFOLDS, _LZMA = (8, 32946, 34925), 34925  # codings of TIFF: deflate twice, LZMA
ALLOWED = "PNG, JPEG or TIFF, grey or RGB"
DNG = 50706  # tag of its version
GREY_ALPHA = 4  # colour type of PNG
_ELSE = {
    b"heic": "HEIC",
    b"heix": "HEIC",
    b"mif1": "HEIC",
    b"msf1": "HEIC",
    b"hevc": "HEIC",
    b"avif": "AVIF",
    b"crx ": "Canon raw (CR3)",
}
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_MODES = ("1", "L", "P", "RGB", "I;16", "I;16B", "I;16L", "I", "RGBA", "LA", "PA", "YCbCr")
_TURNS: dict[int, Any] = {  # EXIF and TIFF orientation: what puts the picture upright
    1: lambda a: a,
    2: lambda a: a[:, ::-1],
    3: lambda a: a[::-1, ::-1],
    4: lambda a: a[::-1],
    5: lambda a: a.swapaxes(0, 1),
    6: lambda a: a.swapaxes(0, 1)[:, ::-1],
    7: lambda a: a[::-1, ::-1].swapaxes(0, 1),
    8: lambda a: a.swapaxes(0, 1)[::-1],
}


@dataclass(frozen=True)
class FilePicture:
    """Values in the file's own numbers, and by what they are divided; what is not done to them."""

    values: Array  # (rows, columns, 1 or 3), unsigned integers or floats
    full: float
    note: str = ""
    table: Any = None  # (8, 8): steps of the cosine transform by which a JPEG holds its brightness, y first


def read_picture(path: str, most: int = MOST_PIXELS) -> FilePicture:
    """The picture of a file of at most so many pixels, the way up that the file says.

    Raises
    ------
    ValueError
        No picture, a damaged one, one that is too large, more than one, transparent pixels, signed numbers, NaN or
        floats outside 0 to 1, colours that are neither grey nor RGB: with the file, what it holds and what is allowed.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        plain_files.check_plain(path)
        with open(path, "rb") as file:
            start = file.read(12)
        if start[:4] in _TIFF:
            return _tiff(path, most)
        if start[:4] == b"\x89PNG":
            _check_parts(path)
        if start[4:8] == b"ftyp" and start[8:] in _ELSE:
            raise ValueError(f"{path} is {_ELSE[start[8:]]}; allowed are {ALLOWED}: save it as one of them")
        with unwarned():  # of pictures that are large: the limit here is lower; of damaged EXIF: what is left is read
            with Image.open(path) as picture:
                kind, size = picture.format, picture.size
            require.that(
                kind in ("PNG", "JPEG", "MPO"), f"{path} holds {kind}; allowed are {ALLOWED}: save it as one of them"
            )
            _check_size(path, size[0] * size[1], most)
            many, stored = size[0] * size[1], os.path.getsize(path)
            # deflate makes nothing more than 1032 times smaller, JPEG hardly more
            require.that(
                not 3 * many > UNCHECKED or not 3 * many > FOLD * stored,
                f"{path} says that it has {many} pixels, in {stored} bytes: it is cut off, or no picture",
            )
            return _plain(path)
    except UnidentifiedImageError:
        raise ValueError(f"{path} cannot be read as a picture; allowed are {ALLOWED}") from None
    except Image.DecompressionBombError as error:
        pixels = re.search(r"\((\d+) pixels\)", str(error))
        _check_size(path, int(pixels[1]) if pixels else 10 * most, most)
        raise ValueError(f"{path} cannot be read: {error}") from None
    except ValueError as error:
        text = str(error) if str(error).startswith(path) else f"{path} cannot be read as a picture: {error}"
        raise ValueError(text) from None
    except (OSError, EOFError, SyntaxError, LookupError, TypeError, ArithmeticError) as error:
        raise ValueError(
            f"{path} cannot be read as a picture ({ALLOWED}): {' '.join(str(error).split())[:150]}"
        ) from None
    except Exception as error:  # of a decoder: zlib.error, struct.error
        raise ValueError(f"{path} is damaged: {type(error).__name__}: {' '.join(str(error).split())[:150]}") from None


def _check_size(path: str, pixels: int, most: int) -> None:
    way_out = (
        "reduce the picture first: a scene is drawn on a grid of its own"
        if most == MOST_PIXELS
        else "cut out what is to be seen"
    )
    too_many = beyond(pixels, "pixels", most, way_out)
    require.that(not too_many, f"{path} has {too_many}")


def _check_parts(path: str) -> None:
    """Refuse a PNG of very many parts that are no picture."""
    with open(path, "rb") as file:
        file.seek(8)
        found = 0
        while len(head := file.read(8)) == 8 and head[4:] != b"IEND":
            found += head[4:] != b"IDAT"
            if found > MOST_PARTS:
                raise ValueError(
                    f"{path} has more than {MOST_PARTS} parts beside its picture; save it again without them"
                )
            file.seek(int.from_bytes(head[:4], "big") + 4, 1)


def check_segments(path: str | Path, page: Any) -> None:
    """Refuse a page of a TIFF file whose strips or tiles are, or unfold to, far more than their part of the picture.

    Raises
    ------
    ValueError
        One does.
    """
    if page.dtype is None:
        return
    most = 2 * math.prod(page.chunks) * page.dtype.itemsize + (1 << 16)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False):
        size = (
            count
            if count > most or int(page.compression) not in _UNFOLDS
            else _unfolded(path, offset, count, page, most)
        )
        if size > most:
            raise ValueError(
                f"{path}: a strip of {most // 2} bytes is stored as more than {most}; no picture is written so"
            )


def _unfolded(path: str | Path, offset: int, count: int, page: Any, most: int) -> int:
    """Bytes that a strip unfolds to, counted up to so many; 0 where so few cannot become many."""
    if count * 8 * FOLD < UNCHECKED:
        return 0
    reader: Any = lzma.LZMADecompressor() if int(page.compression) == _LZMA else zlib.decompressobj()
    size = 0
    with open(path, "rb") as file:
        file.seek(offset)
        left = file.read(count)
    while size <= most and not reader.eof:
        part = reader.decompress(left, 1 << 20)
        left = getattr(reader, "unconsumed_tail", b"")
        size += len(part)
        if not part and not left:
            break
    return size


def _plain(path: str) -> FilePicture:
    """PNG and JPEG."""
    from PIL import Image

    with Image.open(path) as picture:
        frames = getattr(picture, "n_frames", 1)
        if frames > 1 and picture.format != "MPO":  # a telephone's JPEG may hold a preview
            raise ValueError(f"{path} holds {frames} pictures; save the one that is meant")
        mode, turn = picture.mode, picture.getexif().get(0x0112, 1)
        note = colour_note(picture.info) or exif_note(picture.getexif(), picture.info)
        if picture.format == "PNG":
            points = png_note(path)
            note = note if points is None else points
        table = _steps(getattr(picture, "quantization", None), turn)
        require.that(mode in _MODES, f"{path} is a picture of mode {mode}; allowed are {ALLOWED}: convert it first")
        deep = False
        if picture.format == "PNG":
            with open(path, "rb") as file:
                depth, colour = file.read(26)[24:]  # of the header: bits of a sample, colour type
            deep = depth == 16
            require.that(
                not deep or colour != GREY_ALPHA,
                f"{path} is 16-bit grey with an alpha channel; save it without the channel",
            )
        _refuse_clear(path, _transparent(picture))
    if deep and mode in ("RGB", "RGBA"):
        values = _deep_png(path, mode)[..., :3]
    else:
        with Image.open(path) as picture:
            if mode.startswith("I"):
                values = np.asarray(picture).astype(np.uint16)[..., None]
            elif mode in ("1", "L", "LA"):
                values = np.asarray(picture.convert("L"))[..., None]
            else:
                values = np.asarray(picture.convert("RGB"))
    return FilePicture(_TURNS.get(turn, _TURNS[1])(values), 255.0 if values.dtype == np.uint8 else 65535.0, note, table)


def _steps(tables: Any, turn: int) -> FloatArray | None:
    """The first quantisation table of a JPEG, as the picture stands when it is upright."""
    if not tables or len(tables.get(0, ())) != 64:
        return None
    table = np.asarray(tables[0], float).reshape(8, 8)
    return table.T if turn >= 5 else table


def _refuse_clear(path: str, clear: int) -> None:
    require.that(
        not clear, f"{path} has {clear} transparent pixels, and nobody knows what is behind them: flatten it first"
    )


def _transparent(picture: Any) -> int:
    """How many pixels are not opaque."""
    if "A" not in picture.mode and "transparency" not in picture.info:
        return 0
    alpha = np.asarray(picture.convert("RGBA").getchannel("A"))
    return int(np.count_nonzero(alpha < 255))


def _deep_png(path: str, mode: str) -> Any:
    """All 16 bits of a colour PNG, of which Pillow hands on the upper eight: taken as little-endian, the same bytes
    give the lower.
    """
    from PIL import Image

    halves = []
    for order in ("B", "L"):
        with Image.open(path) as picture:
            tile: Any = picture.tile[0]
            raw = f"{mode};16{order}"
            turned: Any = tile._replace(args=raw) if hasattr(tile, "_replace") else (*tile[:3], raw)
            picture.tile = [turned]
            halves.append(np.asarray(picture).astype(np.uint16))
    return halves[0] * np.uint16(256) + halves[1]


def check_directories(path: str | Path) -> None:
    """Refuse a TIFF file whose directories stand one behind the other without end: readers would go round in it.

    Raises
    ------
    ValueError
        A directory points to itself, to one before it, or there are more than any picture has.
    """
    with open(path, "rb") as file:
        start = file.read(16)
        order = "<" if start[:2] == b"II" else ">"
        large = start[2:4] in (b"+\0", b"\0+")
        if start[:4] not in _TIFF or len(start) < (16 if large else 8):
            return
        count, entry, link = ("Q", 20, "Q") if large else ("H", 12, "I")
        at, seen = struct.unpack_from(order + link, start, 8 if large else 4)[0], set[int]()
        while at:
            if at in seen or len(seen) >= MOST_DIRECTORIES:
                raise ValueError(
                    f"{path}: its directories go round in a ring, or are more than {MOST_DIRECTORIES}; no picture is "
                    f"written so"
                )
            seen.add(at)
            file.seek(at)
            head = file.read(struct.calcsize(order + count))
            if len(head) < struct.calcsize(order + count):
                return
            file.seek(entry * struct.unpack(order + count, head)[0], 1)
            tail = file.read(struct.calcsize(order + link))
            at = struct.unpack(order + link, tail)[0] if len(tail) == struct.calcsize(order + link) else 0


def _tiff(path: str, most: int) -> FilePicture:
    import logging

    import tifffile

    check_directories(path)
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    with tifffile.TiffFile(path) as file:
        page = _only_page(path, file)
        _check_size(path, page.imagelength * page.imagewidth, most)
        colours = page.photometric.name if hasattr(page.photometric, "name") else str(page.photometric)
        turn = int(page.tags.valueof(274, 1))
        profile = page.tags.valueof(34675)
        note = colour_note({"icc_profile": bytes(profile)} if profile else {})
        _check_kind(path, page, colours)
        if colours in ("PALETTE", "YCBCR") or page.bitspersample == 1:
            return FilePicture(_by_pillow(path), 255.0, note)
        check_segments(path, page)
        try:
            values = page.asarray()
        except (ValueError, ImportError) as error:  # a codec that is not installed
            if page.dtype.itemsize == 1:
                return FilePicture(_by_pillow(path), 255.0, note)
            raise ValueError(
                f"{path} cannot be decoded: {error}; save it without compression, or with deflate"
            ) from None
        if page.planarconfig == 2 and values.ndim == 3:
            values = values.transpose(1, 2, 0)
    full = 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    values = _opaque(path, values, full)
    if colours == "MINISWHITE":
        values = (values.dtype.type(full) - values).astype(values.dtype)
    return FilePicture(_TURNS.get(turn, _TURNS[1])(values), full, note)


def _only_page(path: str, file: Any) -> Any:
    """The one picture of a TIFF file, beside smaller copies of it."""
    pages = [page for page in file.pages if not getattr(page.aspage(), "is_reduced", False)]
    if file.pages[0].aspage().tags.valueof(DNG) is not None:
        raise ValueError(f"{path} is a raw file (DNG); allowed are {ALLOWED}: develop it first")
    require.that(len(pages) == 1, f"{path} holds {len(pages)} pictures; save the one that is meant")
    return pages[0].aspage()


def _check_kind(path: str, page: Any, colours: str) -> None:
    """Refuse numbers and colours that are no picture's."""
    kind, bits = page.dtype, page.bitspersample
    known = kind is not None and (bits == 1 or (kind.kind in "uf" and bits in (8, 16, 32, 64)))
    require.that(known, f"{path} holds {kind or bits} numbers; allowed are unsigned integers and floats from 0 to 1")
    require.that(
        colours in ("MINISBLACK", "MINISWHITE", "RGB", "PALETTE", "YCBCR"),
        f"{path} is a picture in {colours}; allowed are {ALLOWED}: convert it first",
    )


def _opaque(path: str, values: Array, full: float) -> Array:
    """(rows, columns, 1 or 3): samples without a channel that says where they are transparent, as none may be."""
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] not in (1, 2, 3, 4):
        raise ValueError(f"{path} has {values.shape[2:] or values.shape} samples a pixel; allowed are {ALLOWED}")
    if values.shape[2] in (2, 4):
        _refuse_clear(path, int(np.count_nonzero(values[..., -1] < full)))
        values = values[..., :-1]
    if values.dtype.kind == "f":
        _check_floats(path, values)
    return values


def _by_pillow(path: str) -> Array:
    """8-bit values of a TIFF file whose coding only Pillow knows; it turns them upright itself."""
    from PIL import Image

    with Image.open(path) as picture:
        require.that(
            not _transparent(picture),
            f"{path} has transparent pixels, and nobody knows what is behind them: flatten it first",
        )
        return (
            np.asarray(picture.convert("L"))[..., None]
            if picture.mode in ("1", "L")
            else np.asarray(picture.convert("RGB"))
        )


def _check_floats(path: str, values: Array) -> None:
    """Floats are reflectances behind the sRGB curve: from 0 to 1."""
    bad = ~((values >= 0) & (values <= 1))
    if bad.any():
        row, column, _ = np.unravel_index(int(np.argmax(bad)), bad.shape)
        raise ValueError(
            f"{path} holds {float(values[row, column].flat[int(np.argmax(bad[row, column]))]):g} at row {row}, column "
            f"{column} "
            f"({int(bad.any(axis=2).sum())} such pixels); allowed are floats from 0 to 1"
        )
