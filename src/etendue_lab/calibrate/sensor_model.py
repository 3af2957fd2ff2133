"""A sensor calibrated from frames: every parameter with its interval and how it was found.

In:  a measurement, one site of its colour filter array.
Out: ``SensorModel``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy

from etendue_camera.electronics.emva import QUANTISATION
from etendue_camera.electronics.jackknife import Estimate, Jackknife
from etendue_lab.calibrate import pattern_fit, response_fit
from etendue_lab.calibrate.pattern_fit import PatternFit
from etendue_lab.calibrate.response_model import ResponseFit
from etendue_lab.frames import transfer
from etendue_lab.frames.frame_set import FrameSet
from etendue_lab.frames.moments import MONO, LevelMoments, Site
from etendue_lab.frames.patterns import growing

TESTS = 2  # row noise, column noise


@dataclass
class SensorModel:
    """The parameters of a sensor: ``values`` by name, ``how`` each was found."""

    channel: str
    curve: transfer.Curve
    response: ResponseFit
    dark: PatternFit | None
    light: PatternFit | None
    growth: PatternFit | None  # of the dark with time, DN/s
    bits: int
    values: dict[str, Estimate] = field(default_factory=dict)
    how: dict[str, str] = field(default_factory=dict)
    tests: list[str] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)

    def put(self, name: str, value: Estimate, how: str) -> None:
        self.values[name], self.how[name] = value, how


def calibrate(frames: FrameSet, site: Site = MONO, channel: str = "W", confidence: float = 0.95) -> SensorModel:
    """Calibrate one channel.

    Raises
    ------
    RequestError
        The frames hold no photon transfer curve.
    """
    curve = transfer.curve(frames, site)
    transfer.figures(frames, curve, site)  # refuses what is no curve
    response = response_fit.fit(curve)
    dark, light = transfer.patterns(frames, curve, site)
    if light is not None:  # a response that bends shows less of the pixels' differences than of the signal
        used = np.flatnonzero(curve.between(0.05, transfer.RANGE))
        s = response.straight(curve.exposure[used])
        weight = np.array([len(curve.levels[i].frames) for i in used]) * curve.signal[0, used]
        light = light.scaled(float(weight.sum() / (weight * s * response.slope(s) / response.bent(s)).sum()))
    growth = None if curve.dark_slope is None else growing(frames, curve.dark_levels, site)
    bits = max(1, math.ceil(math.log2(curve.top + 1)))
    model = SensorModel(
        channel, curve, response,
        None if dark is None else pattern_fit.fit(dark, shaded=False),
        None if light is None else pattern_fit.fit(light, shaded=True),
        None if growth is None else pattern_fit.fit(growth, shaded=False), bits,
    )  # fmt: skip
    model.tests += response.tests
    t = float(scipy.special.stdtrit(response.freedom, 0.5 + 0.5 * confidence))

    def fitted(name: str, value: float, unit: str) -> Estimate:
        wide = t * response.errors[name]
        return Estimate(value, value - wide, value + wide, unit)

    gain = fitted("gain", response.gain, "DN/electron")
    levels = int(np.count_nonzero(response.used))
    model.put("gain", gain, f"photon transfer, means and variances of {levels} levels together")
    if response.bend:
        model.put("bend", fitted("bend", response.bend, ""), f"loss of order {response.order:g} at 2^{bits} - 1 DN")
    if response.offset:
        model.put("light_offset", fitted("offset", response.offset, "DN"), "light outside the exposure time")
    if response.lamp:
        how = "of the brightest light over its label, growing with it: means and variances ask for different bends"
        model.put("light_excess", fitted("lamp", response.lamp, ""), how)
    if frames.photons:
        qe = response.rate / response.gain
        wide = t * qe * math.hypot(response.errors["rate"] / response.rate, response.errors["gain"] / response.gain)
        model.put(
            "quantum_efficiency", Estimate(qe, qe - wide, qe + wide, "electron/photon"), "rate of the means over K"
        )
    else:
        model.needs["quantum_efficiency"] = "the photons per pixel of every level"
    _dark(model, frames, gain, Jackknife(confidence), site)
    _patterns(model, gain)
    _widen_black(model)
    _saturation(model)
    return model


def _scaled(one: Estimate, gain: Estimate, unit: str) -> Estimate:
    """Divide an estimate in DN by the gain, whose error joins its own."""
    value = one.value / gain.value
    own = value * (gain.high - gain.value) / gain.value
    low = value - math.hypot((one.value - one.low) / gain.value, own)
    return Estimate(value, max(low, 0.0), value + math.hypot((one.high - one.value) / gain.value, own), unit)


def _dark(model: SensorModel, frames: FrameSet, gain: Estimate, interval: Jackknife, site: Site) -> None:
    curve = model.curve
    origin = interval.of(curve.dark_origin, "DN")
    # the means of dark frames move together; their scatter over levels is part of the black level's error
    means = np.array([one.mean[0] for one in curve.dark])
    times = np.array([one.time for one in curve.dark])
    line = 0.0 if curve.dark_slope is None else float(curve.dark_slope[0]) * (times - times.mean())
    scatter = means - np.nan_to_num(line)
    drift = float(scatter.std(ddof=1)) / math.sqrt(len(means)) if len(means) > 3 else max(o.drift for o in curve.dark)
    # a dark that is cut off or rounded away has its mean anywhere within a step, or the noise
    blind = math.sqrt(max(model.response.floor, 0.0) + 0.25) if model.response.floor is not None else 0.0
    wide = math.hypot(origin.high - origin.value, 2 * drift) + blind
    model.put("black_level", Estimate(origin.value, origin.value - wide, origin.value + wide, "DN"),
              f"mean of {len(curve.dark)} dark levels{'' if curve.dark_slope is None else ', at time 0'}")  # fmt: skip
    charge, alone = 0.0, ""
    weight = np.array([one.frames - 1.0 for one in curve.dark])
    if curve.hidden:
        model.needs["dark_current"] = curve.hidden
    elif curve.dark_slope is not None:
        slope = interval.of(curve.dark_slope, "")
        times = np.array([one.time for one in curve.dark])
        good = ~np.isnan(times)
        x, y = times[good] - times[good].mean(), means[good]
        residual = y - y.mean() - slope.value * x
        over = math.sqrt(float((residual**2).sum()) / max(x.size - 2, 1) / float((x**2).sum()))
        t = float(scipy.special.stdtrit(max(x.size - 2, 1), 0.975))
        wide = math.hypot(slope.high - slope.value, t * over)
        hot, how = 0.0, "slope of the dark mean over time"
        if (growth := model.growth) is not None and growth.outliers:  # told apart from the others
            hot = float(growth.outlier_values.sum()) / growth.pixels
            how += f"; {growth.outliers} pixels that differ from the others, {hot / gain.value:.3g} of the mean, apart"
        own = (slope.value - hot) / gain.value
        error = math.hypot(wide / gain.value, own * (gain.high - gain.value) / gain.value)
        model.put("dark_current", Estimate(own, own - error, own + error, "electron/s"), how)
        charge = max(slope.value, 0.0) * float((times * weight)[good].sum() / weight[good].sum())
    elif (leak := model.response.leak) and math.isfinite(times[0]):
        wide = 1.96 * model.response.errors["leak"]
        slope = Estimate(leak, leak - wide, leak + wide, "")
        model.put(
            "dark_current", _scaled(slope, gain, "electron/s"), "means of light levels whose time and light vary apart"
        )
        charge = leak * float(times[0])
        black = model.values["black_level"]
        wide = math.hypot(black.high - black.value, wide * float(times[0]))
        value = black.value - charge
        model.put("black_level", Estimate(value, value - wide, value + wide, "DN"), "mean of the dark, at time 0")
    else:
        model.needs["dark_current"] = "dark frames at two or more exposure times"
        alone = "; the dark has one exposure time, whose dark charge is in it"
        model.how["black_level"] += alone
    row, column = (_lines(curve.dark, weight, axis, model) for axis in ("row", "column"))
    whole = (np.stack([one.variance for one in curve.dark], 1) * weight).sum(1) / weight.sum()
    square = whole - QUANTISATION - charge * gain.value - row - column
    found = interval.of(square, "")
    if (floor := model.response.floor) is not None:
        wide = 1.96 * model.response.errors["floor"]
        model.needs |= {"row_noise": curve.hidden, "column_noise": curve.hidden}
        if floor > wide:
            one = pattern_fit.root(Estimate(floor, floor - wide, floor + wide, ""))
            model.put("read_noise", _scaled(one, gain, "electron"), "variance of light levels, continued to no light")
        else:
            model.needs["read_noise"] = curve.hidden
        return
    if found.value > 0:
        model.put(
            "read_noise", _scaled(pattern_fit.root(found), gain, "electron"), "temporal variance of the dark" + alone
        )
    for name, variance in (("row_noise", row), ("column_noise", column)):
        if variance > 0:
            lines = math.sqrt(weight.sum() * math.sqrt(curve.dark[0].pixels))
            wide = 1.96 * math.sqrt(2) / lines * (variance + float(whole[0]) / math.sqrt(curve.dark[0].pixels))
            dn = pattern_fit.root(Estimate(variance, variance - wide, variance + wide, ""))
            model.put(
                name, _scaled(dn, gain, "electron"), f"temporal variance of {name.partition('_')[0]} means in the dark"
            )


def _lines(dark: list[LevelMoments], weight: np.ndarray, axis: str, model: SensorModel) -> float:
    """Return the variance of temporal offsets of lines, DN^2; 0 where a test does not accept them."""
    own = np.array([getattr(one, f"{axis}_variance") for one in dark])
    side = math.sqrt(dark[0].pixels)
    mean = float((own * weight).sum() / weight.sum())
    error = math.sqrt(2 / (weight.sum() * side)) * float(dark[0].variance[0]) / side
    p = float(scipy.special.ndtr(-mean / error))
    model.tests.append(f"{axis} noise: p = {p:.2g}, accepted below {0.01 / TESTS:.2g}")
    return mean if p < 0.01 / TESTS else 0.0


def _patterns(model: SensorModel, gain: Estimate) -> None:
    if model.curve.hidden:
        model.needs["dsnu"] = model.curve.hidden
    elif (dark := model.dark) is not None:
        how = f"{dark.frames} dark frames, products of different frames"
        model.put("dsnu_total", _scaled(dark.total, gain, "electron"), how)
        white, grown = dark.white, _growth(model)
        if grown is not None:
            white = pattern_fit.root(pattern_fit.less(pattern_fit.square(white), pattern_fit.square(grown)))
        more = ", without waves, lines and outliers" + (", at time 0" if grown else "")
        model.put("dsnu", _scaled(white, gain, "electron"), how + more)
        for name, part in (("row_pattern", dark.rows), ("column_pattern", dark.columns)):
            if part is not None:
                model.put(name, _scaled(part, gain, "electron"), how)
        model.tests += [f"dark pattern: {one}" for one in dark.tests]
    if (light := model.light) is not None:
        how = f"{light.frames} frames of light, products of different frames"
        model.put("prnu_total", light.total, how + ", shading included")
        model.put("prnu", light.white, how + ", without shading of the third degree, waves, lines and outliers")
        model.tests += [f"response pattern: {one}" for one in light.tests]


def _growth(model: SensorModel) -> Estimate | None:
    """Put the spread of the dark current, where a test accepts it; return its share of the dark pattern, DN."""
    growth, current = model.growth, model.values.get("dark_current")
    if growth is None or current is None:
        return None
    model.tests.append(
        f"spread of the dark current over pixels: p = {growth.chance:.2g}, accepted below {pattern_fit.LEVEL:.2g}"
    )
    if growth.chance >= pattern_fit.LEVEL:
        return None
    gain, white = model.values["gain"].value, growth.white
    how = f"{growth.frames} dark frames, growth of every pixel with time, without outliers"
    if current.low > 0:
        value, high = white.value / gain / current.value, (white.high - white.value) / gain / current.value
        low = (white.value - white.low) / gain / current.value
        share = value * (current.high - current.value) / current.value
        model.put(
            "dark_nonuniformity",
            Estimate(value, max(value - math.hypot(low, share), 0.0), value + math.hypot(high, share), ""),
            how + ", over the dark current",
        )
    else:
        model.needs["dark_nonuniformity"] = "a dark current that is above 0: longer exposure times"
    times = [frame.time for level in model.curve.dark_levels for frame in level.frames if frame.time == frame.time]
    mean = float(np.mean(times))
    return Estimate(white.value * mean, white.low * mean, white.high * mean, "DN")


def _widen_black(model: SensorModel) -> None:
    """Add to the error of the black level that of the mean of few lines: a pattern of lines is no noise of pixels."""
    one, gain, shape = model.values["black_level"], model.response.gain, model.curve.dark[0].shape
    wide = (one.high - one.low) / 2
    for name, count in (("row_pattern", shape[0]), ("column_pattern", shape[1])):
        if name in model.values:
            wide = math.hypot(wide, 1.96 * model.values[name].value * gain / math.sqrt(count))
    model.values["black_level"] = Estimate(one.value, one.value - wide, one.value + wide, one.unit)


def _saturation(model: SensorModel) -> None:
    curve, response = model.curve, model.response
    if not curve.saturates:
        model.needs["full_well"] = "levels bright enough to saturate"
        return
    code = 2**model.bits - 1
    brightest = curve.moments[-1]
    black = float(curve.dark_origin[0])
    if brightest.share_at(code) > 0.5:
        model.needs["full_well"] = f"a lower gain: the top code {code} is reached first"
        return
    top = float(brightest.mean[0]) - black
    value = top / response.gain
    if response.bend:
        value /= max(1 - response.bend * (top / response.full) ** response.order, 0.1)
    wide = value * 1.96 * response.errors["gain"] / response.gain
    model.put("full_well", Estimate(value, value - wide, value + wide, "electron"), "mean beyond saturation")
