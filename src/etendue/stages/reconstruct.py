"""Reconstruction: mosaic to three linear channels, and sharpening.

In:  ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``rgb_camera`` (channel, y, x), linear, in the camera's own primaries.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from etendue.api import RGB, Facts, Grid, Stage, hookimpl, param, quantity
from etendue.physics import demosaic, restoration


@dataclass(frozen=True, kw_only=True)
class _Demosaic(Stage):
    """Three channels at every pixel from one."""

    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    negative: ClassVar = "keep"

    pattern: str = quantity("pattern")

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Of the arithmetic; what the method invents between samples is not an error of its arithmetic."""
        return (4e-7 if precision == "float32" else 1e-15), "measured"


@dataclass(frozen=True, kw_only=True)
class DemosaicNearest(_Demosaic):
    """The nearest sample of each colour."""

    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 2.0

    def run(self, mosaic_linear: Any) -> dict[str, Any]:
        return {"rgb_camera": demosaic.nearest(mosaic_linear, self.pattern)}


@dataclass(frozen=True, kw_only=True)
class DemosaicBilinear(_Demosaic):
    """Means of the two or four nearest samples."""

    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 5.0

    def run(self, mosaic_linear: Any) -> dict[str, Any]:
        return {"rgb_camera": demosaic.bilinear(mosaic_linear, self.pattern)}


@dataclass(frozen=True, kw_only=True)
class DemosaicColourDifference(_Demosaic):
    """The paper's: green first, then the differences to green, which hold fewer edges (its section 2.7)."""

    gain: ClassVar = 3.0  # |R| <= |G| + |K|, |K| <= |R| + |G|, each of gain 1
    nanoseconds: ClassVar = 10.0

    def run(self, mosaic_linear: Any) -> dict[str, Any]:
        return {"rgb_camera": demosaic.colour_difference(mosaic_linear, self.pattern)}


@dataclass(frozen=True, kw_only=True)
class Sharpen(Stage):
    """Identity + strength x Laplacian (eq. 11). No clipping inside."""

    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    gain: ClassVar = 1.0 + 16 * 4.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0

    strength: float = param(0.15, at_least=0, at_most=4, doc="k of identity + k L; the paper's picture has 1")

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": restoration.sharpen(rgb_camera, self.strength)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "strength is 0") if self.strength == 0 else None

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 3e-15) * (1 + 16 * self.strength), "proved"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {
        "demosaic_nearest": DemosaicNearest, "demosaic_bilinear": DemosaicBilinear,
        "demosaic_colour_difference": DemosaicColourDifference, "sharpen": Sharpen,
    }  # fmt: skip
