"""Incoming sound: a source, and a second wave added to it, written with labelled arrays.

In:  the array's geometry; direction, frequency and level of a wave.
Out: ``pressure`` (microphone, time), Pa; ``microphone`` contains positions on the line, m.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Bounded, Facts, Grid, Line, Source, labelled, param, proved, quantity
from etendue_array.kernels import advance

PRESSURE = "microphone time [Pa]"


def wave(microphone: Any, time: Any, tone: float, rms: float, direction: float, speed: float) -> Any:
    """Return the pressure (Pa) of a plane wave at these microphones and times. Arrays may be labelled, or plain if they
    broadcast.
    """
    return math.sqrt(2) * rms * np.cos(2 * math.pi * tone * (time + advance(microphone, direction, speed)))


@labelled
@dataclass(frozen=True, kw_only=True)
class PlaneWave(Source):
    """Generate a tone from a distant source."""

    role: ClassVar = "sound"
    writes: ClassVar = {"pressure": PRESSURE}
    error: ClassVar = proved(1e-6, 1e-12)

    microphones: int = quantity("microphones")
    spacing: float = quantity("spacing")
    sound_speed: float = quantity("sound_speed")
    tone: float = quantity("tone")
    bearing: float = quantity("bearing")
    rms: float = param(1.0, units="Pa", above=0, at_most=1e6, doc="rms sound pressure")
    sampling_rate: float = param(16000.0, units="Hz", above=0, at_most=1e7, doc="samples per second")
    samples: int = param(512, at_least=2, at_most=1_000_000, doc="samples per microphone")

    def __post_init__(self) -> None:
        if self.tone >= 0.5 * self.sampling_rate:
            raise ValueError(
                f"a tone of {self.tone:g} Hz needs more than {2 * self.tone:g} samples per second; sampling_rate is "
                f"{self.sampling_rate:g}"
            )

    def describe(self) -> tuple[Facts, Mapping[str, Grid]]:
        line = Line(self.microphones, -0.5 * (self.microphones - 1) * self.spacing, self.spacing, "m")
        grid = Grid.of({"microphone": line, "time": Line(self.samples, 0.0, 1 / self.sampling_rate, "s")})
        top = math.sqrt(2) * self.rms
        return Facts(low=-top, high=top), {"pressure": grid}

    def run(self, data: Any) -> Any:
        heard = wave(data.microphone, data.time, self.tone, self.rms, self.bearing, self.sound_speed)
        return data.assign(pressure=heard)


@labelled
@dataclass(frozen=True, kw_only=True)
class SecondWave(Bounded):
    """Add another tone from a different direction."""

    role: ClassVar = "interference"
    reads: ClassVar = {"pressure": PRESSURE}
    writes: ClassVar = {"pressure": PRESSURE}
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    error: ClassVar = proved(1e-6, 1e-12)

    sound_speed: float = quantity("sound_speed")
    other_tone: float = param(2500.0, units="Hz", above=0, at_most=1e6, doc="frequency of the second tone")
    other_bearing: float = param(-40.0, units="deg", at_least=-90, at_most=90, doc="direction of the second tone")
    other_rms: float = param(0.0, units="Pa", at_least=0, at_most=1e6, doc="rms sound pressure of the second tone")

    def run(self, data: Any) -> Any:
        other = wave(data.microphone, data.time, self.other_tone, self.other_rms, self.other_bearing, self.sound_speed)
        return data.assign(pressure=data.pressure + other)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "there is no second tone") if self.other_rms == 0 else None
