"""Faults at the ends of a range, and jumps inside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.api import param
from tests.conformance.faulty.base import OfCharge, OfColours


@dataclass(frozen=True, kw_only=True)
class FourthPower(OfCharge):
    """A soft knee: c / (1 + (c / w)^4)^(1/4), by powers that leave the range of single precision."""

    well: float = param(2e4, units="electron", above=0, at_most=1e6, doc="full well")

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        power = charge**4
        share = power / (power + kind(self.well) ** 4)
        return {"charge": kind(self.well) * np.nan_to_num(share, nan=0.0, posinf=0.0) ** kind(0.25)}


@dataclass(frozen=True, kw_only=True)
class ProductOfGains(OfCharge):
    first: float = param(2.0, above=0, at_most=1e30, doc="a gain")
    second: float = param(2.0, above=0, at_most=1e30, doc="its inverse, nearly")

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        both = kind(self.first) * kind(self.second)
        return {"charge": charge * np.nan_to_num(both / (both + kind(1)), nan=0.0, posinf=0.0)}


@dataclass(frozen=True, kw_only=True)
class SquareThatVanishes(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": np.sign(rgb_camera) * (rgb_camera**4) ** rgb_camera.dtype.type(0.25)}


@dataclass(frozen=True, kw_only=True)
class AboveOneTo098(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": np.where(rgb_camera > 1, rgb_camera.dtype.type(0.98), rgb_camera)}


@dataclass(frozen=True, kw_only=True)
class WrapsAtTheTop(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": np.fmod(charge, charge.dtype.type(65536))}


@dataclass(frozen=True, kw_only=True)
class BrightIsDark(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        top = rgb_camera.max(axis=0, keepdims=True)
        return {"rgb_camera": np.where(top >= 2, rgb_camera * rgb_camera.dtype.type(0.999), rgb_camera)}


@dataclass(frozen=True, kw_only=True)
class GainSwitches(OfCharge):
    """Two gains that do not meet."""

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        return {"charge": np.where(charge < 3000, charge, kind(3000) + kind(0.8) * (charge - kind(2990)))}


@dataclass(frozen=True, kw_only=True)
class ParameterSwitches(OfCharge):
    strength: float = param(0.3, at_least=0, at_most=1, doc="strength")

    def run(self, charge: Any) -> dict[str, Any]:
        factor = 1 + self.strength if self.strength < 0.61 else 1.01 + self.strength
        return {"charge": charge * charge.dtype.type(factor)}


@dataclass(frozen=True, kw_only=True)
class SeriesThatDoesNotMeet(OfColours):
    """log(1 + x), by three terms below 0.1."""

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        x = np.maximum(rgb_camera, 0)
        return {"rgb_camera": np.where(x < kind(0.1), x - x * x / kind(2), np.log1p(x))}


FAULTY = {
    "powers at the ends": [FourthPower, ProductOfGains, SquareThatVanishes],
    "values above the top": [AboveOneTo098, WrapsAtTheTop, BrightIsDark],
    "a jump inside the range": [GainSwitches, ParameterSwitches, SeriesThatDoesNotMeet],
}
