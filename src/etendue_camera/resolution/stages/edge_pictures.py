"""One edge of one picture, searched, measured and cached: the work of `edge_resolution` at every stage.

In:  a linear plane (y, x), with or without noise; a window (pixels) or none.
Out: an ``Edge``, or None if no edge can be measured.
"""

from __future__ import annotations

import hashlib
import math
import threading
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from etendue_camera.arrays import Array, FloatArray
from etendue_camera.resolution.edges.edge_interval import EdgeResolution, edge_resolution
from etendue_camera.resolution.edges.edge_region import find_edge
from etendue_camera.resolution.edges.slanted_edge import EdgeResponse, slanted_edge

Window = tuple[int, int, int, int]  # top, bottom, left, right, as slice limits
LONGEST = 400  # pixels along the edge: more is slower and hardly better
SMALL = 96  # pixels; a smaller picture without an isolated edge is taken as a whole
CERTAIN = 1e4  # ratio of step to fit residual above which there is no noise
FAINTEST = 0.02  # smallest contrast of an edge; below it is stray light
INNER = 0.4  # of a frame of light, within which its border has little influence
REMEMBERED = 512


@dataclass(frozen=True)
class Edge:
    """Metrics of one edge: frequencies in cycles per picture sample, along the normal; interval NaN without noise."""

    mtf50: float
    mtf50_low: float
    mtf50_high: float
    mtf10: float
    angle: float
    vertical: bool
    not_reached: bool
    clipped: bool
    noisy: bool
    frequency: FloatArray = field(repr=False, compare=False)
    sfr: FloatArray = field(repr=False, compare=False)


class KnownPicture:
    """A picture identified by its content: an edge that many cells of a sweep share is measured once."""

    def __init__(self, plane: FloatArray, sites: Array | None = None) -> None:
        self.plane, self.sites = plane, sites
        found = hashlib.blake2b(plane.tobytes(), digest_size=16)
        found.update(b"" if sites is None else np.packbits(sites).tobytes())
        self.digest = (plane.shape, found.digest())


_known: dict[Any, Edge | None] = {}
_seen: dict[tuple[int, Any], tuple[weakref.ref[Any], Edge | None]] = {}
_lock = threading.Lock()


def once_for(array: FloatArray, asked: Any, make: Callable[[], Edge | None]) -> Edge | None:
    """Return the result of ``make``, computed once per array: cells of a sweep with the same array share it."""
    key = (id(array), asked)
    with _lock:
        known = _seen.get(key)
        if known is not None and known[0]() is array:
            return known[1]
    found = make()
    with _lock:
        for old in [k for k, (there, _) in _seen.items() if there() is None]:
            del _seen[old]
        _seen[key] = (weakref.ref(array), found)
    return found


def known_edge(
    picture: KnownPicture,
    window: Window | None,
    limits: tuple[float, float] | None,
    draws: int,
    tails: bool,
    bordered: bool = False,
) -> Edge | None:
    """Return the edge in a window, or the strongest edge of the picture; None if there is none. ``draws`` is 0 for a
    picture without noise, ``bordered`` marks a picture that is continued by its mirror image.
    """
    key = (picture.digest, window, limits, draws, tails, bordered)
    with _lock:
        if key in _known:
            return _known[key]
    try:
        found = _measured(picture.plane, picture.sites, window, limits, draws, tails, bordered)
    except ValueError:  # raised by the kernel for pictures without an edge
        found = None
    with _lock:
        while len(_known) >= REMEMBERED:
            _known.pop(next(iter(_known)))
        _known[key] = found
    return found


def _measured(
    plane: FloatArray,
    sites: Array | None,
    window: Window | None,
    limits: tuple[float, float] | None,
    draws: int,
    tails: bool,
    bordered: bool,
) -> Edge:
    if window is None:
        window, sites = _found(plane, sites)
        inner = _inner(window, plane.shape)
        if bordered and inner is not None:
            try:
                cut = np.s_[inner[0] - window[0] : inner[1] - window[0], inner[2] - window[2] : inner[3] - window[2]]
                return _certain(_straight(plane[_slices(inner)], None if sites is None else sites[cut], tails))
            except ValueError:  # the edge is elsewhere
                pass
    elif sites is not None:
        sites = sites[_slices(window)]
    plane = plane[_slices(window)]
    if not draws:
        return _certain(_straight(plane, sites, tails))
    middle = _middle(plane)
    plane, sites = plane[middle], None if sites is None else sites[middle]
    found = edge_resolution(plane, sites=sites, limits=limits, draws=draws, tails=tails)
    _strong(found.response)
    return _certain(found.response, found) if found.snr > CERTAIN else _edge(found)


def _found(plane: FloatArray, sites: Array | None) -> tuple[Window, Any]:
    try:
        return find_edge(plane, sites)
    except ValueError:
        if min(plane.shape) >= SMALL:
            raise
        return (0, plane.shape[0], 0, plane.shape[1]), sites


def _slices(window: Window) -> tuple[slice, slice]:
    return slice(window[0], window[1]), slice(window[2], window[3])


def _inner(window: Window, shape: tuple[int, ...]) -> Window | None:
    """Return the part of a window in the middle of the frame; None if this part is too small to measure.

    Beyond the border of the frame the light is continued by its mirror image. Near the border, widely scattered light
    therefore comes from the mirror image and not from an edge.
    """
    found: list[int] = []
    for low, high, size in ((*window[:2], shape[0]), (*window[2:], shape[1])):
        away = round(0.5 * (1 - INNER) * size)
        found += [max(low, away), min(high, size - away)]
    return (found[0], found[1], found[2], found[3]) if min(found[1] - found[0], found[3] - found[2]) >= SMALL else None


def _straight(plane: FloatArray, sites: Array | None, tails: bool) -> EdgeResponse:
    middle = _middle(plane)
    return _strong(slanted_edge(plane[middle], sites=None if sites is None else sites[middle], tails=tails))


def _strong(found: EdgeResponse) -> EdgeResponse:
    if not found.contrast >= FAINTEST:
        raise ValueError(f"picture shows an edge of contrast {found.contrast:.2g}; at least {FAINTEST} is required")
    return found


def _middle(plane: FloatArray) -> tuple[slice, slice]:
    """Return the slices (y, x) of the middle part of an edge, at most `LONGEST` pixels along it."""

    gy, gx = (float(np.square(np.diff(plane, axis=axis)).sum()) for axis in (0, 1))
    cut = [slice(None), slice(None)]
    along = 0 if gx >= gy else 1
    if plane.shape[along] > LONGEST:
        first = (plane.shape[along] - LONGEST) // 2
        cut[along] = slice(first, first + LONGEST)
    return cut[0], cut[1]


def _certain(found: EdgeResponse, whole: EdgeResolution | None = None) -> Edge:
    return Edge(
        found.mtf50,
        math.nan,
        math.nan,
        found.mtf10,
        found.angle,
        found.vertical,
        found.not_reached,
        clipped=whole is not None and whole.clipped,
        noisy=False,
        frequency=found.frequency,
        sfr=found.sfr,
    )


def _edge(found: EdgeResolution) -> Edge:
    return Edge(
        found.mtf50,
        found.mtf50_low,
        found.mtf50_high,
        found.mtf10,
        found.angle,
        found.vertical,
        found.not_reached,
        found.clipped,
        found.noisy,
        found.response.frequency,
        found.response.sfr,
    )
