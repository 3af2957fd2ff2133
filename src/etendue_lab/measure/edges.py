"""MTF of slanted edges in a photograph: e-SFR with an interval, or a message that says why no edge was measured.

In:  a photograph, a region or none.
Out: a row of values with their curve.
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
from etendue_camera.resolution.edges.edge_interval import CLIPPED, EdgeResolution, edge_resolution
from etendue_camera.resolution.edges.edge_rewritten import AGAIN
from etendue_camera.resolution.edges.edge_shape import EdgeShape, edge_shape
from etendue_camera.resolution.edges.slanted_edge import SMALLEST
from etendue_lab.measure.finding import reason, slanted, strips_of
from etendue_lab.measure.photograph import PLANES, PhotographFile
from etendue_lab.measure.regions import FOUND, PixelWindow, window

ORDER = 3  # of the polynomial fitted to an edge: distortion bends edges
# degrees from the raster; the method's own limits are 2 to 43, with a margin for photographs
LEAST, MOST = (1.0, 44.0)
STEEP = 2.0, 43.0  # degrees from the raster of edges that are found automatically
MISFIT, TIMES = 0.04, 4.0  # rms residual above which there is not a single edge, relative to the step and to the noise
ALONE = 0.02  # relative to the step: rms residual up to which the region contains only the edge
CLEARER = 1.5  # minimum step/residual in a strip over that in its region, if the region contains something else
TILTED = 1.92  # scale of the effect of level errors on MTF50: covers 96 % of 400 edges in 8 bits without noise
LOST, COARSER, FINER = 0.0235, 2.0, 8.34  # of MTF50: see `_lost`
# Mean step of a table below which recompressed edges show mainly rounding; fraction of rounding counted twice.
FINE, TWICE = (
    2.0,
    0.5,
)
METHOD = 5e-4  # relative to MTF50: error of the method itself (`slanted_edge`), a lower bound of every interval
SEEN = 5.0  # step over noise above which an edge is visible by eye; noise alone reaches 3.3
HIDDEN = "its step is lost in noise"
TRIED = 0.08, 0.6  # range of MTF50 tested, cycles/pixel: Gaussian blurs of 2 to 0.35 pixels
TRIED_NOISE, TRIED_STEPS = 0.025, 30.0  # rms noise relative to full scale; mean of a JPEG's table (29 at quality 75)
KINDS = {  # reasons why no edge is found automatically, and the advice for each
    "shorter than 24 pixels": (("shorter than",), "make the chart larger in the picture"),
    "along rows or columns": (
        ("parallel to the pixel axes", "it has no slanted edge"),
        "turn the chart by about 5 degrees",
    ),
    "nearly along a diagonal": (
        ("nearly diagonal",),
        "turn the chart: edges are best at about 5 degrees from rows and columns",
    ),
    "less than 8 pixels from something else": (("there is something within",), "leave more room around the edge"),
    "not straight, or not alone": (
        ("not a single straight", "distances", "line", "in one row", "no step"),
        "",
    ),
    "no stronger than the noise or texture around it": ((HIDDEN,), ""),
}
REGIONS = (
    "give regions: --edge X,Y,WIDTH,HEIGHT around one slanted edge, --star X,Y,RADIUS, --noise X,Y,WIDTH,HEIGHT of a "
    "uniform patch, --chart with the four corners of a ColorChecker"
)


def measured_edge(photograph: PhotographFile, text: str, channel: str, confidence: float) -> Document:
    """Measure one edge.

    Raises
    ------
    RequestError
        The region is outside the picture, or holds no edge, or its edge is bent or parallel to the rows or columns.
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
                f"the edge is not slanted: it is {abs(one['angle']):.1f} degrees from the {one['near']}; allowed: "
                "2 to 43"
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
    raise RequestError(
        f"{photograph.path.name}: no slanted edge was found automatically: {_why(refusals, why)}; {REGIONS}"
    )


