"""Deconvolution with a known transfer function: Wiener filter and Richardson-Lucy.

In:  planes (..., y, x) in any unit; transfer function at the frequencies of the padded plane; properties of noise
     and signal.
Out: restored planes; the gain at each frequency.
Sources: N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series (1949); W. H. Richardson, J.
Opt. Soc. Am. 62 (1972) 55; L. B. Lucy, Astron. J. 79 (1974) 745; total variation after N. Dey et al., Microsc. Res.
Tech. 69 (2006) 260; the discrepancy principle of V. A. Morozov (1966).

Planes are continued seamlessly by their mirror image (``sampling.pad``), so neither filter sees the opposite border.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue.transfer import sampling

OUTER_FREQUENCY = 1 / 256  # cycles/pixel; below it the power spectrum of a picture is taken as flat
# times the largest value: with a larger pedestal, single precision would keep fewer than 20 bits of a picture
FAR_ABOVE = 16.0
HOT = 20.0  # largest value over the mean above which planes are deconvolved in double precision
STEEPEST = 1e-3  # of the largest value: much larger gradients count by direction only in the total variation


def frequencies(rows: int, columns: int) -> tuple[NDArray, NDArray]:
    """Return the frequencies along y and x, cycles/pixel, of the half spectrum of a padded plane, at which a transfer
    function is needed.

    Parameters
    ----------
    rows, columns : int
        Size of the frame.

    Returns
    -------
    (Ny,), (Nx // 2 + 1,) arrays
    """
    return sampling.frequencies(rows, 1.0, half=False), sampling.frequencies(columns, 1.0, half=True)


def wiener_gain(transfer: ArrayLike, noise_to_signal: ArrayLike) -> NDArray:
    """Return the gain of the linear filter with the smallest mean-square error.

    Parameters
    ----------
    transfer : (...) array, dimensionless
        H, real or complex, of any magnitude including 0.
    noise_to_signal : (...) array, dimensionless
        Noise power over the power of the undisturbed signal at the same frequencies, at or above 0.

    Returns
    -------
    (...) array, dimensionless
        conj(H) / (|H|^2 + nsr): 1/H where noise is negligible relative to |H|^2, 0 where H is 0; never above
        1 / (2 sqrt(nsr)). Double precision.

    Raises
    ------
    ValueError
        If noise_to_signal contains negative values or NaN.

    Notes
    -----
    Numerator and denominator are divided by max(|Re H|, |Im H|) first, because |H|^2 underflows to 0 for |H| below
    1e-162.
    Error: below 1e-15 relative (reference values wiener_gain).
    """
    transfer = np.asarray(transfer)
    noise_to_signal = np.asarray(noise_to_signal, dtype=float)
    if not np.all(noise_to_signal >= 0):
        raise ValueError(f"noise_to_signal is {noise_to_signal.min()!r} somewhere; it must be at or above 0")
    size = np.maximum(np.abs(transfer.real), np.abs(transfer.imag))
    tiny = np.finfo(float).tiny
    scale = np.maximum(size, tiny)
    unit = transfer / scale
    with np.errstate(over="ignore"):  # noise over almost nothing: the ratio is infinite, and the gain 0
        below = np.maximum((unit.real**2 + unit.imag**2) * scale + noise_to_signal / scale, tiny)
    return np.conj(unit) / below


def signal_spectrum(fy: ArrayLike, fx: ArrayLike, exponent: float = 2.0, outer: float = OUTER_FREQUENCY) -> NDArray:
    """Return the power spectrum of a picture: a power law, flat below an outer scale.

    Parameters
    ----------
    fy, fx : (...) array, cycles/pixel
    exponent : float
        Power falls as 1 / f^exponent, exponent 0 to 8; 2 for edges and natural scenes, 0 for a flat spectrum.
    outer : float, cycles/pixel
        Frequency above which the law holds; above 0 and below 1/2.

    Returns
    -------
    (...) array, pixel^2
        Power density whose integral over the disc up to 1/2 cycle per pixel is pi/4, the area of the disc; 1 everywhere
        for exponent 0.

    Raises
    ------
    ValueError
        If exponent or outer is out of range.

    Notes
    -----
    Source: (f^2 + outer^2)^(-exponent/2), integrated in closed form. For pictures: D. J. Field, J. Opt. Soc. Am. A 4
    (1987) 2379.
    """
    require.allowed(0 <= exponent <= 8, "exponent", exponent, "numbers from 0 to 8")
    require.allowed(0 < outer < 0.5, "outer", outer, "numbers above 0 and below 0.5 cycles/pixel")
    squared = np.asarray(fy, dtype=float) ** 2 + np.asarray(fx, dtype=float) ** 2 + outer**2
    power, decades = 1 - 0.5 * exponent, math.log((0.25 + outer**2) / outer**2)
    # (high^power - low^power) / power; near power = 0, where it equals `decades`, the difference would lose all digits
    area = outer ** (2 * power) * decades * (math.expm1(power * decades) / (power * decades) if power else 1.0)
    return 0.25 / area * squared ** (-0.5 * exponent)


def limited(gain: NDArray, largest: float) -> NDArray:
    """Return the gain with its magnitude limited to ``largest`` and its phase unchanged.

    Raises
    ------
    ValueError
        If largest is not above 0.
    """
    require.allowed(largest > 0, "largest", largest, "numbers above 0")
    if math.isinf(largest):
        return gain
    size = np.abs(gain)
    return gain * (largest / np.maximum(size, largest))


def apply(planes: NDArray, gain: NDArray) -> NDArray:
    """Return planes with every frequency multiplied by a gain.

    Parameters
    ----------
    planes : (..., ny, nx) array, any unit
    gain : (..., Ny, Nx // 2 + 1) array, dimensionless
        At `frequencies` (ny, nx), real or complex.

    Returns
    -------
    (..., ny, nx) array, unit and dtype of planes (integers become float64)

    Raises
    ------
    ValueError
        If the gain does not have the shape of the padded plane.

    Notes
    -----
    Error in float32: below 3e-7 of the largest value times the largest gain.
    """
    planes = _floating(planes)
    gain = _on_padded(planes, gain, "gain")
    return sampling.planes_of(sampling.transform(planes) * gain, *planes.shape[-2:])


def richardson_lucy_periodic(
    data: NDArray,
    transfer: NDArray,
    iterations: int,
    total_variation: float = 0.0,
    residual: float = 0.0,
    frame: tuple[int, int] | None = None,
    start: str = "mean",
) -> tuple[NDArray, float]:
    """Deconvolve one periodic plane multiplicatively: maximum likelihood for counts.

    Parameters
    ----------
    data : (ny, nx) array, any unit
        Not negative.
    transfer : (ny, nx // 2 + 1) array, dimensionless
        Half spectrum of the point spread function, 1 at zero frequency.
    iterations : int
        Maximum number of iterations, from 1.
    total_variation : float, dimensionless
        Weight of the regularisation that favours flat areas between sharp edges, 0 to 0.2.
    residual : float, unit of data
        Stop when the rms difference between the data and the blurred estimate has fallen to this value, between two
        iterations if necessary; 0: never.
    frame : (rows, columns) or None
        Size of the leading part to which the residual is limited; None: the whole plane.
    start : {"mean", "data"}
        Start from a uniform plane, as is usual, or from the data; the result is then never less sharp than the
        data.

    Returns
    -------
    (ny, nx) array, unit and dtype of data (integers become float64)
        Not negative; its sum equals the sum of the data.
    float
        Number of iterations done.

    Raises
    ------
    ValueError
        If the data are negative somewhere, shapes differ, or an argument is out of range.

    Notes
    -----
    x <- x H^T(y / Hx), where 0/0 is 0. The ratios y/Hx are limited to the largest ratio of the first iteration, max(y)
    / mean(y), so that they stay bounded even where a band-limited kernel, which has negative parts, makes Hx 0 or less.
    Values below 0 become 0 and the sum is restored; neither changes anything for a kernel without negative parts.
    Stopping between two iterations makes the result continuous in the data. Error: below 3e-14 of the largest value
    after 20 iterations (reference richardson_lucy_1d).
    """
    data = _floating(data)
    seen = tuple(slice(size) for size in frame or data.shape)
    require.that(
        data.ndim == 2 and transfer.shape == (data.shape[0], data.shape[1] // 2 + 1),
        f"data has shape {data.shape} and transfer {transfer.shape}; allowed: (ny, nx) and (ny, nx // 2 + 1)",
    )
    if data.size and not data.min() >= 0:
        raise ValueError(
            f"data holds {data.min():g}; it must be at or above 0: add a pedestal, and subtract it afterwards"
        )
    require.allowed(start in ("mean", "data"), "start", start, "'mean' and 'data'")
    require.allowed(iterations >= 1 and iterations == int(iterations), "iterations", iterations, "whole numbers from 1")
    require.allowed(0 <= total_variation <= 0.2, "total_variation", total_variation, "numbers from 0 to 0.2")
    require.amount("residual", residual)
    kind, (rows, columns) = data.dtype.type, data.shape
    forward = transfer.astype(
        np.result_type(data.dtype, np.complex64) if np.iscomplexobj(transfer) else data.dtype, copy=False
    )
    back = np.conj(forward)

    def filtered(plane: NDArray, by: NDArray) -> NDArray:
        return scipy.fft.irfft2(scipy.fft.rfft2(plane, workers=1) * by, s=(rows, columns), workers=1)

    mean = float(data.mean(dtype=np.float64)) if data.size else 0.0
    if mean == 0:
        return np.zeros_like(data), float(iterations)
    least = data * kind(mean / float(data.max()))
    estimate = previous = data.copy() if start == "data" else np.full_like(data, mean)
    farther = math.inf
    for done in range(iterations + 1):
        if done == iterations and not residual:
            break
        model = filtered(estimate, forward)
        if residual:
            apart = math.sqrt(float(np.square((data - model)[seen]).mean(dtype=np.float64)))
            if apart <= residual:
                if done == 0:
                    return estimate, 0.0
                share = (farther - residual) / (farther - apart)
                return previous + kind(share) * (estimate - previous), done - 1 + share
            if done == iterations:
                break
            farther = apart
        np.maximum(model, least, out=model)
        ratio = np.divide(data, model, out=np.zeros_like(data), where=model > 0)
        previous, estimate = estimate, estimate * filtered(ratio, back)
        if total_variation:
            estimate /= 1 - kind(total_variation) * _curvature(previous)
        np.maximum(estimate, kind(0), out=estimate)
        level = float(estimate.mean(dtype=np.float64))
        if level == 0:  # underflow beside a hot pixel
            return previous, float(done)
        estimate *= kind(mean / level)
    return estimate, float(iterations)


def richardson_lucy(
    planes: NDArray,
    transfer: NDArray,
    iterations: int,
    total_variation: float = 0.0,
    residual: ArrayLike = 0.0,
    pedestal: float = 0.0,
    start: str = "mean",
) -> tuple[NDArray, NDArray]:
    """Apply `richardson_lucy_periodic` to planes with borders, each on its padded continuation.

    Parameters
    ----------
    planes : (channel, ny, nx) array, any unit
        Any sign; see pedestal.
    transfer : (channel or 1, Ny, Nx // 2 + 1) array, dimensionless
        At `frequencies` (ny, nx).
    iterations, total_variation, start
        As in `richardson_lucy_periodic`.
    residual : (channel,) array or float, unit of planes
    pedestal : float, unit of planes
        Added before and subtracted afterwards; raised if necessary so that the smallest value becomes 0.

    Returns
    -------
    (channel, ny, nx) array, unit and dtype of planes (integers become float64)
    (channel,) array
        Number of iterations done.

    Raises
    ------
    ValueError
        As in `richardson_lucy_periodic`, or if pedestal is out of range.
    """
    planes = _floating(planes)
    require.shape(planes.ndim == 3, "planes", planes, "(channel, y, x)")
    require.amount("pedestal", pedestal)
    given = np.broadcast_to(transfer, (planes.shape[0], *transfer.shape[-2:]))
    transfer = np.broadcast_to(_on_padded(planes, transfer, "transfer"), given.shape)
    limits = np.broadcast_to(np.asarray(residual, dtype=float), planes.shape[:1])
    result, done = np.empty_like(planes), np.empty(planes.shape[0])
    for channel, plane in enumerate(planes):
        whole = sampling.pad(plane)
        wanted = max(float(pedestal), -float(whole.min()))
        if wanted > FAR_ABOVE * float(whole.max()):  # single precision would keep the pedestal and lose the picture
            whole = whole.astype(np.float64)
        own = transfer[channel]
        if float(whole.max()) + wanted > HOT * (float(whole.mean(dtype=np.float64)) + wanted):
            # a Fourier transform spreads rounding of a hot pixel over all darker pixels; each iteration magnifies it
            whole, own = whole.astype(np.result_type(whole.dtype, np.float64), copy=False), given[channel]
        lift = whole.dtype.type(wanted)
        # if the pedestal equals the smallest value, rounding must not leave it below 0
        estimate, done[channel] = richardson_lucy_periodic(
            np.maximum(whole + lift, 0),
            own,
            iterations,
            total_variation,
            float(limits[channel]),
            plane.shape,
            start,
        )
        result[channel] = estimate[: plane.shape[0], : plane.shape[1]] - lift
    return result, done


def richardson_lucy_response(transfer: ArrayLike, iterations: float, start: str = "mean") -> NDArray:
    """Return the response of `richardson_lucy` to small contrasts on a uniform background, without total variation.

    Parameters
    ----------
    transfer : (...) array, dimensionless
        H, |H| < sqrt 2.
    iterations : float
        From 0. Between whole numbers, the two neighbouring responses are mixed, as when a residual stops the iteration.
    start : {"mean", "data"}
        As in `richardson_lucy_periodic`.

    Returns
    -------
    (...) array, dimensionless
        (1 - (1 - |H|^2)^n) / H: n conj(H) where H is small, 1/H where n is large, 1 where H is 1 and n >= 1. If the
        iteration starts from the data, (1 - |H|^2)^n is added, which gives 1 for n = 0.

    Raises
    ------
    ValueError
        If iterations is out of range, or |H| is too large: small contrasts would grow without bound.

    Notes
    -----
    Source: with x = c (1 + e) and y = c (1 + d), the iteration is to first order e <- e + H^T (d - H e), the Landweber
    iteration. The sum of powers is computed as -expm1(n log1p(-|H|^2)) / |H|^2.
    """
    require.amount("iterations", iterations)
    transfer = np.asarray(transfer)
    square = transfer.real.astype(float) ** 2 + transfer.imag.astype(float) ** 2
    if not np.all(square < 2):
        raise ValueError(f"transfer has a size of {math.sqrt(square.max()):g}; allowed: sizes below sqrt 2")
    require.allowed(start in ("mean", "data"), "start", start, "'mean' and 'data'")
    whole = math.floor(iterations)
    share = iterations - whole
    total, left = _sum_of_powers(square, whole), (1 - square) ** whole
    found = np.conj(transfer) * (total + share * left)
    return found + (1 - share * square) * left if start == "data" else found


def _sum_of_powers(square: NDArray, terms: int) -> NDArray:
    """Return 1 + q + ... + q^(terms - 1) with q = 1 - square."""
    inside = np.clip(square, np.finfo(float).tiny, 0.5)
    with np.errstate(under="ignore"):
        near = -np.expm1(terms * np.log1p(-inside)) / inside
        far = (1 - (1 - square) ** terms) / np.maximum(square, 0.5)
    return np.where(square <= 0.5, near, far)


def _curvature(plane: NDArray) -> NDArray:
    """Return the divergence of the unit vectors along the gradient, on a periodic plane: between -4 and 4 per pixel."""
    down, right = np.roll(plane, -1, 0) - plane, np.roll(plane, -1, 1) - plane
    least = plane.dtype.type((STEEPEST * float(plane.max())) ** 2 + np.finfo(plane.dtype).tiny)
    size = np.sqrt(down**2 + right**2 + least)
    down /= size
    right /= size
    return down - np.roll(down, 1, 0) + right - np.roll(right, 1, 1)


def _floating(planes: NDArray) -> NDArray:
    planes = np.asarray(planes)
    require.shape(planes.ndim >= 2, "planes", planes, "(..., y, x)")
    return require.floating(planes)


def _on_padded(planes: NDArray, values: NDArray, name: str) -> NDArray:
    values = np.asarray(values)
    rows, columns = (sampling.padded_size(size) for size in planes.shape[-2:])
    half = columns // 2 + 1
    what = f"(..., {rows}, {half}), at the frequencies of the padded plane"
    require.shape(values.shape[-2:] == (rows, half), name, values, what)
    return values.astype(
        np.result_type(planes.dtype, np.complex64) if np.iscomplexobj(values) else planes.dtype, copy=False
    )
