"""A sensor calibrated from frames.

In:  a measurement, and one site of its colour filter array.
Out: ``SensorModel``.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from etendue_camera.electronics.jackknife import Estimate, Jackknife
from etendue_lab.calibrate import dark_fit, pattern_fit, response_fit
from etendue_lab.calibrate.sensor_model import SensorModel, over_gain
from etendue_lab.frames import transfer
from etendue_lab.frames.frame_set import FrameSet
from etendue_lab.frames.moments import MONO, Site


def calibrate(frames: FrameSet, site: Site = MONO, channel: str = "W", confidence: float = 0.95) -> SensorModel:
    """Calibrate one channel.

    Raises
    ------
    RequestError
        The frames give no photon transfer curve.
    """
    curve = transfer.curve(frames, site)
    transfer.figures(frames, curve, site)  # raises an error if the frames give no curve
    response = response_fit.fit(curve)
    dark, light = transfer.patterns(frames, curve, site)
    if light is not None:  # a non-linear response reduces differences between pixels more than the signal itself
        used = np.flatnonzero(curve.between(0.05, transfer.RANGE))
        s = response.straight(curve.exposure[used])
        weight = np.array([len(curve.levels[i].frames) for i in used]) * curve.signal[0, used]
        light = light.scaled(float(weight.sum() / (weight * s * response.slope(s) / response.bent(s)).sum()))
    growth = None if dark is None or curve.dark_slope is None else dark.growth
    bits = max(1, math.ceil(math.log2(curve.top + 1)))
    model = SensorModel(
        channel, curve, response,
        None if dark is None else pattern_fit.fit(dark.mean, shaded=False),
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
        how = (
            "excess of the brightest light over its label, growing with the light: means and variances "
            "require different bends"
        )
        model.put("light_excess", fitted("lamp", response.lamp, ""), how)
    if frames.photons:
        qe = response.rate / response.gain
        wide = t * qe * math.hypot(response.errors["rate"] / response.rate, response.errors["gain"] / response.gain)
        model.put(
            "quantum_efficiency", Estimate(qe, qe - wide, qe + wide, "electron/photon"), "rate of the means over K"
        )
    else:
        model.needs["quantum_efficiency"] = "the photons per pixel of every level"
    dark_fit.put_dark(model, gain, Jackknife(confidence))
    _patterns(model, gain)
    _widen_black(model)
    _saturation(model)
    return model


def _patterns(model: SensorModel, gain: Estimate) -> None:
    if model.curve.hidden:
        model.needs["dsnu"] = model.curve.hidden
    elif (dark := model.dark) is not None:
        how = f"{dark.frames} dark frames, products of different frames"
        model.put("dsnu_total", over_gain(dark.total, gain, "electron"), how)
        white, grown = dark.white, _growth(model)
        if grown is not None:
            white = pattern_fit.root(pattern_fit.less(pattern_fit.square(white), pattern_fit.square(grown)))
        more = ", without waves, lines and outliers" + (", at time 0" if grown else "")
        model.put("dsnu", over_gain(white, gain, "electron"), how + more)
        for name, part in (("row_pattern", dark.rows), ("column_pattern", dark.columns)):
            if part is not None:
                model.put(name, over_gain(part, gain, "electron"), how)
        model.tests += [f"dark pattern: {one}" for one in dark.tests]
    if (light := model.light) is not None:
        how = f"{light.frames} frames of light, products of different frames"
        model.put("prnu_total", light.total, how + ", shading included")
        model.put("prnu", light.white, how + ", without shading of the third degree, waves, lines and outliers")
        model.tests += [f"response pattern: {one}" for one in light.tests]


def _growth(model: SensorModel) -> Estimate | None:
    """Add the rms spread of the dark current over the pixels to the model if a test finds it significant. Return the
    dark pattern (DN) that this spread causes, or None.
    """
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
        model.needs["dark_nonuniformity"] = (
            "longer exposure times, so that the dark current can be distinguished from 0"
        )
    times = [frame.time for level in model.curve.dark_levels for frame in level.frames if frame.time == frame.time]
    mean = float(np.mean(times))
    return Estimate(white.value * mean, white.low * mean, white.high * mean, "DN")


def _widen_black(model: SensorModel) -> None:
    """Widen the interval of the black level by the uncertainty from row and column patterns. The frame has fewer lines
    than pixels, so these patterns average out less than independent pixels do.
    """
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
