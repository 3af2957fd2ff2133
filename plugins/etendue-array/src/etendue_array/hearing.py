"""Microphones: self noise (on labelled arrays), and phasors by frequency (on plain arrays).

In:  ``pressure`` (microphone, time), Pa.
Out: the same with noise; ``phasor`` (part, frequency, microphone), Pa.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Bounded, Facts, Grid, Labels, Line, Sampled, Stage, labelled, measured, param, proved
from etendue_array.sound import PRESSURE

PARTS = Labels(("real", "imaginary"))


@labelled
@dataclass(frozen=True, kw_only=True)
class MicrophoneNoise(Bounded, Sampled):
    """Add white noise, independent per microphone and sample."""

    role: ClassVar = "self noise"
    reads: ClassVar = {"pressure": PRESSURE}
    writes: ClassVar = {"pressure": PRESSURE}
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    libraries: ClassVar = ("numpy",)
    error: ClassVar = proved(6e-8, 2e-16)

    noise_rms: float = param(0.1, units="Pa", at_least=0, at_most=1e6, doc="rms of the noise")

    def run(self, data: Any, rng: Any) -> Any:
        pressure = data.pressure
        drawn = rng.standard_normal(pressure.shape, dtype=pressure.dtype)
        return data.assign(pressure=pressure + pressure.dtype.type(self.noise_rms) * drawn)

    def mean(self, pressure: Any) -> dict[str, Any]:
        return {"pressure": pressure}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "there is no noise") if self.noise_rms == 0 else None


@dataclass(frozen=True, kw_only=True)
class Phasors(Stage):
    """Split every signal by frequency (discrete Fourier transform); a tone of rms 1 at a bin centre has magnitude 1."""

    role: ClassVar = "filter bank"
    reads: ClassVar = {"pressure": PRESSURE}
    writes: ClassVar = {"phasor": "part frequency microphone [Pa]"}
    gain: ClassVar = math.sqrt(2)
    negative: ClassVar = "keep"
    libraries: ClassVar = ("numpy",)
    error: ClassVar = measured(1e-6, 1e-14)

    lowest: float = param(500.0, units="Hz", above=0, at_most=1e6, doc="lowest frequency")
    highest: float = param(4000.0, units="Hz", above=0, at_most=1e6, doc="highest frequency")

    def bins(self, time: Line) -> range:
        """Return the indices of the frequency bins from ``lowest`` to ``highest``. Zero and the Nyquist frequency are
        left out, because they have no phasor.
        """
        apart = 1 / (time.step * time.size)
        found = range(
            max(1, math.ceil(self.lowest / apart - 1e-9)),
            min((time.size - 1) // 2, math.floor(self.highest / apart + 1e-9)) + 1,
        )
        if not found:
            raise ValueError(
                f"no frequency bin from {self.lowest:g} to {self.highest:g} Hz: the bins are {apart:g} Hz apart"
            )
        return found

    def grid(self, inputs: Any) -> Mapping[str, Grid]:
        time = inputs["pressure"].line("time")
        bins, apart = self.bins(time), 1 / (time.step * time.size)
        frequency = Line(len(bins), bins.start * apart, apart, "Hz")
        return {
            "phasor": Grid.of({"part": PARTS, "frequency": frequency, "microphone": inputs["pressure"]["microphone"]})
        }

    def run(self, pressure: Any, time: Any) -> dict[str, Any]:
        size = pressure.shape[-1]
        bins = self.bins(Line(size, 0.0, float(time[1] - time[0])))
        found = np.fft.rfft(pressure, axis=-1)[:, bins.start : bins.stop].T * (math.sqrt(2) / size)
        return {"phasor": np.stack([found.real, found.imag]).astype(pressure.dtype)}
