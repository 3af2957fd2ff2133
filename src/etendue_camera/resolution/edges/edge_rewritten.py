"""What a lossy file has done to a measured edge: the edge that was found is written again and again, and measured
again.

In:  a measured edge, and who writes a picture as the file was written.
Out: MTF50 and MTF10 of edges that were written again.
Source: the parametric bootstrap (Efron and Tibshirani 1993).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from etendue_camera.arrays import FloatArray
from etendue_camera.resolution.edges.edge_line import distances
from etendue_camera.resolution.edges.edge_spread import EdgeSpread, refitted
from etendue_camera.resolution.edges.slanted_edge import MeasuredEdge

Written = Callable[[FloatArray, np.random.Generator], FloatArray]
TIMES, TRIED = 16, 3  # edges that are written, and those that say how much noise they take
BY_ROWS, AGAIN = (
    0.93,
    0.57,
)  # of the bootstrap's reach and of the spread of edges written again: both hold the noise of the picture
SEEN = 1.05  # times the rest without noise, from which on noise shows in a file
MOST = 3.0  # times the rest, of the noise in front of the file


@dataclass(frozen=True)
class Rewritten:
    """How far a file moves a frequency, of it."""

    bias: float
    spread: float  # standard deviation
    noise: float  # rms in front of the file that was taken, unit of the picture; of the side of the edge that has less

    def about(self, value: float, low: float, high: float, confidence: float) -> tuple[float, float]:
        """The interval about a measured frequency, with that of the bootstrap by rows (low, high) as a part.

        Notes
        -----
        The parts are added in squares. With noise both see the same, without it the second alone sees what a file does.
        `BY_ROWS` and `AGAIN` make the interval score (Gneiting and Raftery 2007) smallest of 4,800 edges, 60 kinds of
        file, blur and noise, which ``benchmarks/measure_coverage.py`` does not draw (other seeds; of half of them other
        sides, angles and levels), times 1.045: 96 % of these are held, and the shares of the 60 kinds scatter no more
        than draws do.
        """
        if not math.isfinite(self.spread):
            return low, math.inf
        if not math.isfinite(value):
            return low, high
        own = float(scipy.special.ndtri(0.5 + 0.5 * confidence)) * AGAIN * self.spread * value
        below, above = (math.hypot(BY_ROWS * max(part, 0.0), own) for part in (value - low, high - value))
        return max(value - below, 0.0), value + above


def rewritten(
    found: MeasuredEdge,
    written: Written,
    tails: bool,
    own: FloatArray,
    crossings: Callable[[EdgeSpread], FloatArray],
    rng: np.random.Generator,
) -> list[Rewritten]:
    """How far each of some frequencies is moved, those that ``crossings`` finds in curves (frequency, curve); inf where
    one is not reached.

    Notes
    -----
    The edge spread function that was found takes the place of the scene. It gets white noise, on either side of the
    edge so much as leaves behind the file what is left beside the edge; where noise does not come through, none is
    added.
    """
    v, across = np.linspace(-1.0, 1.0, found.rows), np.arange(found.columns) - 0.5 * (found.columns - 1)
    away = distances(found.coefficients, v, across, found.rows)
    clean, fit = found.curve.at(away), found.fit
    sides = (fit.distance < 0, fit.distance >= 0)

    def taken(noise: FloatArray, count: int) -> tuple[EdgeSpread, FloatArray]:
        sigma, values = np.where(away < 0, noise[0], noise[1]), np.empty((count, fit.pixel.size))
        for own in values:
            picture = clean + sigma * rng.standard_normal(clean.shape)
            picture = written(picture if found.vertical else picture.T, rng)
            own[:] = (picture if found.vertical else picture.T).ravel()[fit.pixel]
        curves, rest = refitted(fit, found.curve, values, tails)
        return curves, np.array([np.mean(rest[:, side] ** 2) for side in sides])

    left = np.array([float(np.mean(fit.rest[side] ** 2)) for side in sides])
    quiet, loud = taken(np.zeros(2), TRIED)[1], taken(np.sqrt(left), TRIED)[1]
    shows = loud > SEEN * quiet
    share = np.where(shows, (left - quiet) / np.where(shows, loud - quiet, 1.0), 0.0)
    sigma = np.sqrt(np.clip(share, 0.0, MOST**2) * left)
    curves, _ = taken(sigma, TIMES)
    said = []
    for at, moved in zip(own, crossings(curves), strict=True):
        if math.isfinite(at) and np.isfinite(moved).all():
            said.append(Rewritten(float(moved.mean() / at - 1), float(moved.std(ddof=1) / at), float(sigma.min())))
        else:
            said.append(Rewritten(0.0, math.inf, float(sigma.min())))
    return said
