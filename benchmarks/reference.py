"""Every group of the high-precision cases against its kernel: largest error, in float64 and, where offered, float32.

    python benchmarks/reference.py

The allowed error is 1e-14 x max(1, cond) in float64 and 3e-7 x max(1, cond) in float32 (relative); the last columns are
the largest error as a share of it. A case is skipped where the kernel refuses its input by rule, and that is said.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy.fft

from etendue_camera.colour import difference, encoding
from etendue_camera.colour import matrices as colour
from etendue_camera.electronics import distributions, dynamic_range
from etendue_camera.light import planck, radiometry
from etendue_camera.mosaic import bilinear
from etendue_camera.optics import diffraction
from etendue_camera.restoration import deconvolution, sharpening
from etendue_camera.sensor import photodiode

FILE = Path(__file__).parent.parent / "tests" / "data" / "physics_reference.json"
Q = 1.602176634e-19


def _tan(degrees: float) -> float:
    return math.tan(math.radians(degrees))


def _collection(function: Any, back: str = "absorbing") -> Callable[..., Any]:
    def call(kind: Any, **v: float) -> Any:
        f = np.array(v["f_cyc_per_um"], dtype=kind)
        return function(f, v["alpha_per_um"], v["Ld_um"], v["L_um"], v["Ln_um"], back)

    return call


def _system(kind: Any, **v: float) -> Any:
    f = np.array(v["f_cyc_per_um"], dtype=kind)
    return (
        diffraction.circular_otf(f, v["lam_um"], v["N"])
        * photodiode.collection_mtf(f, v["alpha_per_um"], v["Ld_um"], v["L_um"], v["Ln_um"])
        * photodiode.aperture_otf(f, v["w_um"])
    )


def _dark(v: dict[str, float]) -> float:
    return v["idc_A"] * v["t_s"] / Q


def _pair(value: Any) -> list[float]:
    return [float(value.real), float(value.imag)]


A = np.array
KERNELS: dict[str, tuple[Callable[..., Any], bool]] = {
    "airy_intensity": (lambda dt, **v: diffraction.airy_intensity(A(v["r_um"], dt), v["lam_um"], v["N"]), False),
    "airy_psf_density": (lambda dt, **v: diffraction.airy_psf_density(A(v["r_um"], dt), v["lam_um"], v["N"]), False),
    "airy_encircled": (lambda dt, **v: diffraction.airy_encircled(A(v["r_um"], dt), v["lam_um"], v["N"]), False),
    "airy_outside": (lambda dt, **v: diffraction.airy_outside(A(v["r_um"], dt), v["lam_um"], v["N"]), False),
    "otf_diffraction": (lambda dt, **v: diffraction.circular_otf(A(v["f_cyc_per_um"], dt), v["lam_um"], v["N"]), True),
    "pixel_airy": (lambda dt, **v: diffraction.pixel_airy(v["i"], v["j"], v["p_um"], v["lam_um"], v["N"]), False),
    "mtf_geometric": (lambda dt, **v: photodiode.aperture_otf(A(v["f_cyc_per_um"], dt), v["w_um"]), True),
    "irradiance_paraxial": (
        lambda dt, **v: radiometry.flat_disc_factor(v["N"], v["m_signed"]) * radiometry.cos4(A(_tan(v["phi_deg"]), dt)),
        True,
    ),
    "irradiance_disk": (lambda dt, **v: radiometry.disc_factor(v["N"], A(_tan(v["phi_deg"]), dt), v["m_signed"]), True),
    "irradiance_abbe": (lambda dt, **v: radiometry.aplanatic_factor(v["N"], v["m_signed"]), False),
    "diffusion_D": (_collection(photodiode.collection), True),
    "diffusion_mtf": (_collection(photodiode.collection_mtf), True),
    "diffusion_mtf_reflecting": (_collection(photodiode.collection_mtf, "reflecting"), True),
    "system_mtf_x": (_system, True),
    "photons_from_energy": (lambda dt, **v: radiometry.photons_from_energy(v["E_J"], v["lam_um"]), False),
    "i_max": (lambda dt, **v: dynamic_range.saturation_current(v["Qmax_e"], v["t_s"], v["idc_A"]), False),
    "i_min": (lambda dt, **v: dynamic_range.smallest_current(v["t_s"], v["idc_A"], v["sr_e"], v["sdsnu_e"]), False),
    "dr_db": (
        lambda dt, **v: dynamic_range.dynamic_range_elgamal(v["Qmax_e"], _dark(v), v["sr_e"], v["sdsnu_e"]),
        False,
    ),
    "snr_db": (lambda dt, **v: dynamic_range.snr_db(v["Ne"], _dark(v), v["sr_e"], v["sdsnu_e"], v["prnu"]), False),
    "emva_snr": (lambda dt, **v: dynamic_range.emva_snr(v["mu_p"], v["eta"], v["K_DN_per_e"], v["sigma_d_e"]), False),
    "emva_mu_p_min": (
        lambda dt, **v: dynamic_range.emva_smallest_photons(v["eta"], v["K_DN_per_e"], v["sigma_d_e"]),
        False,
    ),
    "emva_mu_p_min_approx": (
        lambda dt, **v: dynamic_range.emva_smallest_photons_approx(v["eta"], v["K_DN_per_e"], v["sigma_d_e"]),
        False,
    ),
    "poisson_pmf": (lambda dt, **v: distributions.poisson_pmf(v["k"], v["lam"]), False),
    "poisson_logpmf": (lambda dt, **v: distributions.poisson_logpmf(v["k"], v["lam"]), False),
    "quantised_gauss": (lambda dt, **v: distributions.quantised_gauss_moments(v["mu_lsb"], v["sigma_lsb"]), False),
    "lab": (lambda dt, **v: difference.lab(A([v["X"], v["Y"], v["Z"]]), A([v["Xn"], v["Yn"], v["Zn"]])), False),
    "de2000": (
        lambda dt, **v: difference.delta_e_2000(A([v["L1"], v["a1"], v["b1"]]), A([v["L2"], v["a2"], v["b2"]])),
        False,
    ),
    "srgb_encode": (lambda dt, **v: encoding.srgb_encode(A(v["v"], dt)), True),
    "srgb_decode": (lambda dt, **v: encoding.srgb_decode(A(v["v"], dt)), True),
    "bt709_encode": (lambda dt, **v: encoding.bt709_encode(A(v["v"], dt)), True),
    "gamma_signed": (lambda dt, **v: encoding.gamma_signed(A(v["v"], dt), v["gamma"]), True),
    "planck_photon_radiance": (lambda dt, **v: planck.planck_photon_radiance(v["lam_um"], v["T_K"]), False),
    "planck_ratio": (lambda dt, **v: planck.planck_ratio(v["lam_um"], v["T_K"], v["lam0_um"]), False),
    "laplacian_response": (
        lambda dt, **v: sharpening.laplacian_response(v["fy_cyc_per_px"], v["fx_cyc_per_px"]),
        False,
    ),
    "sharpen_response": (
        lambda dt, **v: sharpening.sharpen_response(v["fy_cyc_per_px"], v["fx_cyc_per_px"], v["k"]),
        False,
    ),
    "wiener_gain": (
        lambda dt, **v: _pair(deconvolution.wiener_gain(A(complex(v["H_re"], v["H_im"])), v["nsr"])),
        False,
    ),
    "two_point_saddle": (lambda dt, **v: diffraction.two_point_saddle(v["sep_in_lambda_over_NA"]), False),
}


def richardson_lucy(cases: Any) -> tuple[float, float]:
    """Largest absolute error of the one-dimensional cases, and the allowed one."""
    worst = 0.0
    for case in cases:
        data, kernel = A([case["y"]], float), A([case["h"]], float)
        found, _ = deconvolution.richardson_lucy_periodic(
            data, scipy.fft.rfft2(kernel / kernel.sum()), case["iterations"]
        )
        worst = max(worst, float(np.abs(found[0] - A(case["out"], float)).max()))
    return worst, 1e-13


def matrices(held: Any) -> tuple[float, float]:
    """Display matrices and their inverses, and the printed and the corrected equation 16."""
    pairs = (
        (colour.RGB_TO_XYZ_PAL, "ebu_pal_bt470_625_RGB_to_XYZ"),
        (np.linalg.inv(colour.RGB_TO_XYZ_PAL), "its_inverse"),
        (colour.RGB_TO_XYZ_SRGB, "bt709_RGB_to_XYZ"),
        (np.linalg.inv(colour.RGB_TO_XYZ_SRGB), "bt709_inverse"),
        (np.linalg.inv(colour.EQ16_AS_PRINTED), "eq16_as_printed_inverse"),
        (np.linalg.inv(colour.EQ16_CORRECTED), "eq16_corrected(0.020)_inverse"),
    )
    return max(float(np.abs(found - A(held[name], float)).max()) for found, name in pairs), 1e-14


def adaptation(cases: Any) -> tuple[float, float]:
    """Adaptation matrices between D65, D50 and A."""
    names = {"Bradford": "bradford", "CAT02": "cat02", "VonKries_HPE_D65": "von_kries_hpe_d65"}
    worst = 0.0
    for case in cases:
        source, target = (colour.xyz_from_xy(tuple(float(v) for v in case[key])) for key in ("from_xy", "to_xy"))
        found = colour.von_kries_matrix(source, target, colour.TRANSFORMS[names[case["method"]]])
        worst = max(worst, float(np.abs(found - A(case["matrix"], float)).max()))
    return worst, 2e-15


def demosaicing(cases: Any) -> tuple[float, float]:
    """Whole numbers of twelve bits: the interior is exact."""
    worst = 0.0
    for case in cases:
        first, last = case["rows_cols"]
        for name, method in (
            ("bilinear", bilinear.bilinear),
            ("colour_difference_bilinear", bilinear.colour_difference),
        ):
            planes = method(A(case["mosaic"]), case["pattern_top_left_row_major"])
            found = np.moveaxis(planes, 0, -1)[first:last, first:last]
            worst = max(worst, float(np.abs(found - A(case[name], float)).max()))
    return worst, 1e-300


EXTRAS: dict[str, Callable[[Any], tuple[float, float]]] = {
    "richardson_lucy_1d": richardson_lucy,
    "matrices": matrices,
    "cat": adaptation,
    "demosaic_exact": demosaicing,
}


def errors(group: dict[str, Any], kernel: Callable[..., Any], kind: Any) -> tuple[float, float, int, int]:
    """Largest relative error, largest share of the allowed one, cases compared, cases refused by rule."""
    unit = 1e-14 if kind is np.float64 else 3e-7
    worst = share = 0.0
    done = refused = 0
    for case in group["cases"]:
        inputs = {k: float(v) for k, v in case["in"].items()}
        truth = np.array(case["out"] if isinstance(case["out"], list) else [case["out"]], dtype=float)
        try:
            with np.errstate(all="ignore"):
                found = np.ravel(np.array(kernel(kind, **inputs), dtype=float))
        except ValueError:
            refused += 1
            continue
        tolerance = unit * max(1.0, float(case.get("cond") or 0.0))
        if group["name"] == "quantised_gauss" and inputs["sigma_lsb"] > 0:
            tolerance *= max(
                1.0, 0.25 / inputs["sigma_lsb"] ** 2
            )  # sensitivity of the variance to sigma; the file gives none
        for x, y in zip(found, truth, strict=True):
            if x == y or (math.isnan(x) and math.isnan(y)) or (abs(y) < 1e-50 and abs(x) < 1e-50):
                continue
            if kind is np.float32 and abs(y) < 1e-37:
                continue  # below what float32 holds
            error = abs(x - y) / max(abs(y), 1e-300)
            worst, share = max(worst, error), max(share, error / tolerance)
        done += 1
    return worst, share, done, refused


def main() -> int:
    document = json.loads(FILE.read_text())
    print(f"{'group':26s} {'cases':>5s} {'float64':>10s} {'of allowed':>10s} {'float32':>10s} {'of allowed':>10s}")
    failed = []
    for group in document["groups"]:
        name = group["name"]
        if name not in KERNELS:
            print(f"{name:26s} {len(group['cases']):5d}   no kernel in this version")
            continue
        kernel, single = KERNELS[name]
        worst, share, done, refused = errors(group, kernel, np.float64)
        line = f"{name:26s} {done:5d} {worst:10.2e} {share:10.3f}"
        if single:
            worst32, share32, _, _ = errors(group, kernel, np.float32)
            line += f" {worst32:10.2e} {share32:10.3f}"
            if share32 > 1:
                failed.append(f"{name} float32")
        if refused:
            line += f"   ({refused} refused by rule)"
        print(line)
        if share > 1:
            failed.append(name)
    for name, check in EXTRAS.items():
        worst, allowed = check(document["extra"][name])
        print(f"{name:26s} {len(document['extra'][name]):5d} {worst:10.2e} {worst / allowed:10.3f}   (absolute)")
        if worst > allowed:
            failed.append(name)
    print("beyond the allowed error: " + (", ".join(failed) or "none"))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
