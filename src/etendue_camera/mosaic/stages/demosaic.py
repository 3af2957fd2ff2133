"""Demosaicing: from a mosaic to full linear channels.

In:  ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``rgb_camera`` (channel, y, x), linear camera RGB.
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
    """Interpolate three channels at every pixel of a Bayer array."""

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"
    # Arithmetic error only; interpolation error between samples is a property of the method.
    error: ClassVar[Any] = measured(4e-7, 1e-15)

    pattern: str = quantity(
        "pattern", "colour filter array, Bayer orders only: RGGB, BGGR, GRBG, GBRG; for others use demosaic_any"
    )

    def __post_init__(self) -> None:
        bayer_order(self.pattern, "this demosaicer")

    def seen(self, y: FloatArray, x: FloatArray) -> str:
        """Return the Bayer order as seen from the window, which may start on odd rows and columns."""
        return cfa.shifted_bayer(bayer_order(self.pattern, "this demosaicer"), *first_pixel(y, x))


@dataclass(frozen=True, kw_only=True)
class DemosaicNearest(_Demosaic, Haloed):
    """Demosaic by the nearest sample of each colour."""

    gain: ClassVar = 1.0
    handed: ClassVar = True  # the nearest neighbour on one side
    nanoseconds: ClassVar = 2.0
    working: ClassVar = 0.4

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": bilinear.nearest(mosaic_linear, self.seen(y, x), *first_pixel(y, x))}

    def halo(self) -> int:
        return 2


@dataclass(frozen=True, kw_only=True)
class DemosaicBilinear(_Demosaic, Haloed):
    """Demosaic by means of the two or four nearest samples."""

    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 0.4

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": bilinear.bilinear(mosaic_linear, self.seen(y, x))}

    def halo(self) -> int:
        return bilinear.REACH


@dataclass(frozen=True, kw_only=True)
class DemosaicColourDifference(_Demosaic, Haloed):
    """Demosaic as in the paper: green first, then colour differences to green, which have fewer edges (section 2.7)."""

    gain: ClassVar = 3.0  # |R| <= |G| + |K|, |K| <= |R| + |G|, each of gain 1
    nanoseconds: ClassVar = 10.0
    working: ClassVar = 0.5

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": bilinear.colour_difference(mosaic_linear, self.seen(y, x))}

    def halo(self) -> int:
        return bilinear.REACH


@dataclass(frozen=True, kw_only=True)
class DemosaicDirectional(_Demosaic, Haloed):
    """Demosaic by colour differences along rows and columns, weighted by directional similarity: our reconstruction of
    the idea that the paper cites.
    """

    gain: ClassVar = None  # weights switch from rows to columns within the floor: errors may grow by its inverse
    nanoseconds: ClassVar = 12.0
    working: ClassVar = 0.6

    floor: float = param(
        directional.FLOOR,
        above=0,
        at_most=1,
        doc="floor of mean differences (1 = clipping); smaller differences do not decide the direction",
    )

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the rounding error, which grows as the floor decreases: for instance where two greens on a flat
        background differ by a tenth of full scale.
        """
        return (4e-7 + 5e-9 / self.floor if precision == "float32" else 1e-15 + 1e-17 / self.floor), "measured"

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": directional.directional(mosaic_linear, self.seen(y, x), self.floor)}

    def halo(self) -> int:
        return directional.REACH


@dataclass(frozen=True, kw_only=True)
class DemosaicAny(Haloed):
    """Demosaic any colour filter array by piecewise-linear interpolation between the nearest samples of each channel;
    on Bayer it is bilinear.
    """

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    gain: ClassVar = 1.0  # weights are not negative and sum to 1
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 10.0
    working: ClassVar = 0.6
    # Arithmetic error only; interpolation error between samples is a property of the method.
    error: ClassVar = measured(1e-6, 3e-15)

    pattern: str = quantity("pattern")

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"rgb_camera": inputs["mosaic_linear"].replace(channel=Labels(mask_of(self.pattern).channels))}

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": any_mask.linear(mosaic_linear, mask_of(self.pattern), *first_pixel(y, x))}

    def halo(self) -> int:
        """Return the reach of the interpolation, at least one period: a frame with fewer rows is interpolated
        differently.
        """
        return any_mask.reach_of(mask_of(self.pattern))
