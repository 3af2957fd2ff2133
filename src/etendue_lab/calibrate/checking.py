"""Comparison of a calibrated sensor with the real frames, level by level, without rescaling.

In:  a measurement, its calibration.
Out: rows of levels: mean, variance, spatial spread, histogram distance, row and column spectra; measured and predicted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from etendue.types.documents import Document
from etendue_camera.arrays import Array
from etendue_lab.calibrate.response_fit import SEEN
from etendue_lab.calibrate.sensor_model import SensorModel
from etendue_lab.calibrate.simulating import SimulatedSensor
from etendue_lab.frames.frame_set import FrameSet
from etendue_lab.frames.moments import MONO, LevelMoments, Site
from etendue_lab.frames.transfer import Curve

BETWEEN = (0.02, 0.9)  # fractions of saturation between which levels count for the verdicts
LIMITS = {"variance_rms": 0.012, "variance_worst": 0.03, "mean_worst": 0.005}
SIDE = 256  # maximum rows and columns of simulated frames


@dataclass(frozen=True)
class _Simulated:
    mean: float
    variance: float
    spatial: float
    histogram: Array
    spectra: tuple[float, float]


def check(frames: FrameSet, model: SensorModel, site: Site = MONO, seed: int = 0) -> Document:
    """Return a row for each level, and the result of each check."""
    curve, fit = model.curve, model.response
    step = site[2]
    shape = tuple(min(size // step, SIDE) for size in frames.shape)
    sensor = SimulatedSensor(model, (shape[0], shape[1]), seed)
    black = _drift(curve)
    rows = []
    for i, (level, own) in enumerate(zip(curve.levels, curve.moments, strict=True)):
        light = np.array(own.light)
        dark = float(curve.dark_variance[0, i])
        clear = own.top < curve.top or own.share_at(curve.top) < 1e-3  # no pixel is at the top code
        seen = not curve.hidden or (own.variance[0] > SEEN and own.histogram[0] < 1e-3 * own.histogram.sum())
        after = own.time - curve.dark[0].time if fit.leak else 0.0
        predicted = min(float(fit.mean(light, after=after)), sensor.ceiling()) if clear else math.nan
        clear = clear and predicted < sensor.ceiling()
        fits = math.isnan(predicted) or abs(predicted / float(curve.signal[0, i]) - 1) < 0.01
        shown = own.light if fits else sensor.light_of(float(curve.signal[0, i]))
        simulated = _simulated(sensor, own.time, shown, min(own.frames, 16))
        real = frames.cut(level.frames[0])[site[0] :: step, site[1] :: step][: shape[0], : shape[1]].astype(float)
        signal = float(curve.signal[0, i])
        at_mean = float(fit.variance_at(np.array(signal), np.array(dark))) if clear else math.nan
        low, high = _interval(own, curve)
        # the lamp and the black level drift, which shifts the mean of a level and its whole histogram
        moved = math.hypot(fit.mean_error * signal, black)
        rows.append(
            {
                "level": i,
                "time": own.time,
                "light": own.light,
                "frames": own.frames,
                "signal": signal,
                "signal_predicted": predicted,
                "variance": float(own.variance[0]),
                "variance_low": low,
                "variance_high": high,
                "variance_predicted": at_mean,
                "spatial": float(own.spatial[0]),
                "spatial_error": _error(own.spatial),
                "spatial_predicted": simulated.spatial,
                "histogram_distance": _distance(own.histogram, simulated.histogram),
                "histogram_expected": _chance(own, simulated.histogram, moved),
                "row_spectrum": _lines(real)[0],
                "row_spectrum_predicted": simulated.spectra[0],
                "column_spectrum": _lines(real)[1],
                "column_spectrum_predicted": simulated.spectra[1],
                "judged": bool(curve.between(*BETWEEN)[i] and own.share_at(2**model.bits - 1) < 1e-3 and seen),
                "label_fits": fits,
            }
        )
    return {"channel": model.channel, "levels": rows, **_verdicts(rows, fit.mean_scatter)}


def _verdicts(rows: list[Document], scatter: float) -> Document:
    judged = [row for row in rows if row["judged"]]
    variance = np.array([row["variance_predicted"] / row["variance"] - 1 for row in judged])
    sampling = np.array([(row["variance_high"] - row["variance_low"]) / 2 / row["variance"] for row in judged])
    worst = int(np.abs(variance).argmax()) if variance.size else 0
    means = np.array([row["signal_predicted"] / row["signal"] - 1 for row in judged if row["label_fits"]])
    stack = max(judged, key=lambda row: row["frames"], default=None)
    found = {
        "judged": len(judged),
        "variance_rms": float(np.sqrt((variance**2).mean())) if variance.size else math.nan,
        "variance_worst": float(abs(variance[worst])) if variance.size else math.nan,
        "variance_worst_sampling": float(sampling[worst]) if variance.size else math.nan,
        "variance_beyond": int((np.abs(variance) > LIMITS["variance_worst"]).sum()),
        "variance_sampling": float(np.sqrt((sampling**2).mean())) / 1.96 if variance.size else math.nan,
        "mean_worst": float(np.abs(means).max()) if means.size else math.nan,
        "light_scatter": scatter,
        "labels_off": sum(not row["label_fits"] for row in judged),
        "spatial_at_stack": stack["spatial_predicted"] / stack["spatial"] - 1 if stack else math.nan,
        "spatial_error_at_stack": stack["spatial_error"] / stack["spatial"] if stack else math.nan,
    }
    # Limits apply to the camera alone: the sampling error of variances and the scatter of the light are subtracted.
    # ``chance`` is the 97.5 % quantile of the mean square for cameras exactly at the limit.
    most = (sampling / 1.96) ** 2 + LIMITS["variance_rms"] ** 2
    chance = float(scipy.special.chdtri(max(variance.size, 1), 0.025)) / max(variance.size, 1)
    judged_by = {
        **found,
        "variance_rms": LIMITS["variance_rms"] * math.sqrt(float((variance**2 / most).mean()) / chance)
        if variance.size
        else math.nan,
        "variance_worst": float((np.abs(variance) - sampling).max()) if variance.size else math.nan,
        "mean_worst": found["mean_worst"] - 1.96 * scatter,
    }
    return {
        **found,
        "within": {name: bool(judged_by[name] <= most) for name, most in LIMITS.items()},
        "limits": LIMITS,
    }


def _simulated(sensor: SimulatedSensor, time: float, light: float, count: int) -> _Simulated:
    codes = sensor.frames(time, light, max(count, 2))
    values = codes.astype(float)
    moving = float(values.var(axis=0, ddof=1).mean())
    still = values.mean(axis=0)
    return _Simulated(
        float(values.mean()), moving, float(still.var(ddof=1)) - moving / len(values),
        np.bincount(codes.ravel()), _lines(values[0]),
    )  # fmt: skip


def _drift(curve: Curve) -> float:
    """Return the standard deviation (DN) of the dark means about a straight line over exposure time."""
    means = np.array([one.mean[0] for one in curve.dark])
    if len(means) < 4:
        return max(one.drift for one in curve.dark)
    slope = 0.0 if curve.dark_slope is None else float(curve.dark_slope[0])
    times = np.nan_to_num(np.array([one.time for one in curve.dark]))
    return float((means - slope * times).std(ddof=1))


def _interval(own: LevelMoments, curve: Curve) -> tuple[float, float]:
    """Return the 95 % interval of the temporal variance of a level, DN^2, from sampling errors alone."""
    wide = 1.96 * own.variance_error(curve.line_noise)
    return float(own.variance[0]) - wide, float(own.variance[0]) + wide


def _error(left_out: Array) -> float:
    values = left_out[1:]
    return float(np.sqrt((values.size - 1) * np.mean((values - values.mean()) ** 2)))


def _distance(one: Array, other: Array) -> float:
    """Return the largest difference of two cumulative distributions (Kolmogorov and Smirnov)."""
    size = max(one.size, other.size)
    first, second = (np.cumsum(np.pad(own, (0, size - own.size))) / own.sum() for own in (one, other))
    return float(np.abs(first - second).max())


def _chance(own: LevelMoments, other: Array, moved: float) -> float:
    """Return the Kolmogorov-Smirnov distance that two samples from one distribution exceed in 5 % of cases. One sample
    is shifted by a normal deviate with standard deviation ``moved`` (DN). A fixed pattern is the same in all frames, so
    each pixel counts once.
    """
    codes = np.arange(other.size)
    mean = float((codes * other).sum() / other.sum())
    spread = math.sqrt(float(((codes - mean) ** 2 * other).sum() / other.sum()) + 1 / 12)
    # a shift by d changes the cumulative distribution of a normal by at most d / (sqrt(2 pi) spread)
    shift = 1.96 * moved / (math.sqrt(2 * math.pi) * spread)
    return math.hypot(1.36 * math.sqrt(1 / own.pixels + own.frames / float(other.sum())), shift)


def _lines(plane: Array) -> tuple[float, float]:
    """Return the variance of the row means and of the column means, each relative to its value for white noise: 1
    without line patterns.
    """
    total = float(plane.var())
    if total <= 0:
        return math.nan, math.nan
    rows, columns = (float(plane.mean(axis=axis).var()) * plane.shape[axis] / total for axis in (1, 0))
    return rows, columns
