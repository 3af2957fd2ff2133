"""A calibrated sensor: every parameter with its interval and the method by which it was measured.

In:  values by name.
Out: ``SensorModel``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from etendue_camera.electronics.jackknife import Estimate
from etendue_lab.calibrate.pattern_fit import PatternFit
from etendue_lab.calibrate.response_model import ResponseFit
from etendue_lab.frames import transfer


@dataclass
class SensorModel:
    """The parameters of a sensor. ``values``: estimates by name; ``how``: the method of each estimate; ``needs``: for
    missing values, the frames that would determine them.
    """

    channel: str
    curve: transfer.Curve
    response: ResponseFit
    dark: PatternFit | None
    light: PatternFit | None
    growth: PatternFit | None  # growth of the dark pattern with exposure time, DN/s
    bits: int
    values: dict[str, Estimate] = field(default_factory=dict)
    how: dict[str, str] = field(default_factory=dict)
    tests: list[str] = field(default_factory=list)
    needs: dict[str, str] = field(default_factory=dict)

    def put(self, name: str, value: Estimate, how: str) -> None:
        self.values[name], self.how[name] = value, how


def over_gain(one: Estimate, gain: Estimate, unit: str) -> Estimate:
    """Divide an estimate in DN by the gain (DN/electron), and include the error of the gain in the interval."""
    value = one.value / gain.value
    own = value * (gain.high - gain.value) / gain.value
    low = value - math.hypot((one.value - one.low) / gain.value, own)
    return Estimate(value, max(low, 0.0), value + math.hypot((one.high - one.value) / gain.value, own), unit)
