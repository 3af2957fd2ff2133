"""Automatic exposure: the time follows from the light.

In:  ``photocurrent`` (y, x), electron/s.
Out: ``expected_charge`` (y, x), electron, and ``exposure_time``, s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import measured, param, quantity
from etendue.physics.electronics import metering
from etendue.stages.electronics.exposure import Exposing
from etendue.stages.electronics.gain_chain import GainChain

AVERAGE, HIGHLIGHT = 1 / 7.8, 0.9  # of saturation: ISO 12232's metered mean; room for noise above a highlight


@dataclass(frozen=True, kw_only=True)
class ExposureMetered(GainChain, Exposing):
    """Exposure for a time that is found from the noise-free photocurrent: ``exposure_time`` is an output, ``ev_bias`` moves it.

    ``mean`` and ``centre`` bring the average to 12.8 % of saturation, as ISO 12232 has it; ``highlight`` brings a quantile
    to 90 %; ``exposure_value`` does not look at the light: the time follows the f-number, N^2 / 2^EV. Saturation is
    that of the well or of the top code, whichever comes first, so that the time follows the ISO speed. All pixels of the
    mosaic count the same.
    """

    role: ClassVar = "metering"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"expected_charge": "y x [electron]", "exposure_time": "[s]"}
    finds: ClassVar = {"integration_time": "its exposure_time is an output; <stage>.ev_bias moves it"}
    gain: ClassVar = None  # a brighter highlight makes everything else darker
    negative: ClassVar = "clip"
    nanoseconds: ClassVar = 6.0
    libraries: ClassVar = ("numpy",)
    error: ClassVar = measured(1e-6, 1e-14)

    f_number: float = quantity("f_number")
    metering: str = param("mean", choices=("mean", "centre", "highlight", "exposure_value"), doc="what the time follows")
    target: float = param(0.0, at_least=0, at_most=100, doc="share of saturation to reach; 0: 0.128 of mean and centre, 0.9 of a highlight")
    quantile: float = param(0.99, above=0, at_most=1, doc="share of the pixels which are not above the highlight")
    exposure_value: float = param(10.0, units="stop", at_least=-30, at_most=40, doc="of metering 'exposure_value'")
    ev_bias: float = param(0.0, units="stop", at_least=-40, at_most=40, doc="exposure compensation: +1 doubles the time")
    shortest: float = param(1e-6, units="s", above=0, doc="shortest time")
    longest: float = param(30.0, units="s", above=0, doc="longest time")

    def __post_init__(self) -> None:
        if self.shortest > self.longest:
            raise ValueError(f"shortest = {self.shortest:g} s is above longest = {self.longest:g} s")

    def time(self, photocurrent: Any) -> float:
        if self.metering == "exposure_value":
            wanted = self.f_number**2 / 2.0**self.exposure_value * 2.0**self.ev_bias
            return min(max(wanted, self.shortest), self.longest)
        share = self.target or (HIGHLIGHT if self.metering == "highlight" else AVERAGE)
        level = metering.metered_level(photocurrent, self.metering, self.quantile)
        return metering.metered_time(level, share * self.saturation(), self.ev_bias, self.shortest, self.longest)

    def run(self, photocurrent: Any, rng_sensor: Any) -> dict[str, Any]:
        time = self.time(photocurrent)
        return {"expected_charge": self.after(time, photocurrent, rng_sensor), "exposure_time": np.array(time)}
