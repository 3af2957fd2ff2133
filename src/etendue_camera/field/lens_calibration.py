"""Measurements of one lens: its distortion, lateral colour and fall-off at several focal lengths, apertures and
distances.

In:  calibration points of a lens; a focal length (mm), an f-number, a distance in focus (m).
Out: the real image height of each colour by ideal height, mm; the relative illumination (1) by real height, mm.
Sources: the models and the interpolation of lensfun 0.3.4 (``lens.cpp``, ``mod-coord.cpp``, ``mod-color.cpp``,
``mod-subpix.cpp``). Heights of 1 are half the short side of the calibrated sensor; for fall-off, half its diagonal.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray

DIAGONAL = math.hypot(36.0, 24.0)  # mm, of a sensor with crop factor 1
MODELS = {
    "distortion": {"poly3": 1, "poly5": 2, "ptlens": 3},
    "tca": {"linear": 2, "poly3": 6},
    "vignetting": {"pa": 3},
}  # terms of each model
FARTHEST = 1000.0  # m; the distance that calibrations use for infinity
POWER = 3.5  # exponent of the distance to a calibration point in the weights of fall-off
RANKS = (
    (1.41, 2),
    (1.31, 4),
    (1.21, 6),
    (1.11, 8),
    (1.01, 10),
    (1.0 - 1e-6, 5),
    (0.96, 3),
)  # lowest ratio of crop factors, and its rank
COLOURS = (460.0, 540.0, 600.0)  # nm: blue, green and red of a camera in daylight, to which lateral colour refers


@dataclass(frozen=True)
class Point:
    """One calibration: the terms of a model, measured at one focal length; for fall-off also at one f-number and
    distance (m).
    """

    model: str
    terms: tuple[float, ...]
    focal: float
    aperture: float = 0.0
    distance: float = 0.0


@dataclass(frozen=True)
class Lens:
    """One entry of a lens in the database. ``mounts``: its own mounts; ``fits``: mounts of all bodies that take the
    lens without an adapter.

    ``crop_factor`` and ``aspect`` (long over short side) describe the sensor of the calibration.
    """

    maker: str
    model: str
    mounts: tuple[str, ...]
    fits: tuple[str, ...]
    crop_factor: float
    aspect: float
    focal: tuple[float, float]
    aperture: tuple[float, float]
    distortion: tuple[Point, ...] = ()
    tca: tuple[Point, ...] = ()
    vignetting: tuple[Point, ...] = ()

    def half_diagonal(self) -> float:
        """Return half the diagonal (mm) of the sensor of the calibration: where fall-off has r = 1."""
        return 0.5 * DIAGONAL / self.crop_factor

    def heights(self, ideal_mm: FloatArray, focal: float) -> FloatArray:
        """Return the real height (mm) of each ideal height in blue, green and red, (heights, 3).

        A polynomial may fold back at large heights. Beyond the first fold of a colour its curve continues along the
        tangent, so that real heights always ascend.
        """
        unit = self.half_diagonal() / math.hypot(self.aspect, 1.0)  # half the short side, where distortion has r = 1
        r = np.asarray(ideal_mm) / unit
        moved = distorted(interpolated(self.distortion, focal, "distortion"), r)
        colours = np.stack(dispersed(interpolated(self.tca, focal, "tca"), moved), axis=-1)
        return unit * colours

    def relative(self, height_mm: FloatArray, focal: float, aperture: float, distance_m: float) -> FloatArray | None:
        """Return the relative illumination (1) at real heights; None if no fall-off was measured near these
        settings.
        """
        terms = weighted(self.vignetting, self.focal, focal, aperture, min(distance_m, FARTHEST))
        if terms is None:
            return None
        square = (np.asarray(height_mm) / self.half_diagonal()) ** 2
        return 1.0 + square * (terms[0] + square * (terms[1] + square * terms[2]))


def chosen(entries: Sequence[Lens], crop_factor: float) -> Lens:
    """Return the entry for a sensor with this crop factor; 0 means that the crop factor is unknown.

    Entries with the same name were calibrated on different sensors. They are ranked as in lensfun 0.3.4: the best entry
    was calibrated on a sensor slightly larger than the given sensor, and an entry does not cover a sensor that is more
    than 4 % larger than the sensor of its calibration. If no entry covers the sensor, or its crop factor is unknown,
    the entry of the largest sensor is used.
    """
    require.that(len(entries) > 0, "a lens needs at least one entry")
    ranks = [next((score for least, score in RANKS if crop_factor / one.crop_factor >= least), 0) for one in entries]
    if max(ranks) == 0:
        return min(entries, key=lambda one: one.crop_factor)
    return entries[ranks.index(max(ranks))]


def interpolated(points: Sequence[Point], focal: float, kind: str) -> Point | None:
    """Return the terms at a focal length, interpolated by cubic Hermite curves and constant beyond the calibrated
    range.

    Terms of distortion, and terms of lateral colour except its scales, are multiplied by the focal length before
    interpolation and divided by it afterwards. Points whose model differs from the model of the first point are
    ignored. Without points the result is None.
    """
    own = sorted((one for one in points if one.model == points[0].model), key=lambda one: one.focal)
    if not own:
        return None
    exact = next((one for one in points if one.focal == focal and one.model == points[0].model), None)
    if exact is not None:
        return exact
    above = bisect_left([one.focal for one in own], focal)
    return own[min(above, len(own) - 1)] if above in (0, len(own)) else _between(own, above, focal, kind)


def _between(own: Sequence[Point], above: int, focal: float, kind: str) -> Point:
    """Return the terms at a focal length between two calibrations; ``above`` is the index of the point with the longer
    focal length.
    """
    low, high = own[above - 1], own[above]
    four = (own[above - 2] if above >= 2 else None, low, high, own[above + 1] if above + 1 < len(own) else None)
    t = (focal - low.focal) / (high.focal - low.focal)
    terms = []
    for i in range(len(low.terms)):
        plain = kind == "tca" and i < 2
        y = [None if one is None else one.terms[i] * (1.0 if plain else one.focal) for one in four]
        terms.append(_hermite(y, t) / (1.0 if plain else focal))
    return Point(low.model, tuple(terms), focal)


def _hermite(y: Sequence[float | None], t: float) -> float:
    """Return the cubic through the two middle values of four, at t from 0 to 1 between them; its slope at each value is
    half the difference of the two neighbouring values.
    """
    before, low, high, after = y
    assert low is not None and high is not None
    start = high - low if before is None else 0.5 * (high - before)
    end = high - low if after is None else 0.5 * (after - low)
    return (
        (2 * t**3 - 3 * t**2 + 1) * low
        + (t**3 - 2 * t**2 + t) * start
        + (-2 * t**3 + 3 * t**2) * high
        + (t**3 - t**2) * end
    )


def weighted(
    points: Sequence[Point], range_mm: tuple[float, float], focal: float, aperture: float, distance_m: float
) -> tuple[float, ...] | None:
    """Return the terms of fall-off, averaged over the calibrations.

    The distance to a calibration is Euclidean and has no unit. Its coordinates are the focal length divided by the zoom
    range, 4/f-number, and 0.1 m/focus distance. Each calibration has the weight distance^-3.5. Return None if the
    nearest calibration has a distance above 1.
    """
    total, sums, nearest = 0.0, [0.0, 0.0, 0.0], math.inf
    span = range_mm[1] - range_mm[0]
    for one in points:
        along = (focal - one.focal) / span if span else 0.0
        away = math.sqrt(
            along**2 + (4.0 / aperture - 4.0 / one.aperture) ** 2 + (0.1 / distance_m - 0.1 / one.distance) ** 2
        )
        if away < 1e-4:
            return one.terms
        nearest = min(nearest, away)
        weight = away**-POWER
        total += weight
        sums = [s + weight * t for s, t in zip(sums, one.terms, strict=True)]
    return tuple(s / total for s in sums) if nearest <= 1 else None


def distorted(point: Point | None, r: FloatArray) -> FloatArray:
    """Return the real radius of each ideal radius, both in units of half the short side.

    poly3: r (1 - k1 + k1 r^2); poly5: r (1 + k1 r^2 + k2 r^4); ptlens: r (a r^3 + b r^2 + c r + 1 - a - b - c).
    """
    if point is None:
        return r
    if point.model == "poly3":
        (k1,) = point.terms
        return r * (1 - k1 + k1 * r**2)
    if point.model == "poly5":
        k1, k2 = point.terms
        return r * (1 + r**2 * (k1 + r**2 * k2))
    a, b, c = point.terms
    return r * (1 - a - b - c + r * (c + r * (b + r * a)))


def dispersed(point: Point | None, r: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the radii of blue, green and red from the real radius of green.

    linear: r k; poly3: r (v + c r + b r^2). Terms are kr, kb, or vr, vb, cr, cb, br, bb.
    """
    if point is None:
        return r, r, r
    if point.model == "linear":
        red, blue = point.terms
        return r * blue, r, r * red
    vr, vb, cr, cb, br, bb = point.terms
    return r * (vb + r * (cb + r * bb)), r, r * (vr + r * (cr + r * br))
