"""Reconstruction: mosaic to full linear channels.

In:  ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``rgb_camera`` (channel, y, x), linear, in the camera's own primaries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from etendue.api import RGB, Facts, Grid, Haloed, Labels, Stage, measured, param, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.mosaic import any_mask, bilinear, directional
from etendue_camera.sensor import cfa
from etendue_camera.sensor.stages.masks import bayer_order, first_pixel, mask_of


@dataclass(frozen=True, kw_only=True)
class _Demosaic(Stage):
    """Three channels at every pixel from one, of a Bayer array."""

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"
    # Of the arithmetic; what the method invents between samples is not an error of its arithmetic.
    error: ClassVar[Any] = measured(4e-7, 1e-15)

    pattern: str = quantity(
        "pattern", "colour filter array, of Bayer orders alone: RGGB, BGGR, GRBG, GBRG; others: demosaic_any"
    )

    def __post_init__(self) -> None:
        bayer_order(self.pattern, "this demosaicer")

    def seen(self, y: FloatArray, x: FloatArray) -> str:
        """The Bayer order as the window sees it, which may start on odd rows and columns."""
        return cfa.shifted_bayer(bayer_order(self.pattern, "this demosaicer"), *first_pixel(y, x))


@dataclass(frozen=True, kw_only=True)
class DemosaicNearest(_Demosaic, Haloed):
    """The nearest sample of each colour."""

    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 2.0
    working: ClassVar = 0.4

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": bilinear.nearest(mosaic_linear, self.seen(y, x), *first_pixel(y, x))}

    def halo(self) -> int:
        return 2


@dataclass(frozen=True, kw_only=True)
class DemosaicBilinear(_Demosaic, Haloed):
    """Means of the two or four nearest samples."""

    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 0.4

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": bilinear.bilinear(mosaic_linear, self.seen(y, x))}

    def halo(self) -> int:
        return bilinear.REACH


@dataclass(frozen=True, kw_only=True)
class DemosaicColourDifference(_Demosaic, Haloed):
    """The paper's: green first, then the differences to green, which hold fewer edges (its section 2.7)."""

    gain: ClassVar = 3.0  # |R| <= |G| + |K|, |K| <= |R| + |G|, each of gain 1
    nanoseconds: ClassVar = 10.0
    working: ClassVar = 0.5

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": bilinear.colour_difference(mosaic_linear, self.seen(y, x))}

    def halo(self) -> int:
        return bilinear.REACH


@dataclass(frozen=True, kw_only=True)
class DemosaicDirectional(_Demosaic, Haloed):
    """Colour differences along rows and columns, weighted by direction similarity: our reconstruction of the idea
    the paper cites.
    """

    gain: ClassVar = None  # weights turn from rows to columns within the floor: errors may grow by its inverse
    nanoseconds: ClassVar = 12.0
    working: ClassVar = 0.6

    floor: float = param(
        directional.FLOOR,
        above=0,
        at_most=1,
        doc="mean differences below it, 1 at clipping, say nothing about direction",
    )

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Roundings add to what the floor hides: where two greens on flat ground differ by a tenth of full scale,
        say.
        """
        return (4e-7 + 5e-9 / self.floor if precision == "float32" else 1e-15 + 1e-17 / self.floor), "measured"

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": directional.directional(mosaic_linear, self.seen(y, x), self.floor)}

    def halo(self) -> int:
        return directional.REACH


@dataclass(frozen=True, kw_only=True)
class DemosaicAny(Haloed):
    """Piecewise-linear between the nearest samples of each channel, for any colour filter array; on Bayer it is the
    bilinear one.
    """

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    gain: ClassVar = 1.0  # weights are not negative and sum to 1
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 10.0
    working: ClassVar = 0.6
    # Of the arithmetic; what the method invents between samples is not an error of its arithmetic.
    error: ClassVar = measured(1e-6, 3e-15)

    pattern: str = quantity("pattern")

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"rgb_camera": inputs["mosaic_linear"].replace(channel=Labels(mask_of(self.pattern).channels))}

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": any_mask.linear(mosaic_linear, mask_of(self.pattern), *first_pixel(y, x))}

    def halo(self) -> int:
        """At least a period: a frame of fewer rows is filled otherwise."""
        return any_mask.reach_of(mask_of(self.pattern))
