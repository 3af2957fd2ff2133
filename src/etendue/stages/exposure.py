"""Exposure: photocurrent to charge to digital numbers, in the order in which it happens.

In:  ``photocurrent`` (y, x), electron/s.
Out: ``expected_charge``, ``charge``, ``raw`` (y, x), and ``mosaic_linear``, 1 at clipping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Facts, Grid, Stage, hookimpl, param, quantity
from etendue.physics import converter, exposure, noise


def full_well(pitch: float, fraction: float, density: float) -> float:
    """Charge capacity of a pixel, electron: density times light-sensitive area."""
    return density * (pitch * fraction) ** 2


@dataclass(frozen=True, kw_only=True)
class Exposure(Stage):
    """Charge expected after the integration time: photo (with PRNU) + dark (with its non-uniformity). Not clipped."""

    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"expected_charge": "y x [electron]"}
    gain: ClassVar = 1.0
    negative: ClassVar = "clip"  # the undershoot of band-limited light, once, in front of the Poisson draw
    nanoseconds: ClassVar = 3.0
    libraries: ClassVar = ("numpy",)

    integration_time: float = quantity("integration_time")
    pixel_pitch: float = quantity("pixel_pitch")
    dark_current_density: float = quantity("dark_current_density")
    sensor_serial: str = quantity("sensor_serial")
    prnu: float = param(0.01, at_least=0, at_most=1, doc="relative rms of the response from pixel to pixel")
    dark_nonuniformity: float = param(0.1, at_least=0, at_most=1, doc="relative rms of the dark current from pixel to pixel")

    def run(self, photocurrent: Any, rng_sensor: Any) -> dict[str, Any]:
        kind = photocurrent.dtype.type
        signal = photocurrent * kind(self.integration_time)
        if self.prnu > 0:
            signal = signal * np.maximum(1 + kind(self.prnu) * rng_sensor.normal("prnu"), 0)
        dark = kind(exposure.dark_electrons(self.dark_current_density, self.pixel_pitch**2, self.integration_time))
        if dark > 0 and self.dark_nonuniformity > 0:
            dark = dark * np.maximum(1 + kind(self.dark_nonuniformity) * rng_sensor.normal("dark current"), 0)
        return {"expected_charge": signal + dark}

    def carry(self, facts: Any, grid: Any) -> Facts:
        high = facts["photocurrent"].high
        if high is None or self.prnu > 0 or self.dark_nonuniformity > 0:
            return Facts()
        dark = float(exposure.dark_electrons(self.dark_current_density, self.pixel_pitch**2, self.integration_time))
        return Facts(low=dark, high=high * self.integration_time + dark)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-7 if precision == "float32" else 1e-15), "proved"


@dataclass(frozen=True, kw_only=True)
class ShotNoise(Stage):
    """Photons arrive one by one: Poisson about the expected charge."""

    reads: ClassVar = {"expected_charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 60.0

    noise: str = quantity("noise")
    exact_below: float = param(
        30.0, units="electron", at_least=10, infinite=True, fidelity=True, reference="inf: exact Poisson at every mean",
        doc="above this mean the draw is a Cornish-Fisher form within 1e-3 of Poisson in total variation",
    )  # fmt: skip

    @property
    def common_draws(self) -> bool:
        return self.noise == "common"

    def run(self, expected_charge: Any, rng: Any) -> dict[str, Any]:
        if self.common_draws:
            return {"charge": noise.poisson_by_inversion(expected_charge, rng.random(expected_charge.shape), self.exact_below)}
        return {"charge": noise.poisson(expected_charge, rng, self.exact_below)}

    def carry(self, facts: Any, grid: Any) -> Facts:
        """The expected value stays as it is."""
        return facts["expected_charge"]

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Total variation from Poisson, not an error of the mean."""
        return (0.0 if math.isinf(self.exact_below) else 1e-3), "proved"


@dataclass(frozen=True, kw_only=True)
class FullWell(Stage):
    """Each pixel holds so much and no more: clipped after the draw, so that its noise collapses at saturation."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = None  # where the light exceeds the well, what is not clipped gains in share of full scale
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")

    def capacity(self) -> float:
        return full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": np.minimum(charge, charge.dtype.type(self.capacity()))}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        """What clipping takes from the mean of a Poisson count, as a share of the full well."""
        if facts.high is None or facts.high >= self.capacity():
            return None
        sigma = math.sqrt(max(facts.high, 1.0))
        away = (self.capacity() - facts.high) / sigma
        return sigma * math.exp(-0.5 * away**2) / self.capacity(), "the light stays below the full well"

    def carry(self, facts: Any, grid: Any) -> Facts:
        known, capacity = facts["charge"], self.capacity()
        return Facts(
            uniform=known.uniform,
            low=None if known.low is None else min(known.low, capacity),
            high=capacity if known.high is None else min(known.high, capacity),
        )

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (6e-8 if precision == "float32" else 1e-16), "proved"


@dataclass(frozen=True, kw_only=True)
class ReadNoise(Stage):
    """Noise of the read-out, new in every cell, and the offset pattern (DSNU) that belongs to the sensor."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 15.0
    libraries: ClassVar = ("numpy",)

    read_noise: float = quantity("read_noise")
    dsnu: float = quantity("dsnu")
    sensor_serial: str = quantity("sensor_serial")
    noise: str = quantity("noise")

    @property
    def common_draws(self) -> bool:
        return self.noise == "common"

    def run(self, charge: Any, rng: Any, rng_sensor: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        if self.read_noise > 0:
            charge = charge + kind(self.read_noise) * rng.standard_normal(charge.shape, dtype=charge.dtype)
        if self.dsnu > 0:
            charge = charge + kind(self.dsnu) * rng_sensor.normal("dsnu")
        return {"charge": charge}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "there is no read noise and no offset pattern") if self.read_noise == 0 and self.dsnu == 0 else None

    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["charge"]

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (6e-8 if precision == "float32" else 2e-16), "proved"


