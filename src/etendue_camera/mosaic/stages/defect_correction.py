"""Defect correction on the mosaic, before demosaicing would spread defects over their neighbours.

In:  ``mosaic_linear`` (y, x), 1 at clipping; ``defect_map``, if the sensor has one.
Out: ``mosaic_linear``, and counts of pixels replaced, missed and replaced needlessly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Stage, measured, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.mosaic import defect_correction
from etendue_camera.sensor.stages.masks import first_pixel, mask_of


@dataclass(frozen=True, kw_only=True)
class DefectDetection(KnownNoise):
    """A stage that detects defective pixels as outliers of the picture."""

    error: ClassVar = measured(2e-7, 1e-15)  # arithmetic error; the true value at a defect is unknown

    pattern: str = quantity("pattern")
    threshold: float = param(
        4.0,
        at_least=1,
        at_most=1e6,
        doc="detection threshold outside the neighbours' range, in sigmas of the pixel's noise",
    )
    contrast: float = param(1.0, at_least=0, at_most=1e3, doc="margin for texture, in widths of the neighbours' range")
    prnu: float = param(0.01, at_least=0, at_most=1, doc="photo-response non-uniformity, relative rms, as in exposure")

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def found(self, frame: FloatArray, first: tuple[int, int]) -> Array:
        """Return the map of outliers in a frame."""
        return defect_correction.outliers(
            frame,
            mask_of(self.pattern),
            defect_correction.PixelNoise(self.dark_sigma(), self.electrons(), self.prnu),
            self.threshold,
            self.contrast,
            *first,
        )


FIGURES = {"defects_corrected": "[1]", "defects_left": "[1]", "defects_missed": "[1] nan", "false_alarms": "[1] nan"}


@dataclass(frozen=True, kw_only=True)
class CorrectDefects(DefectDetection):
    """Replace defective pixels with values interpolated from neighbours of the same colour.

    ``by = "map"`` replaces the pixels of the sensor's map, like a camera with a defect list from its maker.
    ``"detection"`` replaces the pixels detected in the picture, like a camera without a list. ``"both"`` searches the
    picture after correcting the listed pixels. In every case the map serves to count the defects that were missed
    (including hot pixels too weak to be visible) and the good pixels that were replaced. Counts are in pixels.
    """

    role: ClassVar = "defect correction"
    handed: ClassVar = True  # of equally good neighbours it takes the first
    reads: ClassVar = {"mosaic_linear": "y x [1]", "defect_map": "y x [1] uint8"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", **FIGURES}
    decides: ClassVar = True
    gain: ClassVar = None  # a decision has no derivative
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 55.0
    working: ClassVar = 3.4

    by: str = param("both", choices=("map", "detection", "both"), doc="pixels to replace")

    def run(self, mosaic_linear: FloatArray, defect_map: Array, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        known, first, mask = defect_map != 0, first_pixel(y, x), mask_of(self.pattern)
        chosen = np.zeros_like(known) if self.by == "detection" else known
        if self.by != "map":
            chosen = chosen | self.found(defect_correction.replaced(mosaic_linear, chosen, mask, *first)[0], first)
        result, left = defect_correction.replaced(mosaic_linear, chosen, mask, *first)
        counts = np.array([chosen.sum() - left, left, (known & ~chosen).sum(), (chosen & ~known).sum()], float)
        return {"mosaic_linear": result, **dict(zip(FIGURES, map(np.array, counts), strict=True))}


@dataclass(frozen=True, kw_only=True)
class CorrectFoundDefects(DefectDetection):
    """Replace outliers of the picture with values interpolated from neighbours of the same colour, without a defect
    map.

    This stage replaces ``correct_defects`` for a sensor with unknown defects. On a sensor without defects, every
    correction is a false alarm.
    """

    role: ClassVar = "defect correction"
    handed: ClassVar = True  # of equally good neighbours it takes the first
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", **FIGURES}
    decides: ClassVar = True
    gain: ClassVar = None
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 55.0
    working: ClassVar = 6.9

    def run(self, mosaic_linear: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        first = first_pixel(y, x)
        chosen = self.found(mosaic_linear, first)
        result, left = defect_correction.replaced(mosaic_linear, chosen, mask_of(self.pattern), *first)
        counts = np.array([chosen.sum() - left, left], float)
        return {"mosaic_linear": result, **dict(zip(FIGURES, map(np.array, (*counts, np.nan, np.nan)), strict=True))}


@dataclass(frozen=True, kw_only=True)
class JoinDefectMaps(Stage):
    """Join the maps of hot and dead pixels (``defects``) and of stuck pixels (``stuck_pixels``)."""

    role: ClassVar = "defect map"
    reads: ClassVar = {"defect_map": "y x [1] uint8", "stuck_map": "y x [1] uint8"}
    writes: ClassVar = {"defect_map": "y x [1] uint8"}
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.1
    error: ClassVar = proved(0.0)

    def run(self, defect_map: Array, stuck_map: Array) -> dict[str, Array]:
        return {"defect_map": np.where(stuck_map > 0, stuck_map, defect_map)}
