"""Whole curves beside the figures of resolution: contrast at shared frequencies, from transfer functions or of a
measured edge.

In:  transfer functions, measured edges; the pitch of the pixels.
Out: contrast over ``frequency`` (cycles/pixel), and the same frequencies in cycles/mm.

Frequencies are counted by the pixel: 65 from 0 to 1, so that the Nyquist frequency is the 33rd whatever the pitch,
cells of a sweep over it share one coordinate, and every sample is a binary fraction. At 1 cycle/pixel a pixel without
gaps has its first zero, and a measured edge ends there. A straight line between two of them errs by less than 1e-3 of
contrast where the cut-off of the lens lies above half a cycle a pixel, and the more the slower the lens: 3e-2 where all
its contrast is in the first five samples.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from etendue.api import Labels
from etendue_camera.arrays import Array, FloatArray

SAMPLES = 65
PER_PIXEL = np.linspace(0.0, 1.0, SAMPLES)  # cycles/pixel
FREQUENCY = Labels(tuple(PER_PIXEL.tolist()), "cycles/pixel")


def beside(pitch: float) -> dict[str, Array]:
    """The frequencies in cycles/mm, and that of Nyquist, of pixels of ``pitch`` um."""
    return {"frequency_lp_mm": PER_PIXEL / pitch * 1e3, "nyquist_lp_mm": np.array(0.5 / pitch * 1e3)}


def undefined() -> FloatArray:
    return np.full(SAMPLES, math.nan)


def of_edge(frequency: FloatArray, sfr: FloatArray, per_pixel: float) -> FloatArray:
    """(frequency,): a response at samples of its picture (cycles/sample) at the camera's; NaN where the picture does
    not see so far.

    ``per_pixel``: samples of the picture a pixel. By a cubic spline through the 201 samples of the response: within
    2e-4 of what the edge itself says where its MTF50 is above 0.05 cycles/sample, within 2e-3 at 0.015.
    """
    wanted = PER_PIXEL / per_pixel
    seen = wanted <= frequency[-1] * (1 + 1e-12)
    curve = scipy.interpolate.CubicSpline(frequency, sfr)
    return np.where(seen, np.maximum(curve(np.where(seen, wanted, 0.0)), 0.0), math.nan)
