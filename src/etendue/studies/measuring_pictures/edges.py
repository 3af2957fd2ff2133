"""MTF of slanted edges in a photograph: e-SFR with an interval, or one line that says why there is none.

In:  a photograph, a region or none.
Out: a row of figures with their curve.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from etendue.errors import RequestError
from etendue.physics.resolution.edge_interval import CLIPPED, EdgeResolution, edge_resolution
from etendue.physics.resolution.edge_shape import EdgeShape, edge_shape
from etendue.physics.resolution.slanted_edge import SMALLEST
from etendue.studies.measuring_pictures.finding import reason, slanted
from etendue.studies.measuring_pictures.photograph import Photograph
from etendue.studies.measuring_pictures.regions import FOUND, Window, window

ORDER = 3  # of the polynomial that an edge follows: distortion bends edges
LEAST, MOST = 1.0, 44.0  # degrees from the raster; the instrument's own 2 to 43, with what a photograph cannot be held to
MISFIT, TIMES = 0.04, 4.0  # of the step, and of the noise: rms about the edge beyond which it is no single edge
SEEN = 5.0  # times the noise: what a step takes to be seen by eye; noise alone has 3.3
REGIONS = (
    "give regions: --edge X,Y,WIDTH,HEIGHT about one slanted edge, --star X,Y,RADIUS, --noise X,Y,WIDTH,HEIGHT of an even patch, "
    "--chart with the four corners of a ColorChecker"
)


def measured_edge(photograph: Photograph, text: str, channel: str, confidence: float) -> dict[str, Any]:
    """One edge.

    Raises
    ------
    RequestError
        A region outside the picture; no edge, one along the raster, a bent one.
    """
    if text != FOUND:
        return _measured(photograph, window("--edge", text, photograph.columns, photograph.rows), channel, confidence, False)
    places, why = slanted(photograph, channel)
    for place in places:
        try:
            return _measured(photograph, place, channel, confidence, True)
        except RequestError as error:
            why = str(error).partition(": ")[2]
    raise RequestError(f"{photograph.path.name}: no slanted edge was found by itself ({why}); {REGIONS}")


def _measured(photograph: Photograph, place: Window, channel: str, confidence: float, find: bool) -> dict[str, Any]:
    """The edge in a rectangle, or with ``find`` the strongest one in it."""
    what = f"--edge {place}"
    if min(place.width, place.height) < SMALLEST:
        raise RequestError(f"{what}: too small for an edge; allowed is at least {SMALLEST} x {SMALLEST} pixels")
    image, sites = photograph.linear(channel, place.cut)
    image = np.ascontiguousarray(image)
    seen = _step(image, sites) > SEEN * _noise(image, sites)
    shape = _shape(what, image, sites) if seen and not find else None
    try:
        found = edge_resolution(image, order=ORDER, sites=sites, confidence=confidence, find=find)
    except ValueError as error:
        hidden = not seen and float(np.ptp(image)) > 0
        raise RequestError(f"{what}: no edge can be measured: {'its step is lost in noise' if hidden else reason(error)}") from None
    _check_straight(what, found, shape, image, sites)
    clipped = float(photograph.clipped(place.cut).mean())
    top, bottom, left, right = found.window
    inner = Window(place.x + left, place.y + top, right - left, bottom - top)
    response = found.response
    return {
        "region": str(inner), "channel": channel, "angle": found.angle, "near": "columns" if found.vertical else "rows",
        "bend": None if shape is None else shape.bend,
        "mtf50": found.mtf50, "mtf50_low": found.mtf50_low, "mtf50_high": found.mtf50_high,
        "mtf10": found.mtf10, "mtf10_low": found.mtf10_low, "mtf10_high": found.mtf10_high,
        "mtf_nyquist": found.mtf_nyquist, "rise": found.rise, "contrast": response.contrast, "snr": found.snr, "clipped": clipped,
        "flags": [*found.flags, *(["clipped"] if clipped > CLIPPED and not found.clipped else [])],
        "frequency": response.frequency.tolist(), "sfr": response.sfr.tolist(),
    }  # fmt: skip


def _shape(what: str, image: Any, sites: Any) -> EdgeShape | None:
    """How the edge of a region stands; one along the raster is refused."""
    try:
        shape = edge_shape(image, sites)
    except ValueError:
        return None
    if not LEAST <= abs(shape.angle) <= MOST:
        raise RequestError(f"{what}: the edge is not slanted: it stands {_stands(shape)}; allowed is 2 to 43")
    return shape


def _stands(shape: EdgeShape) -> str:
    return f"{abs(shape.angle):.1f} degrees from the {'columns' if shape.vertical else 'rows'}"


def _check_straight(what: str, found: EdgeResolution, shape: EdgeShape | None, image: Any, sites: Any) -> None:
    """An edge that no cubic follows: the picture departs from what was fitted by more than its noise."""
    step = 1 / found.snr if found.snr > 0 else math.inf
    if step <= MISFIT or step <= TIMES * _noise(image, sites) / _step(image, sites):
        return
    bend = "" if shape is None else f": up to {shape.bend:.1f} pixels from a line {_stands(shape)}"
    raise RequestError(f"{what}: the edge is not straight, or not alone{bend}; the rest about it is {100 * step:.0f} % of its step")


def _step(image: Any, sites: Any) -> float:
    low, high = np.percentile(image if sites is None else image[sites], (5, 95))
    return max(float(high - low), 1e-300)


def _noise(image: Any, sites: Any) -> float:
    """rms of a pixel, from the median of differences between neighbours of one colour along the smoother direction."""
    if sites is None:
        steps = [np.diff(image, axis=0), np.diff(image, axis=1)]
    else:
        period = next((n for n in (2, 6) if np.array_equal(sites[n:], sites[:-n]) and np.array_equal(sites[:, n:], sites[:, :-n])), 2)
        steps = [(image[period:] - image[:-period])[sites[period:]], (image[:, period:] - image[:, :-period])[sites[:, period:]]]
    return min(float(np.median(np.abs(one))) for one in steps) / (0.6745 * math.sqrt(2))
