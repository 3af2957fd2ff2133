"""Read picture files at full bit depth, or raise an error that states what the file contains.

In:  a PNG, JPEG or TIFF file: grey or colour, 1 to 32 bits or floats, sRGB-encoded.
Out: its size before decoding; its values, 0 to 1, (rows, columns, 1 or 3), in the file's own encoding.
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
from etendue.contract.values.bounds import beyond
from etendue.process import unwarned
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.colour_notes import colour_note, exif_note, png_note

MOST_DIRECTORIES = 10_000  # in a TIFF file
MOST_PIXELS = 50_000_000  # a picture of this size takes 1 GB while it is read
MOST_PARTS = 2000  # maximum number of PNG chunks besides image data
UNCHECKED = 32 << 20  # size to which every file may decompress, bytes
FOLD = 4000  # maximum ratio of decompressed size to file size, for larger pictures
_UNFOLDS, _LZMA = (8, 32946, 34925), 34925  # TIFF compression codes: deflate (two), LZMA
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
_TURNS: dict[int, Any] = {  # EXIF and TIFF orientation: the operation that turns the picture upright
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
    """Values in the file's own encoding, their divisor, and notes on colour information that is not applied."""

    values: Array  # (rows, columns, 1 or 3), unsigned integers or floats
    full: float
    note: str = ""
    table: FloatArray | None = None  # (8, 8): luma quantisation steps of a JPEG, y first


def read_picture(path: str, most: int = MOST_PIXELS) -> FilePicture:
    """Read the picture of a file with at most ``most`` pixels, in the orientation stated by the file.

    Raises
    ------
    ValueError
        If the file is no picture, damaged, too large, has several pictures, transparent pixels, signed values, NaN
        or floats outside 0 to 1, or is neither grey nor RGB; the message states the file, its content and the supported
        formats.
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
            raise ValueError(f"{path} is {_ELSE[start[8:]]}; convert it to {ALLOWED}")
        with unwarned():  # of large pictures: the limit here is lower; of damaged EXIF: the rest is read
            with Image.open(path) as picture:
                kind, size = picture.format, picture.size
            require.that(kind in ("PNG", "JPEG", "MPO"), f"{path} is {kind}; convert it to {ALLOWED}")
            _check_size(path, size[0] * size[1], most)
            many, stored = size[0] * size[1], os.path.getsize(path)
            # deflate compresses by at most 1032, JPEG hardly more
            require.that(
                not 3 * many > UNCHECKED or not 3 * many > FOLD * stored,
                f"{path} declares {many} pixels in {stored} bytes: it is truncated, or not a picture",
            )
            return _plain(path)
    except UnidentifiedImageError:
        raise ValueError(f"{path} could not be read as a picture; it must be {ALLOWED}") from None
    except Image.DecompressionBombError as error:
        pixels = re.search(r"\((\d+) pixels\)", str(error))
        _check_size(path, int(pixels[1]) if pixels else 10 * most, most)
        raise ValueError(f"{path} could not be read: {error}") from None
    except ValueError as error:
        text = str(error) if str(error).startswith(path) else f"{path} could not be read as a picture: {error}"
        raise ValueError(text) from None
    except (OSError, EOFError, SyntaxError, LookupError, TypeError, ArithmeticError) as error:
        raise ValueError(
            f"{path} could not be read as a picture ({ALLOWED}): {' '.join(str(error).split())[:150]}"
        ) from None
    except Exception as error:  # raised by decoders: zlib.error, struct.error
        raise ValueError(f"{path} is damaged: {type(error).__name__}: {' '.join(str(error).split())[:150]}") from None


def _check_size(path: str, pixels: int, most: int) -> None:
    way_out = (
        "downscale the picture first: a scene is resampled anyway"
        if most == MOST_PIXELS
        else "crop it to the region of interest"
    )
    too_many = beyond(pixels, "pixels", most, way_out)
    require.that(not too_many, f"{path} has {too_many}")


def _check_parts(path: str) -> None:
    """Raise ValueError for a PNG with more than `MOST_PARTS` chunks that are not image data."""
    with open(path, "rb") as file:
        file.seek(8)
        found = 0
        while len(head := file.read(8)) == 8 and head[4:] != b"IEND":
            found += head[4:] != b"IDAT"
            if found > MOST_PARTS:
                raise ValueError(
                    f"{path} has more than {MOST_PARTS} chunks besides its image data; save it again without them"
                )
            file.seek(int.from_bytes(head[:4], "big") + 4, 1)


def check_segments(path: str | Path, page: Any) -> None:
    """Reject a TIFF page in which a strip or tile has far more bytes, as stored or decompressed, than its part of the
    picture needs.

    Raises
    ------
    ValueError
        If the page has such a strip or tile.
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
                f"{path}: a strip of {most // 2} bytes is stored as more than {most} bytes; this is not a valid picture"
            )


