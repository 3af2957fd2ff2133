"""Transfer function from a picture of a random texture whose original, or whose spectrum, is known.

In:  a linear picture (y, x) and the original at the same places, such as `dead_leaves` rendered at the pixels' centres.
Out: frequencies (cycles/pixel), response, coherence, MTF50 with flags.
Sources: Kirk et al. (2014), cross spectrum with the known chart; Cao, Guichard and Hornung (2009) and Burns (2011),
power spectrum minus the power spectrum of the noise; Hann windows, means over rings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.resolution.crossing import falls_to

METHODS = ("cross", "power")
NYQUIST = 0.5
SMALLEST = 64
SLOW = 0.2  # cycles/pixel up to which phases are used to find a shift
ROUNDS = 5


@dataclass(frozen=True)
class TextureResponse:
    """Results of a texture. Frequencies in cycles/pixel, means over all directions."""

    frequency: FloatArray
    sfr: FloatArray
    coherence: FloatArray  # 0 to 1: fraction of the picture's power explained by the original
    doubt: FloatArray  # standard error of sfr from the coherence
    mtf50: float  # NaN if not reached below 0.5 cycles/pixel
    mtf10: float
    not_reached: bool
    gain: float  # picture over original at frequency 0
    shift: tuple[float, float]  # of the picture relative to the original, y and x, pixels


def texture_response(
    picture: ArrayLike,
    original: ArrayLike,
    *,
    method: str = "cross",
    known: Callable[[FloatArray], ArrayLike] | None = None,
    noise: ArrayLike | None = None,
    gain: float | None = None,
    rings: int | None = None,
) -> TextureResponse:
    """Measure the response of an imaging system from a picture of a texture.

    Parameters
    ----------
    picture : (y, x) array, any linear unit
        At least 64 x 64.
    original : (y, x) array
        For ``"cross"``, the texture at the positions of the picture, to within a few pixels; for ``"power"``, any part
        of the same texture with the shape of the picture. The original must be free of aliasing: render it with a
        softness of at least 0.7 pixels.
    method : {"cross", "power"}
        ``"cross"``: cross spectrum over the original's power, unaffected by noise, aliases and anything else that the
        original does not explain. ``"power"``: root of the ratio of powers, where all of these count as contrast.
    known : callable or None
        Transfer function, by cycles/pixel, that the original already includes, such as its softness: the response is
        multiplied by it. None: 1.
    noise : (y, x) array, number or None
        For ``"power"``: the noise whose power is subtracted, as a uniformly lit part of a picture from the same camera,
        of at least 64 x 64 pixels, or as the rms of white noise.
    gain : float or None
        Picture over original at frequency 0; None: the ratio of their means, for which 0 must mean no light in both.
    rings : int or None
        Number of rings from 0 to 0.5 cycles/pixel, at least 8; None: a quarter of the shorter side, at most 64.

    Returns
    -------
    TextureResponse

    Raises
    ------
    ValueError
        If arguments are out of range or have inconsistent shapes, or the original has no texture.

    Notes
    -----
    Picture and original are windowed and Fourier transformed, the shift between them is found from the cross spectrum's
    phase and removed, and powers are summed over rings. The response of a ring is at its mean frequency, weighted by
    the original's power. Error for 400 x 400 pixels, leaves of 4 to 60 pixels, Gaussians of 0.45 to 1.5 pixels rms:
    cross, MTF50 within 0.5 % noise-free and 1 % with noise of 5 % of the mean. Power, with known noise and the same
    chart: within 1 % for MTF50 up to 0.32 cycles/pixel, and 6 % at 0.42, where aliases count as contrast. With another
    part of such a chart: 13 %, because a few large leaves dominate its power (``python benchmarks/resolution.py``). For
    linear processing only: content-dependent denoising or sharpening has no transfer function, and the two methods then
    differ.

    """
    image, ideal = np.asarray(picture, np.float64), np.asarray(original, np.float64)
    _check(image, ideal, method, noise, gain, rings)
    shape = image.shape
    count = rings or min(64, min(shape) // 4)
    scale = gain if gain is not None else float(image.mean() / ideal.mean())
    require.that(math.isfinite(scale) and scale != 0, "picture and original have no ratio at frequency 0; give gain")
    seen, ideal_spectrum = _spectrum(image), _spectrum(ideal)
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    radial = np.hypot(fy, fx)
    ring = np.minimum((radial / NYQUIST * count).astype(np.intp), count)
    # the half plane that rfft leaves out
    twice = np.where((fx > 0) & (fx < NYQUIST), 2.0, 1.0) * np.ones(shape[:1])[:, None]

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(ring.ravel(), (twice * values).ravel(), count + 1)[:count], np.float64)

    cross = seen * ideal_spectrum.conj()
    shift = _shift(cross, fy, fx, radial) if method == "cross" else (0.0, 0.0)
    cross = cross * np.exp(2j * np.pi * (fy * shift[0] + fx * shift[1]))
    power, own = total(np.abs(seen) ** 2), total(np.abs(ideal_spectrum) ** 2)
    require.that(
        own[1:].min() > 0,
        "original has rings without power; it must have texture at all frequencies up to 0.5 cycles/pixel",
    )
    frequency = total(np.abs(ideal_spectrum) ** 2 * radial) / own
    together = total(cross.real)
    coherence = np.clip(together**2 / np.maximum(power * own, 1e-300), 0, 1)
    if method == "cross":
        sfr = together / own / scale
    else:
        sfr = np.sqrt(np.maximum(power - _noise_power(noise, shape, count), 0.0) / own) / abs(scale)
        coherence = np.full_like(sfr, np.nan)
    if known is not None:
        sfr = sfr * np.asarray(known(frequency), np.float64)
    number = total(np.ones_like(radial))
    free = 0.5 * number / 1.94  # a Hann window correlates 1.94 frequencies along each axis; half are mirrored
    doubt = np.abs(sfr) * np.sqrt((1 - coherence) / np.maximum(2 * coherence * free, 1e-300))
    # the first contains the mean
    sfr, frequency, coherence, doubt = (part[1:] for part in (sfr, frequency, coherence, doubt))
    mtf50, mtf10 = (falls_to(share, frequency, sfr) for share in (0.5, 0.1))
    return TextureResponse(frequency, sfr, coherence, doubt, mtf50, mtf10, math.isnan(mtf50), scale, shift)


def _check(
    image: FloatArray, ideal: FloatArray, method: str, noise: ArrayLike | None, gain: float | None, rings: int | None
) -> None:
    for name, value in (("picture", image), ("original", ideal)):
        require.shape(
            value.ndim == 2 and min(value.shape, default=0) >= SMALLEST and np.isfinite(value).all(),
            name,
            value,
            f"(y, x) of at least {SMALLEST} x {SMALLEST} finite values",
        )
    require.shape(image.shape == ideal.shape, "original", ideal, f"the shape of the picture, {image.shape}")
    require.only(method in METHODS, "method", repr(method), f"one of {', '.join(METHODS)}")
    require.only(gain is None or (math.isfinite(gain) and gain != 0), "gain", gain, "a finite number other than 0")
    require.only(rings is None or 8 <= rings <= min(image.shape) // 2, "rings", rings, f"8 to {min(image.shape) // 2}")
    flat = None if noise is None else np.asarray(noise)
    require.shape(flat is None or flat.ndim in (0, 2), "noise", flat, "a number or (y, x)")
    require.only(flat is None or flat.ndim != 0 or flat >= 0, "noise", flat, "0 or above")
    require.shape(
        flat is None or flat.ndim != 2 or min(flat.shape) >= SMALLEST,
        "noise",
        flat,
        f"at least {SMALLEST} x {SMALLEST}",
    )


def _window(shape: tuple[int, ...]) -> FloatArray:
    down, across = (0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n) for n in shape)
    return np.asarray(down[:, None] * across, np.float64)


def _spectrum(image: FloatArray) -> np.ndarray:
    """Return the transform of the picture minus its weighted mean, windowed, over the root of the window's energy."""
    window = _window(image.shape)
    mean = (window * image).sum() / window.sum()
    return np.fft.rfft2(window * (image - mean)) / math.sqrt((window**2).sum())


