"""Exposure time: metered from the light, or spread over frames.

In:  ``photocurrent`` (y, x), electron/s; a time.
Out: ``integration_time``, s, of one exposure or of each frame. Later stages use it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import require
from etendue.api import Facts, Grid, Labels, Stage, ends, measured, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import metering
from etendue_camera.electronics.stages.gain_chain import GainChain

AVERAGE, HIGHLIGHT = 1 / 7.8, 0.9  # of saturation: metered mean of ISO 12232; headroom for noise above a highlight


@dataclass(frozen=True, kw_only=True)
class Meter(GainChain):
    """Meter the exposure time from the noise-free photocurrent, shifted by ``ev_bias``; all later stages use it.

    ``mean`` and ``centre`` bring the average to 12.8 % of saturation, as in ISO 12232; ``highlight`` brings a
    quantile to 90 %; ``exposure_value`` ignores the light: the time follows from the f-number, N^2 / 2^EV.
    Saturation is the full well or the top code, whichever is reached first, so the time depends on the ISO speed.
    All pixels of the mosaic have equal weight.
    """

    role: ClassVar = "metering"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"integration_time": "[s]"}
    gain: ClassVar = None  # a brighter highlight shortens the exposure and makes everything else darker
    negative: ClassVar = "clip"
    nanoseconds: ClassVar = 6.0
    error: ClassVar = measured(1e-6, 1e-14)

    f_number: float = quantity("f_number")
    metering: str = param("mean", choices=("mean", "centre", "highlight", "exposure_value"), doc="metering mode")
    target: float = param(
        0.0,
        at_least=0,
        at_most=100,
        apart=(0.0,),
        doc="fraction of saturation to reach; 0: 0.128 for mean and centre, 0.9 for highlight",
    )
    quantile: float = param(0.99, above=0, at_most=1, doc="fraction of the pixels at or below the highlight")
    exposure_value: float = param(
        10.0, units="stop", at_least=-30, at_most=40, doc="exposure value for metering 'exposure_value'"
    )
    ev_bias: float = param(
        0.0, units="stop", at_least=-40, at_most=40, doc="exposure compensation: +1 doubles the time"
    )
    shortest: float = param(1e-6, units="s", above=0, doc="shortest exposure time")
    longest: float = param(30.0, units="s", above=0, doc="longest exposure time")

    def __post_init__(self) -> None:
        require.that(
            not self.shortest > self.longest, f"shortest = {self.shortest:g} s is above longest = {self.longest:g} s"
        )

    def time(self, photocurrent: Any) -> float:
        if self.metering == "exposure_value":
            wanted = self.f_number**2 / 2.0**self.exposure_value * 2.0**self.ev_bias
            return min(max(wanted, self.shortest), self.longest)
        return self.timed(metering.metered_level(photocurrent, self.metering, self.quantile))

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return bounds on the time, from the known range of the light."""
        if self.metering == "exposure_value":
            time = self.time(None)
            return Facts(low=time, high=time)
        low, high = self.levels(facts["photocurrent"])
        return Facts(low=self.timed(high), high=self.timed(low))

    def levels(self, light: Facts) -> tuple[float, float]:
        """Return bounds on the metered level, electron/s; 0 and inf where they are unknown.

        A centre-weighted level is bounded below only by the smallest value. If values have the mean m and the maximum
        h, their quantile q is at least (m - (1 - q) h) / q.
        """
        if light.low is None or light.high is None:
            return 0.0, math.inf
        low = max(light.low, 0.0)
        if light.mean is not None and self.metering == "mean":
            low = max(low, light.mean)
        if light.mean is not None and self.metering == "highlight":
            low = max(low, (light.mean - (1 - self.quantile) * light.high) / self.quantile)
        return low, light.high

    def timed(self, level: float) -> float:
        """Return the exposure time for a metered level, s."""
        share = self.target or (HIGHLIGHT if self.metering == "highlight" else AVERAGE)
        if math.isinf(level):
            return self.shortest
        return metering.metered_time(level, share * self.saturation(), self.ev_bias, self.shortest, self.longest)

    def growth(self, facts: Mapping[str, Facts]) -> float:
        """Return the largest light over the metered level, because an error of the level changes the time and with it
        all values.
        """
        if self.metering == "exposure_value":
            return 0.0
        low, high = self.levels(facts["photocurrent"])
        return high / low if low > 0 else math.inf

    def run(self, photocurrent: FloatArray) -> dict[str, Array]:
        return {"integration_time": np.array(self.time(photocurrent))}


@dataclass(frozen=True, kw_only=True)
class Bracket(Stage):
    """Take repeated and bracketed exposures of one scene as separate frames: the brackets in order, each ``repeats``
    times.

    Frames have independent shot and read noise; all frames have the same fixed patterns of the sensor.
    """

    role: ClassVar = "bracketing"
    writes: ClassVar = {"integration_time": "frame [s]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 1.0
    error: ClassVar = proved(6e-8, 2e-16)

    integration_time: float = quantity("integration_time")
    repeats: int = param(2, at_least=1, at_most=10_000, doc="frames per bracket")
    brackets: tuple[float, ...] = param(
        (0.0,),
        units="stop",
        at_least=-40,
        at_most=40,
        doc="exposures relative to the integration time, such as [-2, 0, 2]",
    )

    def __post_init__(self) -> None:
        require.that(self.brackets, "brackets = [] gives no exposure; use [0] for the integration time itself")

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"integration_time": Grid.of({"frame": Labels(tuple(range(len(self.brackets) * self.repeats)))})}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        low, high = ends(self.integration_time)
        return Facts(low=low * 2.0 ** min(self.brackets), high=high * 2.0 ** max(self.brackets))

    def run(self) -> dict[str, Array]:
        return {
            "integration_time": self.integration_time
            * 2.0 ** np.repeat(np.array(self.brackets, dtype=float), self.repeats)
        }
