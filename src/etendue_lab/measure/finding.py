"""Automatic search for slanted edges in a photograph.

In:  a photograph.
Out: windows of it in which an edge may be measured, the most promising first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.types.arrays import Array
from etendue_camera.resolution.edges.edge_region import FoundEdge, find_edges
from etendue_lab.measure.photograph import PhotographFile
from etendue_lab.measure.regions import PixelWindow

SEARCHED = 2_000_000  # pixels of the picture that is searched
AROUND, WIDEST = 24, 800  # margin around a found edge, and maximum side of its window, pixels
PARTS = 3  # number of parts along y and x, plus overlapping parts: for pictures dominated by something else
MOST, TRIES = 12, 12  # maximum number of edges measured, and of places examined in a part
SPANNED = 0.95  # share of a region's width and height that a strip must span
SHORTEST = 12.0  # half of an edge's length, pixels: a strip of 24 and its ends


@dataclass(frozen=True)
class EdgePlace:
    """A window of a photograph, and its pixels around one edge."""

    window: PixelWindow
    strip: Any  # (y, x) of bool


def slanted(photograph: PhotographFile, channel: str) -> tuple[list[EdgePlace], list[str]]:
    """Return places of edges, and the reasons why other places were rejected. A large picture is first searched on
    block means of the numbers in the file.
    """
    factor = math.ceil(math.sqrt(photograph.rows * photograph.columns / SEARCHED))
    sites = photograph.sites(channel)
    if factor > 1:
        # in any mosaic, three by three pixels contain every colour used for edges
        factor = factor if sites is None else max(factor, 3)
        small, _ = _in_parts(_smaller(photograph, sites, factor), None)
        parts = [_span(*one.window, factor, photograph) for one in small[:MOST]]
        wide = [_in(photograph, channel, part) for part in dict.fromkeys(parts)]
        found = [one for places, _ in wide for one in places]
        why = [word for _, words in wide for word in words]
    else:
        found, why = _in_parts(photograph.linear(channel)[0], sites)
    return _apart([_place(one) for one in sorted(found, key=lambda one: -one.promise)])[:MOST], why


def strips_of(photograph: PhotographFile, channel: str, region: PixelWindow) -> list[EdgePlace]:
    """Return strips along edges that extend over nearly the whole region; the corners of the region may contain
    something else.
    """
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


def _cut_to(region: PixelWindow, place: EdgePlace) -> EdgePlace | None:
    """Return the part of a strip that lies inside a region; None if no part does."""
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
    window = PixelWindow(
        region.x + columns.start, region.y + rows.start, columns.stop - columns.start, rows.stop - rows.start
    )
    return EdgePlace(window, held[rows, columns])


def _place(found: FoundEdge) -> EdgePlace:
    top, bottom, left, right = found.window
    return EdgePlace(PixelWindow(left, top, right - left, bottom - top), found.strip)


def _in_parts(image: Array, sites: Any) -> tuple[list[FoundEdge], list[str]]:
    """Return the edges found in the whole picture and in its parts, in which other edges may be the strongest."""
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
    photograph: PhotographFile, channel: str, part: tuple[int, int, int, int], most: int = 2, tries: int = 4
) -> tuple[list[FoundEdge], list[str]]:
    top, bottom, left, right = part
    image, sites = photograph.linear(channel, np.s_[top:bottom, left:right])
    edges, why = find_edges(image, sites, most=most, tries=tries, shortest=SHORTEST)
    return [_moved(one, top, left) for one in edges], why


def _moved(one: FoundEdge, down: int, right: int) -> FoundEdge:
    top, bottom, first, last = one.window
    return replace(one, window=(top + down, bottom + down, first + right, last + right))


def _apart(places: list[EdgePlace]) -> list[EdgePlace]:
    """Return the places whose centre is not inside the strip of an earlier, better place."""
    kept: list[EdgePlace] = []
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
    """Return the reason why no edge can be measured, without the list of requirements after it."""
    return str(error).removeprefix("picture shows no edge that can be measured: ").partition("; one edge between")[0]


def _parts(rows: int, columns: int) -> list[tuple[int, int, int, int]]:
    """Return the whole picture, then parts: top, bottom, left, right."""
    found = [(0, rows, 0, columns)]
    high, wide = rows // PARTS, columns // PARTS
    if min(high, wide) >= 2 * AROUND:
        starts = [(k * high // 2, j * wide // 2) for k in range(2 * PARTS - 1) for j in range(2 * PARTS - 1)]
        found += [(top, top + high, left, left + wide) for top, left in starts]
    return found


def _span(
    top: int, bottom: int, left: int, right: int, factor: int, photograph: PhotographFile
) -> tuple[int, int, int, int]:
    """Return top, bottom, left and right (pixels) of an edge that was found on block means. A margin is added, and the
    size is limited to what the measurement of an edge needs.
    """
    ends = []
    for first, last, size in ((top, bottom, photograph.rows), (left, right, photograph.columns)):
        middle, half = factor * (first + last) // 2, min(factor * (last - first) // 2 + AROUND, WIDEST // 2)
        ends += [max(middle - half, 0), min(middle + half, size)]
    return ends[0], ends[1], ends[2], ends[3]


def _smaller(photograph: PhotographFile, sites: Any, factor: int) -> Any:
    """Return block values for the search: sums over all channels or, for a mosaic, means of one colour."""
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
