"""Where in a photograph slanted edges are, when nobody has said it.

In:  a photograph.
Out: windows of it in which an edge may be measured, the most promising first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.types.arrays import Array
from etendue_camera.resolution.edge_region import FoundEdge, find_edges
from etendue_lab.measure.photograph import Photograph
from etendue_lab.measure.regions import Window

SEARCHED = 2_000_000  # pixels of the picture in which edges are looked for
AROUND, WIDEST = 24, 800  # pixels about what was found there, and at most along a side
PARTS = 3  # along y and along x, with those half way between: where the whole picture is ruled by something else
MOST, TRIES = 12, 12  # edges that are measured at most, and places that are looked at in a part
SPANNED = 0.95  # of a region's width and height that a strip has whose box it is
SHORTEST = 12.0  # half of an edge's length, pixels: a strip of 24 and its ends


@dataclass(frozen=True)
class Place:
    """A window of a photograph, and which of its pixels lie about one edge."""

    window: Window
    strip: Any  # (y, x) of bool


def slanted(photograph: Photograph, channel: str) -> tuple[list[Place], list[str]]:
    """Places of edges, and why others are none; in a large picture first looked for by means over squares of the
    file's own numbers.
    """
    factor = math.ceil(math.sqrt(photograph.rows * photograph.columns / SEARCHED))
    sites = photograph.sites(channel)
    if factor > 1:
        factor = (
            factor if sites is None else max(factor, 3)
        )  # in any mosaic three by three pixels hold every colour that edges have
        small, _ = _in_parts(_smaller(photograph, sites, factor), None)
        parts = [_span(*one.window, factor, photograph) for one in small[:MOST]]
        wide = [_in(photograph, channel, part) for part in dict.fromkeys(parts)]
        found = [one for places, _ in wide for one in places]
        why = [word for _, words in wide for word in words]
    else:
        found, why = _in_parts(photograph.linear(channel)[0], sites)
    return _apart([_place(one) for one in sorted(found, key=lambda one: -one.promise)])[:MOST], why


def strips_of(photograph: Photograph, channel: str, region: Window) -> list[Place]:
    """Strips whose box a region is: of a turned strip it holds corners, too, in which something else may stand."""
    top, left = max(region.y - AROUND, 0), max(region.x - AROUND, 0)
    part = (
        top,
        min(region.y + region.height + AROUND, photograph.rows),
        left,
        min(region.x + region.width + AROUND, photograph.columns),
    )
    places = [_cut_to(region, _place(one)) for one in _in(photograph, channel, part, MOST, TRIES)[0]]
    return [
        one
        for one in places
        if one is not None
        and one.window.width >= SPANNED * region.width
        and one.window.height >= SPANNED * region.height
    ]


def _cut_to(region: Window, place: Place) -> Place | None:
    """What of a strip lies in a region."""
    held, own = np.zeros((region.height, region.width), bool), place.window
    y, x = own.y - region.y, own.x - region.x
    rows, columns = slice(max(y, 0), max(y + own.height, 0)), slice(max(x, 0), max(x + own.width, 0))
    part = held[rows, columns]
    part[:] = place.strip[max(-y, 0) :, max(-x, 0) :][: part.shape[0], : part.shape[1]] if part.size else False
    if not held.any():
        return None
    rows, columns = (
        slice(int(seen[0]), int(seen[-1]) + 1) for seen in (np.flatnonzero(held.any(axis)) for axis in (1, 0))
    )
    window = Window(
        region.x + columns.start, region.y + rows.start, columns.stop - columns.start, rows.stop - rows.start
    )
    return Place(window, held[rows, columns])


def _place(found: FoundEdge) -> Place:
    top, bottom, left, right = found.window
    return Place(Window(left, top, right - left, bottom - top), found.strip)


def _in_parts(image: Array, sites: Any) -> tuple[list[FoundEdge], list[str]]:
    """Edges of the whole picture and of its parts, whose strongest things are others."""
    found, why = [], []
    for top, bottom, left, right in _parts(*image.shape):
        cut = np.s_[top:bottom, left:right]
        edges, words = find_edges(
            image[cut], None if sites is None else sites[cut], most=MOST, tries=TRIES, shortest=SHORTEST
        )
        found += [_moved(one, top, left) for one in edges]
        why += words
    return sorted(found, key=lambda one: -one.promise), why


def _in(
    photograph: Photograph, channel: str, part: tuple[int, int, int, int], most: int = 2, tries: int = 4
) -> tuple[list[FoundEdge], list[str]]:
    top, bottom, left, right = part
    image, sites = photograph.linear(channel, np.s_[top:bottom, left:right])
    edges, why = find_edges(image, sites, most=most, tries=tries, shortest=SHORTEST)
    return [_moved(one, top, left) for one in edges], why


def _moved(one: FoundEdge, down: int, right: int) -> FoundEdge:
    top, bottom, first, last = one.window
    return replace(one, window=(top + down, bottom + down, first + right, last + right))


def _apart(places: list[Place]) -> list[Place]:
    """Those whose middle no better one holds."""
    kept: list[Place] = []
    for place in places:
        y, x = (float(part.mean()) for part in np.nonzero(place.strip))
        y, x = round(y) + place.window.y, round(x) + place.window.x
        if not any(
            0 <= y - one.window.y < one.window.height
            and 0 <= x - one.window.x < one.window.width
            and one.strip[y - one.window.y, x - one.window.x]
            for one in kept
        ):
            kept.append(place)
    return kept


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


def _span(
    top: int, bottom: int, left: int, right: int, factor: int, photograph: Photograph
) -> tuple[int, int, int, int]:
    """Pixels of what was found on means, with room, and no more than an edge needs: top, bottom, left, right."""
    ends = []
    for first, last, size in ((top, bottom, photograph.rows), (left, right, photograph.columns)):
        middle, half = factor * (first + last) // 2, min(factor * (last - first) // 2 + AROUND, WIDEST // 2)
        ends += [max(middle - half, 0), min(middle + half, size)]
    return ends[0], ends[1], ends[2], ends[3]


def _smaller(photograph: Photograph, sites: Any, factor: int) -> Any:
    """Means of all channels over squares of so many pixels; of one colour where there are sites."""
    rows, columns = photograph.rows // factor, photograph.columns // factor

    def total(plane: Array) -> Any:
        return (
            plane[: rows * factor, : columns * factor]
            .reshape(rows, factor, columns, factor)
            .sum((1, 3), dtype=np.float64)
        )

    if sites is not None:
        return total(photograph.values[..., 0] * sites) / np.maximum(total(sites), 1)
    return sum(total(photograph.values[..., i]) for i in range(photograph.values.shape[2]))
