"""The next settings of a search, from a model of its trials: Gaussian processes for the goal and for every limit, and
the expected improvement times the probability that all limits are met.

In:  the trials so far, as points of a unit cube with their results; the seed and the number of the trial.
Out: the next point, which depends only on these inputs.
Sources: Jones et al. (1998), expected improvement; Gardner et al. (2014), with constraints; Knowles (2006), several
goals, weighted at random in each trial.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy

from etendue.types.arrays import Array, FloatArray

FIRST = 15  # points of a Latin hypercube, evaluated before the first model
REFIT = 5  # number of trials between two fits of the scales
SPREAD, CLOSE = 1024, 512  # candidates over the whole cube and around the best one
NEAR = (0.1, 0.02, 0.004)  # rms distances of the candidates around the best point
STEEP = 5.0  # limits are modelled by sign(e) log(1 + 5 |e|) of their excess e, which may be very large
ROOT5 = 5.0**0.5


@dataclass
class Process:
    """A Gaussian process with a Matern 5/2 kernel, a scale for each dimension, and the scales of its last fit."""

    scales: FloatArray = field(default_factory=lambda: np.zeros(0))  # logs: lengths, variance, noise

    def fit(self, points: FloatArray, values: FloatArray, anew: bool) -> None:
        self.points, self.mean, self.scale = points, float(values.mean()), float(values.std()) or 1.0
        y = (values - self.mean) / self.scale
        size = points.shape[1]
        middle = np.array([*[np.log(0.5)] * size, 0.0, np.log(1e-5)])
        width = np.array([*[1.0] * size, 1.5, 2.0])
        squares = (points[:, None, :] - points[None, :, :]) ** 2

        def loss(scales: FloatArray) -> tuple[float, FloatArray]:
            apart = squares * np.exp(-2 * scales[:size])
            r = ROOT5 * np.sqrt(apart.sum(axis=-1))
            decay = np.exp(scales[size] - r)
            kernel = (1 + r + r * r / 3) * decay
            noise = np.exp(scales[-1])
            try:
                factor = np.linalg.cholesky(kernel + (noise + 1e-8) * np.eye(len(y)))
            except np.linalg.LinAlgError:
                return 1e10, np.zeros_like(scales)
            inverse = scipy.linalg.cho_solve((factor, True), np.eye(len(y)))
            alpha = inverse @ y
            outer = 0.5 * (inverse - np.outer(alpha, alpha))
            prior = (scales - middle) / width
            found = 0.5 * y @ alpha + np.log(np.diag(factor)).sum() + 0.5 * prior @ prior
            slope = prior / width
            slope[:size] += np.einsum("ij,ijd->d", outer * (5 / 3) * (1 + r) * decay, apart)
            slope[size] += (outer * kernel).sum()
            slope[-1] += noise * np.trace(outer)
            return float(found), slope

        if anew or self.scales.size != middle.size:
            start = self.scales if self.scales.size == middle.size else middle
            bounds = [*[(np.log(0.02), np.log(20.0))] * size, (-4.0, 5.0), (np.log(1e-7), np.log(0.1))]
            self.scales = scipy.optimize.minimize(
                loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 30}
            ).x
        kernel = self._kernel(points) + (np.exp(self.scales[-1]) + 1e-8) * np.eye(len(y))
        self.factor = np.linalg.cholesky(kernel)
        self.alpha = scipy.linalg.cho_solve((self.factor, True), y)

    def _kernel(self, others: FloatArray) -> FloatArray:
        lengths = np.exp(self.scales[: self.points.shape[1]])
        r = ROOT5 * scipy.spatial.distance.cdist(others / lengths, self.points / lengths)
        return np.asarray((1 + r + r * r / 3) * np.exp(self.scales[-2] - r))

    def at(self, others: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the expected values and their standard deviations."""
        kernel = self._kernel(others)
        solved = scipy.linalg.solve_triangular(self.factor, kernel.T, lower=True)
        variance = np.maximum(np.exp(self.scales[-2]) - (solved**2).sum(axis=0), 1e-12)
        return self.mean + self.scale * (kernel @ self.alpha), self.scale * np.sqrt(variance)