@dataclass(frozen=True, kw_only=True)
class Adc(Stage):
    """The converter: pedestal, rounding, top code 2^n - 1."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"raw": "y x [DN] uint16"}
    gain: ClassVar = None  # it clips, and rounds to whole codes
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")
    conversion_gain: float = quantity("conversion_gain")
    black_level: float = quantity("black_level")
    bits: int = quantity("bits")

    def run(self, charge: Any) -> dict[str, Any]:
        return {"raw": converter.digitise(charge, self.dn_per_electron(), self.black_level, self.bits)}

    def dn_per_electron(self) -> float:
        return dn_per_electron(self)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Half a step, of the range from black to white."""
        return 0.5 / (2**self.bits - 1 - self.black_level), "proved"


def dn_per_electron(stage: Any) -> float:
    """The conversion gain, or the one that brings the full well to the top code."""
    if stage.conversion_gain > 0:
        return float(stage.conversion_gain)
    top = 2**stage.bits - 1 - stage.black_level
    if top <= 0:
        raise ValueError(f"black_level {stage.black_level:g} leaves nothing of {stage.bits} bits")
    return top / full_well(stage.pixel_pitch, stage.aperture_fraction, stage.full_well_density)


@dataclass(frozen=True, kw_only=True)
class Linearise(Stage):
    """(DN - black) / (white - black): 1 at clipping, negative values kept."""

    reads: ClassVar = {"raw": "y x [DN] uint16"}
    writes: ClassVar = {"mosaic_linear": "y x [1]"}
    gain: ClassVar = None  # the black level is a part of full scale that disappears
    nanoseconds: ClassVar = 2.0

    black_level: float = quantity("black_level")
    bits: int = quantity("bits")

    def run(self, raw: Any) -> dict[str, Any]:
        return {"mosaic_linear": converter.linearise(raw, self.black_level, self.bits, np.float64)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (6e-8 if precision == "float32" else 2e-16), "proved"


@dataclass(frozen=True, kw_only=True)
class ChargeFraction(Stage):
    """Photocurrent as a share of the full well after a reference time: the noise-free mosaic of the paper's order."""

    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]"}
    gain: ClassVar = 1.0
    negative: ClassVar = "clip"
    nanoseconds: ClassVar = 1.0

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")
    reference_time: float = param(0.01, units="s", above=0)

    def run(self, photocurrent: Any) -> dict[str, Any]:
        capacity = full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)
        return {"mosaic_linear": photocurrent * photocurrent.dtype.type(self.reference_time / capacity)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 3e-16), "proved"


@dataclass(frozen=True, kw_only=True)
class PaperExposure(Stage):
    """Integration time and dynamic range behind the demosaic, as the paper has them (its Fig. 9c).

    Scaled by the time, clipped at the full well, and nothing below the smallest detectable charge (eq. 13, with the
    square of q where the paper prints q).
    """

    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    gain: ClassVar = None  # it jumps at the smallest detectable charge, and clips
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0

    integration_time: float = quantity("integration_time")
    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")
    dark_current_density: float = quantity("dark_current_density")
    read_noise: float = quantity("read_noise")
    dsnu: float = quantity("dsnu")
    reference_time: float = param(0.01, units="s", above=0)

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        capacity = full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)
        dark = float(exposure.dark_electrons(self.dark_current_density, self.pixel_pitch**2, self.integration_time))
        smallest = kind(math.sqrt(dark + self.read_noise**2 + self.dsnu**2) / capacity)
        scaled = rgb_camera * kind(self.integration_time / self.reference_time)
        return {"rgb_camera": np.where(scaled < smallest, kind(0), np.minimum(scaled, kind(1)))}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 3e-16), "proved"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {
        "exposure": Exposure, "shot_noise": ShotNoise, "full_well": FullWell, "read_noise": ReadNoise, "adc": Adc,
        "linearise": Linearise, "charge_fraction": ChargeFraction, "paper_exposure": PaperExposure,
    }  # fmt: skip
