"""Exposure: photocurrent to charge, in physical order.

In:  ``photocurrent`` (y, x), electron/s.
Out: ``expected_charge`` and ``charge``, electron, (y, x).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from etendue.api import Bounded, Datasheet, Facts, Grid, Haloed, Noisy, Sampled, ends, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import amplifier, distributions, dynamic_range, noise
from etendue_camera.electronics.stages.gain_chain import Well, common_draws

if TYPE_CHECKING:
    from etendue.compute.tables import PatternRandom


@dataclass(frozen=True, kw_only=True)
class Exposure(Sampled, Noisy, Datasheet, Haloed):
    """Compute the expected charge after the integration time: photo charge with PRNU plus dark charge, not clipped."""

    role: ClassVar = "exposure"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"expected_charge": "y x [electron]"}
    gain: ClassVar = 1.0
    negative: ClassVar = "clip"  # undershoot of band-limited light, clipped once, before the Poisson draw
    nanoseconds: ClassVar = 3.0
    working: ClassVar = 2.0
    libraries: ClassVar = ("numpy",)

    integration_time: float = quantity("integration_time")
    pixel_pitch: float = quantity("pixel_pitch")
    dark_current_density: float = quantity("dark_current_density")
    temperature: float = quantity("temperature")
    dark_reference_temperature: float = quantity("dark_reference_temperature")
    dark_doubling: float = quantity("dark_doubling")
    sensor_serial: str = quantity("sensor_serial")
    sensor_prnu: float = quantity("sensor_prnu")
    sensor_dark_nonuniformity: float = quantity("sensor_dark_nonuniformity")
    prnu: float = param(0.01, at_least=0, at_most=1, doc="photo-response non-uniformity, relative rms")
    dark_nonuniformity: float = param(0.1, at_least=0, at_most=1, doc="dark current non-uniformity, relative rms")
    dark_pattern: bool = param(
        True,
        fidelity=True,
        exact=True,
        reference="true: a dark current for each pixel",
        settings=(False, True),
        costs=(0.75, 1.0),
        doc="whether each pixel has its own dark current, drawn with dark_nonuniformity; false: all pixels have the "
        "mean",
    )

    @property
    def photo_spread(self) -> float:
        """Return the PRNU (relative rms): the sensor's value if it states one, otherwise the parameter of
        this stage.
        """
        return self.sensor_prnu if self.sensor_prnu > 0 else self.prnu

    @property
    def dark_spread(self) -> float:
        """Return the dark current non-uniformity (relative rms): the sensor's value if it states one, otherwise the
        parameter of this stage.
        """
        return self.sensor_dark_nonuniformity if self.sensor_dark_nonuniformity > 0 else self.dark_nonuniformity

    def dark_charge(self, time: float) -> FloatArray:
        """Return the mean dark charge after a time, electron."""
        warm = amplifier.dark_current_factor(self.temperature, self.dark_reference_temperature, self.dark_doubling)
        return dynamic_range.dark_electrons(self.dark_current_density * warm, self.pixel_pitch**2, time)

    def variance(self, charge: float) -> float:
        """Return the variance of PRNU and dark current pattern, electron^2, for a pixel with this charge, dark charge
        included.
        """
        dark = float(self.dark_charge(self.integration_time))
        light_mean, light_variance = distributions.cut_normal_moments(self.photo_spread)
        dark_mean, dark_variance = distributions.cut_normal_moments(self.dark_spread)
        dark_variance *= self.dark_pattern
        signal = (charge - dark_mean * dark) / light_mean
        return float(light_variance * signal**2 + dark_variance * dark**2)

    def datasheet(self) -> dict[str, float]:
        dark = float(self.dark_charge(1.0))
        light_mean, light_variance = distributions.cut_normal_moments(self.photo_spread)
        dark_mean, dark_variance = distributions.cut_normal_moments(self.dark_spread)
        return {
            "prnu": math.sqrt(light_variance) / light_mean,
            "dark_current": dark_mean * dark,
            "dark_spread": math.sqrt(dark_variance * self.dark_pattern) * dark,
        }

    def run(self, photocurrent: FloatArray, rng_sensor: PatternRandom) -> dict[str, Array]:
        kind = photocurrent.dtype.type
        signal = photocurrent * kind(self.integration_time)
        if self.photo_spread > 0:
            signal *= rng_sensor.spread("prnu", self.photo_spread)
        dark = np.asarray(self.dark_charge(self.integration_time), dtype=kind)
        if self.dark_spread > 0 and dark > 0:
            if self.dark_pattern:
                dark = dark * rng_sensor.spread("dark current", self.dark_spread)
            else:
                dark = dark * kind(noise.mean_factor(self.dark_spread))
        signal += dark
        return {"expected_charge": signal}

    def mean(self, photocurrent: FloatArray) -> dict[str, Array]:
        """Return the expected charge, averaged over many sensors, electron."""
        kind = photocurrent.dtype.type
        dark = self.dark_charge(self.integration_time) * noise.mean_factor(self.dark_spread)
        return {
            "expected_charge": photocurrent * kind(self.integration_time * noise.mean_factor(self.photo_spread))
            + kind(dark)
        }

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float | None, str]:
        """Bound the rounding error. If the dark current pattern is omitted (its mean is kept), include the fraction
        that the pattern would add to the variance of a pixel. This fraction is bounded, because every pixel has at
        least the shot noise of its dark charge.
        """
        rounding = 2e-7 if precision == "float32" else 1e-15
        if self.dark_pattern or self.dark_spread == 0:
            return rounding, "proved"
        mean, variance = distributions.cut_normal_moments(self.dark_spread)
        odds = variance * float(self.dark_charge(ends(self.integration_time)[1])) / mean
        return rounding + (odds / (1 + odds) if math.isfinite(odds) else 1.0), "proved"

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return the range of charge for darkest to brightest light and six-sigma patterns: one pixel in 1e9 lies
        outside.
        """
        light = facts["photocurrent"]
        if light.low is None or light.high is None:
            return Facts()
        shortest, longest = ends(self.integration_time)
        sight, dark = 6 * self.photo_spread, 6 * self.dark_spread
        low = max(light.low, 0.0) * shortest * max(1 - sight, 0.0) + float(self.dark_charge(shortest)) * max(
            1 - dark, 0.0
        )
        return Facts(
            low=low,
            high=max(light.high, 0.0) * longest * (1 + sight) + float(self.dark_charge(longest)) * (1 + dark),
            brightest=None if light.brightest is None else light.brightest * shortest,  # patterns have a mean of 1
        )


