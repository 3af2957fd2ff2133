"""MTF of slanted edges in a photograph: e-SFR with an interval, or one line that says why there is none.

In:  a photograph, a region or none.
Out: a row of figures with their curve.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy

from etendue.errors import RequestError
from etendue.types.arrays import Array
from etendue.types.documents import Document
from etendue_camera.electronics.rounding import both, lasting_error
from etendue_camera.resolution.edge_interval import CLIPPED, EdgeResolution, edge_resolution
from etendue_camera.resolution.edge_rewritten import AGAIN
from etendue_camera.resolution.edge_shape import EdgeShape, edge_shape
from etendue_camera.resolution.slanted_edge import SMALLEST
from etendue_lab.measure.finding import reason, slanted, strips_of
from etendue_lab.measure.photograph import PLANES, Photograph
from etendue_lab.measure.regions import FOUND, Window, window

ORDER = 3  # of the polynomial that an edge follows: distortion bends edges
LEAST, MOST = (
    1.0,
    44.0,
)  # degrees from the raster; the instrument's own 2 to 43, with what a photograph cannot be held to
STEEP = 2.0, 43.0  # degrees from the raster of an edge that is taken by itself
MISFIT, TIMES = 0.04, 4.0  # of the step, and of the noise: rms about the edge beyond which it is no single edge
ALONE = 0.02  # of the step, rms about the edge up to which nothing else stands in a region
CLEARER = 1.5  # times the ratio of step to rest that a strip of a region has, where something else stands in the region
TILTED = 1.92  # errors of MTF50, of what both levels are wrong by: holds 96 % of 400 edges in 8 bits without noise
LOST, COARSER, FINER = 0.0235, 2.0, 8.34  # of MTF50: see `_lost`
FINE, TWICE = (
    2.0,
    0.5,
)  # mean step of a table below which edges written again show little but rounding, and how much of that is both's
METHOD = 5e-4  # of MTF50: error of the method itself (`slanted_edge`), below which no interval says anything
SEEN = 5.0  # times the noise: what a step takes to be seen by eye; noise alone has 3.3
HIDDEN = "its step is lost in noise"
TRIED = 0.08, 0.6  # cycles/pixel, of MTF50: Gaussian blurs of 2 to 0.35 pixels
TRIED_NOISE, TRIED_STEPS = 0.025, 30.0  # rms of full scale; mean of a JPEG's table, that of quality 75 being 29
KINDS = {  # of what keeps the edges of a picture from being found by themselves: what its reason holds, and what helps
    "shorter than 24 pixels": (("shorter than",), "take the chart larger in the picture"),
    "along rows or columns": (
        ("along the raster", "not slanted", "nothing in it stands at a slant"),
        "turn the chart by some 5 degrees",
    ),
    "nearly along a diagonal": (
        ("along a diagonal",),
        "turn the chart: edges are best at some 5 degrees from rows and columns",
    ),
    "less than 8 pixels from something else": (("something stands within",), "give the edge more room"),
    "not straight, or not alone": (
        ("not straight", "no single straight", "distances", "line", "in one row", "no step"),
        "",
    ),
    "no stronger than noise or texture about it": ((HIDDEN,), ""),
}
REGIONS = (
    "give regions: --edge X,Y,WIDTH,HEIGHT about one slanted edge, --star X,Y,RADIUS, --noise X,Y,WIDTH,HEIGHT of an "
    "even patch, "
    "--chart with the four corners of a ColorChecker"
)


def measured_edge(photograph: Photograph, text: str, channel: str, confidence: float) -> Document:
    """One edge.

    Raises
    ------
    RequestError
        A region outside the picture; no edge, one along the raster, a bent one.
    """
    if text != FOUND:
        return _measured_in(
            photograph, window("--edge", text, photograph.columns, photograph.rows), channel, confidence
        )
    places, why = slanted(photograph, channel)
    measured, refusals = [], []
    for place in places:
        try:
            one = _measured(photograph, place.window, channel, confidence, place.strip)
        except RequestError as error:
            refusals.append(str(error).partition(": ")[2])
            continue
        if not STEEP[0] <= abs(one["angle"]) <= STEEP[1]:
            refusals.append(
                f"the edge is not slanted: it stands {abs(one['angle']):.1f} degrees from the {one['near']}; allowed "
                f"is 2 to 43"
            )
            continue
        if not math.isfinite(one["mtf50_high"]):
            refusals.append("the edge is not straight, or not alone: its response does not fall to a half")
            continue
        measured.append(one)
        if not one["flags"] and not one["doubts"]:
            return one
    if measured:
        return min(measured, key=lambda one: (len(one["doubts"]), len(one["flags"])))
    raise RequestError(f"{photograph.path.name}: no slanted edge was found by itself: {_why(refusals, why)}; {REGIONS}")


def _measured_in(photograph: Photograph, region: Window, channel: str, confidence: float) -> Document:
    """The one edge of a region; where something else stands in a corner of it, that of the strip whose box the
    region is.
    """
    refusal: RequestError | None = None
    whole: Document = {}
    try:
        whole = _measured(photograph, region, channel, confidence)
    except RequestError as error:
        refusal = error
    image, sites = photograph.linear(channel, region.cut)
    if whole and 1 <= whole["snr"] * max(CLEARER * _noise(image, sites) / _step(image, sites), ALONE):
        return whole
    if refusal and min(region.width, region.height) < SMALLEST:
        raise refusal
    named = [one for one in slanted(photograph, channel)[0] if _roomy(one.window, one.strip, photograph)[0] == region]
    for place in named or strips_of(photograph, channel, region):
        try:
            one = _measured(photograph, place.window, channel, confidence, place.strip)
        except RequestError:
            continue
        slanted_enough = STEEP[0] <= abs(one["angle"]) <= STEEP[1] and math.isfinite(one["mtf50_high"])
        if slanted_enough and (refusal or one["snr"] > CLEARER * whole["snr"]):
            return one
    if refusal:
        raise refusal
    return whole


def _why(refusals: list[str], why: list[str]) -> str:
    """What edges of the picture are that cannot be measured, most of them first, and what helps with these."""
    reasons = [*refusals, *(reason(ValueError(one)) for one in why)]
    counts = {kind: sum(any(part in one for part in parts) for one in reasons) for kind, (parts, _) in KINDS.items()}
    kinds = sorted((kind for kind in counts if counts[kind]), key=lambda kind: -counts[kind])
    if not kinds:
        return reasons[0] if reasons else "it is even all over"
    help = KINDS[kinds[0]][1]
    return f"what it has of edges is {'; or '.join(kinds)}{f' ({help})' if help else ''}"


def _measured(photograph: Photograph, place: Window, channel: str, confidence: float, strip: Any = None) -> Document:
    """The edge in a rectangle, or that of the pixels of a strip in it."""
    what = f"--edge {place}"
    if strip is not None:
        place, strip = _roomy(place, strip, photograph)
    if min(place.width, place.height) < SMALLEST:
        raise RequestError(f"{what}: too small for an edge; allowed is at least {SMALLEST} x {SMALLEST} pixels")
    image, sites = photograph.linear(channel, place.cut)
    image = np.ascontiguousarray(image)
    sites = sites if strip is None else strip
    seen = _step(image, sites) > SEEN * _noise(image, sites)
    shape = _shape(what, image, sites) if seen and strip is None else None
    try:
        written = photograph.written if photograph.lossy else None
        found = edge_resolution(image, order=ORDER, sites=sites, confidence=confidence, written=written)
    except ValueError as error:
        raise RequestError(f"{what}: no edge can be measured: {_said(reason(error), seen, image)}") from None
    _check_straight(what, found, shape, image, sites)
    clipped = float(photograph.clipped(place.cut).mean())
    top, bottom, left, right = found.window
    inner = Window(place.x + left, place.y + top, right - left, bottom - top)
    response = found.response
    middle, turn = 0.5 * ((bottom - top if found.vertical else right - left) - 1), math.tan(math.radians(found.angle))
    ends_of_line = [[response.place + turn * part, middle + part] for part in (-middle, middle)]
    line = [[inner.x + (u if found.vertical else v), inner.y + (v if found.vertical else u)] for u, v in ends_of_line]
    levels = tuple(float(v) for v in np.percentile(image if sites is None else image[sites], (5, 95)))
    return {
        "region": str(inner),
        "channel": channel,
        "angle": found.angle,
        "near": "columns" if found.vertical else "rows",
        "bend": None if shape is None else shape.bend,
        "line": line,
        "half_width": response.half_width,
        "mtf50": found.mtf50,
        "mtf10": found.mtf10,
        **_intervals(photograph, levels, found, confidence),
        "mtf_nyquist": found.mtf_nyquist,
        "rise": found.rise,
        "contrast": response.contrast,
        "snr": found.snr,
        "clipped": clipped,
        "doubts": list(found.doubts),
        "not_covered": _untried(photograph, channel, found, _step(image, sites)),
        "flags": [*found.flags, *(["clipped"] if clipped > CLIPPED and not found.clipped else [])],
        "frequency": response.frequency.tolist(),
        "sfr": response.sfr.tolist(),
    }


def _untried(photograph: Photograph, channel: str, found: EdgeResolution, step: float) -> list[str]:
    """What of a picture lies outside of what intervals have been tried on (``benchmarks/measure_coverage.py``)."""
    noise = step / found.snr if found.snr > 0 else math.inf
    seen = {
        "sharp": found.mtf50 > TRIED[1] or found.not_reached,
        "blurred": found.mtf50 < TRIED[0],
        "noise": noise > TRIED_NOISE,
        "coarse": photograph.lossy and float(np.mean(photograph.table)) > TRIED_STEPS,
        "colour": photograph.lossy and channel in PLANES,
    }
    return [name for name, outside in seen.items() if outside]


def _intervals(photograph: Photograph, levels: tuple[float, ...], found: EdgeResolution, confidence: float) -> Document:
    """Intervals of noise with what a file adds to them, all parts in squares, and those parts, of MTF50."""
    doubt, lost = _rounding(photograph, levels, found, confidence), _lost(photograph, levels, found)
    z = float(scipy.special.ndtri(0.5 + 0.5 * confidence))
    again = found.written[0] if found.written is not None and math.isfinite(found.written[0].spread) else None
    if again is not None and (mean := float(np.mean(photograph.table))) < FINE:
        doubt = math.sqrt(max(doubt**2 - TWICE * (z * AGAIN * again.spread / mean) ** 2, 0.0))
    further = math.hypot(doubt, z * lost)
    fifty = _wider(found.mtf50, found.mtf50_low, found.mtf50_high, further, lost)
    ten = _wider(found.mtf10, found.mtf10_low, found.mtf10_high, further, lost)
    conservative = bool(fifty[1] - fifty[0] < 2 * METHOD * found.mtf50)
    if conservative:
        fifty, ten = _wider(found.mtf50, *fifty, METHOD), _wider(found.mtf10, *ten, METHOD)
    return {
        "mtf50_low": fifty[0],
        "mtf50_high": fifty[1],
        "mtf10_low": ten[0],
        "mtf10_high": ten[1],
        "conservative": conservative,
        "rounding": doubt,
        "compression": None
        if found.written is None
        else {"bias": found.written[0].bias, "spread": found.written[0].spread, "lost": lost},
    }


def _lost(photograph: Photograph, levels: tuple[float, ...], found: EdgeResolution) -> float:
    """What a JPEG of an edge hides from edges that are written again, of MTF50: a mean error, and as much of a spread.

    Notes
    -----
    These begin from the edge that the file has left: what it took off a sharp one they have not any more. So much that
    truth lies on the average higher, and as much is its spread: `LOST` times the squared ratio of the table's mean step
    to the step of the edge, times exp(`FINER` MTF50), up to the sharpest edge that was tried. Fitted with
    `edge_rewritten.BY_ROWS` to the same edges; 0.1 of MTF50 for blurs of 0.35 pixels at quality 75, 0.005 at 95.
    """
    if not math.isfinite(found.mtf50):
        return 0.0
    return float(LOST * photograph.coarse(*levels) ** COARSER * math.exp(FINER * min(found.mtf50, TRIED[1])))


def _rounding(photograph: Photograph, levels: tuple[float, ...], found: EdgeResolution, confidence: float) -> float:
    """How far the file's whole numbers may have moved a frequency, of it: what both levels of the edge are wrong by,
    of its step.
    """
    low, high = levels
    steps = [photograph.step(low), photograph.step(high)]
    if found.written is not None:
        noise = found.written[0].noise  # what is left beside the edge is mostly that of the file, and spreads nothing
    elif not found.snr > 0:
        noise = 0.0
    else:
        noise = math.sqrt(max(0.0, ((high - low) / found.snr) ** 2 - max(steps) ** 2 / 12))  # without that of rounding
    wrong = [lasting_error(step, noise) for step in steps]
    return TILTED * both(wrong[0], wrong[1], confidence) / max(high - low, 1e-300)


def _wider(value: float, low: float, high: float, doubt: float, higher: float = 0.0) -> tuple[float, float]:
    """An interval with a further doubt of the value (of it) that has nothing to do with what made the interval.

    By ``higher`` (of the value) the interval lies higher; the value stays in it.
    """
    if not math.isfinite(value):
        return low, high
    below, above = (math.hypot(max(part, 0.0), doubt * value) for part in (value - low, high - value))
    return max(value - max(below - higher * value, 0.0), 0.0), value + above + higher * value


def _said(why: str, seen: bool, image: Array) -> str:
    """What keeps an edge from being measured: a step that is seen is not lost in noise."""
    if not seen and float(np.ptp(image)) > 0:
        return HIDDEN
    return "what stands there is no single straight edge between two even fields" if why == HIDDEN else why


def _roomy(place: Window, strip: Any, photograph: Photograph) -> tuple[Window, Any]:
    """A window with room about a strip that is narrower than an edge's picture may be."""
    (y, height), (x, width) = (
        _widened(first, length, size)
        for first, length, size in (
            (place.y, place.height, photograph.rows),
            (place.x, place.width, photograph.columns),
        )
    )
    held = np.zeros((height, width), bool)
    held[place.y - y : place.y - y + place.height, place.x - x : place.x - x + place.width] = strip
    return Window(x, y, width, height), held


