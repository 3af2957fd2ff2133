"""Light at the image plane: what is claimed of it, and what is measured.

    python benchmarks/radiometry.py

Levels by hand arithmetic, fall-off against direct integration over the pupil, pupils cut by a rim, focus, glare and
split light. Every form is closed: there is no fidelity knob, so the second table is run time alone. Exit code 1 where a
bound does not hold.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import etendue
from etendue_camera import spectra
from etendue_camera.constants import PLANCK, SPEED_OF_LIGHT
from etendue_camera.field import illumination
from etendue_camera.light import radiometry
from etendue_camera.optics import filters, focus, glare

REFERENCE = Path(__file__).parent.parent / "tests" / "data" / "physics_reference.json"
ROWS: list[tuple[str, str, str, bool]] = []


def claim(what: str, bound: str, measured: float | str, holds: bool) -> None:
    ROWS.append((what, bound, measured if isinstance(measured, str) else f"{measured:.3g}", bool(holds)))


def below(what: str, bound: float, measured: float) -> None:
    claim(what, f"<= {bound:g}", measured, measured <= bound)


def uniform(*stages: dict[str, Any], scene: dict[str, Any], camera: dict[str, Any], wanted: list[str]) -> Any:
    flat = {"use": "uniform", "name": "scene", "white_luminance": 100, "width": 64, "height": 48, **scene}
    return etendue.simulate(
        {
            "name": "level",
            "precision": "float64",
            "camera": camera,
            "stages": [flat, {"use": "irradiance"}, *stages],
            "wanted": wanted,
        }
    )


# -------------------------------------------------------------------------------------------------- levels


def levels() -> None:
    print("A D65 surface of 100 cd/m2 at f/4, focus at infinity, on the axis:")
    fine = {"width": 2, "height": 2, "bin_width": 1}  # luminance is of the whole light, lux of the rendered bins
    for model, form, hand in (
        ("aplanatic", "pi L / (4 N^2) = pi 100 / 64", math.pi * 100 / 64),
        ("flat_disc", "pi L / (1 + 4 N^2) = pi 100 / 65", math.pi * 100 / 65),
    ):
        camera = {"f_number": 4, "aperture_model": model, "illuminant": "D65"}
        found = float(
            uniform({"use": "illuminance"}, scene=fine, camera=camera, wanted=["illuminance"])[
                "illuminance"
            ].illuminance
        )
        print(f"  {model:10s} {form:34s} = {hand:.6f} lx by hand, {found:.6f} lx simulated")
        below(f"lux of {model} in 1 nm bins from 380 to 780 nm against the hand, relative", 2e-5, abs(found / hand - 1))
        claim(
            f"lux of {model}",
            "4.909" if model == "aplanatic" else "4.833",
            f"{found:.3f}",
            round(found, 3) == round(hand, 3),
        )

    pitch, fraction, seconds, efficiency = 5.4, 0.741, 0.01, 0.5
    tree = uniform(
        {"use": "pixel"},
        {"use": "mosaic"},
        {"use": "exposure", "prnu": 0, "dark_nonuniformity": 0},
        scene={"wavelength_from": 550, "wavelength_to": 560, "bin_width": 10},
        wanted=["expected_charge"],
        camera={
            "illuminant": "555 nm",
            "f_number": 4,
            "pixel_pitch": pitch,
            "aperture_fraction": fraction,
            "integration_time": seconds,
            "sensitivity": "flat",
            "peak_qe": [efficiency] * 3,
            "dark_current_density": 0,
        },
    )
    charge = tree["exposure"].expected_charge.values
    luminous = spectra.luminance_of("555 nm")
    irradiance = math.pi * 100 / luminous / (4 * 4**2)
    area = (pitch * fraction * 1e-6) ** 2
    hand = irradiance * area * seconds * 555e-9 / (PLANCK * SPEED_OF_LIGHT) * efficiency
    print(
        "A uniform 555 nm scene of 100 cd/m2 at f/4, 10 ms, a light-sensitive square of (0.741 x 5.4 um)^2, efficiency "
        "0.5:"
    )
    print(f"  L = 100 / {luminous:.6f} lm/W = {100 / luminous:.9f} W m-2 sr-1;  E = pi L / 64 = {irradiance:.9f} W m-2")
    print(f"  E A t lambda/(h c) QE = {hand:.9f} electrons by hand, {charge.mean():.9f} simulated\n")
    below("electrons of the 555 nm scene, relative", 1e-12, float(np.abs(charge / hand - 1).max()))


# ------------------------------------------------------------------------------------------------ fall-off


def pupil_integral(number: float, tangent: float) -> float:
    """E/L by quadrature over the pupil: Gauss-Legendre in the radius, equal steps in the angle."""
    edge = 0.5 / number
    nodes, weights = np.polynomial.legendre.leggauss(80)
    r = 0.5 * edge * (1 + nodes)[:, None]
    angle = 2 * np.pi * (np.arange(600) + 0.5) / 600
    squared = 1 + tangent**2 + r * r - 2 * r * tangent * np.cos(angle)
    return float(0.5 * edge * weights @ (np.mean(1 / squared**2, axis=1) * 2 * np.pi * r[:, 0]))


def textbook_disc(number: float, tangent: Any, kind: Any) -> Any:
    """(pi/2) (1 - (1 + t^2 - u^2)/sqrt(...)) as it is printed: for comparison."""
    u2, t2 = kind((0.5 / number) ** 2), np.asarray(tangent, dtype=kind) ** 2
    return kind(np.pi / 2) * (1 - (1 + t2 - u2) / np.sqrt((1 + t2 - u2) ** 2 + 4 * u2))


def fall_off() -> None:
    numbers, angles = (0.5, 0.7, 1.0, 1.4, 2.8, 8.0, 64.0, 1e4, 1e6), (0.0, 1.0, 10.0, 22.0, 30.0, 60.0, 80.0)
    worst = single = textbook = 0.0
    for number in numbers:
        for angle in angles:
            t = math.tan(math.radians(angle))
            truth = pupil_integral(number, t)
            worst = max(worst, abs(float(radiometry.disc_factor(number, t)) / truth - 1))
            single = max(single, abs(float(radiometry.disc_factor(number, np.float32(t))) / truth - 1))
            textbook = max(textbook, abs(float(textbook_disc(number, t, np.float64)) / truth - 1))
    below("disc, f/0.5 ... f/1e6 to 80 deg, against 2-D integration", 1e-12, worst)
    below("the same in float32", 1e-6, single)
    claim("the same by the formula as textbooks print it", "none", textbook, True)

    cases = next(g for g in json.loads(REFERENCE.read_text())["groups"] if g["name"] == "irradiance_disk")["cases"]
    worst = 0.0
    for case in cases:
        v = {k: float(x) for k, x in case["in"].items()}
        found = float(radiometry.disc_factor(v["N"], math.tan(math.radians(v["phi_deg"])), v["m_signed"]))
        truth = float(case["out"] if not isinstance(case["out"], list) else case["out"][0])
        worst = max(worst, abs(found / truth - 1) / max(1.0, float(case.get("cond") or 0.0)))
    below(f"disc against {len(cases)} cases of 60 digits, over their condition", 1e-14, worst)

    line = np.linspace(-math.tan(math.radians(80)), math.tan(math.radians(80)), 512) / math.sqrt(2)
    radius = np.hypot(line[:, None], line[None, :])
    for number in (1e4, 1e5, 1e6):
        field = radiometry.disc_falloff(number, radius)
        claim(
            f"map of 512 x 512 to 80 deg at f/{number:g}",
            "in [0, 1]",
            f"{field.min():.3g} ... {field.max():.9g}",
            0 <= field.min() and field.max() <= 1,
        )
        below(
            f"  against cos4, whose error is {0.75 / number**2:.1g}",
            1e-14 + 0.75 / number**2,
            float(np.abs(field / radiometry.cos4(radius) - 1).max()),
        )
        naive = textbook_disc(number, radius, np.float64) / textbook_disc(number, np.zeros(1), np.float64)
        claim("  the same as textbooks print it", "none", f"{naive.min():.3g} ... {naive.max():.9g}", True)


# ------------------------------------------------------------------------------------------------ the others


def rims() -> None:
    """Overlap of two discs against counting a fine lattice of rings: exact arcs of every ring."""
    rng, worst = np.random.default_rng(1), 0.0
    nodes, weights = np.polynomial.legendre.leggauss(200)
    for _ in range(300):
        rim, share = 10 ** rng.uniform(-1, 2), rng.uniform(0, 1)
        s = abs(rim - 1) + share * 2 * min(1.0, rim)
        # rings of the unit disc: the arc that lies inside the rim; its ends are square roots, so panels grow
        # quadratically
        low, high = max(0.0, s - rim, rim - s), 1.0
        total = min(1.0, max(0.0, rim - s)) ** 2
        if high > low:
            half = 0.25 * np.pi * (1 + nodes)
            r = low + (high - low) * np.sin(half) ** 2
            w = (high - low) * 0.25 * np.pi * weights * np.sin(2 * half)
            total += float(w @ (2 * r * np.arccos(np.clip((r * r + s * s - rim * rim) / (2 * r * s), -1, 1)) / np.pi))
        worst = max(worst, abs(float(illumination.overlap_of_discs(1.0, rim, s)) - total))
    below("pupil cut by a rim against rings of the pupil, 300 cases", 1e-12, worst)


def focusing() -> None:
    rng, blur, naive, shift = np.random.default_rng(2), 0.0, 0.0, 0.0
    for _ in range(2000):
        f, number, circle = 10 ** rng.uniform(0, 2.5), 10 ** rng.uniform(0, 1.5), 10 ** rng.uniform(-3.5, -1.5)
        s = f * (1 + 10 ** rng.uniform(0, 4))
        for limit in focus.depth_of_field(f, number, circle, s):
            if math.isfinite(limit):
                sensitive = 1 + limit / abs(limit - s)
                blur = max(blur, abs(float(focus.blur_diameter(f, number, s, limit)) / circle - 1) / sensitive)
        o = s * (1 + 1e-10)
        exact = -(f / (s - f)) * (f / (o - f)) * (o - s)
        shift = max(shift, abs(float(focus.defocus_mm(f, s, o)) / exact - 1))
        naive = max(naive, abs((f * o / (o - f) - f * s / (s - f)) / exact - 1))
    below("blur at the limits of the depth of field, relative to c", 1e-14, blur)
    below("defocus of an object 1e-10 behind the focus", 1e-14, shift)
    claim("  the same as a difference of image distances", "none", naive, True)
    claim(
        "hyperfocal distance: far limit",
        "inf",
        str(focus.depth_of_field(50.0, 8.0, 0.03, focus.hyperfocal(50.0, 8.0, 0.03))[1]),
        True,
    )
    claim(
        "working f-number at m = -1 of f/4",
        "8",
        f"{radiometry.working_f_number(4.0, -1.0):g}",
        radiometry.working_f_number(4.0, -1.0) == 8,
    )


def spreading() -> None:
    plane = np.random.default_rng(3).uniform(0, 1, (128, 160))
    fy, fx = np.fft.fftfreq(128)[:, None], np.fft.rfftfreq(160)[None, :]

    def through(otf: Any) -> Any:
        return np.fft.irfft2(np.fft.rfft2(plane) * otf, s=plane.shape)

    veiled = through(glare.glare_otf(np.hypot(fy, fx), 0.03, 0.02, 20.0))
    below("light kept by glare, relative", 1e-13, abs(veiled.sum() / plane.sum() - 1))
    only = through(glare.glare_otf(np.hypot(fy, fx), 0.0, 0.02, 20.0))
    below("veil against the mean of the frame", 1e-14, float(np.abs(only - (0.98 * plane + 0.02 * plane.mean())).max()))
    copies = [np.roll(plane, (a, b), (0, 1)) for a in (-1, 1) for b in (-3, 3)]
    split = through(filters.four_spot_otf(fy, fx, 2.0, 6.0))
    below("split light against the mean of four copies", 1e-14, float(np.abs(split - np.mean(copies, axis=0)).max()))


def best(function: Callable[[], Any]) -> float:
    found = []
    for _ in range(5):
        began = time.perf_counter()
        function()
        found.append(time.perf_counter() - began)
    return min(found)


def times() -> None:
    line = np.linspace(-3.0, 3.0, 512)
    radius = np.hypot(line[:, None], line[None, :])
    frequency = np.abs(radius) / 3
    nodes, values = np.linspace(0, 5, 40), np.linspace(1, 0.3, 40)
    print(f"\n{'512 x 512, float64':44s} {'ms':>8s}")
    for name, call in (
        ("cos4", lambda: radiometry.cos4(radius)),
        ("exact disc", lambda: radiometry.disc_falloff(1.4, radius)),
        ("table", lambda: illumination.table_at(radius, nodes, values)),
        ("vignetting", lambda: illumination.vignetting(radius / 6, 2.0, 2.5, 5.0)),
        (
            "response by angle, cos^k",
            lambda: illumination.cosine_response(illumination.chief_ray_angle(radius, 5.0), 2.0),
        ),
        ("glare, power 3", lambda: glare.glare_otf(frequency, 0.02, 0.01, 20.0)),
        ("glare, power 2.5", lambda: glare.glare_otf(frequency, 0.02, 0.01, 20.0, 2.5)),
        ("four spots", lambda: filters.four_spot_otf(line[:, None], line[None, :], 2.0, 2.0)),
        ("four spots, turned", lambda: filters.four_spot_otf(line[:, None], line[None, :], 2.0, 2.0, 0.3)),
    ):
        print(f"{name:44s} {1e3 * best(call):8.2f}")


def main() -> int:
    for part in (levels, fall_off, rims, focusing, spreading):
        part()
    print(f"{'claim':66s} {'bound':>12s} {'measured':>26s}")
    for what, bound, measured, holds in ROWS:
        print(f"{what:66s} {bound:>12s} {measured:>26s}{'' if holds else '   DOES NOT HOLD'}")
    times()
    return 0 if all(holds for *_, holds in ROWS) else 1


if __name__ == "__main__":
    sys.exit(main())
