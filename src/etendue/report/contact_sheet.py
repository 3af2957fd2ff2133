"""The contact sheet: every stage of one cell in order, in one PNG.

In:  the table of frames of an archive.
Out: a PNG.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

BOX, LABEL, GAP, HEAD = 256, 34, 10, 34  # pixels: a picture, the two lines above it, between pictures, the title
COLUMNS = 5
TITLE, TEXT = 18, 11  # pixels: heights of letters
LINE = 14  # pixels from line to line of a label
COMPRESSION = 3  # of 9: a third of the time of the usual 6, for 8 % more bytes


def contact_sheet(table: Mapping[str, Any], path: Path, title: str) -> None:
    """All frames in order, each with its stage, variable and true size, as one PNG. Written whole or not at all.

    Frames stand at a whole number of screen pixels per sample: a mosaic resampled by anything else shows a moire that
    is not in it.
    """
    from PIL import Image, ImageDraw

    columns = {name: values for name, (_, values, _) in table["arrays"].items()}
    previews = columns["preview"]
    across = min(COLUMNS, len(previews))
    down = -(-len(previews) // across)
    pixels = np.full((HEAD + down * (BOX + LABEL + GAP) + GAP, across * (BOX + GAP) + GAP, 3), 255, np.uint8)
    labels = []
    for number, preview in enumerate(previews):
        picture = np.moveaxis(preview[:, : columns["height"][number], : columns["width"][number]], 0, -1)
        scale = max(1, BOX // max(picture.shape[:2]))
        picture = picture.repeat(scale, axis=0).repeat(scale, axis=1)
        row, column = divmod(number, across)
        left, top = GAP + column * (BOX + GAP), HEAD + row * (BOX + LABEL + GAP)
        indent = left + (BOX - picture.shape[1]) // 2
        pixels[top + LABEL : top + LABEL + picture.shape[0], indent : indent + picture.shape[1]] = picture
        stage, variable = str(columns["stage"][number]), str(columns["variable"][number])
        stage = stage.removesuffix(f".{variable}")
        size = f"{columns['true_width'][number]} x {columns['true_height'][number]}"
        labels.append((left + BOX / 2, top + LABEL - 6, f"{number + 1}. {stage}", f"{variable}  {size}"))
    whole = Image.fromarray(pixels)
    drawn = ImageDraw.Draw(whole)
    drawn.text((pixels.shape[1] / 2, 0.55 * HEAD), title, fill="black", font=_font(TITLE), anchor="mm")
    for middle, bottom, *lines in labels:
        for line, text in enumerate(reversed(lines)):
            drawn.text((middle, bottom - line * LINE), text, fill="black", font=_font(TEXT), anchor="ms")
    temporary = path.with_name(path.name + ".partial")
    whole.save(temporary, format="png", compress_level=COMPRESSION)
    os.replace(temporary, path)


def _font(height: int) -> Any:
    """DejaVu Sans, which comes with matplotlib and has the letters of most scripts; else the one of Pillow."""
    from PIL import ImageFont

    found = importlib.util.find_spec("matplotlib")  # where it is, without importing it
    for folder in (found.submodule_search_locations or ()) if found else ():
        try:
            return ImageFont.truetype(os.path.join(folder, "mpl-data", "fonts", "ttf", "DejaVuSans.ttf"), height)
        except OSError:
            continue
    return ImageFont.load_default(height)
