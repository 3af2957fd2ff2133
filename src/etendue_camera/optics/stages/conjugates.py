"""Conjugates for all stages that depend on the light cone: one magnification, however it is given.

In:  camera quantities.
Out: the magnification, the working f-number, the exit pupil position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.api import Stage, quantity
from etendue_camera.light import radiometry
from etendue_camera.optics import focus


@dataclass(frozen=True, kw_only=True)
class Conjugates(Stage):
    """Base of the stages that depend on the lens cone: all use the same magnification."""

    f_number: float = quantity("f_number")
    focal_length: float = quantity("focal_length")
    magnification: float = quantity("magnification")
    pupil_magnification: float = quantity("pupil_magnification")
    focus_distance: float = quantity("focus_distance")

    def __post_init__(self) -> None:
        self.image_magnification()  # raises on contradictory quantities

    def image_magnification(self) -> float:
        """Return the magnification, given directly or by the focus distance."""
        return focus.effective_magnification(self.magnification, self.focal_length, self.focus_distance)

    def in_focus(self) -> float:
        """Return the distance (mm) in focus, given directly or by the magnification."""
        return focus.focus_distance_of(self.focal_length, self.image_magnification())

    def working_f_number(self) -> float:
        return float(radiometry.working_f_number(self.f_number, self.image_magnification(), self.pupil_magnification))

    def pupil_distance(self) -> float:
        """Return the distance from the exit pupil to the image plane, mm."""
        return float(
            radiometry.exit_pupil_distance(self.focal_length, self.image_magnification(), self.pupil_magnification)
        )


@dataclass(frozen=True, kw_only=True)
class Cone(Conjugates):
    """Base of the diffraction stages: they use the same marginal rays as light gathering."""

    aperture_model: str = quantity("aperture_model")

    def cone_f_number(self) -> float:
        """Return N_c = 1/(2 sin u), where u is the half angle of the cone; the cut-off is 1/(lambda N_c).

        For a flat exit pupil N_c = sqrt(N_w^2 + 1/4), because tan u = 1/(2 N_w) from the centre of the image to the
        edge of the pupil.
        """
        working = self.working_f_number()
        return working if self.aperture_model == "aplanatic" else float(np.hypot(working, 0.5))
