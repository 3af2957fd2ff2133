"""Where in a photograph slanted edges are, when nobody has said it.

In:  a photograph.
Out: windows of it in which an edge may be measured, the most promising first.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from etendue.physics.resolution.edge_region import find_edge
from etendue.studies.measuring_pictures.photograph import Photograph
from etendue.studies.measuring_pictures.regions import Window

SEARCHED = 2_000_000  # pixels of the picture in which edges are looked for
AROUND, WIDEST = 24, 800  # pixels about what was found there, and at most along a side
PARTS = 3  # along y and along x, with those half way between: where the whole picture is ruled by something else
MOST = 4  # windows


def slanted(photograph: Photograph, channel: str) -> tuple[list[Window], str]:
    """Windows, and why there are none: looked for in the file's own numbers, by means over squares of a large picture."""
    factor = math.ceil(math.sqrt(photograph.rows * photograph.columns / SEARCHED))
    sites = photograph.sites(channel)
    if factor > 1:
        factor = factor if sites is None else max(factor, 3)  # in any mosaic three by three pixels hold every colour that edges have
        image, sites = _smaller(photograph, sites, factor), None
    else:
        image = photograph.values.astype(np.float64).mean(2)
    found, why = [], ""
    for top, bottom, left, right in _parts(*image.shape):
        try:
            cut = np.s_[top:bottom, left:right]
            (up, down, near, far), strip = find_edge(image[cut], None if sites is None else sites[cut])
        except ValueError as error:
            why = why or reason(error)
            continue
        first, last = _span(top + up, top + down, factor, photograph.rows)
        begin, end = _span(left + near, left + far, factor, photograph.columns)
        found.append((int(strip.sum()), Window(begin, first, end - begin, last - first)))
        if (bottom - top, right - left) == image.shape:
            break
    return [place for _, place in sorted(found, key=lambda one: -one[0])[:MOST]], why


def reason(error: ValueError) -> str:
    """Why no edge can be measured, without what is allowed."""
    return str(error).removeprefix("picture shows no edge that can be measured: ").partition("; allowed is")[0]


def _parts(rows: int, columns: int) -> list[tuple[int, int, int, int]]:
    """All of it, then parts: top, bottom, left, right."""
    found = [(0, rows, 0, columns)]
    high, wide = rows // PARTS, columns // PARTS
    if min(high, wide) >= 2 * AROUND:
        starts = [(k * high // 2, j * wide // 2) for k in range(2 * PARTS - 1) for j in range(2 * PARTS - 1)]
        found += [(top, top + high, left, left + wide) for top, left in starts]
    return found


def _span(first: int, last: int, factor: int, size: int) -> tuple[int, int]:
    """Pixels of what was found on means, with room, and no more than an edge needs."""
    middle, half = factor * (first + last) // 2, min(factor * (last - first) // 2 + AROUND, WIDEST // 2)
    return max(middle - half, 0), min(middle + half, size)


def _smaller(photograph: Photograph, sites: Any, factor: int) -> Any:
    """Means of all channels over squares of so many pixels; of one colour where there are sites."""
    rows, columns = photograph.rows // factor, photograph.columns // factor

    def total(plane: Any) -> Any:
        return plane[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor).sum((1, 3), dtype=np.float64)

    if sites is not None:
        return total(photograph.values[..., 0] * sites) / np.maximum(total(sites), 1)
    return sum(total(photograph.values[..., i]) for i in range(photograph.values.shape[2]))
