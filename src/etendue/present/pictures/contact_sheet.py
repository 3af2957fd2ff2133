"""The contact sheet: every stage of one cell in order, each with an enlarged detail, and maps of metrics over the
sweep, in one PNG.

In:  the table of frames of an archive; maps drawn by ``present.pictures.small_maps``.
Out: a PNG.
"""

from __future__ import annotations

import importlib.util
import os
import struct
import textwrap
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.arrays.variables import variable as known
from etendue.present.pictures.details import SIDE
from etendue.types.arrays import Array
from etendue.types.documents import DocumentView

# dots: a picture, the two lines above it, gap between pictures, a line of the title
BOX, LABEL, GAP, HEAD = (256, 34, 12, 34)
MOST = 360  # dots of a picture whose samples are enlarged by a whole factor
COLUMNS = 4
TITLE, TEXT = 18, 11  # dots: heights of letters
LINE = 14  # dots between lines of a label
MARK = (255, 40, 40)  # outline of the detail
RIM = 200  # grey rim of a picture
MAPS_FROM = "maps from row"  # PNG text entry: row where the maps start, so that later runs can redraw them


@dataclass(frozen=True)
class _Tile:
    text: tuple[str, str]
    picture: Any
    part: Any
    place: tuple[float, ...]


def contact_sheet(table: DocumentView, path: Path, title: str, maps: Sequence[Array] = ()) -> None:
    """Write all frames in order, each with its stage, variable and true size, as one PNG, completely or not at all.

    Enlarged frames, and all frames with a pattern, use a whole number of dots per sample: any other resampling shows a
    false moire. Pictures on a finer grid are drawn as large as the pictures of the pixels. ``maps``: (y, x, 3) bytes
    each.
    """
    tiles = _tiles(table)
    wide, high = max(t.picture.shape[1] for t in tiles), max(t.picture.shape[0] for t in tiles)
    inset = SIDE + 4 if any(t.part is not None for t in tiles) else 0
    high = max(high, SIDE if inset else 0)
    across = min(COLUMNS if inset else COLUMNS + 1, len(tiles))
    down = -(-len(tiles) // across)
    width = max(across * (wide + inset + GAP) + GAP, *(one.shape[1] + 2 * GAP for one in maps), 420)
    lines = textwrap.wrap(title, max(20, int(width / (0.58 * TITLE))))
    head = HEAD + (len(lines) - 1) * (TITLE + 6)
    pixels = np.full((head + down * (LABEL + high + GAP), width, 3), 255, np.uint8)
    titles = [(width / 2, 0.55 * HEAD + n * (TITLE + 6), line, TITLE, "mm") for n, line in enumerate(lines)]
    pixels[:head] = _written((head, width), tuple(titles))
    for row in range(down):
        top, labels = head + row * (high + LABEL + GAP) + LABEL, []
        for column, tile in enumerate(tiles[row * across : (row + 1) * across]):
            left = GAP + column * (wide + inset + GAP)
            y, x = tile.picture.shape[:2]
            pixels[top - 1 : top + y + 1, left - 1 : left + x + 1] = (
                RIM  # a rim, so that a white picture stands out from the white sheet
            )
            pixels[top : top + y, left : left + x] = tile.picture
            if tile.part is not None:
                _frame(pixels, top, left, tile.place, (y, x))
                beside = left + x + 4
                height, breadth = tile.part.shape[:2]
                pixels[top : top + height, beside : beside + breadth] = tile.part
                _edge(pixels, top, beside, height, breadth)
            for line, words in enumerate(reversed(tile.text)):
                labels.append((left, LABEL - 6 - line * LINE, words, TEXT, "ls"))
        pixels[top - LABEL : top - 1] = _written((LABEL - 1, width), tuple(labels))
    _save(pixels, maps, path)


@lru_cache(maxsize=32)
def _written(size: tuple[int, int], texts: tuple[tuple[float, float, str, int, str], ...]) -> Array:
    """Return a white band of the sheet with black texts, each given by position, text, letter height and anchor. The
    result is cached, because runs of one process often have the same texts.
    """
    from PIL import Image, ImageDraw

    whole = Image.new("L", size[::-1], 255)
    drawn = ImageDraw.Draw(whole)
    for x, y, words, height, anchor in texts:
        drawn.text((x, y), words, fill=0, font=font(height), anchor=anchor)
    return np.asarray(whole)[..., None]


def with_maps(path: Path, sheet: Path, maps: Sequence[Array]) -> None:
    """Write the sheet of an earlier run with the maps of this run below its pictures."""
    from PIL import Image

    with Image.open(sheet) as whole:
        rows = int(whole.text.get(MAPS_FROM, whole.height)) if hasattr(whole, "text") else whole.height
        pictures = np.asarray(whole.convert("RGB").crop((0, 0, whole.width, rows)))
    _save(pictures, maps, path)


def _save(pictures: Array, maps: Sequence[Array], path: Path) -> None:
    top, width = pictures.shape[:2]
    below = _flowed(maps, width)
    whole = np.concatenate([pictures, np.full((sum(high for high, _ in below), width, 3), 255, np.uint8)])
    for high, row in below:
        for left, one in row:
            y, x = one.shape[:2]
            whole[top : top + y, left : left + x] = one
        top += high
    temporary = path.with_name(path.name + ".partial")
    temporary.write_bytes(_png(whole, f"{MAPS_FROM}\0{len(pictures)}".encode()))
    os.replace(temporary, path)


def _png(pixels: Array, text: bytes) -> bytes:
    """Return (y, x, 3) bytes as a PNG with a text entry. Each row is stored as its difference from the row above
    (filter 2), which is mostly 0 in enlarged pictures; Pillow tries five filters on every row and takes twice as long
    for a file of the same size.
    """
    high, wide, _ = pixels.shape
    rows = np.empty((high, 3 * wide + 1), np.uint8)
    rows[:, 0] = 2
    flat = pixels.reshape(high, 3 * wide)
    rows[0, 1:] = flat[0]
    np.subtract(flat[1:], flat[:-1], out=rows[1:, 1:])
    head = struct.pack(">IIBBBBB", wide, high, 8, 2, 0, 0, 0)  # 8 bits, RGB
    parts = {b"IHDR": head, b"tEXt": text, b"IDAT": zlib.compress(rows.data, 1), b"IEND": b""}
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts.items()
    )


