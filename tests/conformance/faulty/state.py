"""State: what one picture leaves behind for the next, and for other threads."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tests.conformance.faulty.base import OfCharge, OfColours

_means: dict[Any, float] = {}
_last: list[float] = []
_scratch: dict[Any, Any] = {}


def forget() -> None:
    """Empty what these stages remember, as a process that has not met them."""
    for one in (_means, _last, _scratch):
        one.clear()
    _brightest.cache_clear()


@dataclass(frozen=True, kw_only=True)
class MeanOfTheFirstPicture(OfCharge):
    """Subtracts a mean that is remembered by the size of the frame."""

    def run(self, charge: Any) -> dict[str, Any]:
        mean = _means.setdefault(charge.shape, float(charge.mean(dtype=np.float64)))
        return {"charge": charge - charge.dtype.type(0.1 * mean)}


@dataclass(frozen=True, kw_only=True)
class MeanOfTheLastPicture(OfColours):
    def run(self, rgb_camera: Any) -> dict[str, Any]:
        before = _last[-1] if _last else float(rgb_camera.mean(dtype=np.float64))
        _last.append(float(rgb_camera.mean(dtype=np.float64)))
        return {"rgb_camera": rgb_camera - rgb_camera.dtype.type(0.1 * before)}


@functools.lru_cache(maxsize=8)
def _brightest(_: tuple[int, ...], top: int) -> float:
    return _scratch["top"]


@dataclass(frozen=True, kw_only=True)
class TopRememberedByDecade(OfCharge):
    """Scales by a top that is remembered by its decade."""

    def run(self, charge: Any) -> dict[str, Any]:
        top = float(np.abs(charge).max()) or 1.0
        _scratch["top"] = top
        scale = _brightest(charge.shape, int(np.floor(np.log10(top))))
        return {"charge": charge * charge.dtype.type(1 + 0.01 * top / scale)}


@dataclass(frozen=True, kw_only=True)
class SharedBuffer(OfCharge):
    """Works in a buffer that all threads share."""

    def run(self, charge: Any) -> dict[str, Any]:
        buffer = _scratch.setdefault((charge.shape, charge.dtype), np.empty_like(charge))
        buffer[...] = charge
        buffer *= charge.dtype.type(1.1)
        return {"charge": buffer.copy()}


@dataclass(frozen=True, kw_only=True)
class LeavesItsLevelOnTheClass(OfColours):
    level: ClassVar[float] = 0.0

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        type(self).level = float(rgb_camera.max())
        found = rgb_camera * rgb_camera.dtype.type(0.5)
        return {"rgb_camera": found + rgb_camera.dtype.type(0.1 * type(self).level)}


@dataclass(frozen=True, kw_only=True)
class ReturnsItsBuffer(OfCharge):
    """What it returned is overwritten by the next picture."""

    def run(self, charge: Any) -> dict[str, Any]:
        buffer = _scratch.setdefault(("own", charge.shape, charge.dtype), np.empty_like(charge))
        np.multiply(charge, charge.dtype.type(1.1), out=buffer)
        return {"charge": buffer}


FAULTY = {
    "a cache of another picture": [MeanOfTheFirstPicture, MeanOfTheLastPicture, TopRememberedByDecade],
    "state shared by threads": [SharedBuffer, LeavesItsLevelOnTheClass, ReturnsItsBuffer],
}
