"""The time of an exposure: found from the light, or spread over frames.

In:  ``photocurrent`` (y, x), electron/s; a time.
Out: ``integration_time``, s, of one exposure or of each frame. Stages behind take it from here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import require
from etendue.api import Facts, Grid, Labels, Stage, ends, measured, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import metering
from etendue_camera.electronics.stages.gain_chain import GainChain

AVERAGE, HIGHLIGHT = 1 / 7.8, 0.9  # of saturation: ISO 12232's metered mean; room for noise above a highlight


@dataclass(frozen=True, kw_only=True)
class Meter(GainChain):
    """The time that the noise-free photocurrent asks for; every stage behind takes it, and ``ev_bias`` moves it.

    ``mean`` and ``centre`` bring the average to 12.8 % of saturation, as ISO 12232 has it; ``highlight`` brings a
    quantile to 90 %; ``exposure_value`` does not look at the light: the time follows the f-number, N^2 / 2^EV.
    Saturation is that of the well or of the top code, whichever comes first, so that the time follows the ISO speed.
    All pixels of the mosaic count the same.
    """

    role: ClassVar = "metering"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"integration_time": "[s]"}
    gain: ClassVar = None  # a brighter highlight makes everything else darker
    negative: ClassVar = "clip"
    nanoseconds: ClassVar = 6.0
    error: ClassVar = measured(1e-6, 1e-14)

    f_number: float = quantity("f_number")
    metering: str = param(
        "mean", choices=("mean", "centre", "highlight", "exposure_value"), doc="what the time follows"
    )
    target: float = param(
        0.0,
        at_least=0,
        at_most=100,
        doc="share of saturation to reach; 0: 0.128 of mean and centre, 0.9 of a highlight",
    )
    quantile: float = param(0.99, above=0, at_most=1, doc="share of the pixels which are not above the highlight")
    exposure_value: float = param(10.0, units="stop", at_least=-30, at_most=40, doc="of metering 'exposure_value'")
    ev_bias: float = param(
        0.0, units="stop", at_least=-40, at_most=40, doc="exposure compensation: +1 doubles the time"
    )
    shortest: float = param(1e-6, units="s", above=0, doc="shortest time")
    longest: float = param(30.0, units="s", above=0, doc="longest time")

    def __post_init__(self) -> None:
        require.that(
            not self.shortest > self.longest, f"shortest = {self.shortest:g} s is above longest = {self.longest:g} s"
        )

    def time(self, photocurrent: Any) -> float:
        if self.metering == "exposure_value":
            wanted = self.f_number**2 / 2.0**self.exposure_value * 2.0**self.ev_bias
            return min(max(wanted, self.shortest), self.longest)
        share = self.target or (HIGHLIGHT if self.metering == "highlight" else AVERAGE)
        level = metering.metered_level(photocurrent, self.metering, self.quantile)
        return metering.metered_time(level, share * self.saturation(), self.ev_bias, self.shortest, self.longest)

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """The ends between which it finds a time."""
        if self.metering != "exposure_value":
            return Facts(low=self.shortest, high=self.longest)
        time = self.time(None)
        return Facts(low=time, high=time)

    def run(self, photocurrent: FloatArray) -> dict[str, Array]:
        return {"integration_time": np.array(self.time(photocurrent))}


@dataclass(frozen=True, kw_only=True)
class Bracket(Stage):
    """Repeated and bracketed exposures of one scene: a frame each, brackets in order, each of them ``repeats`` times.

    Every frame behind it has its own shot and read noise; the patterns of the sensor are the same in all.
    """

    role: ClassVar = "bracketing"
    writes: ClassVar = {"integration_time": "frame [s]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 1.0
    error: ClassVar = proved(6e-8, 2e-16)

    integration_time: float = quantity("integration_time")
    repeats: int = param(2, at_least=1, at_most=10_000, doc="frames of every bracket")
    brackets: tuple[float, ...] = param(
        (0.0,), units="stop", at_least=-40, at_most=40, doc="exposures beside the integration time, such as [-2, 0, 2]"
    )

    def __post_init__(self) -> None:
        require.that(self.brackets, "brackets = [] leaves no exposure; [0] is the integration time itself")

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
