"""Faults of place: at the rim, by half a pixel, by one row, by the phase of the mask."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import RGB, Haloed, Stage, param
from etendue_camera.mosaic.bilinear import bilinear
from etendue_camera.sensor.cfa import shifted_bayer
from tests.conformance.faulty.base import OfCharge, OfColours, OfLight, box


@dataclass(frozen=True, kw_only=True)
class LastRowForgotten(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        found = box(charge)
        found[-1] = charge[-1]
        return {"charge": found}


@dataclass(frozen=True, kw_only=True)
class WrapsAround(OfCharge):
    """The left neighbour of the first column is the last column."""

    def run(self, charge: Any) -> dict[str, Any]:
        kind = charge.dtype.type
        right = np.concatenate([charge[:, 1:], charge[:, -1:]], axis=1)
        return {"charge": kind(0.5) * charge + kind(0.25) * (np.roll(charge, 1, axis=1) + right)}


@dataclass(frozen=True, kw_only=True)
class FirstColumnTwice(OfCharge, Haloed):
    def run(self, charge: Any) -> dict[str, Any]:
        found = charge.copy()
        found[:, 1:] = charge[:, :-1]
        return {"charge": found}


@dataclass(frozen=True, kw_only=True)
class BlursToTheRight(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        right = np.concatenate([charge[:, 1:], charge[:, -1:]], axis=1)
        return {"charge": charge.dtype.type(0.5) * (charge + right)}


@dataclass(frozen=True, kw_only=True)
class HalfAPixelByPhase(OfLight):
    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.exp(-1j * np.pi * fx * 2.0) * np.ones_like(wavelength)


@dataclass(frozen=True, kw_only=True)
class ColoursHalfAPixelUp(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        up = np.concatenate([rgb_camera[:, 1:], rgb_camera[:, -1:]], axis=1)
        found = rgb_camera.copy()
        found[2] = rgb_camera.dtype.type(0.5) * (rgb_camera + up)[2]
        return {"rgb_camera": found}


@dataclass(frozen=True, kw_only=True)
class PaddedWithZeros(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        return {"charge": box(charge, "constant")}


@dataclass(frozen=True, kw_only=True)
class FadesAtTheRim(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        found = rgb_camera.copy()
        found[:, [0, -1]] *= found.dtype.type(0.99)
        return {"rgb_camera": found}


@dataclass(frozen=True, kw_only=True)
class LosesAtTheRimAlthoughItKeepsTheSum(OfCharge):
    """Spreads charge, and drops what crosses the border; asks where it is, so that it might be a shading."""

    keeps: ClassVar = ("sum",)

    def run(self, charge: Any, y: Any, x: Any) -> dict[str, Any]:
        return {"charge": box(charge, "constant")}


@dataclass(frozen=True, kw_only=True)
class EveryOtherColumn(OfCharge):
    def run(self, charge: Any) -> dict[str, Any]:
        found = charge.copy()
        found[:, ::2] *= found.dtype.type(1.01)
        return {"charge": found}


@dataclass(frozen=True, kw_only=True)
class MaskOfItsOwnWindow(Stage):
    """Takes the first pixel that it is given for the first of the mask."""

    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"

    def run(self, mosaic_linear: Any, y: Any, x: Any) -> dict[str, Any]:
        return {"rgb_camera": bilinear(mosaic_linear, shifted_bayer("RGGB", 0, 0))}


@dataclass(frozen=True, kw_only=True)
class BrighterInTheMiddle(OfCharge):
    strength: float = param(0.1, at_least=0, at_most=1, doc="fall towards the corners")

    def run(self, charge: Any) -> dict[str, Any]:
        rows, columns = charge.shape
        down, across = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None, :]
        return {"charge": (charge * (1 - self.strength * (down**2 + across**2) / 2)).astype(charge.dtype)}


FAULTY = {
    "boundary off by one": [LastRowForgotten, WrapsAround, FirstColumnTwice],
    "half a pixel": [BlursToTheRight, HalfAPixelByPhase, ColoursHalfAPixelUp],
    "light lost at the rim": [PaddedWithZeros, FadesAtTheRim, LosesAtTheRimAlthoughItKeepsTheSum],
    "position or phase": [EveryOtherColumn, MaskOfItsOwnWindow, BrighterInTheMiddle],
}