@dataclass(frozen=True, kw_only=True)
class ShotNoise(Sampled, Noisy, Haloed):
    """Add photon shot noise: a Poisson draw about the expected charge."""

    role: ClassVar = "shot noise"
    inherent: ClassVar = True
    reads: ClassVar = {"expected_charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 20.0
    working: ClassVar = 0.5

    noise: str = quantity("noise")
    exact_below: float = param(
        30.0,
        units="electron",
        at_least=10,
        infinite=True,
        fidelity=True,
        reference="inf: exact Poisson at every mean",
        settings=(30.0, 100.0, 300.0, 1000.0, math.inf),
        costs=(1.0, 1.35, 1.5, 1.65, 1.9),
        doc="above this mean the draw uses a Cornish-Fisher expansion within 1.2e-4 (30 / mean)^1.5 of Poisson in "
        "total variation",
    )

    def __post_init__(self) -> None:
        if self.common_draws and self.exact_below > noise.LARGEST_INVERTED:
            raise ValueError(
                f"exact_below is {self.exact_below:g} electron; noise = '{self.noise}' inverts the distribution only "
                f"up to {noise.LARGEST_INVERTED:g}: lower it, or use noise = 'independent'"
            )

    @property
    def common_draws(self) -> bool | str:
        return common_draws(self.noise)

    def variance(self, charge: float) -> float:
        return charge

    def halo(self) -> int | None:
        """Return 0 for common random draws, which are made pixel by pixel; None for independent draws, whose order
        depends on the whole frame.
        """
        return 0 if self.common_draws else None

    def run(self, expected_charge: FloatArray, rng: np.random.Generator) -> dict[str, Array]:
        if self.common_draws:
            return {
                "charge": noise.poisson_by_inversion(
                    expected_charge, rng.random(expected_charge.shape), self.exact_below
                )
            }
        return {"charge": noise.poisson(expected_charge, rng, self.exact_below)}

    def mean(self, expected_charge: FloatArray) -> dict[str, Array]:
        return {"charge": expected_charge}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Keep the facts: the expected value is unchanged."""
        return facts["expected_charge"]

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the total variation distance from a Poisson distribution, rather than the error of the mean. The
        distance is largest at the smallest mean for which the expansion is used, and at the transition of common draws.
        """
        if math.isinf(self.exact_below):
            return 0.0, "proved"
        return 1.2e-4 * (30.0 / self.exact_below) ** 1.5 + (1e-4 if self.common_draws else 0.0), "measured"


@dataclass(frozen=True, kw_only=True)
class FullWell(Well, Bounded, Datasheet):
    """Clip charge at the full well, after shot noise is drawn, so that saturated pixels have no noise."""

    role: ClassVar = "full well"
    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = None  # above 1 where light exceeds the full well, see `growth`
    elementwise: ClassVar = True
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.0
    error: ClassVar = proved(6e-8, 1e-16)

    def datasheet(self) -> dict[str, float]:
        return {"full_well": self.well()}

    def run(self, charge: FloatArray) -> dict[str, Array]:
        return {"charge": np.minimum(charge, charge.dtype.type(self.well()))}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        """Bound the amount by which clipping lowers the mean of a Poisson count, relative to the full well."""
        if facts.high is None or facts.high >= self.well():
            return None
        sigma = math.sqrt(max(facts.high, 1.0))
        away = (self.well() - facts.high) / sigma
        return sigma * math.exp(-0.5 * away**2) / self.well(), "the light stays below the full well"

    def growth(self, facts: Mapping[str, Facts]) -> float:
        """Return the brightest light over the full well, at least 1: clipping reduces full scale, so errors of
        unclipped pixels grow relative to it.
        """
        high = facts["charge"].high
        return 1.0 if high is None else max(1.0, high / self.well())

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        known, capacity = facts["charge"], self.well()
        return Facts(
            uniform=known.uniform,
            low=None if known.low is None else min(known.low, capacity),
            high=capacity if known.high is None else min(known.high, capacity),
            brightest=None if known.brightest is None else min(known.brightest, capacity),
        )