def _flowed(maps: Sequence[Array], width: int) -> list[tuple[int, list[tuple[int, Array]]]]:
    """Arrange maps side by side in as many rows as needed; return the height of each row, and the left edge of each map
    in it.
    """
    rows: list[tuple[int, list[tuple[int, Array]]]] = []
    left = width
    for one in maps:
        y, x = one.shape[:2]
        if not rows or left + x + GAP > width:
            rows.append((0, []))
            left = GAP
        high, row = rows[-1]
        rows[-1] = (max(high, y + GAP), [*row, (left, one)])
        left += x + 2 * GAP
    return rows


def _tiles(table: DocumentView) -> list[_Tile]:
    """Return the pictures as they are drawn."""
    columns = {name: values for name, (_, values, _) in table["arrays"].items()}
    sizes = [(int(columns["height"][n]), int(columns["width"][n])) for n in range(len(columns["preview"]))]
    sides = [max(size) for size, seen in zip(sizes, columns["detail_height"], strict=True) if seen]
    coarsest = min(sides or map(max, sizes))
    times = -(-BOX // coarsest)  # dots per sample of the coarsest picture; sets the longer side of all pictures
    target = coarsest * (times if coarsest * times <= MOST else max(1, BOX // coarsest))
    tiles = []
    for number, preview in enumerate(columns["preview"]):
        y, x = sizes[number]
        picture = np.moveaxis(preview[:, :y, :x], 0, -1)
        stage, variable = str(columns["stage"][number]), str(columns["variable"][number])
        text = f"{number + 1}. {stage.removesuffix(f'.{variable}')}"
        size = f"{columns['true_width'][number]} x {columns['true_height'][number]}"
        size += ", without gamma" if known(variable).shown == "unencoded" else ""
        size += next((f", all {name}" for name, end in (("white", 255), ("black", 0)) if (picture == end).all()), "")
        part = None
        if columns["detail_height"][number]:
            own = columns["detail"][number][:, : columns["detail_height"][number], : columns["detail_width"][number]]
            part = _enlarged(np.moveaxis(own, 0, -1), SIDE)
        tiles.append(
            _Tile(
                (text, f"{variable}  {size}"), _enlarged(picture, target), part, tuple(columns["detail_place"][number])
            )
        )
    return tiles


def _enlarged(picture: Array, target: int) -> Array:
    """Return the picture scaled to a longer side of ``target`` dots: samples are repeated if the factor is whole, else
    the picture is resampled.
    """
    y, x = picture.shape[:2]
    times, left = divmod(target, max(y, x))
    if times and not left:
        return picture.repeat(times, axis=1).repeat(times, axis=0)
    from PIL import Image

    size = (max(1, round(x * target / max(y, x))), max(1, round(y * target / max(y, x))))
    how = Image.Resampling.BOX if target < max(y, x) else Image.Resampling.NEAREST
    return np.asarray(Image.fromarray(np.ascontiguousarray(picture)).resize(size, how))


def _frame(pixels: Array, top: int, left: int, place: Sequence[float], size: tuple[int, int]) -> None:
    """Outline the detail in its picture."""
    y, x = round(place[0] * size[0]), round(place[1] * size[1])
    high, wide = max(3, round(place[2] * size[0])), max(3, round(place[3] * size[1]))
    high, wide = min(high, size[0]), min(wide, size[1])
    _edge(pixels, top + min(y, size[0] - high), left + min(x, size[1] - wide), high, wide)


def _edge(pixels: Array, top: int, left: int, high: int, wide: int) -> None:
    """Draw a line one dot wide along the inside of a rectangle."""
    own = pixels[top : top + high, left : left + wide]
    own[[0, -1]] = MARK
    own[:, [0, -1]] = MARK


@lru_cache(maxsize=8)
def font(height: int) -> Any:
    """Return DejaVu Sans, which comes with matplotlib and covers most scripts; else the font of Pillow."""
    from PIL import ImageFont

    found = importlib.util.find_spec("matplotlib")  # located without importing it
    for folder in (found.submodule_search_locations or ()) if found else ():
        try:
            return ImageFont.truetype(os.path.join(folder, "mpl-data", "fonts", "ttf", "DejaVuSans.ttf"), height)
        except OSError:
            continue
    return ImageFont.load_default(height)
