"""Lens metrics: diffraction limits, depth of field, light gathering.

In:  camera quantities; the irradiance of a white diffuser.
Out: scalars, each over the axes that affect it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Stage, param, proved, quantity
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.constants import LUMINOUS_EFFICACY
from etendue_camera.light import radiometry
from etendue_camera.optics import diffraction, focus
from etendue_camera.optics.stages.conjugates import Cone, Conjugates


@dataclass(frozen=True, kw_only=True)
class LensNumbers(Cone):
    """Compute the Airy diameter (eq. 4), Rayleigh and Sparrow separations and cut-off; the focal length (eq. 9);
    working f-numbers; depth of field.

    The T-number applies to the lens focused at infinity. Distances are from the front principal plane; ``far_limit`` is
    infinite if the focus distance is at least the hyperfocal distance.
    """

    role: ClassVar = "figures"
    error: ClassVar = proved(1e-7, 1e-15)

    writes: ClassVar = {
        "airy_diameter": "[um]",
        "rayleigh_separation": "[um]",
        "sparrow_separation": "[um]",
        "cutoff_frequency": "[cycles/um]",
        "focal_length_from_field": "[mm]",
        "field_of_view": "[deg]",
        "working_f_number": "[1]",
        "equivalent_t_number": "[1]",
        "exit_pupil_distance": "[mm]",
        "near_limit": "[mm]",
        "far_limit": "[mm] nan",
        "hyperfocal_distance": "[mm]",
    }

    t_number: float = quantity("t_number")
    transmittance: float = quantity("transmittance")
    wavelength: float = param(555.0, units="nm", above=0)
    half_diagonal: float = param(4.0, units="mm", above=0, doc="half diagonal of the sensor; 1/2-inch type: 4 mm")
    half_field: float = param(
        30.0, units="deg", above=0, below=90, held=(1e-6, 89.9), doc="half field of view, for eq. 9"
    )
    circle_of_confusion: float = param(
        5.0,
        units="um",
        above=0,
        doc="circle of confusion: the largest blur that counts as sharp, about one pixel pitch",
    )

    def run(self) -> dict[str, Array]:
        number, wavelength = self.cone_f_number(), self.wavelength * 1e-3
        circle = self.circle_of_confusion * 1e-3
        near, far = focus.depth_of_field(
            self.focal_length, self.f_number, circle, self.in_focus(), self.pupil_magnification
        )
        return {
            "airy_diameter": diffraction.airy_diameter(wavelength, number),
            "rayleigh_separation": diffraction.rayleigh_separation(wavelength, number),
            "sparrow_separation": diffraction.sparrow_separation(wavelength, number),
            "cutoff_frequency": diffraction.cutoff_frequency(wavelength, number),
            "focal_length_from_field": radiometry.focal_length_from_field(
                self.half_diagonal, math.radians(self.half_field)
            ),
            "field_of_view": 2
            * math.degrees(float(radiometry.field_from_focal_length(self.half_diagonal, self.focal_length))),
            "working_f_number": self.working_f_number(),
            "equivalent_t_number": self.t_number or radiometry.t_number_of(self.f_number, self.transmittance),
            "exit_pupil_distance": self.pupil_distance(),
            "near_limit": near,
            "far_limit": far,
            "hyperfocal_distance": focus.hyperfocal(self.focal_length, self.f_number, circle),
        }


@dataclass(frozen=True, kw_only=True)
class PixelEtendue(Conjugates):
    """Compute the etendue of an on-axis pixel: light-sensitive area times projected solid angle of the lens cone, and
    the half angle of that cone.
    """

    role: ClassVar = "figures"
    writes: ClassVar = {"etendue": "[um2 sr]", "cone_half_angle": "[deg]"}
    error: ClassVar = proved(2e-7, 2e-15)

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    aperture_model: str = quantity("aperture_model")

    def run(self) -> dict[str, Array]:
        model = radiometry.aplanatic_factor if self.aperture_model == "aplanatic" else radiometry.flat_disc_factor
        factor = float(model(self.f_number, self.image_magnification(), self.pupil_magnification))
        return {
            "etendue": np.asarray((self.pixel_pitch * self.aperture_fraction) ** 2 * factor),
            "cone_half_angle": np.asarray(math.degrees(math.asin(min(math.sqrt(factor / math.pi), 1.0)))),
        }


@dataclass(frozen=True, kw_only=True)
class Illuminance(Stage):
    """Compute the on-axis illuminance on the sensor of a white and a grey diffuser, in lux, after all filters before
    this stage.
    """

    role: ClassVar = "figures"
    reads: ClassVar = {"white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"illuminance": "[lx]", "illuminance_grey": "[lx]"}
    gain: ClassVar = 1.0
    libraries: ClassVar = ("colour-science",)
    error: ClassVar = proved(2e-7, 1e-15)

    grey: float = param(0.18, above=0, at_most=1, doc="reflectance of the grey diffuser")

    def prepare(self, coordinates: Mapping[str, Array]) -> FloatArray:
        edges = tuple(coordinates["wavelength_edges"])
        return LUMINOUS_EFFICACY * spectra.luminous_efficiency(edges) * np.diff(edges)

    def run(self, white_irradiance: FloatArray, prepared: FloatArray) -> dict[str, float]:
        white = float(prepared @ white_irradiance.astype(np.float64))
        return {"illuminance": white, "illuminance_grey": self.grey * white}
