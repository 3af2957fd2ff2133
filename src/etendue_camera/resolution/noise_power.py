"""Noise power spectra: propagation of independent pixel noise through stages, and periodograms.

In:  impulse responses of a chain and noise variances, for each site of the mosaic's unit cell; or frames of noise.
Out: cross power of channels at spatial frequencies (cycles/pixel), squared unit of the picture per pixel.
Sources: linear propagation, power = sum over places of v |H|^2; Bartlett's mean of periodograms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def spectra(responses: ArrayLike, sites: ArrayLike, fy: ArrayLike, fx: ArrayLike) -> ComplexArray:
    """Return the Fourier transforms of impulse responses, with the changed pixel as origin: (place, channel, m, n) at
    fy (m,) and fx (n,).

    Parameters
    ----------
    responses : (place, channel, y, x) array
        The response of the picture to a unit change of one pixel, for each place of the cell.
    sites : (place, 2) array
        Position of that pixel in the window, y and x, pixels.
    fy, fx : arrays
        Cycles/pixel.
    """
    h, at = np.asarray(responses, np.float64), np.asarray(sites, np.float64)
    require.that(
        h.ndim == 4 and at.shape == (h.shape[0], 2),
        f"responses has shape {h.shape} and sites {at.shape}; they must be (place, channel, y, x) and (place, 2)",
    )
    down = np.exp(
        -2j * np.pi * np.asarray(fy, np.float64)[None, :, None] * (np.arange(h.shape[2]) - at[:, :1])[:, None, :]
    )
    right = np.exp(
        -2j * np.pi * np.asarray(fx, np.float64)[None, :, None] * (np.arange(h.shape[3]) - at[:, 1:])[:, None, :]
    )
    return np.asarray(np.einsum("pmy,pcyx,pnx->pcmn", down, h, right, optimize=True))


def carried_power(answers: ArrayLike, variance: ArrayLike) -> ComplexArray:
    """Return the cross power (channel, channel, m, n) of propagated noise, averaged over the places of the cell.

    ``answers`` are from `spectra`; ``variance`` (place,) is the noise variance of a pixel at each place.

    Its integral over the Nyquist square is the covariance of `noise_propagation.carried_covariance`.
    """
    h, v = np.asarray(answers), np.asarray(variance, np.float64)
    require.allowed(np.all(v >= 0), "variance", v.tolist(), "numbers at or above 0")
    return np.asarray(np.einsum("p,pcmn,pdmn->cdmn", v, h, h.conj()) / len(h))


def carried_signal(answers: ArrayLike, signal: ArrayLike) -> ComplexArray:
    """Return the response (channel, m, n) of the chain to fine detail of relative contrast 1, from `spectra`.

    ``signal`` (place, m, n) is the mean of the pixels at each place of the cell times the transfer function before the
    chain. Power that the mosaic moves to other frequencies (aliases, colour fringes) is not included.
    """
    return np.asarray(np.einsum("pmn,pcmn->cmn", np.asarray(signal), np.asarray(answers)) / len(np.asarray(answers)))


def periodograms(frames: ArrayLike, block: int) -> tuple[ComplexArray, int]:
    """Return the mean cross power of frames of noise, and the number of independent periodograms.

    Parameters
    ----------
    frames : (frame, channel, y, x) array
        At least two frames of the same scene: their mean, which is signal and common noise, is subtracted, and the
        power is corrected by frames / (frames - 1).
    block : int, pixels
        Side of adjacent squares whose periodograms are taken, without a window. At least 2.

    Returns
    -------
    (channel, channel, block, block) array
        At ``numpy.fft.fftfreq(block)`` along y and x. The relative standard error of a power is 1 / sqrt(periodograms).
    int
        Number of independent periodograms in each value; one frame is lost to the subtracted mean.

    Raises
    ------
    ValueError
        If there are fewer than two frames, or the block is larger than the frame.
    """
    noise = np.asarray(frames, np.float64)
    require.shape(
        noise.ndim == 4 and noise.shape[0] >= 2, "frames", noise, "(frame, channel, y, x) with at least two frames"
    )
    count, channels, rows, columns = noise.shape
    require.allowed(2 <= block <= min(rows, columns), "block", block, f"2 to {min(rows, columns)} pixels")
    mean = noise.mean(axis=0)
    total, down, right = np.zeros((channels, channels, block, block), np.complex128), rows // block, columns // block
    for frame in noise:
        cut = (frame - mean)[:, : down * block, : right * block].reshape(channels, down, block, right, block)
        found = np.fft.fft2(cut, axes=(2, 4))
        total += np.einsum("caybx,daybx->cdyx", found, found.conj())
    blocks = down * right
    return total / ((count - 1) * blocks * block**2), (count - 1) * blocks


def expected_periodogram(responses: ArrayLike, variance: ArrayLike, block: int) -> ComplexArray:
    """Return the expected value of `periodograms` for propagated noise: the noise power spectrum, blurred by the
    transform of a square of ``block`` pixels.

    The result is exact: the covariance at each lag is weighted with the fraction of pixels in the square that have a
    neighbour at that lag (Bartlett's triangle). ``responses`` and ``variance`` are as in `spectra` and `carried_power`.
    Returns (channel, channel, block, block).
    """
    h, v = np.asarray(responses, np.float64), np.asarray(variance, np.float64)
    size = [2 * n for n in h.shape[-2:]]
    found = np.fft.fft2(h, size)
    covariance = np.fft.ifft2(np.einsum("p,pcyx,pdyx->cdyx", v, found, found.conj()) / len(h)).real
    lags = [np.fft.fftfreq(n, 1 / n) for n in size]
    share = [np.maximum(0.0, 1 - np.abs(lag) / block) for lag in lags]
    waves = [
        np.exp(-2j * np.pi * np.outer(np.fft.fftfreq(block), lag)) * own for lag, own in zip(lags, share, strict=True)
    ]
    return np.asarray(np.einsum("my,cdyx,nx->cdmn", waves[0], covariance, waves[1], optimize=True))
