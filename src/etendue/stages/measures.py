"""The numbers beside the pictures: plain figures of lens, pixel and exposure, and probes that look at all stages.

In:  camera quantities; ``raw`` and ``expected_charge``; the transfer functions of all stages.
Out: scalars, each at the axes that reach it; ``mtf50`` with a dimension ``stage``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Probe, Stage, hookimpl, param, quantity
from etendue.physics import diffraction, exposure, radiometry, resolution
from etendue.stages.exposure import dn_per_electron, full_well


@dataclass(frozen=True, kw_only=True)
class LensNumbers(Stage):
    """What diffraction allows: Airy diameter (eq. 4), Rayleigh and Sparrow separations, cut-off; focal length (eq. 9)."""

    writes: ClassVar = {
        "airy_diameter": "[um]", "rayleigh_separation": "[um]", "sparrow_separation": "[um]", "cutoff_frequency": "[um-1]",
        "focal_length_from_field": "[mm]", "field_of_view": "[deg]",
    }  # fmt: skip

    f_number: float = quantity("f_number")
    focal_length: float = quantity("focal_length")
    magnification: float = quantity("magnification")
    wavelength: float = param(555.0, units="nm", above=0)
    half_diagonal: float = param(4.0, units="mm", above=0, doc="half the diagonal of the sensor; 1/2-inch type: 4 mm")
    half_field: float = param(30.0, units="deg", above=0, below=90, doc="half the field of view, for eq. 9")

    def run(self) -> dict[str, Any]:
        number = float(radiometry.working_f_number(self.f_number, self.magnification))
        wavelength = self.wavelength * 1e-3
        return {
            "airy_diameter": diffraction.airy_diameter(wavelength, number),
            "rayleigh_separation": diffraction.rayleigh_separation(wavelength, number),
            "sparrow_separation": diffraction.sparrow_separation(wavelength, number),
            "cutoff_frequency": diffraction.cutoff_frequency(wavelength, number),
            "focal_length_from_field": radiometry.focal_length_from_field(self.half_diagonal, math.radians(self.half_field)),
            "field_of_view": 2 * math.degrees(float(radiometry.field_from_focal_length(self.half_diagonal, self.focal_length))),
        }

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 1e-15), "proved"


@dataclass(frozen=True, kw_only=True)
class PixelNumbers(Stage):
    """Nyquist frequency, plate scale (eq. 10), full well."""

    writes: ClassVar = {"nyquist_frequency": "[um-1]", "plate_scale": "[arcsec/pixel]", "full_well": "[electron]"}

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    focal_length: float = quantity("focal_length")
    full_well_density: float = quantity("full_well_density")

    def run(self) -> dict[str, Any]:
        return {
            "nyquist_frequency": np.array(0.5 / self.pixel_pitch),
            "plate_scale": radiometry.plate_scale(self.pixel_pitch, self.focal_length),
            "full_well": np.array(full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)),
        }

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 1e-15), "proved"


@dataclass(frozen=True, kw_only=True)
class DynamicRange(Stage):
    """Largest over smallest signal, two definitions under two names: dark noise as smallest (eqs. 12-13), or SNR = 1 (EMVA 1288)."""

    writes: ClassVar = {"dr_elgamal": "[dB] nan", "dr_emva": "[dB] nan", "dark_charge": "[electron]"}

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")
    dark_current_density: float = quantity("dark_current_density")
    integration_time: float = quantity("integration_time")
    read_noise: float = quantity("read_noise")
    dsnu: float = quantity("dsnu")
    conversion_gain: float = quantity("conversion_gain")
    black_level: float = quantity("black_level")
    bits: int = quantity("bits")

    def run(self) -> dict[str, Any]:
        gain = dn_per_electron(self)
        well = full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)
        dark = exposure.dark_electrons(self.dark_current_density, self.pixel_pitch**2, self.integration_time)
        largest = min(well, (2**self.bits - 1 - self.black_level) / gain)
        return {
            "dr_elgamal": exposure.dynamic_range_elgamal(largest, dark, self.read_noise, self.dsnu),
            "dr_emva": exposure.dynamic_range_emva(largest, dark, self.read_noise, gain),
            "dark_charge": dark,
        }

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 1e-14), "measured"


@dataclass(frozen=True, kw_only=True)
class ExposureReport(Stage):
    """How the frame is exposed: share of clipped and of black pixels, mean signal-to-noise ratio of the expected charge."""

    reads: ClassVar = {"raw": "y x [DN] uint16", "expected_charge": "y x [electron]"}
    writes: ClassVar = {"clipped_fraction": "[1]", "black_fraction": "[1]", "mean_snr": "[1]"}
    nanoseconds: ClassVar = 5.0

    bits: int = quantity("bits")
    black_level: float = quantity("black_level")
    read_noise: float = quantity("read_noise")
    dsnu: float = quantity("dsnu")

    def run(self, raw: Any, expected_charge: Any) -> dict[str, Any]:
        variance = expected_charge + expected_charge.dtype.type(self.read_noise**2 + self.dsnu**2)
        snr = expected_charge / np.sqrt(np.maximum(variance, np.finfo(variance.dtype).tiny))
        return {
            "clipped_fraction": np.array(np.count_nonzero(raw >= 2**self.bits - 1) / raw.size),
            "black_fraction": np.array(np.count_nonzero(raw <= self.black_level) / raw.size),
            "mean_snr": np.array(snr.mean(dtype=np.float64)),
        }

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 1e-14), "measured"


@dataclass(frozen=True, kw_only=True)
class Resolution(Probe):
    """Analytic MTF50 up to each stage: the photon-weighted polychromatic transfer function along x.

    Lowest frequency at which contrast has fallen to one half; NaN where it does not below ``highest``. The weights
    are those of the pixel's green channel under an equal-energy light; in front of a pixel stage every photon counts
    the same.
    """

    reads: ClassVar = {"transfers": "*.transfer [1]"}
    writes: ClassVar = {"mtf50": "stage [um-1] nan", "mtf50_lp_mm": "stage [mm-1] nan"}
    nanoseconds: ClassVar = 1.5e7

    highest: float = param(4.0, units="um-1", above=0, doc="where the search ends")
    nodes: int = param(512, at_least=16, fidelity=True, reference="twice the nodes", doc="frequencies at which the crossing is looked for")

    def run(self, transfers: Any, prepared: Any) -> dict[str, Any]:
        weights = None if prepared is None else prepared[1]
        values = np.array([resolution.mtf50(otf, weights, self.highest, self.nodes) for _, otf in transfers])
        return {"mtf50": values, "mtf50_lp_mm": values * 1e3}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (2e-7 if precision == "float32" else 1e-11), "measured"


@dataclass(frozen=True, kw_only=True)
class LightBudget(Probe):
    """Mean irradiance behind every stage that writes it: blurs keep it, fall-off and filters do not."""

    reads: ClassVar = {"planes": "*.irradiance [W m-2 nm-1]"}
    writes: ClassVar = {"mean_irradiance": "stage [W m-2 nm-1]"}
    nanoseconds: ClassVar = 5.0

    def run(self, planes: Any) -> dict[str, Any]:
        return {"mean_irradiance": np.array([plane.mean(dtype=np.float64) for _, plane in planes])}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-7 if precision == "float32" else 1e-15), "proved"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {
        "lens_numbers": LensNumbers, "pixel_numbers": PixelNumbers, "dynamic_range": DynamicRange,
        "exposure_report": ExposureReport, "resolution": Resolution, "light_budget": LightBudget,
    }  # fmt: skip