def _measured_in(photograph: PhotographFile, region: PixelWindow, channel: str, confidence: float) -> Document:
    """Measure the one edge of a region. If the region also contains other features, measure only the strip whose
    bounding box is the region.
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
    """Return a text that says why no edge can be measured: the kinds of unsuitable edges, most frequent first, and
    advice.
    """
    reasons = [*refusals, *(reason(ValueError(one)) for one in why)]
    counts = {kind: sum(any(part in one for part in parts) for one in reasons) for kind, (parts, _) in KINDS.items()}
    kinds = sorted((kind for kind in counts if counts[kind]), key=lambda kind: -counts[kind])
    if not kinds:
        return reasons[0] if reasons else "the picture is uniform"
    help = KINDS[kinds[0]][1]
    return f"its edges are {'; or '.join(kinds)}{f' ({help})' if help else ''}"


def _measured(
    photograph: PhotographFile, place: PixelWindow, channel: str, confidence: float, strip: Array | None = None
) -> Document:
    """Measure the edge in a rectangle, or only in the pixels of a strip inside it."""
    what = f"--edge {place}"
    if strip is not None:
        place, strip = _roomy(place, strip, photograph)
    if min(place.width, place.height) < SMALLEST:
        raise RequestError(f"{what}: too small for an edge; at least {SMALLEST} x {SMALLEST} pixels are needed")
    image, sites = photograph.linear(channel, place.cut)
    image = np.ascontiguousarray(image)
    sites = sites if strip is None else strip
    seen = _step(image, sites) > SEEN * _noise(image, sites)
    shape = _shape(what, image, sites) if seen and strip is None else None
    try:
        written = photograph.written if photograph.lossy else None
        found = edge_resolution(image, order=ORDER, sites=sites, confidence=confidence, written=written)
    except ValueError as error:
        raise RequestError(f"{what}: cannot measure an edge: {_said(reason(error), seen, image)}") from None
    _check_straight(what, found, shape, image, sites)
    clipped = float(photograph.clipped(place.cut).mean())
    top, bottom, left, right = found.window
    inner = PixelWindow(place.x + left, place.y + top, right - left, bottom - top)
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


def _untried(photograph: PhotographFile, channel: str, found: EdgeResolution, step: float) -> list[str]:
    """Return the names of the properties that lie outside the range in which intervals were tested
    (``benchmarks/measure_coverage.py``).
    """
    noise = step / found.snr if found.snr > 0 else math.inf
    seen = {
        "sharp": found.mtf50 > TRIED[1] or found.not_reached,
        "blurred": found.mtf50 < TRIED[0],
        "noise": noise > TRIED_NOISE,
        "coarse": photograph.lossy and float(np.mean(photograph.table)) > TRIED_STEPS,
        "colour": photograph.lossy and channel in PLANES,
    }
    return [name for name, outside in seen.items() if outside]


def _intervals(
    photograph: PhotographFile, levels: tuple[float, ...], found: EdgeResolution, confidence: float
) -> Document:
    """Return intervals that combine noise with the effects of the file format, added in squares. Also return these
    effects relative to MTF50.
    """
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


def _lost(photograph: PhotographFile, levels: tuple[float, ...], found: EdgeResolution) -> float:
    """Return the error of MTF50 by JPEG compression that recompressed edges do not show, relative to MTF50. The value
    is both the mean error and its spread.

    Notes
    -----
    Recompressed edges start from the edge in the file, in which compression has already removed detail. On average the
    true MTF50 is higher by this error: `LOST` times the squared ratio of the table's mean step to the step of the edge,
    times exp(`FINER` MTF50), up to the sharpest edge tested. The constants are fitted, with `edge_rewritten.BY_ROWS`,
    to the same edges. For a blur of 0.35 pixels the error is 0.1 of MTF50 at quality 75 and 0.005 at 95.
    """
    if not math.isfinite(found.mtf50):
        return 0.0
    return float(LOST * photograph.coarse(*levels) ** COARSER * math.exp(FINER * min(found.mtf50, TRIED[1])))


def _rounding(photograph: PhotographFile, levels: tuple[float, ...], found: EdgeResolution, confidence: float) -> float:
    """Return the largest relative error of a frequency, such as MTF50, that rounding in the file causes. It follows
    from the rounding errors of the two levels of the edge, relative to its step.
    """
    low, high = levels
    steps = [photograph.step(low), photograph.step(high)]
    if found.written is not None:
        noise = found.written[0].noise  # the residual is mostly noise of the file format and adds no spread
    elif not found.snr > 0:
        noise = 0.0
    else:
        # Subtract the noise of rounding.
        noise = math.sqrt(max(0.0, ((high - low) / found.snr) ** 2 - max(steps) ** 2 / 12))
    wrong = [lasting_error(step, noise) for step in steps]
    return TILTED * both(wrong[0], wrong[1], confidence) / max(high - low, 1e-300)


def _wider(value: float, low: float, high: float, doubt: float, higher: float = 0.0) -> tuple[float, float]:
    """Widen an interval by a further independent uncertainty, given as a fraction of the value.

    ``higher`` (a fraction of the value) shifts the interval up; the value stays inside the interval.
    """
    if not math.isfinite(value):
        return low, high
    below, above = (math.hypot(max(part, 0.0), doubt * value) for part in (value - low, high - value))
    return max(value - max(below - higher * value, 0.0), 0.0), value + above + higher * value


def _said(why: str, seen: bool, image: Array) -> str:
    """Return the reason why an edge cannot be measured. A visible edge is never reported as hidden by noise."""
    if not seen and float(np.ptp(image)) > 0:
        return HIDDEN
    return "there is no single straight edge between two uniform fields" if why == HIDDEN else why


def _roomy(place: PixelWindow, strip: Any, photograph: PhotographFile) -> tuple[PixelWindow, Any]:
    """Return a window that is widened to the smallest measurable size around a narrow strip, and the mask of the strip
    in it.
    """
    (y, height), (x, width) = (
        _widened(first, length, size)
        for first, length, size in (
            (place.y, place.height, photograph.rows),
            (place.x, place.width, photograph.columns),
        )
    )
    held = np.zeros((height, width), bool)
    held[place.y - y : place.y - y + place.height, place.x - x : place.x - x + place.width] = strip
    return PixelWindow(x, y, width, height), held


def _widened(first: int, length: int, size: int) -> tuple[int, int]:
    begin = min(first, max(first + (length - SMALLEST) // 2, 0))
    end = min(max(first + length, begin + SMALLEST), size)
    begin = max(min(begin, end - SMALLEST), 0)
    return begin, end - begin


def _shape(what: str, image: Array, sites: Array | None) -> EdgeShape | None:
    """Return the shape of the edge in a region; refuse an edge along rows or columns."""
    try:
        shape = edge_shape(image, sites)
    except ValueError:
        return None
    if not LEAST <= abs(shape.angle) <= MOST:
        raise RequestError(f"{what}: the edge is not slanted: it is {_stands(shape)}; allowed: 2 to 43")
    return shape


def _stands(shape: EdgeShape) -> str:
    return f"{abs(shape.angle):.1f} degrees from the {'columns' if shape.vertical else 'rows'}"


def _check_straight(
    what: str, found: EdgeResolution, shape: EdgeShape | None, image: Array, sites: Array | None
) -> None:
    """Refuse an edge that a cubic curve does not fit: the residual of the fit exceeds the noise."""
    step = 1 / found.snr if found.snr > 0 else math.inf
    if step <= MISFIT or step <= TIMES * _noise(image, sites) / _step(image, sites):
        return
    bend = "" if shape is None else f": up to {shape.bend:.1f} pixels from a line {_stands(shape)}"
    raise RequestError(
        f"{what}: the edge is not straight, or not alone{bend}; the residual is {100 * step:.0f} % of its step"
    )


def _step(image: Array, sites: Array | None) -> float:
    low, high = np.percentile(image if sites is None else image[sites], (5, 95))
    return max(float(high - low), 1e-300)


def _noise(image: Array, sites: Array | None) -> float:
    """Return the rms noise of a pixel. It follows from the median difference between neighbours of one colour, along
    rows or columns, whichever gives less.
    """
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