def _unfolded(path: str | Path, offset: int, count: int, page: Any, most: int) -> int:
    """Return the size of a decompressed strip, bytes. Counting stops above ``most``; strips that are too small to
    exceed it give 0.
    """
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
    """Read a PNG or JPEG file."""
    from PIL import Image

    with Image.open(path) as picture:
        frames = getattr(picture, "n_frames", 1)
        if frames > 1 and picture.format != "MPO":  # a phone's JPEG may contain a preview
            raise ValueError(f"{path} contains {frames} pictures; save the one to use separately")
        mode, turn = picture.mode, picture.getexif().get(0x0112, 1)
        note = colour_note(picture.info) or exif_note(picture.getexif(), picture.info)
        if picture.format == "PNG":
            points = png_note(path)
            note = note if points is None else points
        table = _steps(getattr(picture, "quantization", None), turn)
        require.that(mode in _MODES, f"{path} is a picture of mode {mode}; convert it to {ALLOWED}")
        deep = False
        if picture.format == "PNG":
            with open(path, "rb") as file:
                depth, colour = file.read(26)[24:]  # from the header: bits per sample, colour type
            deep = depth == 16
            require.that(
                not deep or colour != GREY_ALPHA,
                f"{path} is 16-bit grey with an alpha channel; save it without the alpha channel",
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
    """Return the first quantisation table (8, 8) of a JPEG, transposed if the picture is turned by 90 degrees; None
    without a table.
    """
    if not tables or len(tables.get(0, ())) != 64:
        return None
    table = np.asarray(tables[0], float).reshape(8, 8)
    return table.T if turn >= 5 else table


def _refuse_clear(path: str, clear: int) -> None:
    require.that(not clear, f"{path} has {clear} transparent pixels, whose background is unknown; flatten it first")


def _transparent(picture: Any) -> int:
    """Return the number of pixels that are not opaque."""
    if "A" not in picture.mode and "transparency" not in picture.info:
        return 0
    alpha = np.asarray(picture.convert("RGBA").getchannel("A"))
    return int(np.count_nonzero(alpha < 255))


def _deep_png(path: str, mode: str) -> Array:
    """Return all 16 bits of a colour PNG. Pillow returns only the upper eight bits. If the samples are decoded as
    little-endian, Pillow returns the lower eight.
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
    """Reject a TIFF file with a cycle of directories, in which readers would loop forever.

    Raises
    ------
    ValueError
        If a directory points to itself or to an earlier one, or there are too many.
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
                    f"{path}: its directories form a cycle, or are more than {MOST_DIRECTORIES}; this is not a valid "
                    f"picture"
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
        except (ValueError, ImportError) as error:  # a missing codec
            if page.dtype.itemsize == 1:
                return FilePicture(_by_pillow(path), 255.0, note)
            raise ValueError(
                f"{path} could not be decoded: {error}; save it without compression, or with deflate"
            ) from None
        if page.planarconfig == 2 and values.ndim == 3:
            values = values.transpose(1, 2, 0)
    full = 1.0 if values.dtype.kind == "f" else float(np.iinfo(values.dtype).max)
    values = _opaque(path, values, full)
    if colours == "MINISWHITE":
        values = (values.dtype.type(full) - values).astype(values.dtype)
    return FilePicture(_TURNS.get(turn, _TURNS[1])(values), full, note)


def _only_page(path: str, file: Any) -> Any:
    """Return the picture of a TIFF file, which may contain smaller copies of it but no other picture."""
    pages = [page for page in file.pages if not getattr(page.aspage(), "is_reduced", False)]
    if file.pages[0].aspage().tags.valueof(DNG) is not None:
        raise ValueError(f"{path} is a raw file (DNG); convert it to {ALLOWED}")
    require.that(len(pages) == 1, f"{path} contains {len(pages)} pictures; save the one to use separately")
    return pages[0].aspage()


def _check_kind(path: str, page: Any, colours: str) -> None:
    """Reject sample formats and colour types that are not supported."""
    kind, bits = page.dtype, page.bitspersample
    known = kind is not None and (bits == 1 or (kind.kind in "uf" and bits in (8, 16, 32, 64)))
    require.that(known, f"{path} has {kind or bits} samples; they must be unsigned integers, or floats from 0 to 1")
    require.that(
        colours in ("MINISBLACK", "MINISWHITE", "RGB", "PALETTE", "YCBCR"),
        f"{path} is a picture in {colours}; convert it to {ALLOWED}",
    )


def _opaque(path: str, values: Array, full: float) -> Array:
    """Return (rows, columns, 1 or 3) samples without the alpha channel, which must be opaque."""
    values = values[..., None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] not in (1, 2, 3, 4):
        raise ValueError(f"{path} has {values.shape[2:] or values.shape} samples per pixel; it must be {ALLOWED}")
    if values.shape[2] in (2, 4):
        _refuse_clear(path, int(np.count_nonzero(values[..., -1] < full)))
        values = values[..., :-1]
    if values.dtype.kind == "f":
        _check_floats(path, values)
    return values


def _by_pillow(path: str) -> Array:
    """Return 8-bit values of a TIFF file whose compression only Pillow supports. Pillow also turns it upright."""
    from PIL import Image

    with Image.open(path) as picture:
        require.that(
            not _transparent(picture),
            f"{path} has transparent pixels, whose background is unknown; flatten it first",
        )
        return (
            np.asarray(picture.convert("L"))[..., None]
            if picture.mode in ("1", "L")
            else np.asarray(picture.convert("RGB"))
        )


def _check_floats(path: str, values: Array) -> None:
    """Check floats, which are sRGB-encoded reflectances from 0 to 1."""
    bad = ~((values >= 0) & (values <= 1))
    if bad.any():
        row, column, _ = np.unravel_index(int(np.argmax(bad)), bad.shape)
        raise ValueError(
            f"{path} has {float(values[row, column].flat[int(np.argmax(bad[row, column]))]):g} at row {row}, column "
            f"{column} "
            f"({int(bad.any(axis=2).sum())} such pixels); floats must be from 0 to 1"
        )
