"""Sound stages that resemble the faulty ones: what is accused here is accused without reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import param, proved
from tests.conformance.faulty.base import OfCharge, OfColours, box
from tests.conformance.faulty.noise import Drawn
from tests.conformance.faulty.values import Converter


@dataclass(frozen=True, kw_only=True)
class Blurs(OfCharge):
    amount: float = param(0.5, at_least=0, at_most=1, doc="share that is blurred")

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        return {"charge": charge + kind(self.amount) * (box(charge) - charge)}


@dataclass(frozen=True, kw_only=True)
class SoftKnee(OfCharge):
    well: float = param(2e4, units="electron", above=1, at_most=1e6, doc="full well")

    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge / (1 + np.abs(charge) / charge.dtype.type(self.well))}


@dataclass(frozen=True, kw_only=True)
class Clips(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": np.minimum(rgb_camera, rgb_camera.dtype.type(1))}


@dataclass(frozen=True, kw_only=True)
class Matrix(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        matrix = np.array([[1.6, -0.4, -0.2], [-0.2, 1.5, -0.3], [0.0, -0.5, 1.5]], rgb_camera.dtype)
        return {"rgb_camera": np.einsum("ij,jyx->iyx", matrix, rgb_camera)}


@dataclass(frozen=True, kw_only=True)
class ShadesFromTheMiddle(OfCharge):
    """A fall-off that is told where it is."""

    strength: float = param(0.1, at_least=0, at_most=1, doc="fall towards the corners")

    def run(self, charge: Any, y_um: Any, x_um: Any) -> dict[str, Any]:
        square = (y_um[:, None] ** 2 + x_um[None, :] ** 2) / 1e4
        return {"charge": (charge / (1 + self.strength * square)).astype(charge.dtype)}


@dataclass(frozen=True, kw_only=True)
class SubtractsItsMean(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": charge - charge.dtype.type(0.1 * charge.mean(dtype=np.float64))}


@dataclass(frozen=True, kw_only=True)
class EightBitsThatSaysSo(OfColours):
    decides: ClassVar = True
    error: ClassVar = proved(0.5 / 255, 0.5 / 255)

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        kind = rgb_camera.dtype.type
        return {"rgb_camera": np.clip(np.rint(rgb_camera * kind(255)), 0, 255) / kind(255)}


class Rounds(Converter):
    """The converter that the faulty ones are spoilt copies of."""


class Noise(Drawn):
    """The noise that the faulty ones are spoilt copies of."""


SOUND = [Blurs, SoftKnee, Clips, Matrix, ShadesFromTheMiddle, SubtractsItsMean, EightBitsThatSaysSo, Rounds, Noise]
