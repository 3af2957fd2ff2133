"""Pictures in a report: every stage of one cell, and the display pictures of a few chosen cells.

In:  an archive opened for display; the maximum number of bytes of the pictures.
Out: pictures as ``data:`` texts, with their number and size. Metrics cover all cells; pictures do not.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from itertools import product

import numpy as np

from etendue.errors import ArchiveError
from etendue.present.page.looks import Picture, drawn_of, picture, pictured
from etendue.present.page.opened import Opened
from etendue.types.arrays import Array
from etendue.types.documents import Document

MOST_CELLS = 64
BUDGET = 3_300_000  # bytes of all pictures: 4.4 MB as text
QUALITY = 90  # of WebP, if a lossless picture is too large
LOSSLESS_SHARE = 0.45  # share of the budget that lossless pictures of the display may take
STRIP_SHARE = 0.5  # 24 noisy pictures of 256 x 192 take two thirds of it


def chosen(sizes: Sequence[int], start: Sequence[int], most: int = MOST_CELLS) -> list[tuple[int, ...]]:
    """Choose at most ``most`` cells of a sweep whose axes have these sizes: all cells if they fit, else corners,
    ``start`` and evenly spaced cells.
    """
    counts = [min(size, 2) for size in sizes]
    if np.prod(counts, dtype=float) >= most and np.prod(sizes, dtype=float) > most:  # more axes than corners fit
        corners = product(*([0, size - 1] if size > 1 else [0] for size in sizes))
        return list(
            dict.fromkeys([tuple(start), *(corner for corner, _ in zip(corners, range(most - 1), strict=False))])
        )
    grown = True
    while grown:  # the axis with the fewest positions first; by two, so that there is a middle
        grown = False
        for number in sorted(range(len(sizes)), key=lambda n: counts[n]):
            more = min(counts[number] + 2 - (counts[number] % 2 == 0), sizes[number])
            tried = [*counts[:number], more, *counts[number + 1 :]]
            if more > counts[number] and np.prod(tried, dtype=float) < most + (tried == list(sizes)):
                counts, grown = tried, True
                break
    own = [_along(size, count, middle) for size, count, middle in zip(sizes, counts, start, strict=True)]
    found = list(product(*own))
    return found if tuple(start) in found else [*found, tuple(start)]


def _along(size: int, count: int, middle: int) -> list[int]:
    """Return ``count`` positions on an axis: both ends, ``middle``, and evenly spaced positions between them."""
    places = [round(i * (size - 1) / max(1, count - 1)) for i in range(count)]
    if middle not in places and count > 2:
        places[min(range(1, count - 1), key=lambda i: abs(places[i] - middle))] = middle
    return sorted(set(places))


def shots(opened: Opened, start: dict[str, int], budget: int = BUDGET) -> Document:
    """Return two groups of pictures: ``strip``, one of every stage of the cell at ``start``; and ``cells``, pictures of
    chosen cells, those of the last stages first.
    """
    first, spent = strip(opened, start, int(STRIP_SHARE * budget))
    dims = [axis.dim for axis in opened.axes]
    places = [
        dict(zip(dims, place, strict=True))
        for place in chosen([len(axis.values) for axis in opened.axes], list(start.values()))
    ]
    shown: list[Document] = []
    left_out: list[str] = []
    for stage, variable in _wanted(opened):
        made = _series(opened, stage, variable, places, budget - spent, lossless=not shown)
        if made is None:
            left_out.append(f"{stage}.{variable}")
        elif made["pictures"]:
            spent += made.pop("bytes")
            shown.append(made)
    return {
        "strip": first,
        "places": [list(place.values()) for place in places],
        "series": shown,
        "left_out": left_out,
        "bytes": spent,
    }


def _wanted(opened: Opened) -> list[tuple[str, str]]:
    """Return the last encoded picture; then the pictures before it, nearest first."""
    everything = _shown(opened)
    encoded = [one for one in everything if drawn_of(opened, *one).shown == "encoded"]
    first = encoded[-1:] or everything[-1:]
    seen = {variable for _, variable in first}
    rest = []
    for stage, variable in reversed(everything):
        if (
            variable not in seen
            and drawn_of(opened, stage, variable).shown != "map"
            and (opened.reaching(stage) or not opened.axes)
        ):
            seen.add(variable)
            rest.append((stage, variable))
    return first + rest


def _shown(opened: Opened) -> list[tuple[str, str]]:
    return [one for one in pictured(opened) if drawn_of(opened, *one).shown]


def strip(opened: Opened, start: dict[str, int], budget: int = int(STRIP_SHARE * BUDGET)) -> tuple[list[Document], int]:
    """Return the picture of every stage in one cell, and their total size in bytes. The pictures are lossless if they
    fit into ``budget``; otherwise the largest are compressed first.
    """
    found: list[Document] = []
    exact: list[tuple[Array, bytes]] = []
    for stage, variable in _shown(opened):
        one = _picture(opened, stage, variable, start)
        if one is None:
            continue
        small = one.small()
        exact.append((small, _webp(small, None)))
        found.append(
            {
                "stage": stage,
                "variable": variable,
                "size": [one.size[1], one.size[0]],
                "shown": [small.shape[1], small.shape[0]],
                "scaled": one.scaled,
                "unencoded": one.drawn.shown == "unencoded",
                "units": one.units,
                "bright": one.bright,
                "how": "lossless",
            }
        )
    data = [whole for _, whole in exact]
    for number in sorted(range(len(data)), key=lambda n: -len(data[n])):
        if sum(map(len, data)) > budget:
            data[number], found[number]["how"] = _webp(exact[number][0], QUALITY), f"WebP, quality {QUALITY}"
    return [{**one, "data": _text(own)} for one, own in zip(found, data, strict=True)], sum(map(len, data))


def _series(
    opened: Opened, stage: str, variable: str, places: list[dict[str, int]], budget: float, lossless: bool
) -> Document | None:
    """Return the pictures of one variable in all chosen cells, without repeating a picture along an axis that does not
    affect it; None if they do not fit into ``budget``.
    """
    axes = opened.reaching(stage)
    pictures: dict[str, str] = {}
    sizes: dict[str, list[int]] = {}
    raw: Document = {}
    for place in places:
        key = ",".join(str(place[dim]) for dim in axes)
        if key in raw:
            continue
        one = _picture(opened, stage, variable, place)
        raw[key] = None if one is None else one.small()
        if one is not None:
            sizes[key] = [one.size[1], one.size[0]]
    there = {key: small for key, small in raw.items() if small is not None}
    size = 0
    how = f"WebP, quality {QUALITY}"
    if lossless and there:
        probe = [_webp(small, None) for small in list(there.values())[:: max(1, len(there) // 4)]]
        if len(there) * sum(map(len, probe)) / len(probe) <= LOSSLESS_SHARE * BUDGET:
            how = "lossless"
    for key, small in there.items():
        data = _webp(small, None if how == "lossless" else QUALITY)
        size += len(data)
        if size > budget:
            return None
        pictures[key] = _text(data)
    return {
        "stage": stage,
        "variable": variable,
        "axes": list(axes),
        "pictures": pictures,
        "sizes": sizes,
        "how": how,
        "bytes": size,
        "scaled": drawn_of(opened, stage, variable).scaled,
    }


def _picture(opened: Opened, stage: str, variable: str, place: dict[str, int]) -> Picture | None:
    try:
        return picture(opened, stage, variable, place)
    except (ArchiveError, ValueError, KeyError):  # damaged, or not a picture
        return None


def _webp(pixels: Array, quality: int | None) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(pixels).save(
        file, "WEBP", lossless=quality is None, quality=40 if quality is None else quality, method=2
    )
    return file.getvalue()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()
