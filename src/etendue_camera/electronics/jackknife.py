"""Confidence intervals for measurements on an area of pixels: the delete-a-group jackknife over 8 x 8 blocks.

In:  planes (y, x); an estimate from all pixels, and estimates with one block omitted.
Out: the estimate with its confidence interval.
Sources: Efron and Tibshirani 1993 (delete-a-group jackknife).
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

BLOCKS = 8  # along y and along x: 64 groups of pixels


@dataclass(frozen=True)
class Estimate:
    """A measured value and its confidence interval; NaN if the frames do not determine it."""

    value: float
    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:.6g} [{self.low:.6g}, {self.high:.6g}] {self.unit}".rstrip()


class Jackknife:
    """Confidence intervals from replicates: the first is estimated from all pixels, the others omit one group each."""

    def __init__(self, confidence: float) -> None:
        self.t = float(scipy.special.stdtrit(BLOCKS**2 - 1, 0.5 + 0.5 * confidence))

    def error(self, values: NDArray) -> float:
        left_out = values[1:]
        return float(np.sqrt((left_out.size - 1) * np.mean((left_out - left_out.mean()) ** 2)))

    def of(self, values: NDArray, unit: str) -> Estimate:
        value, wide = float(values[0]), self.t * self.error(values)
        return Estimate(value, value - wide, value + wide, unit)

    def root(self, squares: NDArray, unit: str) -> Estimate:
        """Return the estimate of a standard deviation from variances; a negative variance counts as 0."""
        square, wide = float(squares[0]), self.t * self.error(squares)
        low, value, high = np.sqrt(np.maximum([square - wide, square, square + wide], 0.0))
        return Estimate(float(value), float(low), float(high), unit)


def left_out(plane: NDArray) -> NDArray:
    """Return the sum over all pixels, then the sums that omit one block each: (1 + 64,)."""
    edges = [np.linspace(0, size, BLOCKS + 1).astype(int)[:-1] for size in plane.shape]
    blocks = np.add.reduceat(np.add.reduceat(plane, edges[0], axis=0), edges[1], axis=1).ravel()
    total = blocks.sum()
    return np.concatenate([[total], total - blocks])
