"""The frequency at which a transfer function known on rings falls to a level.

In:  rings of frequency (ascending), the transfer function on them, and its standard error.
Out: the frequency of the crossing, in their unit; NaN if there is none.
"""

import math

import numpy as np

from etendue_camera.arrays import FloatArray

NEAR = 0.3  # of a crossing: the range of frequencies used to locate it


def falls_to(share: float, frequency: FloatArray, sfr: FloatArray, doubt: FloatArray | None = None) -> float:
    """Return the lowest frequency at which ``sfr`` falls below ``share``, in the unit of the rings; NaN without one.

    The crossing is located between two rings, then refined by a cubic through nearby rings, weighted by 1/``doubt``
    (equally if it is None).
    """
    below = np.flatnonzero(sfr < share)
    if below.size == 0 or below[0] == 0:
        return math.nan
    at = int(below[0])
    chord = float(
        frequency[at - 1] + (frequency[at] - frequency[at - 1]) * (sfr[at - 1] - share) / (sfr[at - 1] - sfr[at])
    )
    about = np.abs(frequency / chord - 1) < NEAR
    if about.sum() < 6:
        return chord
    weight = None if doubt is None else 1 / np.maximum(doubt[about], 1e-6)
    curve = np.polynomial.polynomial.polyfit(frequency[about] / chord - 1, sfr[about] - share, 3, w=weight)
    roots = np.polynomial.polynomial.polyroots(curve)
    real = roots.real[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) < NEAR)]
    return chord * (1 + float(real[np.abs(real).argmin()])) if real.size else chord
