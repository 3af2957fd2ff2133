"""Sensor characterisation from raw frames according to EMVA 1288 release 4 (linear).

In:  stacks of raw frames (DN) under uniform light and in the dark, at ascending exposure times (s).
Out: gain (DN/electron), read noise, full well, DSNU (electrons), PRNU, dark current (electron/s), linearity,
     thresholds, each with a confidence interval.
Sources: EMVA 1288 release 4 linear, for the model and the quantities; Efron and Tibshirani 1993 (delete-a-group
jackknife) for the intervals. Departures are documented where they occur.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.electronics.jackknife import BLOCKS, Estimate, Jackknife, left_out

QUANTISATION = 1 / 12  # DN^2
LEAST_DARK_VARIANCE = 0.24  # DN^2: below, quantisation hides the read noise (EMVA 1288)


@dataclass(frozen=True)
class SensorFigures:
    """The results of `measure`.

    Attributes
    ----------
    gain : DN/electron, slope of the photon transfer curve
    read_noise : electrons, temporal dark noise at zero exposure time, quantisation removed
    dark_current : electron/s, from the mean of dark frames against time
    full_well : electrons, mean charge of frames beyond saturation (of full well or ADC)
    saturation_capacity : electrons, photocharge where the temporal variance is largest: EMVA's saturation
    dsnu, prnu : electrons and relative: DSNU1288, PRNU1288, at ``pattern_level``
    linearity_error : mean relative deviation from a line between 5 and 95 % of saturation
    absolute_sensitivity : electrons, photocharge at which SNR = 1
    dynamic_range, snr_max : dB
    quantum_efficiency : electrons per photon; NaN without photons
    pattern_level : the level nearest half saturation
    signal, variance : (level,) DN and DN^2, the photon transfer curve: means and temporal variances, dark subtracted
    dark_mean, dark_variance : (level,) DN and DN^2
    """

    gain: Estimate
    read_noise: Estimate
    dark_current: Estimate
    full_well: Estimate
    saturation_capacity: Estimate
    dsnu: Estimate
    prnu: Estimate
    linearity_error: Estimate
    absolute_sensitivity: Estimate
    dynamic_range: Estimate
    snr_max: Estimate
    quantum_efficiency: Estimate
    pattern_level: int
    signal: NDArray
    variance: NDArray
    dark_mean: NDArray
    dark_variance: NDArray

    @property
    def hidden(self) -> bool:
        """Return whether rounding hides the dark noise: means of dark frames are then nearer to integers than
        expected.
        """
        return bool(self.dark_variance.min() < LEAST_DARK_VARIANCE)


@dataclass(frozen=True)
class _Levels:
    """Moments by replicate and level. Replicate 0 includes all pixels; every other replicate omits one group of
    pixels.
    """

    mean: NDArray
    variance: NDArray  # temporal
    spatial: NDArray  # of the mean frame, corrected for residual temporal noise
    frames: NDArray


def measure(
    times: ArrayLike,
    light: Sequence[ArrayLike],
    dark: Sequence[ArrayLike],
    photons: ArrayLike | None = None,
    confidence: float = 0.95,
) -> SensorFigures:
    """Measure gain, noise, saturation and fixed patterns of a sensor, with confidence intervals.

    Parameters
    ----------
    times : (level,) array, s
        Exposure times, ascending, above 0; at least four.
    light : sequence of (frame, y, x) arrays, DN
        Raw frames under uniform light, one stack per level, at least two frames each, at least 8 x 8 pixels. The
        longest times should saturate: otherwise full well, saturation and derived metrics are NaN.
    dark : sequence of (frame, y, x) arrays, DN
        Raw frames without light at the same times, black level neither subtracted nor reached.
    photons : (level,) array, photons per pixel, optional
        Photons per pixel at each light level.
    confidence : float
        Confidence level of the intervals, above 0 and below 1.

    Returns
    -------
    SensorFigures

    Raises
    ------
    ValueError
        If the stacks do not match the times or each other, have too few frames or pixels, or contain no photon
        transfer curve.

    Notes
    -----
    Source: EMVA 1288 release 4 linear. With mean mu and temporal variance s2 of light (y) and dark (d) frames of one
    time: s2_y - s2_d = K (mu_y - mu_d) up to 70 % of saturation, through the origin; read noise^2 = (s2_d - 1/12 - K
    (mu_d - mu_d0)) / K^2; dark current = slope of mu_d over time / K; DSNU = spatial deviation of the mean dark frame /
    K; PRNU^2 = (difference of the spatial variances) / (mu_y - mu_d)^2, at half saturation. Offsets common to a whole
    frame (a lamp that drifts) are taken out of the temporal variance.

    Departures. The photon transfer curve is fitted with the weights of a normal variance (the standard weights all
    levels equally, which widens the interval of K by a quarter). Dark noise is averaged over all times, with the shot
    noise of the dark current subtracted. `full_well` is the mean beyond saturation; unlike `saturation_capacity`, it is
    not too low by a fraction of a level step.

    Intervals come from a delete-a-group jackknife over 8 x 8 blocks of pixels with Student's t: pixels are treated as
    independent samples of both temporal noise and patterns. Row and column patterns are counted in DSNU, but their
    interval is then too narrow. Coverage of 95 % intervals: `python benchmarks/emva.py`.
    """
    time = np.asarray(times, dtype=float)
    _check(time, light, dark, confidence)
    y, d = _moments(light), _moments(dark)
    interval = Jackknife(confidence)
    signal, excess = y.mean - d.mean, y.variance - d.variance

    peak = int(np.argmax(y.variance[0]))
    quiet = y.variance[0] < 1.1 * d.variance[0] + 0.005 * y.variance[0].max()
    beyond = np.flatnonzero(quiet & (np.arange(time.size) > peak) & (signal[0] > 0.9 * signal[0, peak]))
    saturates = beyond.size > 0
    top = signal[0, peak]  # if nothing saturates, take the signal of the brightest level
    used = (signal[0] > 0) & (signal[0] <= 0.7 * top)
    if np.count_nonzero(used) < 3 or not np.any(excess[0][used] > 0):
        raise ValueError(
            f"{np.count_nonzero(used)} levels are above dark and below 70 % of saturation; a photon transfer curve "
            f"requires at least "
            "three, with more noise in light than in the dark"
        )
    gain = _slope(signal, excess, used, y, d)

    slope, origin = _line(time, d.mean)
    read_dn2 = _dark_noise(d, gain, origin) - QUANTISATION
    shown = float(d.variance[0].min()) >= LEAST_DARK_VARIANCE
    read = (
        interval.root(read_dn2 / gain**2, "electron")
        if shown
        else Estimate(np.nan, 0.0, 0.4 / float(gain[0]), "electron")
    )
    floor = np.sqrt(np.maximum(read_dn2 + QUANTISATION, 0)) / gain
    threshold = np.hypot(floor, 0.5) + 0.5

    nan = np.full(gain.shape, np.nan)
    capacity = signal[:, peak] / gain if saturates else nan
    well = (y.mean[:, beyond].mean(axis=1) - origin) / gain if saturates else nan
    half = _half(signal[0], top, y.frames)
    dsnu2 = d.spatial[:, half] / gain**2
    prnu2 = (y.spatial[:, half] - d.spatial[:, half]) / signal[:, half] ** 2
    exposure = time if photons is None else np.asarray(photons, dtype=float)
    x = exposure[used]  # a line through the origin
    efficiency = nan if photons is None else (signal[:, used] * x).sum(axis=1) / (x**2).sum() / gain
    with np.errstate(invalid="ignore"):
        decibel = 20 * np.log10(capacity / threshold)
        best = 10 * np.log10(capacity)
    return SensorFigures(
        gain=interval.of(gain, "DN/electron"),
        read_noise=read,
        dark_current=interval.of(slope / gain, "electron/s"),
        full_well=interval.of(well, "electron"),
        saturation_capacity=interval.of(capacity, "electron"),
        dsnu=interval.root(dsnu2, "electron"),
        prnu=interval.root(prnu2, ""),
        linearity_error=interval.of(_linearity(exposure, signal, top), ""),
        absolute_sensitivity=interval.of(threshold, "electron"),
        dynamic_range=interval.of(decibel, "dB"),
        snr_max=interval.of(best, "dB"),
        quantum_efficiency=interval.of(efficiency, "electron/photon"),
        pattern_level=half,
        signal=signal[0],
        variance=excess[0],
        dark_mean=d.mean[0],
        dark_variance=d.variance[0],
    )


def saturation_of_well(full_well: float, prnu: float = 0.0) -> float:
    """Return the mean charge at which the temporal variance of a pixel is largest: the EMVA saturation capacity, which
    is below the full well.

    Parameters
    ----------
    full_well : float, electrons
        Charge at which pixels clip, above 0.
    prnu : float
        Relative rms of the response between pixels, over which the variance is averaged, 0 to 0.5.

    Returns
    -------
    float, electrons

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    Shot noise is modelled as a normal distribution of variance x, clipped at the well w: moments of min(z, a) with a =
    (w - x)/sqrt(x), averaged over responses with 41 Gauss-Hermite nodes. The result is the maximum over 4001 charges
    from 0.5 to 1.2 w. Read noise after the full well has no effect.
    Error: 5e-4 relative where w is above 500 electrons (from the normal approximation of Poisson counts).
    """
    require.that(
        full_well > 0 and 0 <= prnu <= 0.5,
        f"full_well is {full_well!r} and prnu {prnu!r}; they must be above 0, and 0 to 0.5",
    )
    nodes, weights = np.polynomial.hermite_e.hermegauss(41)
    factor = np.maximum(1 + prnu * nodes, 1e-6)[:, None]
    mean = np.linspace(0.5, 1.2, 4001) * full_well * factor
    sigma = np.sqrt(mean)
    a = (full_well - mean) / sigma
    density, below = np.exp(-0.5 * a**2) / np.sqrt(2 * np.pi), scipy.special.ndtr(a)
    first = -density + a * (1 - below)  # of min(z, a), z standard normal
    second = below - a * density + a**2 * (1 - below)
    share = (weights / weights.sum())[:, None]
    variance = (share * sigma**2 * (second - first**2)).sum(axis=0)
    charge = (share * (mean + sigma * first)).sum(axis=0)
    return float(charge[np.argmax(variance)])


def _check(time: NDArray, light: Sequence[ArrayLike], dark: Sequence[ArrayLike], confidence: float) -> None:
    if time.ndim != 1 or time.size < 4 or not np.all(time > 0) or not np.all(np.diff(time) > 0):
        raise ValueError(f"times are {time!r} s; at least four are required, above 0 and ascending")
    require.that(0 < confidence < 1, f"confidence is {confidence!r}; it must be above 0 and below 1")
    shapes = {np.shape(stack)[1:] for stacks in (light, dark) for stack in stacks}
    require.that(
        len(light) == time.size and len(dark) == time.size,
        f"light has {len(light)} stacks and dark {len(dark)}; one stack per time is required, {time.size}",
    )
    require.that(
        len(shapes) == 1 and not any(np.ndim(stack) != 3 for stacks in (light, dark) for stack in stacks),
        f"the frames are {sorted(shapes)} pixels; stacks (frame, y, x) of one size are required",
    )
    size = shapes.pop()
    require.that(
        min(size) >= BLOCKS and not any(np.shape(stack)[0] < 2 for stacks in (light, dark) for stack in stacks),
        f"the stacks have frames of {size} pixels; at least {BLOCKS} x {BLOCKS} pixels and two frames "
        f"per level are required",
    )


def _moments(stacks: Sequence[ArrayLike]) -> _Levels:
    """Return mean, temporal and spatial variance of every level, for all pixels and with one block omitted at
    a time.
    """
    means, variances, spatials, frames = [], [], [], []
    for stack in stacks:
        values = np.asarray(stack, dtype=float)
        count = values.shape[0]
        centre = values.mean()
        values = values - centre  # so that sums of squares keep their digits
        still = values.mean(axis=0)
        n = left_out(np.ones_like(still))
        total, squares = left_out(still), left_out(still**2)
        moving = left_out(values.var(axis=0, ddof=1))
        drift = np.stack([left_out(frame) for frame in values], axis=1) / n[:, None]
        mean = total / n
        # offsets of whole frames are not pixel noise; removing their variance removes 1/n of the noise too
        variance = (moving / n - drift.var(axis=1, ddof=1)) * n / (n - 1)
        means.append(mean + centre)
        variances.append(variance)
        spatials.append((squares - n * mean**2) / (n - 1) - variance / count)
        frames.append(count)
    return _Levels(np.stack(means, axis=1), np.stack(variances, axis=1), np.stack(spatials, axis=1), np.array(frames))


def _slope(signal: NDArray, excess: NDArray, used: NDArray, y: _Levels, d: _Levels) -> NDArray:
    """Return the gain K by replicate, DN/electron. Weights come from the model for all pixels, because weights from
    single variances would favour small variances.
    """
    first = float((signal[0, used] * excess[0, used]).sum() / (signal[0, used] ** 2).sum())
    dark = np.median(d.variance[0]) + first * (d.mean[0, used] - np.median(d.mean[0]))
    dark = np.maximum(dark, 0.5 * np.median(d.variance[0]))
    bright = dark + first * signal[0, used]
    weight = 1 / (bright**2 / (y.frames[used] - 1) + dark**2 / (d.frames[used] - 1))
    x, v = signal[:, used], excess[:, used]
    return (weight * x * v).sum(axis=1) / (weight * x**2).sum(axis=1)


def _dark_noise(d: _Levels, gain: NDArray, origin: NDArray) -> NDArray:
    """Return the temporal dark variance without the shot noise of the dark charge, DN^2, by replicate."""
    charge = gain[:, None] * (d.mean - origin[:, None])
    least = d.variance[0] - charge[0]
    expected = np.maximum(np.median(least) + charge[0], 0.1 * np.median(d.variance[0]))
    weight = (d.frames - 1) / expected**2
    return (weight * (d.variance - charge)).sum(axis=1) / weight.sum()


def _half(signal: NDArray, top: float, frames: NDArray) -> int:
    """Return the level at which patterns are measured: among levels from 30 to 70 % of saturation, the level with the
    most frames; among equals, the level nearest to half of saturation.
    """
    near = np.abs(signal / top - 0.5)
    many = np.where(near <= 0.2, frames, 0)
    return int(np.lexsort((near, -many))[0])


def _line(x: NDArray, values: NDArray) -> tuple[NDArray, NDArray]:
    """Return slope and value at x = 0 of straight lines through (replicate, level) values."""
    centred = x - x.mean()
    slope = (values * centred).sum(axis=1) / (centred**2).sum()
    return slope, values.mean(axis=1) - slope * x.mean()


def _linearity(exposure: NDArray, signal: NDArray, top: float) -> NDArray:
    """Return the mean relative deviation from the line that minimises relative deviations, 5 to 95 % of saturation."""

    inside = (signal[0] >= 0.05 * top) & (signal[0] <= 0.95 * top)
    if np.count_nonzero(inside) < 3:
        return np.full(signal.shape[0], np.nan)
    x, values = exposure[inside], signal[:, inside]
    weight = 1 / values[0] ** 2
    centre = (weight * x).sum() / weight.sum()
    middle = (weight * values).sum(axis=1, keepdims=True) / weight.sum()
    slope = (weight * (x - centre) * values).sum(axis=1, keepdims=True) / (weight * (x - centre) ** 2).sum()
    line = middle + slope * (x - centre)
    return np.abs(values / line - 1).mean(axis=1)
