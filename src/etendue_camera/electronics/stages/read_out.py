"""Read-out: charge to digital numbers, and back to a linear scale.

In:  ``charge`` (y, x) or (frame, y, x), electron.
Out: ``raw``, DN, and ``mosaic_linear``, 1 where pixels saturate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from etendue.api import Bounded, Datasheet, Facts, Grid, Haloed, Noisy, Sampled, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import amplifier, converter, response
from etendue_camera.electronics.stages.gain_chain import GainChain, ReadOut, analogue_gain, common_draws
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.roles import Scaled

if TYPE_CHECKING:
    from etendue.compute.tables import PatternRandom


@dataclass(frozen=True, kw_only=True)
class ReadNoise(ReadOut, Bounded, Sampled, Noisy, Datasheet, Haloed):
    """Add read noise, which differs in every cell and frame, and the fixed offset pattern of the sensor (DSNU).

    Noise after the amplifier (``read_noise_after``) is divided by the gain: sigma^2 = read_noise^2 + (after / gain)^2.
    """

    role: ClassVar = "read noise"
    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 15.0
    libraries: ClassVar = ("numpy",)
    error: ClassVar = proved(6e-8, 2e-16)

    dsnu: float = quantity("dsnu")
    sensor_serial: str = quantity("sensor_serial")
    noise: str = quantity("noise")

    @property
    def common_draws(self) -> bool | str:
        return common_draws(self.noise)

    def variance(self, charge: float) -> float:
        return self.read_sigma() ** 2 + self.dsnu**2

    def datasheet(self) -> dict[str, float]:
        return {"read_noise": self.read_sigma(), "dsnu": self.dsnu}

    def run(self, charge: FloatArray, rng: np.random.Generator, rng_sensor: PatternRandom) -> dict[str, Array]:
        kind, sigma = charge.dtype.type, self.read_sigma()
        if sigma > 0:
            noise = rng.standard_normal(charge.shape, dtype=charge.dtype)
            noise *= kind(sigma)
            noise += charge
            charge = noise
        if self.dsnu > 0:
            offset = kind(self.dsnu) * rng_sensor.normal("dsnu")
            charge = charge + offset if offset.shape != charge.shape else np.add(charge, offset, out=offset)
        return {"charge": charge}

    def mean(self, charge: FloatArray) -> dict[str, Array]:
        return {"charge": charge}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        quiet = self.read_noise == 0 and self.read_noise_after == 0 and self.dsnu == 0
        return (0.0, "there is neither read noise nor an offset pattern") if quiet else None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return facts["charge"]


@dataclass(frozen=True, kw_only=True)
class LinePattern(Bounded, Sampled, Noisy, Datasheet, Haloed):
    """Add row and column noise: offsets fixed per sensor, and offsets new in every frame."""

    role: ClassVar = "line pattern"
    by_line: ClassVar = True
    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0
    libraries: ClassVar = ("numpy",)
    error: ClassVar = proved(3e-7, 1e-15)

    sensor_serial: str = quantity("sensor_serial")
    noise: str = quantity("noise")
    sensor_row_pattern: float = quantity("sensor_row_pattern")
    sensor_column_pattern: float = quantity("sensor_column_pattern")
    sensor_row_noise: float = quantity("sensor_row_noise")
    sensor_column_noise: float = quantity("sensor_column_noise")
    row_pattern: float = param(
        0.0, units="electron", at_least=0, held=(0, 1e6), doc="rms of row offsets that are fixed for a sensor"
    )
    column_pattern: float = param(
        0.0, units="electron", at_least=0, held=(0, 1e6), doc="rms of column offsets that are fixed for a sensor"
    )
    row_noise: float = param(
        0.0, units="electron", at_least=0, held=(0, 1e6), doc="rms of row offsets that are new in every frame"
    )
    column_noise: float = param(
        0.0, units="electron", at_least=0, held=(0, 1e6), doc="rms of column offsets that are new in every frame"
    )

    @property
    def of_row_pattern(self) -> float:
        """Return the sensor's value if it states one, otherwise the parameter of this stage."""
        return self.sensor_row_pattern if self.sensor_row_pattern > 0 else self.row_pattern

    @property
    def of_column_pattern(self) -> float:
        """Return the sensor's value if it states one, otherwise the parameter of this stage."""
        return self.sensor_column_pattern if self.sensor_column_pattern > 0 else self.column_pattern

    @property
    def of_row_noise(self) -> float:
        """Return the sensor's value if it states one, otherwise the parameter of this stage."""
        return self.sensor_row_noise if self.sensor_row_noise > 0 else self.row_noise

    @property
    def of_column_noise(self) -> float:
        """Return the sensor's value if it states one, otherwise the parameter of this stage."""
        return self.sensor_column_noise if self.sensor_column_noise > 0 else self.column_noise

    @property
    def common_draws(self) -> bool | str:
        return common_draws(self.noise)

    def variance(self, charge: float) -> float:
        return self.of_row_pattern**2 + self.of_column_pattern**2 + self.of_row_noise**2 + self.of_column_noise**2

    def datasheet(self) -> dict[str, float]:
        return {
            "read_noise": math.hypot(self.of_row_noise, self.of_column_noise),
            "dsnu": math.hypot(self.of_row_pattern, self.of_column_pattern),
        }

    def halo(self) -> int | None:
        """Return None if new column offsets are drawn, because one draw serves all rows of a frame."""
        return None if self.of_column_noise > 0 else 0

    def run(self, charge: FloatArray, rng: np.random.Generator, rng_sensor: PatternRandom) -> dict[str, Array]:
        kind = charge.dtype.type
        *leading, rows, columns = charge.shape
        offset = np.zeros((1, 1), dtype=charge.dtype)
        if self.of_row_pattern > 0:
            offset = offset + kind(self.of_row_pattern) * rng_sensor.row_normal("row")
        if self.of_column_pattern > 0:
            offset = offset + kind(self.of_column_pattern) * rng_sensor.column_normal("column")
        if self.of_row_noise > 0 or self.of_column_noise > 0:
            # Rows are drawn even without row noise: otherwise the columns would be other draws at row_noise = 0.
            offset = offset + kind(self.of_row_noise) * rng.standard_normal((*leading, rows, 1), dtype=charge.dtype)
        if self.of_column_noise > 0:
            offset = offset + kind(self.of_column_noise) * rng.standard_normal(
                (*leading, 1, columns), dtype=charge.dtype
            )
        return {"charge": charge + offset}

    def mean(self, charge: FloatArray) -> dict[str, Array]:
        return {"charge": charge}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        quiet = self.of_row_pattern == self.of_column_pattern == self.of_row_noise == self.of_column_noise == 0
        return (0.0, "there is no row or column noise") if quiet else None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Keep the facts, since the expected value is unchanged; keep none with fixed patterns, which are unbounded."""
        return facts["charge"] if self.of_row_pattern == self.of_column_pattern == 0 else Facts()


@dataclass(frozen=True, kw_only=True)
class Adc(ReadOut, GainChain, Sampled, Noisy, Datasheet):
    """Convert charge to codes by amplifier and ADC: optional non-linear response, gain, pedestal, rounding, clipping at
    the top code 2^n - 1. With a high gain, the top code is reached below the full well.
    """

    role: ClassVar = "converter"
    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"raw": "y x [DN] uint16"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = None  # it clips, and rounds to whole codes
    elementwise: ClassVar = True
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0
    working: ClassVar = 2.6

    def __post_init__(self) -> None:
        # rejects unattainable ISO speeds, and black levels that leave no codes, before anything runs
        analogue_gain(self)
        converter.top_code(self.bits, self.black_level)
        response.check(self.response_bend, self.response_order, self.bend_scale())

    def variance(self, charge: float) -> float:
        share = min(max(charge, 0.0) / self.bend_scale(), 1.0) ** self.response_order if self.response_bend > 0 else 0.0
        slope = 1 - self.response_bend * (1 + self.response_order) * share  # slope of the response at this charge
        return 1 / (12 * (self.dn_per_electron() * slope) ** 2)

    def datasheet(self) -> dict[str, float]:
        gain = self.dn_per_electron()
        return {"gain": gain, "full_well": float(self.before_bend((2**self.bits - 1 - self.black_level) / gain))}

    def run(self, charge: FloatArray) -> dict[str, Array]:
        return {"raw": converter.digitise(self.after_bend(charge), self.dn_per_electron(), self.black_level, self.bits)}

    def mean(self, charge: FloatArray) -> dict[str, Array]:
        return {
            "raw": converter.unrounded(self.after_bend(charge), self.dn_per_electron(), self.black_level, self.bits)
        }

    def growth(self, facts: Mapping[str, Facts]) -> float:
        """Return the largest charge divided by the charge at full scale of the output, which is the top code or the
        full well.
        """
        high = facts["charge"].high
        return 1.0 if high is None else high / self.saturation()

    def warn(self, facts: Facts, grid: Mapping[str, Grid]) -> list[str]:
        sigma = self.read_sigma()
        wide = sigma * self.dn_per_electron()
        if self.black_level >= 4 * wide:
            return []
        share = 0.5 * math.erfc((self.black_level + 0.5) / (wide * math.sqrt(2)))
        return [
            f"the pedestal, black_level = {self.black_level:g} DN, is below 4 sigma of the read noise ({sigma:.3g} "
            f"electron = "
            f"{wide:.3g} DN): {share:.2g} of a dark frame is clipped at code 0, which raises its mean; "
            f"{math.ceil(4 * wide)} DN avoid this"
        ]

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the rounding: half a step, relative to the range from black to white."""
        return 0.5 / (2**self.bits - 1 - self.black_level), "proved"


