"""What a lossy file has done to a measured edge: the edge that was found is written again and again, and measured again.

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

from etendue.physics.resolution.edge_line import FloatArray, distances
from etendue.physics.resolution.edge_spread import Curve, refitted
from etendue.physics.resolution.slanted_edge import Measured

Written = Callable[[FloatArray, np.random.Generator], FloatArray]
TIMES, TRIED = 16, 3  # edges that are written, and those that say how much noise they take
SEEN = 1.05  # times the rest without noise, from which on noise shows in a file
MOST = 3.0  # times the rest, of the noise in front of the file


@dataclass(frozen=True)
class Rewritten:
    """How far a file moves a frequency, of it."""

    bias: float
    spread: float  # standard deviation

    def reach(self, confidence: float) -> float:
        """Half of an interval about a measured frequency."""
        freedom = TIMES - 1
        spread = float(scipy.special.stdtrit(freedom, 0.5 + 0.5 * confidence)) * self.spread * math.sqrt(1 + 1 / TIMES)
        return math.hypot(spread, self.bias)


def rewritten(
    found: Measured, written: Written, tails: bool, crossings: Callable[[Curve], FloatArray], generator: np.random.Generator
) -> list[Rewritten]:
    """How far each of the frequencies that ``crossings`` finds in a curve (frequency, ...) is moved; inf where it is not reached.

    Notes
    -----
    The edge spread function that was found takes the place of the scene. It gets white noise, on either side of the edge so much as
    leaves behind the file what is left beside the edge; where noise does not come through, none is added.
    """
    v, across = np.linspace(-1.0, 1.0, found.rows), np.arange(found.columns) - 0.5 * (found.columns - 1)
    away = distances(found.coefficients, v, across, found.rows)
    clean, fit = found.curve.at(away), found.fit
    sides = (fit.distance < 0, fit.distance >= 0)

    def taken(noise: FloatArray, count: int) -> tuple[list[Curve], FloatArray]:
        curves, rests = [], []
        sigma = np.where(away < 0, noise[0], noise[1])
        for _ in range(count):
            picture = clean + sigma * generator.standard_normal(clean.shape)
            picture = written(picture if found.vertical else picture.T, generator)
            curve, rest = refitted(fit, found.curve, (picture if found.vertical else picture.T).ravel()[fit.pixel], tails)
            curves.append(curve)
            rests.append([float(np.mean(rest[side] ** 2)) for side in sides])
        return curves, np.mean(rests, axis=0)

    left = np.array([float(np.mean(fit.rest[side] ** 2)) for side in sides])
    quiet, loud = taken(np.zeros(2), TRIED)[1], taken(np.sqrt(left), TRIED)[1]
    shows = loud > SEEN * quiet
    share = np.where(shows, (left - quiet) / np.where(shows, loud - quiet, 1.0), 0.0)
    curves, _ = taken(np.sqrt(np.clip(share, 0.0, MOST**2) * left), TIMES)
    values = np.array([crossings(curve) for curve in curves])
    own = crossings(found.curve)
    said = []
    for at, moved in zip(own, values.T, strict=True):
        if math.isfinite(at) and np.isfinite(moved).all():
            said.append(Rewritten(float(moved.mean() / at - 1), float(moved.std(ddof=1) / at)))
        else:
            said.append(Rewritten(0.0, math.inf))
    return said
