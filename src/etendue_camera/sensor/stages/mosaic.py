"""The colour filter array: one channel per pixel.

In:  ``photon_rate`` (channel, y, x), electron/s, behind each filter of the sensor.
Out: ``photocurrent`` (y, x), electron/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from etendue.api import Facts, Grid, Haloed, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.sensor import cfa
from etendue_camera.sensor.stages.masks import first_pixel, mask_of


@dataclass(frozen=True, kw_only=True)
class Mosaic(Haloed):
    """Apply the colour filter array: each pixel keeps one channel, selected by its position on the sensor, not in the
    window.
    """

    role: ClassVar = "colour filter array"
    reads: ClassVar = {"photon_rate": "channel y x [electron/s]"}
    writes: ClassVar = {"photocurrent": "y x [electron/s]"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.0
    error: ClassVar = proved(0.0)

    pattern: str = quantity("pattern")

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        planes, channels = inputs["photon_rate"], mask_of(self.pattern).channels
        found = tuple(planes["channel"].values())
        if found != channels:
            raise ValueError(
                f"the pattern {self.pattern!r} has the channels {', '.join(channels)}, but photon_rate has "
                f"{', '.join(map(str, found))}"
            )
        return {"photocurrent": planes.take(("y", "x"))}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return the range of all planes, since every value comes from one of the planes."""
        planes = facts["photon_rate"]
        return Facts(low=planes.low, high=planes.high, mean=planes.mean, brightest=planes.brightest)

    def run(self, photon_rate: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"photocurrent": cfa.pick(photon_rate, mask_of(self.pattern), *first_pixel(y, x))}