@dataclass(frozen=True, kw_only=True)
class Linearise(KnownNoise, Scaled):
    """Scale to (DN - black) / (white - black): 1 where pixels saturate, at full well or top code; negatives are kept.
    A non-linear response (``response_bend``) is inverted.

    ``clipping_level`` is the lowest value that a clipped pixel can have. Rounding brings this level slightly below 1.
    If the full well lies below the top code, the noise after the full well lowers it further (by four sigma of read
    noise and offsets).
    """

    role: ClassVar = "linearisation"
    reads: ClassVar = {"raw": "y x [DN] uint16"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = None  # the black level is part of full scale and is removed
    elementwise: ClassVar = True
    nanoseconds: ClassVar = 2.0
    working: ClassVar = 2.0
    error: ClassVar = proved(6e-8, 2e-16)

    def run(self, raw: Array) -> dict[str, Array]:
        white = self.white()
        sigma = math.hypot(self.read_sigma(), self.dsnu)
        if self.response_bend > 0:
            return self._straightened(raw, white, sigma)
        lowest = amplifier.lowest_clipped_code(self.well(), self.dn_per_electron(), self.black_level, self.bits, sigma)
        return {
            "mosaic_linear": converter.linearise(raw, self.black_level, self.bits, np.float64, white),
            "clipping_level": np.array(lowest / white),
        }

    def _straightened(self, raw: Array, white: float, sigma: float) -> dict[str, Array]:
        """Invert the non-linear response, so that values are proportional to light again."""
        gain, full = self.dn_per_electron(), self.saturation()
        codes = np.asarray(raw, dtype=np.float64) - self.black_level
        well = float(self.after_bend(self.well()))
        lowest = amplifier.lowest_clipped_code(well, gain, self.black_level, self.bits, sigma)
        return {
            "mosaic_linear": self.before_bend(codes / gain) / full,
            "clipping_level": np.array(float(self.before_bend(lowest / gain)) / full),
        }
