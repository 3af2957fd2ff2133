"""The effect of a restoration filter on resolution and noise, from its transfer function.

In:  responses at spatial frequencies (cycles/pixel), real or complex; the transfer function before the filter.
Out: gain in MTF50 and in noise, dimensionless.
Sources: Parseval's theorem for noise after a linear filter.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.resolution import contrast


def response_noise_gain(response: ArrayLike, spectrum: ArrayLike | None = None) -> float:
    """Return the factor by which a linear filter multiplies the standard deviation of noise.

    Parameters
    ----------
    response : (m, n) array, dimensionless
        Transfer function, real or complex, at frequencies evenly spaced over 1 x 1 cycles/pixel (those of a full
        discrete Fourier transform).
    spectrum : (m, n) array, any unit, or None
        Power spectrum of the noise at the same frequencies, not negative; None: white.

    Returns
    -------
    float, dimensionless
        Root of the mean of |response|^2, weighted with the spectrum.

    Raises
    ------
    ValueError
        If the shapes differ, or a spectrum is negative or nowhere positive.

    Notes
    -----
    Source: Parseval. Exact for a filter with fewer taps than frequencies.
    """
    power = np.abs(np.asarray(response)) ** 2
    if spectrum is None:
        return math.sqrt(float(power.mean()))
    spectrum = np.asarray(spectrum, dtype=float)
    require.that(
        spectrum.shape == power.shape,
        f"spectrum has shape {spectrum.shape}; it must equal the shape of the response, {power.shape}",
    )
    require.that(
        np.all(spectrum >= 0) and spectrum.sum() > 0,
        "spectrum has negative values or none above 0; it must contain powers",
    )
    return math.sqrt(float((power * spectrum).sum() / spectrum.sum()))


def mtf50_gain(
    system: Callable[[NDArray], NDArray], response: Callable[[NDArray], NDArray], highest: float = 1.0, nodes: int = 256
) -> float:
    """Return the ratio of MTF50 after a restoration filter to MTF50 before it.

    Parameters
    ----------
    system : callable
        Maps frequencies (n,) in cycles/pixel to the transfer function (n,) before the filter.
    response : callable
        The same for the filter, which works on pixels and is therefore periodic with 1 cycle/pixel.
    highest : float, cycles/pixel
        Upper end of the search.
    nodes : int
        Number of frequencies at which the first crossing is searched.

    Returns
    -------
    float, dimensionless
        Above 1 if the filter sharpens. NaN if contrast stays above one half up to ``highest``, before or after.

    Notes
    -----
    Contrast is relative to the contrast at zero frequency, before and after the filter. See `resolution.mtf50` for the
    search.
    """
    start = abs(complex(np.asarray(system(np.zeros(1)))[0])), abs(complex(np.asarray(response(np.zeros(1)))[0]))

    def before(frequency: NDArray) -> NDArray:
        return np.abs(np.asarray(system(frequency)))[None] / start[0]

    def after(frequency: NDArray) -> NDArray:
        return before(frequency) * (np.abs(np.asarray(response(frequency)))[None] / start[1])

    return contrast.mtf50(after, None, highest, nodes) / contrast.mtf50(before, None, highest, nodes)
