"""OpenCV's demosaicers, one stage each, so that ``compare --axis demosaic.use`` finds them all.

In:  ``mosaic_linear`` (y, x), 1 at clipping; Bayer masks.
Out: ``rgb_camera`` (channel, y, x), linear camera RGB.

OpenCV works on integers, see ``codes``. It copies inner pixels to the borders, and returns very small frames
uninitialised. The frame is therefore first mirrored about its outermost samples, which keeps the colours in place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np

from etendue.api import RGB, Stage, param, quantity
from etendue_camera.sensor import cfa
from etendue_other_libraries.codes import Codes

MARGIN = 8  # even, so that the mask keeps its order


@dataclass(frozen=True, kw_only=True)
class Bilinear(Stage):
    """Demosaic with OpenCV's bilinear method, on 16 bits."""

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    libraries: ClassVar = ("opencv-python-headless",)
    negative: ClassVar = "keep"
    gain: ClassVar = None  # rounding: a small error may disappear, or become a step
    decides: ClassVar = True
    nanoseconds: ClassVar = 10.0
    bits: ClassVar[int] = 16
    suffix: ClassVar[str] = ""

    pattern: str = quantity("pattern")
    largest: float = param(4.0, at_least=1, at_most=64, doc="value of the highest code; brighter values are clipped")

    def __post_init__(self) -> None:
        self.order(0, 0)

    def order(self, row: int, column: int) -> str:
        """Return the Bayer order as seen by a window that starts at this pixel of the sensor."""
        name = None if self.pattern.endswith(".csv") else cfa.parse(self.pattern).bayer
        if name is None:
            raise ValueError(f"OpenCV supports {', '.join(cfa.BAYER)} only, not {self.pattern!r}; use demosaic_any")
        return cfa.shifted_bayer(name, row, column)

    def run(self, mosaic_linear: Any, y: Any, x: Any) -> dict[str, Any]:
        if min(mosaic_linear.shape) < 2:
            raise ValueError(
                f"a frame of {' x '.join(map(str, mosaic_linear.shape))} does not have two colours along both sides"
            )
        codes = Codes(self.largest, self.bits)
        order = self.order(round(float(y[0])), round(float(x[0])))
        mirrored = np.pad(codes.of(mosaic_linear), MARGIN, mode="reflect")
        found = cv2.cvtColor(mirrored, getattr(cv2, f"COLOR_Bayer{order}2RGB{self.suffix}"))
        inner = found[MARGIN:-MARGIN, MARGIN:-MARGIN]
        return {"rgb_camera": codes.back(np.moveaxis(inner, -1, 0), mosaic_linear.dtype)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the rounding error, to codes and within OpenCV. Interpolation error is not included."""
        return Codes(self.largest, self.bits).step, "measured"


@dataclass(frozen=True, kw_only=True)
class EdgeAware(Bilinear):
    """Demosaic with OpenCV's edge-aware method, on 16 bits: green along the smaller of two gradients."""

    suffix: ClassVar[str] = "_EA"


@dataclass(frozen=True, kw_only=True)
class GradientNumber(Bilinear):
    """Demosaic with OpenCV's variable number of gradients (Chang, Cheung and Pang 1999), on 8 bits, its maximum."""

    nanoseconds: ClassVar = 60.0
    bits: ClassVar[int] = 8
    suffix: ClassVar[str] = "_VNG"

    largest: float = param(1.0, at_least=1, at_most=64, doc="value of the highest code; brighter values are clipped")
