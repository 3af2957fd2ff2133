"""Other field-dependent losses: vignetting at a rim, and the angular response of pixels.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1, and its positions relative to the optical axis.
Out: ``irradiance``, reduced away from the axis.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Banded, Bounded, Facts, Grid, Line, measured, param
from etendue_camera.arrays import Array, FloatArray, Floats
from etendue_camera.field import illumination
from etendue_camera.field.stages.tables import FieldTable, field_table
from etendue_camera.optics.stages.conjugates import Conjugates


def ends_of(line: Line) -> tuple[float, float]:
    """Return the positions (um) of the first and the last sample."""
    start, step = line.um()
    return start, start + step * (line.size - 1)


def farthest(grid: Grid) -> float:
    """Return the distance (um) of the farthest sample of a grid from the axis."""
    return math.hypot(*(max(map(abs, ends_of(grid.line(dim)))) for dim in ("y", "x")))


def nearest(grid: Grid) -> float:
    """Return a lower bound on the distance (um) of the nearest point of a grid from the axis."""
    sides = [ends_of(grid.line(dim)) for dim in ("y", "x")]
    return math.hypot(*(0.0 if min(ends) <= 0 <= max(ends) else min(map(abs, ends)) for ends in sides))


def by_curves(irradiance: FloatArray, where: FloatArray, nodes: FloatArray, curves: FloatArray) -> FloatArray:
    """Multiply light by a field curve, given at nodes as (1 or wavelength, node), interpolated at positions (y, x)."""
    if len(curves) == 1:
        return irradiance * illumination.table_at(where, nodes, curves[0]).astype(irradiance.dtype, copy=False)
    weakened = np.empty_like(irradiance)
    for band, curve in enumerate(curves):
        np.multiply(
            irradiance[band], illumination.table_at(where, nodes, curve), out=weakened[band], casting="same_kind"
        )
    return weakened


@dataclass(frozen=True, kw_only=True)
class Dimming(Conjugates):
    """A stage that multiplies the light by a local factor, and does nothing else."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    pointwise: ClassVar = True
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"


@dataclass(frozen=True, kw_only=True)
class Vignetting(Dimming, Banded, Bounded):
    """Apply vignetting: a round rim in front of the entrance pupil cuts oblique beams. The open part is the overlap of
    two discs, and stopping down reduces the effect.

    Its effect multiplies the effect of a falloff stage.
    """

    role: ClassVar = "vignetting"
    nanoseconds: ClassVar = 3.0
    working: ClassVar = 0.5
    error: ClassVar = measured(2e-7, 1e-14)

    rim_radius: float = param(math.inf, units="mm", above=0, infinite=True, doc="radius of the rim; inf: no rim")
    rim_distance: float = param(
        0.0, units="mm", at_least=0, doc="distance from the rim to the entrance pupil behind it"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.relative(0.0)

    def relative(self, radius_um: Floats) -> FloatArray:
        """Return the open fraction of the pupil, by image height."""
        magnification = self.image_magnification()
        slower = 1.0 - magnification / self.pupil_magnification
        tangent = np.asarray(radius_um) * (1e-3 / (self.focal_length * slower))  # on the object side
        distance = self.focal_length * slower / -magnification if magnification else math.inf
        return illumination.vignetting(
            tangent, 0.5 * self.focal_length / self.f_number, self.rim_radius, self.rim_distance, distance
        )

    def by_band(self, prepared: None, bands: slice) -> None:
        return prepared

    def in_rows(self) -> bool:
        return True

    def run(self, irradiance: FloatArray, y_um: FloatArray, x_um: FloatArray) -> dict[str, Array]:
        return {
            "irradiance": irradiance * self.relative(np.hypot(y_um[:, None], x_um[None, :])).astype(irradiance.dtype)
        }

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str]:
        return 1.0 - float(self.relative(farthest(grid))), "vignetting at the corner is at most this"

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        lowest = float(self.relative(farthest(grid["irradiance"])))
        return facts["irradiance"].scaled(lowest, 1.0)

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if float(self.relative(farthest(grids["irradiance"]))) > 0:
            return []
        return [
            f"behind a rim of {self.rim_radius:g} mm, {self.rim_distance:g} mm in front of the pupil, the corner of "
            f"the frame is black"
        ]


