"""The beam, steered over all directions, and its metrics, written with labelled arrays.

In:  ``phasor`` (part, frequency, microphone), Pa.
Out: ``beam`` (frequency, direction), Pa2, summed over microphones; metrics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Grid, Line, Stage, labelled, measured, param, quantity
from etendue_array import kernels

REFERENCE = 20e-6  # Pa: 0 dB of sound pressure


@labelled
@dataclass(frozen=True, kw_only=True)
class DelayAndSum(Stage):
    """Delay each microphone by the advance of a wave from a direction, then sum."""

    role: ClassVar = "beamforming"
    reads: ClassVar = {"phasor": "part frequency microphone [Pa]"}
    writes: ClassVar = {"beam": "frequency direction [Pa2]", "white_noise_gain": "[1]"}
    negative: ClassVar = "keep"
    libraries: ClassVar = ("numpy",)
    nanoseconds: ClassVar = 200.0
    error: ClassVar = measured(1e-5, 1e-12)

    sound_speed: float = quantity("sound_speed")
    taper: str = param("uniform", choices=kernels.TAPERS, doc="weighting of the microphones along the line")
    directions: int = param(361, at_least=2, at_most=100_000, doc="number of directions, from -90 to 90 deg")

    def grid(self, inputs: Any) -> Mapping[str, Grid]:
        direction = Line(self.directions, -90.0, 180.0 / (self.directions - 1), "deg")
        return {"beam": inputs["phasor"].take(("frequency",)).replace(direction=direction)}

    def run(self, data: Any) -> Any:
        weights = kernels.taper(self.taper, data.sizes["microphone"])
        early = kernels.advance(data.microphone, data.direction, self.sound_speed)
        turn = np.exp(-2j * math.pi * data.frequency * early)
        phasor = data.phasor.astype(np.float64)
        heard = (phasor.sel(part="real") + 1j * phasor.sel(part="imaginary")) * data.phasor.microphone.copy(
            data=weights
        )
        beam = np.abs((heard * turn).sum("microphone")) ** 2
        return {
            "beam": beam.astype(data.phasor.dtype),
            "white_noise_gain": np.array(kernels.white_noise_gain(weights), data.phasor.dtype),
        }


@labelled
@dataclass(frozen=True, kw_only=True)
class BeamFigures(Stage):
    """Compute the direction of arrival, and how well the beam separates sounds from different directions."""

    role: ClassVar = "measure of a beam"
    reads: ClassVar = {"beam": "frequency direction [Pa2]"}
    writes: ClassVar = {
        "bearing_found": "[deg]",
        "bearing_error": "[deg]",
        "beam_width": "[deg]",
        "side_lobe": "[dB]",
        "sound_level": "[dB]",
    }
    decides: ClassVar = True

    tone: float = quantity("tone")
    bearing: float = quantity("bearing")

    def run(self, data: Any) -> Any:
        power = data.beam.sel(frequency=self.tone, method="nearest").to_numpy().astype(np.float64)
        directions = data.direction.to_numpy()
        found = kernels.parabola(directions, power)
        figures = {
            "bearing_found": found,
            "bearing_error": found - self.bearing,
            "beam_width": kernels.half_power_width(directions, power),
            "side_lobe": kernels.side_lobe(power),
            "sound_level": 10 * math.log10(max(float(power.max()) / REFERENCE**2, 1e-30)),
        }
        return {name: np.array(value, data.beam.dtype) for name, value in figures.items()}
