"""How far band-limited light falls below zero where a grid cuts the lens' transfer function off.

In:  Nyquist frequency of the grid over the cut-off of the lens.
Out: undershoot of a point as a share of its peak, and of any scene as a share of its brightest value.
Sources: the discrete Fourier transform of the cut transfer function (Goodman, Introduction to Fourier Optics, eq.
6-32).

Light that a grid resolves up to the cut-off has no undershoot. Below that, the point spread function on the grid is
that of the square of frequencies which is left, and its dark rings are negative.
"""

from functools import lru_cache

import numpy as np
import scipy

from etendue import require
from etendue_camera.optics.diffraction import circular_otf

SIDE = 128  # samples of the plane on which the point is looked at

LARGEST_OF_A_POINT = 0.0191
"""Undershoot of a point behind a perfect lens at the worst of all gratings: Nyquist at 0.68 of the cut-off."""
LARGEST_OF_A_SCENE = 0.0628
"""The same of any scene, over its brightest value: Nyquist at 0.60 of the cut-off."""


@lru_cache(maxsize=4096)
def undershoot(ratio: float) -> tuple[float, float]:
    """How negative samples of light behind a perfect circular lens can be.

    Parameters
    ----------
    ratio : float, 1
        Nyquist frequency of the grid, 1/(2 spacing), over the cut-off 1/(lambda N); above 0.

    Returns
    -------
    point : float, 1
        Undershoot of a single bright sample, over its peak behind the lens. At most 0.0191.
    scene : float, 1
        Undershoot of any scene without negative light, over its brightest sample: the sum of what is negative in the
        point spread function. At most 0.0628. A scene reaches it if it is bright exactly where the point spread
        function is negative.

    Raises
    ------
    ValueError
        For a ratio that is not above 0.

    Notes
    -----
    On a plane of 128 x 128 samples; against 256 x 256 both change by 0.2 %. Exactly 0 from a ratio of 1 on. At the
    samples; between them, where a pixel that is no whole multiple of the spacing looks, a point falls further.
    """
    require.positive("ratio", ratio)
    if ratio >= 1:
        return 0.0, 0.0
    fy, fx = scipy.fft.fftfreq(SIDE)[:, None], scipy.fft.rfftfreq(SIDE)[None, :]
    kernel = scipy.fft.irfft2(circular_otf(np.hypot(fy, fx), 1.0, 2.0 * float(ratio)), s=(SIDE, SIDE))
    return float(max(-kernel.min() / kernel.max(), 0.0)), float(-kernel[kernel < 0].sum())
