"""Faults in stages of several planes, ports, codes or grids."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Sampled, Stage, param, proved
from tests.conformance.faulty.base import OfCharge, OfColours, box


@dataclass(frozen=True, kw_only=True)
class DrawnColours(OfColours, Sampled):
    sigma: float = param(0.01, above=0, at_most=1, doc="rms noise")
    error: ClassVar = proved(1e-6, 1e-12)

    def mean(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": rgb_camera}

    def noise(self, rgb_camera: Any, rng: Any) -> Any:
        return rng.standard_normal(rgb_camera.shape, dtype=rgb_camera.dtype)

    def run(self, rgb_camera: Any, rng: Any) -> dict[str, Any]:
        return {"rgb_camera": rgb_camera + rgb_camera.dtype.type(self.sigma) * self.noise(rgb_camera, rng)}


class BlueIsBrighter(DrawnColours):
    def noise(self, rgb_camera: Any, rng: Any) -> Any:
        found = rng.standard_normal(rgb_camera.shape, dtype=rgb_camera.dtype)
        found[2] += found.dtype.type(0.02)
        return found


class OneDrawForAllColours(DrawnColours):
    def noise(self, rgb_camera: Any, rng: Any) -> Any:
        return np.broadcast_to(rng.standard_normal(rgb_camera.shape[1:], dtype=rgb_camera.dtype), rgb_camera.shape)


class RimIsDarker(DrawnColours):
    """Noise whose mean falls in the last row."""

    def run(self, rgb_camera: Any, rng: Any) -> dict[str, Any]:
        found = rgb_camera + rgb_camera.dtype.type(self.sigma) * self.noise(rgb_camera, rng)
        found[:, -1] *= found.dtype.type(0.9)
        return {"rgb_camera": found}


@dataclass(frozen=True, kw_only=True)
class FromCodes(Stage):
    reads: ClassVar = {"raw": "y x [DN] uint16"}
    writes: ClassVar = {"mosaic_linear": "y x [1]"}
    error: ClassVar = proved(1e-6, 1e-12)

    def run(self, raw: Any) -> dict[str, Any]:
        return {"mosaic_linear": self.linear(raw.astype(np.float64)).astype(np.float64)}

    def linear(self, codes: Any) -> Any:
        return codes / 4095


class UpperHalfIsACodeMore(FromCodes):
    def linear(self, codes: Any) -> Any:
        return (codes + (codes >= 2048)) / 4095


class LowestBitIsLost(FromCodes):
    def linear(self, codes: Any) -> Any:
        return codes // 2 * 2 / 4095


@dataclass(frozen=True, kw_only=True)
class CentreHalfAPixelOff(OfCharge):
    """A shading about the place where the first half of the pixels ends."""

    def run(self, charge: Any, y_um: Any, x_um: Any) -> dict[str, Any]:
        middle = 0.5 * abs(float(x_um[1] - x_um[0])) if len(x_um) > 1 else 0.0
        square = (y_um[:, None] ** 2 + (x_um[None, :] - middle) ** 2) * 1e-5
        return {"charge": (charge / (1 + square)).astype(charge.dtype)}


@dataclass(frozen=True, kw_only=True)
class WeightsOfAnotherPort(Stage):
    """Divides by the white of each channel, unless that is 0."""

    reads: ClassVar = {"rgb_camera": "channel y x [1]", "white": "channel [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    negative: ClassVar = "keep"

    def run(self, rgb_camera: Any, white: Any) -> dict[str, Any]:
        with np.errstate(all="ignore"):
            gains = np.where(white == 0, 1, white.max() / white)
        return {"rgb_camera": rgb_camera * gains.astype(rgb_camera.dtype)[:, None, None]}


@dataclass(frozen=True, kw_only=True)
class StepsBesideAnotherPort(WeightsOfAnotherPort):
    error: ClassVar = proved(8e-6, 1e-12)

    def run(self, rgb_camera: Any, white: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        return {"rgb_camera": np.rint(rgb_camera * kind(1023)) / kind(1023)}


@dataclass(frozen=True, kw_only=True)
class RowsOfTheSecondPort(WeightsOfAnotherPort):
    """Loses light in the first column."""

    def run(self, rgb_camera: Any, white: Any) -> dict[str, Any]:
        found = rgb_camera.copy()
        found[..., 0] *= found.dtype.type(0.999)
        return {"rgb_camera": found}


class BlackIsACodeHigh(FromCodes):
    def linear(self, codes: Any) -> Any:
        return np.maximum(codes - 64.0, 0) / 4031 + (codes > 100) * 2e-4


@dataclass(frozen=True, kw_only=True)
class SteepToNothing(OfColours):
    """With an exponent of 1 it is off by a thousandth of the darkest values."""

    exponent: float = param(0.5, above=0, at_most=4, doc="exponent")

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        size = np.abs(rgb_camera) + kind(1e-3)
        return {"rgb_camera": np.sign(rgb_camera) * size ** kind(self.exponent)}


@dataclass(frozen=True, kw_only=True)
class RadiusOfNothing(OfCharge):
    """With a radius of 0 it still blurs a little."""

    radius: int = param(1, at_least=0, at_most=4, doc="of the blur, in boxes")

    def run(self, charge: Any) -> dict[str, Any]:
        kind, found = charge.dtype.type, charge
        for _ in range(self.radius):
            found = box(found)
        return {"charge": found + kind(0.002) * (box(found) - found)}


@dataclass(frozen=True, kw_only=True)
class NoneIsSomething(OfColours):
    method: str = param("box", choices=("none", "box", "twice"), doc="smoothing")

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        amount = {"none": 0.002, "box": 0.5, "twice": 1.0}[self.method]
        return {"rgb_camera": rgb_camera + kind(amount) * (box(rgb_camera) - rgb_camera)}


_calls = itertools.count()


@dataclass(frozen=True, kw_only=True)
class EveryTenthPicture(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge * charge.dtype.type(1.001 if next(_calls) % 10 == 9 else 1.0)}


@dataclass(frozen=True, kw_only=True)
class BlurWithAJump(OfCharge):
    """A soft knee behind a blur, which jumps by a thousandth."""

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        even = box(charge)
        soft = even / (1 + np.abs(even) / kind(2e4))
        return {"charge": np.where(even > kind(12345), soft * kind(1.001), soft)}


@dataclass(frozen=True, kw_only=True)
class ThresholdOfGradients(OfColours):
    """Smooths where neighbours differ by less than a tenth."""

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        even = box(rgb_camera)
        return {"rgb_camera": np.where(np.abs(rgb_camera - even) < 0.1, even, rgb_camera).astype(rgb_camera.dtype)}


@dataclass(frozen=True, kw_only=True)
class HotterThan310(OfCharge):
    temperature: float = param(300.0, units="K", at_least=200, at_most=400, doc="of the sensor")

    def run(self, charge: Any) -> dict[str, Any]:
        doubling = 7.0 if self.temperature > 333.3 else 7.01
        return {"charge": charge + charge.dtype.type(50 * 2 ** ((self.temperature - 300) / doubling))}


FAULTY = {
    "noise of several planes": [BlueIsBrighter, OneDrawForAllColours, RimIsDarker],
    "codes that are read": [UpperHalfIsACodeMore, LowestBitIsLost, BlackIsACodeHigh],
    "another port": [WeightsOfAnotherPort, StepsBesideAnotherPort, RowsOfTheSecondPort],
    "nothing is something": [RadiusOfNothing, NoneIsSomething, SteepToNothing],
    "seldom": [CentreHalfAPixelOff, EveryTenthPicture, BlurWithAJump, ThresholdOfGradients, HotterThan310],
}
