"""Measured distortion and fall-off of a real lens, for the stages that apply them.

In:  camera quantities: the file of the lens, the crop factor and mount of the body.
Out: real heights and relative illumination as the tables of the stages ``distortion`` and ``falloff``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from etendue.api import Stage, quantity
from etendue.contract.stage import file_state
from etendue_camera.field import lens_calibration
from etendue_camera.field.lens_files import lens_file
from etendue_camera.field.stages.tables import FieldTable
from etendue_camera.field.warp import Table

REACH = 1.3  # heights of a table, over half the diagonal of the calibrated sensor
NODES = 521
FLAT = 0.05  # where the slope of real heights falls below this of its value on the axis, a table ends


@dataclass(frozen=True, kw_only=True)
class Profiled(Stage):
    """A stage that applies measurements of a real lens."""

    lens_profile: str = quantity("lens_profile")
    crop_factor: float = quantity("crop_factor")
    mount: str = quantity("mount")
    adapter: bool = quantity("adapter")

    def check_lens(self) -> None:
        """Raise ValueError if the file does not describe a lens, or the lens does not fit the mount of the body."""
        if not self.lens_profile:
            return
        own = lens_file(self.lens_profile)
        fits = {mount for one in own.entries for mount in one.fits}
        if self.mount and not self.adapter and self.mount not in fits:
            mounts = ", ".join(sorted({mount for one in own.entries for mount in one.mounts}))
            raise ValueError(
                f"the lens {own.name} has the mount {mounts}, the body {self.mount}; choose another lens, or set "
                f"adapter = true under [camera]"
            )

    def lens_name(self) -> str:
        return lens_file(self.lens_profile).name if self.lens_profile else ""

    def lens_notes(
        self, what: str, instead: str, measured: bool, settings: tuple[float, float] | None = None
    ) -> list[str]:
        """Return notes on properties of the lens that were not measured, and on settings outside its range."""
        if not self.lens_profile:
            return []
        own = lens_calibration.chosen(lens_file(self.lens_profile).entries, self.crop_factor)
        notes = []
        if not measured:
            notes.append(f"{self.lens_name()}: {what} at these settings is not in its source; {instead}")
        if settings is None:
            return notes
        focal, aperture = settings
        low, high = own.focal
        if not low * 0.99 <= focal <= high * 1.01:
            span = f"{low:g} mm" if low == high else f"{low:g} to {high:g} mm"
            notes.append(f"{self.lens_name()} has {span}, not focal_length = {focal:g} mm")
        if aperture < own.aperture[0] * 0.99:
            notes.append(f"{self.lens_name()} opens to f/{own.aperture[0]:g}, not f/{aperture:g}")
        if self.crop_factor and own.crop_factor > self.crop_factor * 1.05:
            notes.append(
                f"{self.lens_name()} was measured on a sensor of crop factor {own.crop_factor:g}, smaller than "
                f"the sensor of the body ({self.crop_factor:g}): beyond it the curves are continued"
            )
        return notes


def measured_falloff(stage: Profiled, focal: float, aperture: float, distance_mm: float) -> FieldTable | None:
    """Return the relative illumination of a stage's lens by height; None if it was not measured near these settings."""
    if not stage.lens_profile:
        return None
    state = file_state(stage.lens_profile)
    return _falloff(stage.lens_profile, state, stage.crop_factor, focal, aperture, distance_mm)


@lru_cache(512)
def _falloff(
    path: str, state: tuple[int, int], crop: float, focal: float, aperture: float, distance_mm: float
) -> FieldTable | None:
    own = lens_file(path)
    lens = lens_calibration.chosen(own.entries, crop)
    nodes = np.linspace(0.0, REACH * lens.half_diagonal(), NODES)
    values = lens.relative(nodes, focal, aperture, 1e-3 * distance_mm)
    if values is None:
        return None
    beyond = nodes > lens.half_diagonal()  # outside the measured range a polynomial may rise or fall steeply
    inside = float(values[~beyond][-1])
    values = np.where(beyond, np.minimum(values, inside), values)
    return FieldTable(own.name, "height_mm", nodes, np.maximum(values, 0.0)[:, None], ())


@lru_cache(512)
def measured_heights(path: str, state: tuple[int, int], crop: float, focal: float) -> Table | None:
    """Return ideal heights, wavelengths and real heights (um) of a lens; None if none were measured."""
    lens = lens_calibration.chosen(lens_file(path).entries, crop)
    if not lens.distortion and not lens.tca:
        return None
    ideal = np.linspace(0.0, REACH * lens.half_diagonal(), NODES)
    real = lens.heights(ideal, focal)
    rise = np.diff(real, axis=0) / np.diff(real[:2], axis=0)
    folded = np.flatnonzero((rise < FLAT).any(axis=1))
    if folded.size:  # beyond the last rising height the curve is continued along its tangent
        last = max(2, int(folded[0]))
        ideal, real = ideal[: last + 1], real[: last + 1]
    wavelengths = np.array(lens_calibration.COLOURS) * 1e-3
    return (ideal * 1e3, wavelengths, real * 1e3) if lens.tca else (ideal * 1e3, wavelengths[1:2], real[:, 1:2] * 1e3)
