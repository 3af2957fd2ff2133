"""Lens shading correction before demosaicing: the falloff of the lens is corrected by gains known to the camera.

In:  ``mosaic_linear`` (y, x), 1 at clipping, positions from the axis.
Out: ``mosaic_linear`` as from a lens without falloff, noisier away from the axis.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from etendue.api import Bounded, Facts, Grid, Haloed, Stage, measured, param, quantity
from etendue.contract.stage import file_state
from etendue_camera.arrays import FloatArray
from etendue_camera.field import illumination
from etendue_camera.field.stages.falloff import Falloff
from etendue_camera.field.stages.illumination import AngularResponse, Vignetting, farthest
from etendue_camera.mosaic import shading
from etendue_camera.optics.stages.conjugates import Conjugates
from etendue_camera.sensor import cfa
from etendue_camera.sensor.stages.masks import first_pixel, mask_of

if TYPE_CHECKING:
    from etendue_camera.arrays import Array

NOTED = 1.1  # gain above which the plan reports the noise increase


@lru_cache(maxsize=16)
def _table(path: str, state: tuple[int, int]) -> shading.GainTable:
    try:
        return shading.read_gains(path)
    except OSError as error:
        raise ValueError(f"{path}: could not be read: {error.strerror}") from None


@dataclass(frozen=True, kw_only=True)
class LensShading(Conjugates, Bounded, Haloed):
    """Correct falloff with gains by image height, relative to the axis, from a model of the lens or a calibrated table.

    With ``map = "model"`` the gains correct the falloff of the stage ``falloff`` (``model``, ``geometry``,
    ``full_field``), the rim of ``vignetting`` and the cosine response of ``angular_response``, for the camera's own
    aperture and focus. The parameters have the same names as in these stages; if the values differ, the correction is
    wrong by the difference. With ``map = "table"`` the gains come from a CSV file by height, with one column for all
    channels or one per channel, as `etendue_camera.mosaic.shading.calibrated` computes from a flat field. Black stays
    black; noise grows with the gain, and the plan reports by how much. ``clipping_level`` is multiplied by the smallest
    gain of the frame.
    """

    role: ClassVar = "shading correction"
    reads: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    gain: ClassVar[float | None] = None  # set by the table
    negative: ClassVar = "keep"
    once: ClassVar = ("the correction of shading",)
    nanoseconds: ClassVar = 8.0
    working: ClassVar = 7.0
    # Arithmetic error only; the fit of model or table to the lens is separate.
    error: ClassVar = measured(1e-6, 2e-14)

    pattern: str = quantity("pattern")
    map: str = param("model", choices=("model", "table"), doc="source of the gains")
    strength: float = param(
        1.0,
        at_least=0,
        at_most=1,
        doc="strength s of the correction: the gain is 1 + s (1/r - 1), with r the relative illumination",
    )
    largest_gain: float = param(16.0, at_least=1, at_most=1e4, doc="upper limit of the gains")
    table: str = param("", table=True, doc="for map 'table': CSV file height_mm,gain or height_mm,R,G,B")
    model: str = param("cos4", choices=("cos4", "disc"), doc="for map 'model': as in falloff")
    geometry: str = param("physical", choices=("physical", "paper"), doc="as in falloff")
    full_field: float = param(60.0, units="deg", above=0, below=170, doc="as in falloff")
    rim_radius: float = param(math.inf, units="mm", above=0, infinite=True, doc="as in vignetting; inf: no rim")
    rim_distance: float = param(0.0, units="mm", at_least=0, doc="as in vignetting")
    power: float = param(0.0, at_least=0, at_most=1e3, doc="as in angular_response; 0: none")

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.map == "table") != bool(self.table):
            raise ValueError(
                f"map is {self.map!r} and table is {self.table!r}; give a table with map = 'table', and only with it"
            )
        mask_of(self.pattern)
        if self.map == "model":
            self.relative(np.zeros(1), 0.0)

    def relative(self, radius_um: FloatArray, corner_um: float) -> FloatArray:
        """Return the relative illumination by image height that the camera assumes."""
        shared: dict[str, Any] = {
            "f_number": self.f_number,
            "focal_length": self.focal_length,
            "magnification": self.magnification,
            "pupil_magnification": self.pupil_magnification,
            "focus_distance": self.focus_distance,
        }
        falling = Falloff(model=self.model, geometry=self.geometry, full_field=self.full_field, **shared)
        found = falling.relative(falling.tangent(radius_um, corner_um))
        if not math.isinf(self.rim_radius):
            found = found * Vignetting(rim_radius=self.rim_radius, rim_distance=self.rim_distance, **shared).relative(
                radius_um
            )
        if self.power:
            response = AngularResponse(power=self.power, **shared)
            found = found * illumination.cosine_response(response.angle(radius_um), self.power)
        return found

    def rows(self) -> shading.GainTable:
        """Return the table, which must have a column for each channel of the pattern, or one column for all; for a
        single plane, it may have more columns.
        """
        table = _table(self.table, file_state(self.table))
        channels, columns = set(mask_of(self.pattern).channels), set(table.columns)
        if len(columns) > 1 and channels != columns and not (len(channels) == 1 and channels < columns):
            raise ValueError(
                f"{self.table} has the columns {', '.join(table.columns)}, but the pattern {self.pattern!r} has the "
                f"channels {', '.join(mask_of(self.pattern).channels)}; give one column per channel, or one for all"
            )
        return table

    def weakened(self, gains: FloatArray) -> FloatArray:
        """Return the gains of a table at the given strength and limit."""
        return np.minimum(1 + self.strength * (gains - 1), self.largest_gain)

    def largest(self, grid: Grid) -> float:
        """Return the largest gain over the frame: in the corner for a model, anywhere for a table."""
        corner = farthest(grid)
        if self.map == "table":
            table = self.rows()
            inside = table.heights_mm[table.heights_mm < 1e-3 * corner]
            places = np.append(inside, 1e-3 * corner)
            return max(
                float(np.max(self.weakened(np.interp(places, table.heights_mm, column)))) for column in table.gains.T
            )
        return float(
            shading.gain_of(
                np.asarray(self.relative(np.array([corner]), corner), float), self.strength, self.largest_gain
            )[0]
        )

    def gains(self, y_um: FloatArray, x_um: FloatArray) -> FloatArray:
        """Return the gains, (1 or channel, y, x)."""
        radius = np.hypot(y_um[:, None], x_um[None, :])
        if self.map == "model":
            corner = math.hypot(*(max((abs(v) for v in line[[0, -1]]), default=0.0) for line in (y_um, x_um)))
            return shading.gain_of(self.relative(radius, corner), self.strength, self.largest_gain)[None]
        table, channels = self.rows(), mask_of(self.pattern).channels
        columns = [table.columns.index(channel) for channel in channels] if len(table.columns) > 1 else [0]
        return np.stack(
            [self.weakened(np.interp(1e-3 * radius, table.heights_mm, table.gains[:, column])) for column in columns]
        )

    def run(
        self,
        mosaic_linear: FloatArray,
        clipping_level: FloatArray,
        y: FloatArray,
        x: FloatArray,
        y_um: FloatArray,
        x_um: FloatArray,
    ) -> dict[str, Array]:
        gains = self.gains(y_um, x_um)
        own = gains[0] if len(gains) == 1 else cfa.pick(gains, mask_of(self.pattern), *first_pixel(y, x))
        own = own.astype(mosaic_linear.dtype, copy=False)
        return {
            "mosaic_linear": mosaic_linear * own,
            "clipping_level": clipping_level * own.min(initial=self.largest_gain),
        }

    def halo(self) -> int | None:
        """Return 0: gains depend on image height only; None for the paper's falloff, which depends on the frame
        corner."""
        return None if self.map == "model" and self.geometry == "paper" else 0

    def joined(self, parts: Mapping[str, Sequence[Array]], sizes: Sequence[int]) -> Mapping[str, Array]:
        return {"clipping_level": np.min(parts["clipping_level"], axis=0)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.strength == 0:
            return 0.0, "strength is 0"
        return (self.largest(grid) - 1, "the largest gain is within this of 1") if self.map == "model" else None

    def assumes(self) -> dict[str, Hashable]:
        """Return the model's assumptions about the lens; a table has none."""
        if self.map != "model" or self.strength == 0:
            return {}
        fall_off = (self.model, self.geometry, *((self.full_field,) if self.geometry == "paper" else ()))
        return {"the fall-off": fall_off, "the response by angle": ("power", self.power)}

    def warn_among(self, others: Mapping[str, type[Stage]]) -> list[str]:
        rims = [name for name, kind in others.items() if kind.role == Vignetting.role]
        if self.strength > 0 and self.map == "model" and math.isinf(self.rim_radius) and rims:
            return [
                f"the lens has a rim (stage {rims[0]}) that this correction does not include: give it rim_radius and "
                f"rim_distance too"
            ]
        return []

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if self.strength == 0:
            return []
        notes, grid = [], grids["mosaic_linear"]
        largest = self.largest(grid)
        if largest >= self.largest_gain:
            notes.append(
                f"gains are limited to largest_gain = {self.largest_gain:g}: the corner stays darker than the axis"
            )
        elif largest > NOTED:
            notes.append(
                f"gain up to {largest:.3g} away from the axis: noise grows by the same factor, "
                f"{20 * math.log10(largest):.1f} dB"
            )
        if self.map == "table" and 1e-3 * farthest(grid) > self.rows().heights_mm[-1] * (1 + 1e-9):
            notes.append(
                f"{self.table} ends at {self.rows().heights_mm[-1]:g} mm, but the frame corner is at "
                f"{1e-3 * farthest(grid):.4g} mm: "
                "the last row is used beyond"
            )
        return notes