@dataclass(frozen=True, kw_only=True)
class AngularResponse(Dimming, Banded, Bounded):
    """Apply the angular response of pixels: less signal from angles for which their microlenses are not designed."""

    role: ClassVar = "angular response"
    once: ClassVar = ("angular response",)
    nanoseconds: ClassVar = 3.0
    error: ClassVar = measured(3e-7, 1e-14)

    power: float = param(
        0.0,
        at_least=0,
        at_most=1e3,
        doc="exponent of the response cos^power of the angle error; 0: no loss; 1.55: a response of 0.8 at 30 degrees",
    )
    table: str = param(
        "", table=True, doc="CSV file angle_deg,ratio or angle_deg,450,550,650 (by wavelength, nm) instead of the power"
    )
    exit_pupil_distance: float = param(
        0.0,
        units="mm",
        at_least=0,
        infinite=True,
        apart=(0.0,),
        doc="distance from the exit pupil to the sensor; 0: from the camera's pupils, f (m_p - m); inf: telecentric",
    )
    microlens_shift: float = param(
        0.0, units="deg/mm", doc="chief-ray angle for which a pixel is designed, per distance from the axis"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.table and self.power:
            raise ValueError("power and table are both given; give only one of them")

    def assumes(self) -> dict[str, Hashable]:
        return {"the response by angle": ("that of", self.table) if self.table else ("power", self.power)}

    def distance(self) -> float:
        return self.exit_pupil_distance or self.pupil_distance()

    def angle(self, radius_um: FloatArray) -> FloatArray:
        """Return the angle of the chief ray relative to the design direction of the pixel there, degrees."""
        height = np.asarray(radius_um) * 1e-3
        return illumination.chief_ray_angle(height, self.distance()) - self.microlens_shift * height

    def rows(self) -> FieldTable:
        return field_table(self.table, ("angle_deg",))

    def folded(self, angle: FloatArray) -> FloatArray:
        """Return angles as the table has them: without their sign if the table begins on the axis."""
        return np.abs(angle) if self.rows().nodes[0] >= 0 else angle

    def bounds(self, grid: Grid) -> tuple[float, float]:
        """Return lower and upper bounds of the response over the frame."""
        radii = np.linspace(nearest(grid), farthest(grid), 257)
        angles = self.angle(radii)
        # largest change of angle between two of the radii, from the slopes of the arctangent and of the profile
        slack = (math.degrees(1.0 / self.distance()) + abs(self.microlens_shift)) * 1e-3 * float(radii[1] - radii[0])
        if self.table:
            places = self.folded(angles)
            return self.rows().range(float(places.min()) - slack, float(places.max()) + slack)
        worst = max(abs(float(angles.min())), abs(float(angles.max()))) + slack
        return float(illumination.cosine_response(worst, self.power)), 1.0

    def does_nothing(self) -> bool:
        return not self.table and self.power == 0

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        return self.rows().curves(coordinates["wavelength"]) if self.table else np.ones((1, 1))

    def by_band(self, prepared: FloatArray, bands: slice) -> FloatArray:
        return prepared if len(prepared) == 1 else prepared[bands]

    def in_rows(self) -> bool:
        return True

    def run(self, irradiance: FloatArray, y_um: FloatArray, x_um: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        angle = self.angle(np.hypot(y_um[:, None], x_um[None, :]))
        if self.table:
            return {"irradiance": by_curves(irradiance, self.folded(angle), self.rows().nodes, prepared)}
        return {"irradiance": irradiance * illumination.cosine_response(angle, self.power).astype(irradiance.dtype)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str]:
        if self.does_nothing():
            return 0.0, "the response does not depend on angle"
        low, high = self.bounds(grid)
        return max(1.0 - low, high - 1.0), "the response is within this of its on-axis value"

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return (
            facts["irradiance"]
            if self.does_nothing()
            else facts["irradiance"].scaled(*self.bounds(grid["irradiance"]), smooth=not self.table)
        )

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if not self.table:
            return []
        radii = np.linspace(0.0, farthest(grids["irradiance"]), 257)
        bands = grids["irradiance"].bands().values()
        return self.rows().remarks(float(np.max(self.folded(self.angle(radii)))), "degrees", bands)
