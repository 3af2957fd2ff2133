"""Photon transfer of real frames: the EMVA 1288 metrics, with intervals that include the deviation from a straight
line.

In:  moments and patterns of light and dark levels.
Out: for each metric, value and interval, or the frames that are needed to determine it.
Sources: EMVA 1288 release 4 (linear); all levels have equal weights, as in the fits of the standard.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from etendue.errors import RequestError
from etendue_camera.arrays import Array
from etendue_camera.electronics.emva import QUANTISATION
from etendue_camera.electronics.jackknife import Estimate, Jackknife
from etendue_lab.frames.frame_set import FrameSet, Level
from etendue_lab.frames.moments import MONO, LevelMoments, Site, moments
from etendue_lab.frames.patterns import DarkPatterns, Pattern, dark_patterns, differ, pattern

HIDDEN = 0.24  # DN^2: below this variance, EMVA 1288 states no dark noise
STACK = 8  # frames of one level
RANGE = 0.7  # fraction of saturation up to which EMVA 1288 fits lines
NONE = Estimate(math.nan, math.nan, math.nan, "")


@dataclass(frozen=True)
class Curve:
    """The photon transfer curve: levels of light by ascending mean. Arrays are (replicate, level); replicate 0 uses all
    pixels, every other replicate omits one block of pixels.
    """

    levels: list[Level]
    moments: list[LevelMoments]
    mean: Array
    variance: Array
    dark_mean: Array  # DN, of dark frames at the exposure time of the level
    dark_variance: Array
    exposure: Array  # (level,) photons per pixel, or relative
    dark: list[LevelMoments]
    dark_levels: list[Level]
    dark_slope: Array | None  # DN/s by replicate; None if dark frames have one exposure time
    dark_origin: Array  # DN at time 0
    top: int  # highest code
    saturates: bool
    peak: int  # index of the level of largest variance below saturation

    @property
    def signal(self) -> Array:
        return self.mean - self.dark_mean

    @property
    def excess(self) -> Array:
        return self.variance - self.dark_variance

    @property
    def full(self) -> float:
        """Signal at saturation, DN; if no level is saturated, the signal of the brightest level."""
        return float(self.signal[0, self.peak])

    @property
    def hidden(self) -> str:
        """The change that would make the dark noise measurable; empty if it is measurable."""
        weight = np.array([one.frames - 1.0 for one in self.dark])
        if sum(float(one.histogram[0]) for one in self.dark) > 1e-3 * sum(one.histogram.sum() for one in self.dark):
            return "a higher black level: the dark is cut off at code 0"
        if float((weight * np.array([one.variance[0] for one in self.dark])).sum() / weight.sum()) < HIDDEN:
            return "a higher gain: rounding hides the noise of the dark"
        return ""

    @property
    def line_noise(self) -> tuple[float, float]:
        """Return the temporal variance of row offsets and of column offsets in the dark, DN^2."""
        weight = np.array([one.frames - 1.0 for one in self.dark])
        rows, columns = (
            float((weight * own).sum() / weight.sum())
            for own in (
                np.array([one.row_variance for one in self.dark]),
                np.array([one.column_variance for one in self.dark]),
            )
        )
        return max(rows, 0.0), max(columns, 0.0)

    def line_error(self, frames: Array | float) -> Array:
        """Return the variance (DN^2) that row and column noise causes in the mean of ``frames`` frames."""
        rows, columns = self.line_noise
        return np.asarray((rows / self.dark[0].shape[0] + columns / self.dark[0].shape[1]) / frames)

    def between(self, low: float, high: float) -> Array:
        """Return a mask of the levels between two fractions of saturation."""
        signal = self.signal[0]
        return np.asarray(
            (signal > low * self.full) & (signal <= high * self.full) & (np.arange(signal.size) <= self.peak)
        )


def curve(frames: FrameSet, site: Site = MONO) -> Curve:
    """Return the curve of a measurement.

    Raises
    ------
    RequestError
        There are no dark frames, or fewer than three levels of light.
    """
    levels = frames.levels()
    dark_levels = [one for one in levels if one.dark]
    light_levels = [one for one in levels if not one.dark]
    if not dark_levels:
        raise RequestError(
            f"{frames.path}: has no dark frames; two are needed, at one exposure time or at every exposure time"
        )
    if len(light_levels) < 3:
        raise RequestError(
            f"{frames.path}: has {len(light_levels)} levels of light; a photon transfer curve needs three or more"
        )
    dark = [moments(frames, one, site) for one in dark_levels]
    light = [moments(frames, one, site) for one in light_levels]
    order = np.argsort([one.mean[0] for one in light], kind="stable")
    light, light_levels = [light[i] for i in order], [light_levels[i] for i in order]
    times = np.array([one.time for one in light])
    dark_mean, dark_variance, slope, origin = _dark(dark, times)
    mean, variance = np.stack([one.mean for one in light], 1), np.stack([one.variance for one in light], 1)
    top = max(one.top for one in light)
    clipped = np.array([one.share_at(top) for one in light])
    quiet = variance[0] < 1.1 * dark_variance[0] + 0.005 * variance[0].max()
    peak = int(np.argmax(variance[0]))
    beyond = (np.arange(len(light)) > peak) & (quiet | (clipped > 0.5))
    return Curve(
        light_levels, light, mean, variance, dark_mean, dark_variance, np.array([one.light for one in light]),
        dark, dark_levels, slope, origin, top, bool(beyond.any()), peak,
    )  # fmt: skip


def _dark(dark: list[LevelMoments], times: Array) -> tuple[Array, Array, Array | None, Array]:
    """Return the dark mean (DN) and variance (DN^2) at the exposure times of the light levels. They come from dark
    frames of the same time; without these, the mean comes from a line over time and the variance is averaged. Also
    return slope (DN/s) and origin (DN) of the line.
    """
    own = np.array([one.time for one in dark])
    mean, variance = np.stack([one.mean for one in dark], 1), np.stack([one.variance for one in dark], 1)
    weight = np.array([float(one.frames - 1) for one in dark])
    slope, origin = None, (mean * weight).sum(1) / weight.sum()
    if differ(own[~np.isnan(own)]):
        good = ~np.isnan(own)
        x, y, w = own[good], mean[:, good], weight[good]
        centred = x - (w * x).sum() / w.sum()
        slope = (y * w * centred).sum(1) / (w * centred**2).sum()
        origin = (w * y).sum(1) / w.sum() - slope * (w * x).sum() / w.sum()
    at_mean, at_variance = [], []
    flat = (variance * weight).sum(1) / weight.sum()
    for time in times:
        same = np.flatnonzero(np.isclose(own, time, rtol=1e-9, atol=0))
        if same.size:
            at_mean.append(mean[:, same[0]])
            at_variance.append(variance[:, same[0]])
        else:
            at_mean.append(origin + slope * time if slope is not None and not math.isnan(time) else origin)
            at_variance.append(flat)
    return np.stack(at_mean, 1), np.stack(at_variance, 1), slope, origin


@dataclass
class Figures:
    """Metrics by name; for metrics that the data do not determine, the frames that would determine them."""

    values: dict[str, Estimate] = field(default_factory=dict)
    needs: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    lack_of_fit: float = 1.0  # rms of the residuals of the photon transfer line over their statistical error

    def lacks(self, name: str, unit: str, why: str) -> None:
        self.values[name] = Estimate(math.nan, math.nan, math.nan, unit)
        self.needs[name] = why


def patterns(frames: FrameSet, found: Curve, site: Site = MONO) -> tuple[DarkPatterns | None, Pattern | None]:
    """Return the dark pattern (DN), and the pattern of the response (relative) from all levels between 5 and 70 % of
    saturation.
    """
    dark = dark_patterns(frames, found.dark_levels, site)
    used = np.flatnonzero(found.between(0.05, RANGE))
    signal = found.signal[0]
    # the variance of a relative response is about 1 / signal, so the weight is the signal
    light = pattern(frames, [(found.levels[i], float(signal[i]), float(signal[i])) for i in used], site)
    if dark is not None and light is not None:  # subtract offsets, which are not part of the response
        frames_of = np.array([len(found.levels[i].frames) for i in used], float)
        time = float((frames_of * np.array([found.levels[i].time for i in used])).sum() / frames_of.sum())
        light = light.less(dark.at(time), float(frames_of.sum() / (frames_of * signal[used]).sum()))
    return dark, light


def figures(frames: FrameSet, found: Curve, site: Site = MONO, confidence: float = 0.95) -> Figures:
    """Return the EMVA 1288 metrics.

    Raises
    ------
    RequestError
        Fewer than three levels lie between the dark and 70 % of saturation.
    """
    interval, result = Jackknife(confidence), Figures()
    used = found.between(0.0, RANGE)
    if np.count_nonzero(used) < 3 or not (found.excess[0][used] > 0).any():
        raise RequestError(
            f"{frames.path}: {np.count_nonzero(used)} levels are above the dark and below 70 % of saturation, with "
            f"more noise than the dark; three are needed"
        )
    gain, wide, result.lack_of_fit = _slope(
        found.signal[:, used], found.excess[:, used], _errors(found, used), interval
    )
    value = float(gain[0])
    result.values["gain"] = Estimate(value, value - wide, value + wide, "DN/electron")
    if result.lack_of_fit > 1.5:
        result.notes.append(
            f"the photon transfer curve is not a line: its residuals are {result.lack_of_fit:.2g} times their "
            "statistical "
            f"error, and the interval of K includes the slope at the dark; etendue calibrate fits a response that bends"
        )
    relative = wide / value

    def by_gain(values: Array, unit: str) -> Estimate:
        """Divide an estimate in DN by K. The interval includes the lack of fit of K."""
        own, error = float(values[0] / gain[0]), interval.t * interval.error(values / gain)
        error = math.hypot(error, own * relative)
        return Estimate(own, own - error, own + error, unit)

    weight = np.array([one.frames - 1.0 for one in found.dark])
    dark_variance = (np.stack([one.variance for one in found.dark], 1) * weight).sum(1) / weight.sum()
    read2 = dark_variance - QUANTISATION
    if found.dark_slope is not None and not found.hidden:  # shot noise of the dark charge
        times = np.array([one.time for one in found.dark])
        usual = float(np.nansum(times * weight) / weight[~np.isnan(times)].sum())
        result.values["dark_current"] = by_gain(found.dark_slope, "electron/s")
        read2 = read2 - np.maximum(gain * found.dark_slope * usual, 0.0)
    else:
        why = "" if found.dark_slope is None else found.hidden
        result.lacks("dark_current", "electron/s", why or "dark frames at two or more exposure times")
    if found.hidden:
        result.lacks("read_noise", "electron", found.hidden)
    else:
        result.values["read_noise"] = by_gain(np.sqrt(np.maximum(read2, 0)), "electron")
    if found.saturates:
        result.values["saturation_capacity"] = by_gain(found.signal[:, found.peak], "electron")
        floor = np.sqrt(np.maximum(dark_variance, 0)) / gain
        decibel = 20 * np.log10(found.signal[:, found.peak] / gain / (np.hypot(floor, 0.5) + 0.5))
        result.values["dynamic_range"] = interval.of(decibel, "dB")
        result.values["snr_max"] = interval.of(10 * np.log10(found.signal[:, found.peak] / gain), "dB")
    else:
        for name, unit in (("saturation_capacity", "electron"), ("dynamic_range", "dB"), ("snr_max", "dB")):
            result.lacks(name, unit, "levels bright enough to saturate")
    _efficiency(found, used, result, frames.photons, relative, gain, interval)
    _patterns(frames, found, site, result, relative, value, confidence)
    return result


def _patterns(
    frames: FrameSet, found: Curve, site: Site, result: Figures, relative: float, gain: float, confidence: float
) -> None:
    dark, light = patterns(frames, found, site)
    if found.hidden:
        result.lacks("dsnu", "electron", found.hidden)
    elif dark is not None:
        # as in the standard: at the exposure time of the stack, or at half saturation
        half = found.moments[int(np.argmin(np.abs(found.signal[0] - 0.5 * found.full)))]
        stack = max(found.dark, key=lambda one: one.frames)
        own = dark.at((stack if stack.frames >= STACK else half).time)
        result.values["dsnu"] = _root(own.variance(confidence), 1 / gain, relative, "electron")
        if own.frames < 8:
            result.notes.append(
                f"DSNU includes patterns that move between frames: {own.frames} dark frames do not separate them, 16 do"
            )
    if light is None:
        result.lacks("prnu", "", "levels between 5 and 70 % of saturation")
        return
    response = light.variance(confidence)
    result.values["prnu"] = _root(response, 1.0, 0.0, "")


def _root(square: Estimate, scale: float, relative: float, unit: str) -> Estimate:
    """Return the square root of a variance; the upper end of its interval is always above 0."""
    low, value, high = (math.sqrt(max(one, 0.0)) * scale for one in (square.low, square.value, square.high))
    if high <= 0:
        high = math.sqrt(square.high - square.value) * scale
    return Estimate(
        value, max(0.0, value - math.hypot(value - low, value * relative)),
        value + math.hypot(high - value, value * relative), unit,
    )  # fmt: skip


def _efficiency(
    found: Curve, used: Array, result: Figures, photons: bool, relative: float, gain: Array, interval: Jackknife
) -> None:
    x, signal = found.exposure[used], found.signal[:, used]
    rate = (signal * x).sum(1) / (x**2).sum()
    inside = found.between(0.05, 0.95)
    if np.count_nonzero(inside) >= 3:
        result.values["linearity_error"] = interval.of(_linearity(found.exposure[inside], found.signal[:, inside]), "")
    else:
        result.lacks("linearity_error", "", "three levels between 5 and 95 % of saturation")
    if not photons:
        result.lacks("quantum_efficiency", "electron/photon", "the photons per pixel of every level")
        return
    value = float(rate[0] / gain[0])
    low_end = float(np.polynomial.polynomial.polyfit(x / x.max(), signal[0] / x, 1)[0]) / float(rate[0]) - 1
    error = math.sqrt(
        (interval.t * interval.error(rate / gain)) ** 2 + (value * relative) ** 2 + (value * low_end) ** 2
    )
    result.values["quantum_efficiency"] = Estimate(value, value - error, value + error, "electron/photon")


def _linearity(x: Array, signal: Array) -> Array:
    """Return the mean relative deviation of the signal from a straight line, fitted with weights 1/signal^2."""
    weight = 1 / signal[0] ** 2
    mean_x = (weight * x).sum() / weight.sum()
    mean = (weight * signal).sum(1) / weight.sum()
    slope = (weight * (x - mean_x) * signal).sum(1) / (weight * (x - mean_x) ** 2).sum()
    return np.asarray(np.abs((signal - (mean[:, None] + slope[:, None] * (x - mean_x))) / signal).mean(1))


def _errors(found: Curve, used: Array) -> Array:
    """Return the sampling standard error of the variance of every level, DN^2."""
    light = np.array([2 / (one.frames - 1) / one.pixels for one in found.moments])
    dark = 2 / sum(one.frames - 1 for one in found.dark) / found.dark[0].pixels
    return np.asarray(np.sqrt(light * found.variance[0] ** 2 + dark * found.dark_variance[0] ** 2)[used])


def _slope(x: Array, v: Array, errors: Array, interval: Jackknife) -> tuple[Array, float, float]:
    """Return the gain K (DN/electron) of each replicate, the half width of the interval of K, and the lack of fit.

    The interval combines two errors: the jackknife over pixels, scaled by the lack of fit; and, if the curvature of a
    fitted parabola is significant at 1 %, the difference between K and the parabola's slope at zero.
    """
    gain = (x * v).sum(1) / (x**2).sum(1)
    residual = (v[0] - gain[0] * x[0]) / errors
    lack = math.sqrt(float((residual**2).sum()) / max(x.shape[1] - 1, 1))
    wide = interval.t * interval.error(gain) * max(lack, 1.0)
    if x.shape[1] >= 4:
        scale = float(x[0].max())
        design = np.stack([x[0] / scale, (x[0] / scale) ** 2], 1) / errors[:, None]
        inverse = np.linalg.inv(design.T @ design)
        fit = inverse @ design.T @ (v[0] / errors)
        left = (v[0] / errors) - design @ fit
        spread = max(1.0, math.sqrt(float((left**2).sum()) / (x.shape[1] - 2)))
        if abs(fit[1]) > 2.58 * spread * math.sqrt(inverse[1, 1]):
            wide = math.hypot(wide, float(fit[0]) / scale - float(gain[0]))
    return gain, wide, lack
