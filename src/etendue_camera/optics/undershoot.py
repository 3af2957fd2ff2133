"""Undershoot below zero of band-limited light on a grid that truncates the transfer function of the lens.

In:  Nyquist frequency of the grid over the cut-off of the lens.
Out: undershoot of a point relative to its peak, and of any scene relative to its brightest value.
Sources: the discrete Fourier transform of the truncated transfer function (Goodman, Introduction to Fourier Optics, eq.
6-32).

A grid whose Nyquist frequency reaches the cut-off has no undershoot. On a coarser grid only a square of frequencies is
left, so that the dark rings of the point spread function become negative.
"""

from functools import lru_cache

import numpy as np
import scipy

from etendue import require
from etendue_camera.optics.diffraction import circular_otf

SIDE = 128  # samples along each side of the plane on which the point is evaluated

LARGEST_OF_A_POINT = 0.0191
"""Undershoot of a point behind a perfect lens on the worst grid, whose Nyquist frequency is 0.68 of the cut-off."""
LARGEST_OF_A_SCENE = 0.0628
"""Undershoot of any scene relative to its brightest value on the worst grid, whose Nyquist frequency is 0.60 of the
cut-off.
"""


@lru_cache(maxsize=4096)
def undershoot(ratio: float) -> tuple[float, float]:
    """Return how far samples of the light behind a perfect circular lens can fall below zero.

    Parameters
    ----------
    ratio : float, 1
        Nyquist frequency of the grid, 1/(2 spacing), over the cut-off 1/(lambda N); above 0.

    Returns
    -------
    point : float, 1
        Undershoot of a single bright sample relative to its peak behind the lens. At most 0.0191.
    scene : float, 1
        Upper bound on the undershoot of any non-negative scene relative to its brightest sample: the sum of the
        negative values of the point spread function. At most 0.0628. A scene reaches it if it is bright exactly where
        the point spread function is negative.

    Raises
    ------
    ValueError
        For a ratio that is not above 0.

    Notes
    -----
    Evaluated on a plane of 128 x 128 samples; with 256 x 256 both values change by 0.2 %. Exactly 0 for ratios of 1 and
    above. The values hold at the samples. Between samples, the undershoot of a point is larger; such values are read if
    the pixel pitch is not a whole multiple of the spacing.
    """
    require.positive("ratio", ratio)
    if ratio >= 1:
        return 0.0, 0.0
    fy, fx = scipy.fft.fftfreq(SIDE)[:, None], scipy.fft.rfftfreq(SIDE)[None, :]
    kernel = scipy.fft.irfft2(circular_otf(np.hypot(fy, fx), 1.0, 2.0 * float(ratio)), s=(SIDE, SIDE))
    return float(max(-kernel.min() / kernel.max(), 0.0)), float(-kernel[kernel < 0].sum())
