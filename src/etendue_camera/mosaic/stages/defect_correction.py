"""Defective pixels corrected on the mosaic, in front of the demosaicer, which would spread them over their neighbours.

In:  ``mosaic_linear`` (y, x), 1 at clipping; ``defect_map``, where the sensor has one.
Out: ``mosaic_linear``, and how many pixels were replaced, missed, and replaced for nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Stage, measured, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.mosaic import defect_correction
from etendue_camera.sensor.stages.masks import first_pixel, mask_of


@dataclass(frozen=True, kw_only=True)
class DefectDetection(KnownNoise):
    """What the search for defects needs to know of the camera, and what it finds."""

    error: ClassVar = measured(2e-7, 1e-15)  # of the arithmetic; what stood where a defect is, nobody knows

    pattern: str = quantity("pattern")
    threshold: float = param(
        4.0, at_least=1, at_most=1e6, doc="sigma of a pixel's noise beyond what its neighbours allow"
    )
    contrast: float = param(
        1.0, at_least=0, at_most=1e3, doc="widths by which the range of the neighbours is widened: what texture may do"
    )
    prnu: float = param(
        0.01, at_least=0, at_most=1, doc="relative rms of the response from pixel to pixel, as of exposure"
    )

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def found(self, frame: Any, first: tuple[int, int]) -> Any:
        """Map of what stands out of a frame."""
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
    """Defects of the sensor's map, or those that stand out of the picture, or both, replaced from neighbours of the
    same colour.

    ``by = "map"`` is a camera with the list its maker measured, ``"detection"`` one without, ``"both"`` searches the
    picture after the list has been corrected. Whatever is used, the map says what was missed (hot pixels too weak to be
    seen count) and which sound pixels were replaced. Counts are pixels.
    """

    role: ClassVar = "defect correction"
    reads: ClassVar = {"mosaic_linear": "y x [1]", "defect_map": "y x [1] uint8"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", **FIGURES}
    decides: ClassVar = True
    gain: ClassVar = None  # a decision has no slope
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 55.0
    working: ClassVar = 3.4

    by: str = param("both", choices=("map", "detection", "both"), doc="which pixels are replaced")

    def run(self, mosaic_linear: FloatArray, defect_map: Any, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        known, first, mask = defect_map != 0, first_pixel(y, x), mask_of(self.pattern)
        chosen = np.zeros_like(known) if self.by == "detection" else known
        if self.by != "map":
            chosen = chosen | self.found(defect_correction.replaced(mosaic_linear, chosen, mask, *first)[0], first)
        result, left = defect_correction.replaced(mosaic_linear, chosen, mask, *first)
        counts = np.array([chosen.sum() - left, left, (known & ~chosen).sum(), (chosen & ~known).sum()], float)
        return {"mosaic_linear": result, **dict(zip(FIGURES, map(np.array, counts), strict=True))}


@dataclass(frozen=True, kw_only=True)
class CorrectFoundDefects(DefectDetection):
    """Pixels that stand out of the picture replaced from neighbours of the same colour, where no map says what is
    missed.

    Takes the place of ``correct_defects`` for a sensor whose defects nobody knows; on one without defects all it
    corrects are false alarms.
    """

    role: ClassVar = "defect correction"
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
    """One map of all defective pixels: hot and dead ones (``defects``) and stuck ones (``stuck_pixels``)."""

    role: ClassVar = "defect map"
    reads: ClassVar = {"defect_map": "y x [1] uint8", "stuck_map": "y x [1] uint8"}
    writes: ClassVar = {"defect_map": "y x [1] uint8"}
    nanoseconds: ClassVar = 1.0
    working: ClassVar = 0.1
    error: ClassVar = proved(0.0)

    def run(self, defect_map: Any, stuck_map: Any) -> dict[str, Array]:
        return {"defect_map": np.where(stuck_map > 0, stuck_map, defect_map)}
