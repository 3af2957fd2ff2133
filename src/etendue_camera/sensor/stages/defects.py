"""Defective pixels, drawn or listed, fixed per sensor.

In:  ``photocurrent``, electron/s (hot, dead); ``raw``, DN (stuck).
Out: the same with defects, and a map of them. No stage of a real camera can read this map; corrections and tests use it
     as the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from etendue.api import Sampled, measured, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import amplifier
from etendue_camera.sensor import defects

if TYPE_CHECKING:
    from etendue.compute.tables import PatternRandom


@dataclass(frozen=True, kw_only=True)
class Defects(Sampled):
    """Add hot pixels, with exponentially distributed dark current that grows with temperature, and dead pixels, which
    see no light.

    The stage comes before the exposure, so that the signal of a hot pixel grows with time, has shot noise and
    saturates. Pixels from a list (``row,column,kind`` with kind hot or dead; other kinds are for ``stuck_pixels``) are
    added to the drawn pixels.
    """

    role: ClassVar = "sensor defects"
    decides: ClassVar = True  # which pixels are defective
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"photocurrent": "y x [electron/s]", "defect_map": "y x [1] uint8"}
    gain: ClassVar = None  # the brightest hot pixel does not count towards the full scale of the light
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 2.3
    libraries: ClassVar = ("numpy",)
    error: ClassVar = measured(1e-6, 1e-15)

    sensor_serial: str = quantity("sensor_serial")
    temperature: float = quantity("temperature")
    dark_reference_temperature: float = quantity("dark_reference_temperature")
    dark_doubling: float = quantity("dark_doubling")
    hot: float = param(1e-4, at_least=0, at_most=0.5, doc="fraction of hot pixels")
    dead: float = param(1e-5, at_least=0, at_most=0.5, doc="fraction of dead pixels")
    hot_rate: float = param(
        1e4, units="electron/s", at_least=0, doc="mean dark current of hot pixels, at the reference temperature"
    )
    file: str = param("", file=True, doc="CSV list of defective pixels: row,column,kind")

    def prepare(self, coordinates: Mapping[str, Array]) -> Array:
        entries = defects.read_list(self.file) if self.file else ()
        return defects.listed_map(entries, coordinates["y"], coordinates["x"])

    def run(self, photocurrent: FloatArray, prepared: Array, rng_sensor: PatternRandom) -> dict[str, Array]:
        drawn = defects.drawn_map(rng_sensor.uniform("hot or dead"), self.hot, self.dead, 0.0)
        found = np.where(np.isin(prepared, (defects.HOT, defects.DEAD)), prepared, drawn)
        warm = amplifier.dark_current_factor(self.temperature, self.dark_reference_temperature, self.dark_doubling)
        hot = np.nonzero(found == defects.HOT)
        light = np.where(found == defects.DEAD, photocurrent.dtype.type(0), photocurrent)
        light[hot] += defects.hot_rates(rng_sensor.uniform("hot rate")[hot], self.hot_rate * warm).astype(light.dtype)
        return {"photocurrent": light, "defect_map": found.astype(np.uint8)}

    def mean(self, photocurrent: FloatArray, prepared: Array) -> dict[str, Array]:
        """Return the mean over many sensors: the effect of randomly drawn defects is spread over all pixels, and the
        map contains only the defects from the list.
        """
        kind = photocurrent.dtype.type
        warm = amplifier.dark_current_factor(self.temperature, self.dark_reference_temperature, self.dark_doubling)
        rate = kind(self.hot_rate * warm)
        anywhere = photocurrent * kind(1 - self.dead) + kind(self.hot) * rate
        light = np.where(
            prepared == defects.DEAD, kind(0), np.where(prepared == defects.HOT, photocurrent + rate, anywhere)
        )
        listed = np.isin(prepared, (defects.HOT, defects.DEAD))
        return {"photocurrent": light, "defect_map": np.where(listed, prepared, 0).astype(np.uint8)}


@dataclass(frozen=True, kw_only=True)
class StuckPixels(Sampled):
    """Give stuck pixels a constant code that does not depend on light, time and noise: a code for each pixel, or one
    code for all.
    """

    role: ClassVar = "stuck pixels"
    reads: ClassVar = {"raw": "y x [DN] uint16"}
    writes: ClassVar = {"raw": "y x [DN] uint16", "stuck_map": "y x [1] uint8"}
    gain: ClassVar = None
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 2.3
    libraries: ClassVar = ("numpy",)
    error: ClassVar = proved(0.0)

    sensor_serial: str = quantity("sensor_serial")
    bits: int = quantity("bits")
    stuck: float = param(1e-5, at_least=0, at_most=0.5, doc="fraction of stuck pixels")
    level: float = param(
        -1.0,
        at_least=-1,
        at_most=1,
        doc="level of all stuck pixels as a fraction of the top code; -1: each pixel has its own level",
    )
    file: str = param("", file=True, doc="CSV list of defective pixels: row,column,kind")

    def prepare(self, coordinates: Mapping[str, Array]) -> Array:
        entries = defects.read_list(self.file) if self.file else ()
        return defects.listed_map(entries, coordinates["y"], coordinates["x"])

    def run(self, raw: Array, prepared: Array, rng_sensor: PatternRandom) -> dict[str, Array]:
        drawn = defects.drawn_map(rng_sensor.uniform("stuck"), 0.0, 0.0, self.stuck)
        found = np.where(prepared == defects.STUCK, prepared, drawn)
        stuck = np.nonzero(found == defects.STUCK)
        share = rng_sensor.uniform("stuck level")[stuck] if self.level < 0 else self.level
        codes = raw.copy()
        codes[stuck] = np.floor(share * (2**self.bits - 1) + 0.5)
        return {"raw": codes, "stuck_map": found.astype(np.uint8)}

    def mean(self, raw: FloatArray, prepared: Array) -> dict[str, Array]:
        """Return the mean over many sensors: the effect of randomly drawn stuck pixels is spread over all pixels, and
        the map contains only the pixels from the list.
        """
        level = (0.5 if self.level < 0 else self.level) * (2**self.bits - 1)
        stuck = prepared == defects.STUCK
        anywhere = raw * raw.dtype.type(1 - self.stuck) + raw.dtype.type(self.stuck * level)
        return {
            "raw": np.where(stuck, raw.dtype.type(level), anywhere),
            "stuck_map": np.where(stuck, prepared, 0).astype(np.uint8),
        }