def _noise_power(noise: ArrayLike | None, shape: tuple[int, ...], count: int) -> FloatArray:
    """Return the noise power in each ring, (count,), for a picture of this shape."""
    if noise is None:
        return np.zeros(count)
    flat = np.asarray(noise, np.float64)
    if flat.ndim == 0:
        return float(flat) ** 2 * _by_ring(np.ones((shape[0], shape[1] // 2 + 1)), shape, count)
    own = _by_ring(np.abs(_spectrum(flat)) ** 2, flat.shape, count)
    number = _by_ring(np.ones((flat.shape[0], flat.shape[1] // 2 + 1)), flat.shape, count)
    wanted = _by_ring(np.ones((shape[0], shape[1] // 2 + 1)), shape, count)
    return np.asarray(own / np.maximum(number, 1) * wanted, np.float64)


def _by_ring(values: FloatArray, shape: tuple[int, ...], count: int) -> FloatArray:
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    ring = np.minimum((np.hypot(fy, fx) / NYQUIST * count).astype(np.intp), count)
    twice = np.where((fx > 0) & (fx < NYQUIST), 2.0, 1.0)
    return np.asarray(np.bincount(ring.ravel(), (twice * values).ravel(), count + 1)[:count], np.float64)


def _shift(cross: np.ndarray, fy: FloatArray, fx: FloatArray, radial: FloatArray) -> tuple[float, float]:
    """Return the shift of the picture relative to the original, pixels, positive down and to the right."""
    rows, columns = cross.shape[0], 2 * (cross.shape[1] - 1)
    peak = np.fft.irfft2(cross, (rows, columns))
    y, x = np.unravel_index(int(peak.argmax()), peak.shape)
    shift = np.array([y - rows * (y > rows // 2), x - columns * (x > columns // 2)], np.float64)
    slow = (radial > 0) & (radial < SLOW)
    place = np.stack([np.broadcast_to(fy, radial.shape)[slow], np.broadcast_to(fx, radial.shape)[slow]], axis=1)
    for _ in range(ROUNDS):
        turned = cross[slow] * np.exp(2j * np.pi * place @ shift)
        weight = np.abs(turned)
        step = np.linalg.solve(place.T @ (place * weight[:, None]), place.T @ (weight * np.angle(turned))) / (
            -2 * np.pi
        )
        shift = shift + step
    return float(shift[0]), float(shift[1])
