"""The dark signal of a sensor: black level, dark current, read noise, and temporal row and column noise.

In:  dark levels of a photon transfer curve, the fitted response.
Out: the values in a ``SensorModel``, or a list of the frames that are needed to determine them.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from etendue_camera.arrays import Array
from etendue_camera.electronics.emva import QUANTISATION
from etendue_camera.electronics.jackknife import Estimate, Jackknife
from etendue_lab.calibrate import pattern_fit
from etendue_lab.calibrate.sensor_model import SensorModel, over_gain

TESTS = 2  # row noise, column noise
ALONE = "; all dark frames have one exposure time, whose dark charge is included"


def put_dark(model: SensorModel, gain: Estimate, interval: Jackknife) -> None:
    """Add black level, dark current and read noise to a model."""
    _black_level(model, interval)
    charge = _dark_current(model, gain, interval)
    if model.curve.hidden:
        _hidden_noise(model, gain)
    else:
        _read_noise(model, gain, interval, charge)


def _weight(model: SensorModel) -> Array:
    return np.array([one.frames - 1.0 for one in model.curve.dark])


def _black_level(model: SensorModel, interval: Jackknife) -> None:
    curve = model.curve
    origin = interval.of(curve.dark_origin, "DN")
    # All pixels of a dark frame drift together, so the scatter of level means counts in the interval of the black
    # level.
    means = np.array([one.mean[0] for one in curve.dark])
    times = np.array([one.time for one in curve.dark])
    line = 0.0 if curve.dark_slope is None else float(curve.dark_slope[0]) * (times - times.mean())
    scatter = means - np.nan_to_num(line)
    drift = float(scatter.std(ddof=1)) / math.sqrt(len(means)) if len(means) > 3 else max(o.drift for o in curve.dark)
    # If dark values are clipped or lost in rounding, their mean is uncertain by the noise or by half a step.
    blind = math.sqrt(max(model.response.floor, 0.0) + 0.25) if model.response.floor is not None else 0.0
    lines = 1.96 * math.sqrt(float(curve.line_error(float(sum(one.frames for one in curve.dark)))))
    if curve.dark_slope is not None:
        lines = math.hypot(lines, float(np.nanmean(times)) * _slope_error(model))
    wide = math.hypot(origin.high - origin.value, 2 * drift, lines) + blind
    how = f"mean of {len(curve.dark)} dark levels{'' if curve.dark_slope is None else ', at time 0'}"
    model.put("black_level", Estimate(origin.value, origin.value - wide, origin.value + wide, "DN"), how)


def _dark_current(model: SensorModel, gain: Estimate, interval: Jackknife) -> float:
    """Add the dark current to the model; return the mean dark charge of the dark frames, DN."""
    curve = model.curve
    times = np.array([one.time for one in curve.dark])
    if curve.hidden:
        model.needs["dark_current"] = curve.hidden
        return 0.0
    if curve.dark_slope is not None:
        return _dark_slope(model, curve.dark_slope, gain, interval)
    if (leak := model.response.leak) and math.isfinite(times[0]):
        wide = 1.96 * model.response.errors["leak"]
        slope = Estimate(leak, leak - wide, leak + wide, "")
        how = "means of light levels whose time and light vary independently"
        model.put("dark_current", over_gain(slope, gain, "electron/s"), how)
        black = model.values["black_level"]
        wide = math.hypot(black.high - black.value, wide * float(times[0]))
        value = black.value - leak * float(times[0])
        model.put("black_level", Estimate(value, value - wide, value + wide, "DN"), "mean of the dark, at time 0")
        return leak * float(times[0])
    model.needs["dark_current"] = "dark frames at two or more exposure times"
    model.how["black_level"] += ALONE
    return 0.0


def _slope_error(model: SensorModel) -> float:
    """Return the uncertainty that row and column noise adds to the slope of the dark means: half of a 95 % interval,
    DN/s.
    """
    curve, weight = model.curve, _weight(model)
    times = np.array([one.time for one in curve.dark])
    good = ~np.isnan(times)
    x, w = times[good], weight[good]
    pull = w * (x - (w * x).sum() / w.sum())
    moved = curve.line_error(np.array([float(one.frames) for one in curve.dark])[good])
    return 1.96 * math.sqrt(float((pull**2 * moved).sum())) / float((pull * x).sum())


def _dark_slope(model: SensorModel, slopes: Array, gain: Estimate, interval: Jackknife) -> float:
    """Measure the dark current from dark frames at several exposure times and add it to the model. Return the mean dark
    charge of these frames, DN.
    """
    curve = model.curve
    slope = interval.of(slopes, "")
    means, times = np.array([one.mean[0] for one in curve.dark]), np.array([one.time for one in curve.dark])
    weight, good = _weight(model), ~np.isnan(times)
    x, y = times[good] - times[good].mean(), means[good]
    residual = y - y.mean() - slope.value * x
    over = math.sqrt(float((residual**2).sum()) / max(x.size - 2, 1) / float((x**2).sum()))
    t = float(scipy.special.stdtrit(max(x.size - 2, 1), 0.975))
    wide = math.hypot(slope.high - slope.value, t * over, _slope_error(model))
    hot, how = 0.0, "slope of the dark mean over time"
    if (growth := model.growth) is not None and growth.outliers:  # hot pixels are counted separately
        hot = float(growth.outlier_values.sum()) / growth.pixels
        how += f"; {growth.outliers} pixels that differ from the others, {hot / gain.value:.3g} of the mean, apart"
    own = (slope.value - hot) / gain.value
    error = math.hypot(wide / gain.value, own * (gain.high - gain.value) / gain.value)
    model.put("dark_current", Estimate(own, own - error, own + error, "electron/s"), how)
    return max(slope.value, 0.0) * float((times * weight)[good].sum() / weight[good].sum())


def _hidden_noise(model: SensorModel, gain: Estimate) -> None:
    """Add the read noise to the model. It is extrapolated from light levels, because the noise of the dark frames is
    clipped or lost in rounding.
    """
    why, floor, wide = model.curve.hidden, model.response.floor or 0.0, 1.96 * model.response.errors["floor"]
    model.needs |= {"row_noise": why, "column_noise": why}
    if floor > wide:
        one = pattern_fit.root(Estimate(floor, floor - wide, floor + wide, ""))
        model.put("read_noise", over_gain(one, gain, "electron"), "variance of light levels, continued to no light")
    else:
        model.needs["read_noise"] = why


def _read_noise(model: SensorModel, gain: Estimate, interval: Jackknife, charge: float) -> None:
    """Add read noise, row noise and column noise to the model. The read noise is the temporal noise of dark frames,
    without row and column noise and without the shot noise of the dark ``charge`` (DN).
    """
    curve, weight = model.curve, _weight(model)
    row, column = (_lines(model, axis) for axis in ("row", "column"))
    whole = (np.stack([one.variance for one in curve.dark], 1) * weight).sum(1) / weight.sum()
    found = interval.of(whole - QUANTISATION - charge * gain.value - row - column, "")
    if found.value > 0:
        how = "temporal variance of the dark" + (ALONE if "dark_current" in model.needs else "")
        model.put("read_noise", over_gain(pattern_fit.root(found), gain, "electron"), how)
    else:
        model.needs["read_noise"] = "shorter dark exposures: the shot noise of dark charge hides it"
    for axis, variance in (("row", row), ("column", column)):
        if variance > 0:
            count, length = _size(model, axis)
            wide = 1.96 * math.sqrt(2 / (weight.sum() * count)) * (variance + float(whole[0]) / length)
            dn = pattern_fit.root(Estimate(variance, variance - wide, variance + wide, ""))
            how = f"temporal variance of {axis} means in the dark"
            model.put(f"{axis}_noise", over_gain(dn, gain, "electron"), how)


def _size(model: SensorModel, axis: str) -> tuple[int, int]:
    """Return the number of rows or columns, and the length of each, pixels."""
    rows, columns = model.curve.dark[0].shape
    return (rows, columns) if axis == "row" else (columns, rows)


def _lines(model: SensorModel, axis: str) -> float:
    """Return the variance of temporal row or column offsets, DN^2; 0 if a test does not find them significant."""
    dark, weight, (count, length) = model.curve.dark, _weight(model), _size(model, axis)
    own = np.array([getattr(one, f"{axis}_variance") for one in dark])
    mean = float((own * weight).sum() / weight.sum())
    error = math.sqrt(2 / (weight.sum() * count)) * float(dark[0].variance[0]) / length
    p = float(scipy.special.ndtr(-mean / error)) if error > 0 else 1.0
    model.tests.append(f"{axis} noise: p = {p:.2g}, accepted below {0.01 / TESTS:.2g}")
    return mean if p < 0.01 / TESTS else 0.0
