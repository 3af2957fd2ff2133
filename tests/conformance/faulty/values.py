"""Faults of value: offsets, steps, a neutral parameter that is not, a channel near zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Stage, param, proved
from tests.conformance.faulty.base import OfCharge, OfColours, box


@dataclass(frozen=True, kw_only=True)
class Converter(Stage):
    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"raw": "y x [DN] uint16"}
    negative: ClassVar = "clip"
    gain_dn: float = param(0.3, units="DN/electron", above=0, at_most=10, doc="gain")

    def codes(self, volts: Any) -> Any:
        return np.rint(volts)

    def run(self, charge: Any) -> dict[str, Any]:
        codes = self.codes(charge.astype(np.float64) * self.gain_dn + 64)
        return {"raw": np.clip(codes, 0, 4095).astype(np.uint16)}


class CutsDown(Converter):
    def codes(self, volts: Any) -> Any:
        return np.floor(volts)


class RoundsUp(Converter):
    def codes(self, volts: Any) -> Any:
        return np.ceil(volts)


class HalfACodeTwice(Converter):
    def codes(self, volts: Any) -> Any:
        return np.rint(volts + 0.5)


@dataclass(frozen=True, kw_only=True)
class NeutralIsDimmer(OfCharge):
    amount: float = param(0.5, at_least=0, at_most=1, doc="share that is blurred")

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        return {"charge": kind(0.999) * ((1 - kind(self.amount)) * charge + kind(self.amount) * box(charge))}


@dataclass(frozen=True, kw_only=True)
class NeutralStillBlurs(OfColours):
    amount: float = param(1.0, at_least=0, at_most=4, doc="strength of sharpening")

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        amount = kind(self.amount - 0.01)
        return {"rgb_camera": rgb_camera + amount * (rgb_camera - box(rgb_camera))}


@dataclass(frozen=True, kw_only=True)
class NeutralPower(OfColours):
    exponent: float = param(0.45, above=0, at_most=4, doc="exponent")

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        exponent = rgb_camera.dtype.type(self.exponent + 1e-3)
        return {"rgb_camera": np.sign(rgb_camera) * np.abs(rgb_camera) ** exponent}


@dataclass(frozen=True, kw_only=True)
class EightBits(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        return {"rgb_camera": np.rint(rgb_camera * kind(255)) / kind(255)}


@dataclass(frozen=True, kw_only=True)
class EightBitsThatDecides(EightBits):
    decides: ClassVar = True


@dataclass(frozen=True, kw_only=True)
class HalfPrecision(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": (charge / charge.dtype.type(1e5)).astype(np.float16).astype(charge.dtype) * 100000}


@dataclass(frozen=True, kw_only=True)
class TableOf256(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        table = np.linspace(0, 2e4, 256)
        place = np.clip(charge / 2e4 * 255, 0, 255).astype(int)
        return {"charge": np.where(charge > 2e4, charge, table[place]).astype(charge.dtype)}


@dataclass(frozen=True, kw_only=True)
class EightBitsInACode(Converter):
    """Writes 16 bits of which eight are used."""

    error: ClassVar = proved(8e-6, 8e-6)

    def codes(self, volts: Any) -> Any:
        return np.rint(volts / 16) * 16


@dataclass(frozen=True, kw_only=True)
class DividesByAChannel(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        mean = rgb_camera.mean(axis=(1, 2), keepdims=True)
        with np.errstate(all="ignore"):
            gains = mean[1:2] / mean
        return {"rgb_camera": rgb_camera * np.where(np.isfinite(gains), gains, 1).astype(rgb_camera.dtype)}


@dataclass(frozen=True, kw_only=True)
class RatioOfChannels(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        red, green, blue = rgb_camera
        with np.errstate(all="ignore"):
            ratio = np.where(green == 0, 0, red / green)
        return {"rgb_camera": np.stack([ratio * green, green, blue * (1 + ratio)]).astype(rgb_camera.dtype)}


@dataclass(frozen=True, kw_only=True)
class Chromaticity(OfColours):
    """The third channel from the sum of the others, which may be near zero."""

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        total = rgb_camera[0] - rgb_camera[1]
        with np.errstate(all="ignore"):
            found = np.where(total == 0, 0, rgb_camera / total)
        return {"rgb_camera": found.astype(rgb_camera.dtype)}


FAULTY = {
    "half a code": [CutsDown, RoundsUp, HalfACodeTwice],
    "neutral is not": [NeutralIsDimmer, NeutralStillBlurs, NeutralPower],
    "a step beyond the stated error": [EightBits, EightBitsThatDecides, HalfPrecision, TableOf256, EightBitsInACode],
    "a channel near zero": [DividesByAChannel, RatioOfChannels, Chromaticity],
}