def _widened(first: int, length: int, size: int) -> tuple[int, int]:
    begin = min(first, max(first + (length - SMALLEST) // 2, 0))
    end = min(max(first + length, begin + SMALLEST), size)
    begin = max(min(begin, end - SMALLEST), 0)
    return begin, end - begin


def _shape(what: str, image: Array, sites: Any) -> EdgeShape | None:
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


def _check_straight(what: str, found: EdgeResolution, shape: EdgeShape | None, image: Array, sites: Any) -> None:
    """An edge that no cubic follows: the picture departs from what was fitted by more than its noise."""
    step = 1 / found.snr if found.snr > 0 else math.inf
    if step <= MISFIT or step <= TIMES * _noise(image, sites) / _step(image, sites):
        return
    bend = "" if shape is None else f": up to {shape.bend:.1f} pixels from a line {_stands(shape)}"
    raise RequestError(
        f"{what}: the edge is not straight, or not alone{bend}; the rest about it is {100 * step:.0f} % of its step"
    )


def _step(image: Array, sites: Any) -> float:
    low, high = np.percentile(image if sites is None else image[sites], (5, 95))
    return max(float(high - low), 1e-300)


def _noise(image: Array, sites: Any) -> float:
    """rms of a pixel, from the median of differences between neighbours of one colour along the smoother direction."""
    if sites is None:
        steps = [np.diff(image, axis=0), np.diff(image, axis=1)]
    else:
        period = next(
            (
                n
                for n in (2, 6)
                if np.array_equal(sites[n:], sites[:-n]) and np.array_equal(sites[:, n:], sites[:, :-n])
            ),
            2,
        )
        steps = [
            (image[period:] - image[:-period])[sites[period:]],
            (image[:, period:] - image[:, :-period])[sites[:, period:]],
        ]
    return min(float(np.median(np.abs(one))) for one in steps) / (0.6745 * math.sqrt(2))
