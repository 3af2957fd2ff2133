"""Noise that is not what is declared: mean, variance, correlation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Noisy, Sampled, param, proved
from tests.conformance.faulty.base import OfCharge


@dataclass(frozen=True, kw_only=True)
class Drawn(OfCharge, Sampled, Noisy):
    sigma: float = param(5.0, units="electron", above=0, at_most=100, doc="rms noise")
    error: ClassVar = proved(1e-6, 1e-12)

    def variance(self, level: float) -> float:
        return self.sigma**2

    def mean(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge}

    def noise(self, charge: Any, rng: Any) -> Any:
        return rng.standard_normal(charge.shape, dtype=charge.dtype)

    def run(self, charge: Any, rng: Any) -> dict[str, Any]:
        return {"charge": charge + charge.dtype.type(self.sigma) * self.noise(charge, rng)}


class MeanOff(Drawn):
    def noise(self, charge: Any, rng: Any) -> Any:
        return rng.standard_normal(charge.shape, dtype=charge.dtype) + charge.dtype.type(1 / 30)


class MeanOffInTheDark(Drawn):
    """A count about its mean that is cut at zero."""

    def variance(self, level: float) -> float:
        return level

    def run(self, charge: Any, rng: Any) -> dict[str, Any]:
        spread = np.sqrt(np.maximum(charge, 0)) * self.noise(charge, rng)
        return {"charge": np.where(charge < 100, np.maximum(charge + spread, 0), charge + spread)}


class MeanRises(Drawn):
    def run(self, charge: Any, rng: Any) -> dict[str, Any]:
        return {"charge": charge * charge.dtype.type(1.0005) + charge.dtype.type(5) * self.noise(charge, rng)}


class VarianceLarge(Drawn):
    def noise(self, charge: Any, rng: Any) -> Any:
        return charge.dtype.type(1.01) * rng.standard_normal(charge.shape, dtype=charge.dtype)


class VarianceForgetsTheLevel(Drawn):
    def variance(self, level: float) -> float:
        return self.sigma**2 + level

    def noise(self, charge: Any, rng: Any) -> Any:
        spread = np.sqrt(1 + np.clip(charge, 0, 3000) / 25).astype(charge.dtype)
        return spread * rng.standard_normal(charge.shape, dtype=charge.dtype)


class TailsCut(Drawn):
    def noise(self, charge: Any, rng: Any) -> Any:
        return np.clip(rng.standard_normal(charge.shape, dtype=charge.dtype), -2.5, 2.5)


class NeighboursShare(Drawn):
    def noise(self, charge: Any, rng: Any) -> Any:
        own = rng.standard_normal(charge.shape, dtype=charge.dtype)
        return (own + charge.dtype.type(0.1) * np.roll(own, 1, axis=-1)) / charge.dtype.type(1.01**0.5)


class RowsShare(Drawn):
    def noise(self, charge: Any, rng: Any) -> Any:
        kind, (rows, _) = charge.dtype.type, charge.shape
        own = rng.standard_normal(charge.shape, dtype=charge.dtype)
        return kind(0.98**0.5) * own + kind(0.02**0.5) * rng.standard_normal((rows, 1), dtype=charge.dtype)


class RepeatsItsDraws(Drawn):
    """Draws for half of the frame and uses them again."""

    def noise(self, charge: Any, rng: Any) -> Any:
        rows, columns = charge.shape
        half = rng.standard_normal((-(-rows // 2), columns), dtype=charge.dtype)
        return np.concatenate([half, half])[:rows]


FAULTY = {
    "mean of a noise": [MeanOff, MeanOffInTheDark, MeanRises],
    "variance of a noise": [VarianceLarge, VarianceForgetsTheLevel, TailsCut],
    "correlation of a noise": [NeighboursShare, RowsShare, RepeatsItsDraws],
}
