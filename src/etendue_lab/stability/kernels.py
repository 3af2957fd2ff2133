"""Kernels below the stages compared with closed forms of 60 digits, at stiff and extreme points of the physics.

In:  ``data/closed_forms.json``: inputs, results and condition numbers.
Out: a row per case; the stage uses the kernel.

The bound is 1e-14, or 3e-7 in single precision, times the condition number: the error that rounding of the inputs alone
may cause.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from etendue.archive.read.differing import apart
from etendue.telling import said
from etendue.types.arrays import Array
from etendue_camera.colour import difference, encoding
from etendue_camera.constants import ELEMENTARY_CHARGE
from etendue_camera.electronics import distributions, dynamic_range
from etendue_camera.field import illumination
from etendue_camera.light import planck, radiometry
from etendue_camera.optics import diffraction, glare
from etendue_camera.restoration import deconvolution, sharpening
from etendue_camera.sensor import defects, photodiode
from etendue_lab.stability.rows import LawCase

DOUBLE, SINGLE = 1e-14, 3e-7
CUT = 1e-300  # smaller values count as zero
Kernel = Callable[..., Any]


@dataclass(frozen=True)
class ClosedForm:
    """A kernel with a known closed form."""

    kernel: Kernel
    single: bool = False  # whether single precision of the first argument is kept
    least: float = CUT  # absolute error that is always allowed


def _dark(current: float, time: float) -> float:
    return current * time / ELEMENTARY_CHARGE


def _tangent(degrees: Any) -> Any:
    return np.tan(np.deg2rad(degrees))


def _paraxial(number: float, magnification: float, angle: float) -> Any:
    if magnification > 0:
        raise ValueError("the magnification of a real image is at most 0")
    return radiometry.flat_disc_factor(number, magnification) * radiometry.cos4(_tangent(angle))


FORMS = {
    "airy_intensity": ClosedForm(diffraction.airy_intensity),
    "airy_psf_density": ClosedForm(diffraction.airy_psf_density),
    "airy_encircled": ClosedForm(diffraction.airy_encircled),
    "airy_outside": ClosedForm(diffraction.airy_outside),
    "otf_diffraction": ClosedForm(diffraction.circular_otf),
    "pixel_airy": ClosedForm(
        diffraction.pixel_airy, least=1e-15
    ),  # faint pixels are differences of terms of order 0.1, so they have the rounding errors of these terms
    "tail_otf": ClosedForm(glare.tail_otf),
    "mtf_geometric": ClosedForm(photodiode.aperture_otf),
    "irradiance_paraxial": ClosedForm(_paraxial),
    "irradiance_disk": ClosedForm(lambda n, m, angle: radiometry.disc_factor(n, _tangent(angle), m)),
    "irradiance_abbe": ClosedForm(radiometry.aplanatic_factor),
    "diffusion_D": ClosedForm(lambda *given: photodiode.collection(given[-1], *given[:-1])),
    "diffusion_mtf": ClosedForm(lambda *given: photodiode.collection_mtf(given[-1], *given[:-1]), True),
    "diffusion_mtf_reflecting": ClosedForm(
        lambda a, w, d, length, f: photodiode.collection_mtf(f, a, w, d, length, back="reflecting"), True
    ),
    "system_mtf_x": ClosedForm(
        lambda f, wavelength, number, side, *silicon: (
            diffraction.circular_otf(f, wavelength, number)
            * photodiode.collection_mtf(f, *silicon)
            * photodiode.aperture_otf(f, side)
        )
    ),
    "overlap_of_discs": ClosedForm(illumination.overlap_of_discs),
    "segment_area": ClosedForm(illumination.segment_area),
    "photons_from_energy": ClosedForm(radiometry.photons_from_energy),
    "hot_rates": ClosedForm(lambda u, mean: defects.hot_rates(np.asarray(u), mean)),
    "i_max": ClosedForm(lambda well, t, dark: dynamic_range.saturation_current(well, t, dark)),
    "i_min": ClosedForm(dynamic_range.smallest_current),
    "dr_db": ClosedForm(
        lambda well, t, dark, read, dsnu: dynamic_range.dynamic_range_elgamal(well, _dark(dark, t), read, dsnu)
    ),
    "snr_db": ClosedForm(
        lambda n, t, dark, read, dsnu, prnu: dynamic_range.snr_db(n, _dark(dark, t), read, dsnu, prnu)
    ),
    "emva_snr": ClosedForm(dynamic_range.emva_snr),
    "emva_mu_p_min": ClosedForm(dynamic_range.emva_smallest_photons),
    "poisson_pmf": ClosedForm(distributions.poisson_pmf),
    "poisson_logpmf": ClosedForm(distributions.poisson_logpmf),
    "quantised_gauss": ClosedForm(
        lambda mean, spread: [*map(float, distributions.quantised_gauss_moments(mean, spread))], least=1e-50
    ),
    "lab": ClosedForm(lambda *xyz: difference.lab(xyz[:3], xyz[3:])),
    "de2000": ClosedForm(lambda *lab: difference.delta_e_2000(lab[:3], lab[3:])),
    "srgb_encode": ClosedForm(encoding.srgb_encode, True),
    "srgb_decode": ClosedForm(encoding.srgb_decode, True),
    "bt709_encode": ClosedForm(encoding.bt709_encode, True),
    "gamma_signed": ClosedForm(encoding.gamma_signed, True),
    "planck_photon_radiance": ClosedForm(planck.planck_photon_radiance),
    "planck_ratio": ClosedForm(planck.planck_ratio),
    "laplacian_response": ClosedForm(lambda fx, fy: sharpening.laplacian_response(fy, fx)),
    "sharpen_response": ClosedForm(lambda fx, fy, k: sharpening.sharpen_response(fy, fx, k)),
    "wiener_gain": ClosedForm(
        lambda a, b, noise: deconvolution.wiener_gain(np.array([complex(a, b)]), noise).view(float)
    ),
}


def rows_of_forms(names: frozenset[str]) -> Iterator[LawCase]:
    """Yield every case of every closed form; only for the named stages, if any."""
    found = json.loads((resources.files("etendue_lab") / "data" / "closed_forms.json").read_text(encoding="utf-8"))
    for group in found["groups"]:
        form = FORMS[group["name"]]
        if names and group["stage"] not in names:
            continue
        for given, expected, condition in group["cases"]:
            case = ", ".join(f"{name} = {value:g}" for name, value in zip(group["inputs"], given, strict=True))
            yield judged(group["stage"], form, f"closed form {group['name']}", case, given, expected, condition, DOUBLE)
            if form.single:
                yield judged(
                    group["stage"],
                    form,
                    f"closed form {group['name']}, 32 bits",
                    case,
                    given,
                    expected,
                    condition,
                    SINGLE,
                )


def judged(
    stage: str,
    form: ClosedForm,
    law: str,
    case: str,
    given: list[float],
    expected: Array,
    condition: float,
    unit: float,
) -> LawCase:
    """Test one case and return its row, with the largest relative error of the kernel's result."""
    wanted = np.asarray([float(v) for v in expected] if isinstance(expected, list) else float(expected))
    bound = unit * max(1.0, condition)
    values: list[Any] = list(given)
    if unit == SINGLE:
        place = -1 if law.startswith("closed form diffusion") else 0
        values[place] = np.float32(values[place])
        bound *= 1.2  # rounding of that input
    try:
        with np.errstate(all="ignore"):
            got = np.asarray(form.kernel(*values), dtype=float)
    except ValueError as error:
        return LawCase(stage, law, case, True, condition=condition, why=f"refused: {error}")
    except Exception as error:
        return LawCase(stage, law, case, False, condition=condition, why=said(error))
    away = apart(got, wanted)
    with np.errstate(all="ignore"):
        off = np.where(away <= form.least, 0.0, away / np.abs(wanted))
    worst = float(np.max(np.where(np.isnan(off), np.inf, off)))
    ok = worst <= bound
    why = "" if ok else f"gives {np.ravel(got)[0]:.17g}; the exact value is {np.ravel(wanted)[0]:.17g}"
    return LawCase(stage, law, case, ok, worst, bound, condition, why)