@dataclass
class Model:
    """A search over a unit cube with ``size`` dimensions; goals are minimised."""

    size: int
    seed: int
    goal: Process = field(default_factory=Process)
    limits: dict[int, Process] = field(default_factory=dict)

    def next(self, points: FloatArray, goals: FloatArray, excess: FloatArray) -> FloatArray:
        """Return the next point.

        Parameters
        ----------
        points : (trial, size) array
        goals : (trial, goal) array
            NaN if a trial has no result.
        excess : (trial, limit) array
            Above 0 if a limit is exceeded; NaN if unknown.
        """
        number = len(points)
        draw = np.random.Generator(np.random.Philox(key=[self.seed, number]))
        if number < FIRST:
            square = np.random.Generator(np.random.Philox(key=[self.seed, 2**32]))
            places = np.stack([square.permutation(FIRST) for _ in range(self.size)], axis=1)
            return np.asarray((places[number] + draw.random(self.size)) / FIRST)
        anew = number % REFIT == 0
        there = np.isfinite(goals).all(axis=1)
        allowed = there & np.all(~(excess > 0), axis=1)
        limits = []
        for limit in range(excess.shape[1]):
            known = np.isfinite(excess[:, limit])
            if (excess[known, limit] > 0).any():
                process = self.limits.setdefault(limit, Process())
                process.fit(points[known], np.sign(e := excess[known, limit]) * np.log1p(STEEP * np.abs(e)), anew)
                limits.append(process)
        best, centre = np.inf, points[int(np.argmin(np.nansum(np.maximum(excess, 0), axis=1)))]
        if there.sum() > 1:
            values = _scaled(goals, np.asarray(allowed if allowed.any() else there), draw)
            self.goal.fit(points[there], values[there], anew)
            if allowed.any():
                best = float(values[allowed].min())
                centre = points[allowed][int(np.argmin(values[allowed]))]

        def worth(candidates: FloatArray) -> Array:
            found = np.zeros(len(candidates))
            for process in limits:
                mean, deviation = process.at(candidates)
                found += scipy.special.log_ndtr(-mean / deviation)
            if np.isfinite(best):
                mean, deviation = self.goal.at(candidates)
                found += _log_improvement((best - mean) / deviation) + np.log(deviation)
            return found

        near = [centre + width * draw.standard_normal((CLOSE // len(NEAR), self.size)) for width in NEAR]
        candidates = np.clip(np.concatenate([draw.random((SPREAD, self.size)), *near]), 0, 1)
        chosen = candidates[int(np.argmax(worth(candidates)))]
        closer = np.clip(chosen + 0.02 * draw.standard_normal((CLOSE // 2, self.size)), 0, 1)
        every = np.concatenate([chosen[None], closer])
        return np.asarray(every[int(np.argmax(worth(every)))])


def _scaled(goals: FloatArray, among: Array, draw: np.random.Generator) -> FloatArray:
    """Return a single goal unchanged; combine several goals with random weights (augmented Chebyshev norm)."""
    if goals.shape[1] == 1:
        return goals[:, 0]
    low, high = goals[among].min(axis=0), goals[among].max(axis=0)
    share = (goals - low) / np.where(high > low, high - low, 1.0)
    weights = draw.dirichlet(np.ones(goals.shape[1]))
    return np.asarray((weights * share).max(axis=1) + 0.05 * share @ weights)


def _log_improvement(z: FloatArray) -> FloatArray:
    """Return the logarithm of E[max(z + n, 0)] for a standard normal n: the expected improvement in units of the
    standard deviation.
    """
    density = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    tail = -0.5 * z * z - 2 * np.log(np.maximum(-z, 1.0))  # far below, up to a constant
    with np.errstate(divide="ignore"):
        return np.asarray(
            np.where(z > -6, np.log(np.maximum(z * scipy.special.ndtr(z) + density, 1e-300)), tail - 0.92)
        )
