"""Check that a measured edge is one straight edge between two uniform areas, from the fit residuals and the edge
spread function.

In:  a measured edge.
Out: names of the checks that failed.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import scipy

from etendue_camera.arrays import FloatArray
from etendue_camera.resolution.edges.slanted_edge import MeasuredEdge

PARTS = 6  # segments along the edge
CHANGES, SURE = 0.15, 4.0  # change of the step along the edge, and its significance in standard errors
SIDE, PATTERN = 6, 0.05  # side of a square in pixels, and rms of the means of squares relative to the step
BENT = 0.04  # distance of the edge from a straight line, relative to its length
WIDE = 0.3  # 10 to 90 % rise, relative to the fitted range
FINE = 0.75  # pixels rms, smoothing of the curve
BEYOND = 0.35  # overshoot beyond the plateaus, relative to the step: sharpening reaches up to a third
# Minimum of a second rise, relative to the steepest slope; maximum slope between both, relative to the weaker rise.
AGAIN, BETWEEN = (
    0.15,
    0.7,
)
NAMES = ("bent", "changes", "pattern", "no_plateau", "line", "double")


def doubts(found: MeasuredEdge, rise: float) -> tuple[str, ...]:
    """Return the reasons against a single straight edge.

    Parameters
    ----------
    found : MeasuredEdge
    rise : float, pixels
        10 to 90 % of the step.

    Returns
    -------
    names out of ``NAMES``: the line is bent; the step changes along it; the areas have a pattern; the rise leaves no
    uniform areas; the curve leaves its plateaus, as for a line; the curve rises twice.

    Notes
    -----
    ``python benchmarks/measure_others.py`` prints which of twenty edges and twenty other objects are accepted and which
    are doubted.
    """
    seen = {
        "bent": _bend(found) > BENT * found.rows,
        "changes": _changes(found),
        "pattern": _pattern(found),
        "no_plateau": not rise <= WIDE * 2 * float(np.abs(found.fit.distance).max()),
    }
    return tuple(name for name in NAMES if ({**seen, **_shape(found)})[name])


def _bend(found: MeasuredEdge) -> float:
    """Return the largest distance of the edge from a straight line, pixels."""
    v = np.linspace(-1.0, 1.0, found.rows)
    own = np.polynomial.polynomial.polyval(v, found.coefficients)
    straight = np.polynomial.polynomial.polyval(v, np.polynomial.polynomial.polyfit(v, own, 1))
    return float(np.abs(own - straight).max()) / math.hypot(
        1.0, float(found.coefficients[1]) * 2 / max(found.rows - 1, 1)
    )


def _changes(found: MeasuredEdge) -> bool:
    """Return whether the step changes along the edge: each segment is fitted by least squares to the common curve."""
    fit = found.fit
    spline = fit.value - fit.rest
    part = np.minimum((fit.row - fit.row.min()) * PARTS // max(int(np.ptp(fit.row)), 1), PARTS - 1)
    count = np.maximum(np.bincount(part, minlength=PARTS), 1)
    centred = spline - (np.bincount(part, spline, PARTS) / count)[part]
    power = np.bincount(part, centred**2, PARTS)
    known = power > 0.05 * power.max()
    slope = np.bincount(part, centred * fit.value, PARTS)[known] / power[known]
    error = fit.noise / np.sqrt(power[known])
    return bool(not known.all() or (np.abs(slope - np.median(slope)) > CHANGES + SURE * error).any())


def _pattern(found: MeasuredEdge) -> bool:
    """Return whether mean residuals over squares vary more than independent pixel noise explains."""
    fit, step = found.fit, abs(float(found.curve.high - found.curve.low))
    across = ((fit.distance - fit.distance.min()) / SIDE).astype(np.intp)
    place = (fit.row // SIDE) * (int(across.max()) + 1) + across
    count = np.bincount(place)
    full = count >= SIDE**2 // 2
    means = np.bincount(place, fit.rest)[full] / count[full]
    if means.size < PARTS:
        return False
    power, white = float(np.mean(means**2)), float(np.mean(fit.noise**2 / count[full]))
    return power > (PATTERN * step) ** 2 and power > SURE * white


def _shape(found: MeasuredEdge) -> dict[str, bool]:
    """Return whether the smoothed curve leaves the plateaus, and whether it rises more than once."""
    reach = float(np.abs(found.fit.distance).max())
    step = 0.25
    place = np.arange(-reach, reach + 0.5 * step, step)
    raw = (found.curve.at(place) - found.curve.low) / (found.curve.high - found.curve.low)
    curve = scipy.ndimage.gaussian_filter1d(raw, FINE / step, mode="nearest")
    slope = np.gradient(curve, step)
    noise = _noise(found) / step
    least = max(AGAIN * float(slope.max()), 0.0) + SURE * noise
    peaks, valleys = _peaks(slope, least)
    double = any(valley < BETWEEN * min(a, b) for a, b, valley in zip(peaks[:-1], peaks[1:], valleys, strict=True))
    leaves = max(float(curve.max()) - 1, -float(curve.min()))
    return {"line": leaves > BEYOND, "double": double}


def _noise(found: MeasuredEdge) -> float:
    """Return the rms difference that noise causes between neighbouring samples of the curve, relative to the step."""
    fit = found.fit
    each = fit.distance.size / max(float(np.ptp(fit.distance)), 1.0)  # pixels per pixel of distance
    smoothed = 1 / math.sqrt(2 * math.sqrt(math.pi) * FINE * each)
    return fit.noise / abs(float(found.curve.high - found.curve.low)) * smoothed * 0.25 / (math.sqrt(2) * FINE)


def _peaks(slope: FloatArray, least: float) -> tuple[list[float], list[float]]:
    """Return maxima above a threshold, and the lowest value between each maximum and the next."""
    at = [
        i
        for i in range(1, len(slope) - 1)
        if slope[i] >= least and slope[i] >= slope[i - 1] and slope[i] > slope[i + 1]
    ]
    return [float(slope[i]) for i in at], [float(slope[a:b].min()) for a, b in pairwise(at)]
