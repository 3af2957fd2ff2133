"""The figures that docs/paper.md states, from the kernels, beside what the paper prints.

    python benchmarks/paper_numbers.py points | diffraction | falloff | pixel | sampling | sharpening | range | colour
    python benchmarks/paper_numbers.py order paper paper_order      two archives of `etendue run`, compared
    python benchmarks/paper_numbers.py times times times_order      the same of two sweeps over the integration time
    python benchmarks/paper_numbers.py cost pipelines/paper.toml    what a run takes, best of five

One section, several or none (all that need no archive); every line is a quantity, its value and a remark.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from etendue_camera.colour import encoding, matrices
from etendue_camera.constants import ELEMENTARY_CHARGE
from etendue_camera.electronics import dynamic_range as exposure
from etendue_camera.light import radiometry
from etendue_camera.optics import diffraction
from etendue_camera.restoration import sharpening as restoration
from etendue_camera.sensor import photodiode, silicon

GREEN, TRACED = 0.555, 0.550  # um: the wavelengths of the paper's sections 2.5 and of its parameters
PITCH, WINDOW, DEPLETION, DEPTH, LENGTH = 5.4, 4.0, 1.8, 10.0, 50.0  # um; the diffusion length is not in the paper
NYQUIST = 0.5 / PITCH
FOCAL = 6.93  # mm

BEHIND = (
    "mosaic",
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "adc",
    "linearise",
    "balance_mosaic",
    "demosaic",
    "sharpen",
    "camera_to_xyz",
    "balance",
    "display",
    "encode",
    "to_xyz",
)

Row = tuple[str, str, str]  # quantity, value, remark


def points() -> list[Row]:
    """Fig. 2: two points at separations in lambda/NA, which is 2 lambda N."""
    cases = {0.4: "one spot", 0.5: "a dip of 2 %", 0.6: "a dip of 24 %", 0.61: "the paper's Rayleigh"}
    rows = [
        (f"saddle at {s:g} lambda/NA", f"{diffraction.two_point_saddle(s)[0]:.5f}", remark)
        for s, remark in cases.items()
    ]
    rows.append(("Rayleigh, lambda/NA", f"{diffraction.RAYLEIGH / 2:.6f}", "printed: 0.61"))
    rows.append(("Sparrow, lambda/NA", f"{diffraction.SPARROW / 2:.6f}", "the dip begins"))
    return rows


def diffraction_section() -> list[Row]:
    """Eqs. 3-4."""
    cases = {
        2.5: "the lens in section 2.1",
        2.8: "the lens in section 2.5",
        8.0: "printed: 10.833",
        11.0: "11 is printed as its f-number",
    }
    rows = [
        (f"d at f/{n:g}, 555 nm", f"{diffraction.airy_diameter(GREEN, n):.4f} um", remark)
        for n, remark in cases.items()
    ]
    rows.append(("2.44 x 0.555 x 8", f"{2.44 * 0.555 * 8:.4f} um", "with the rounded constant"))
    rows.append(("first dark ring, lambda N", f"{diffraction.AIRY_DIAMETER:.7f}", "printed: 2.44"))
    rows.append(("N_w of f/2.8 at m = -1", f"{radiometry.working_f_number(2.8, -1.0):.1f}", "the spot doubles"))
    return rows


def falloff() -> list[Row]:
    """Eq. 5 and the fourth power of the cosine."""
    rows = []
    for n in (2.8, 1.4, 0.7):
        more = radiometry.aplanatic_factor(n) / radiometry.flat_disc_factor(n) - 1
        rows.append((f"aplanatic over eq. 5, f/{n:g}", f"{100 * more:+.1f} %", "1 + 1/(4 N_w^2)"))
    rows.append(
        ("eq. 5 with m = +1, any N", f"{math.pi / (1 + 4 * (2.8 * (1 - 1)) ** 2):.4f} L", "pi L: N has no effect")
    )
    edge = math.tan(math.radians(30))
    rows.append(("cos^4 at 30 degrees", f"{radiometry.cos4(edge):.4f}", "= 9/16"))
    for n in (2.8, 1.4):
        rows.append((f"exact disc at 30 degrees, f/{n:g}", f"{radiometry.disc_falloff(n, edge):.4f}", "Foote 1915"))
    corner = PITCH * 1e-3 * 128 * math.sqrt(2) / FOCAL
    rows.append(
        ("corner of 256 x 256 pixels", f"{math.degrees(math.atan(corner)):.2f} degrees", "off the axis, f = 6.93 mm")
    )
    rows.append(("cos^4 there", f"{radiometry.cos4(corner):.4f}", "for the true field size"))
    return rows


def _diffusion(wavelength_um: float) -> float:
    alpha = float(silicon.absorption(wavelength_um))
    return float(photodiode.collection_mtf(NYQUIST, alpha, DEPLETION, DEPTH, LENGTH))


def pixel() -> list[Row]:
    """Eqs. 6-8 at the Nyquist frequency."""
    optics, window = (
        float(diffraction.circular_otf(NYQUIST, TRACED, 2.8)),
        float(photodiode.aperture_otf(NYQUIST, WINDOW)),
    )
    rows = [("eq. 8 as printed, at f = 0", f"{WINDOW**2:.0f}", "w^2; a transfer function has 1")]
    rows += [
        (f"diffusion, {1000 * w:.0f} nm", f"{_diffusion(w):.5f}", "D(f)/D(0) at Nyquist") for w in (0.45, 0.55, 0.65)
    ]
    rows.append(("geometric, w = 4 um", f"{window:.5f}", "sinc(w f) at Nyquist"))
    rows.append(("optics, f/2.8", f"{optics:.5f}", "diffraction only"))
    rows.append(("product, 550 nm", f"{optics * _diffusion(TRACED) * window:.5f}", "optics x diffusion x geometric"))
    rows.append(
        (
            "first zero of sinc(w f)",
            f"{1 / WINDOW:.3f} cycles/um",
            f"{1 / WINDOW / NYQUIST:.1f} x Nyquist; negative beyond",
        )
    )
    rows.append(
        (
            "D(0), 550 nm",
            f"{float(photodiode.collection(0.0, float(silicon.absorption(TRACED)), DEPLETION, DEPTH, LENGTH)):.4f}",
            "electrons for a photon inside the silicon",
        )
    )
    return rows


def sampling() -> list[Row]:
    """Section 2.5: how small a pixel has to be, the focal length, the plate scale."""
    rows = [
        ("d/2 at f/8", f"{diffraction.rayleigh_separation(GREEN, 8.0):.3f} um", "printed: 5.4, as the largest pixel")
    ]
    for n in (8.0, 2.8):
        small = 0.5 / diffraction.cutoff_frequency(GREEN, n)
        rows.append(
            (
                f"lambda N / 2 at f/{n:g}",
                f"{small:.3f} um",
                f"Nyquist at the cut-off; 5.4 is {PITCH / small:.1f} x that",
            )
        )
    rows.append(("Nyquist of 5.4 um", f"{1e3 * NYQUIST:.1f} lp/mm", "half a cycle a pixel"))
    for half in (4.0, 2.3):
        rows.append(
            (
                f"eq. 9, y = {half} mm",
                f"{radiometry.focal_length_from_field(half, math.radians(30)):.3f} mm",
                "focal length",
            )
        )
    rows.append(("eq. 10, f = 6.93 mm", f"{radiometry.plate_scale(PITCH, FOCAL):.2f}", "arcsec/pixel"))
    across = 2 * math.degrees(math.atan(128 * PITCH * 1e-3 / FOCAL))
    rows.append(("256 pixels of 5.4 um see", f"{across:.1f} degrees", "printed: 60, over the diagonal"))
    return rows


def sharpening() -> list[Row]:
    """Eq. 11 as it stands, and as identity + k L."""
    rows = [
        (
            "eq. 11 alone, at frequency 0",
            f"{float(restoration.laplacian_response(0.0, 0.0)):g}",
            "even light becomes black",
        )
    ]
    for k in (1.0, 0.1):
        there = [float(restoration.sharpen_response(*at, k)) for at in ((0.0, 0.0), (0.0, 0.5), (0.5, 0.5))]
        rows.append((f"I + {k:g} L at 0, (0, 1/2), (1/2, 1/2)", " ".join(f"{g:.1f}" for g in there), "cycles/pixel"))
        rows.append((f"white noise, k = {k:g}", f"x {restoration.noise_gain(k):.2f}", "standard deviation"))
    return rows


def dynamic_range() -> list[Row]:
    """Eq. 13 for 60000 electrons, 1 fA, 10 ms, 20 and 10 electrons: the paper gives no values."""
    full, current, seconds, read, dsnu = 6e4, 1e-15, 10e-3, 20.0, 10.0
    q = ELEMENTARY_CHARGE
    right = float(exposure.dynamic_range_elgamal(full, current * seconds / q, read, dsnu))
    q = 1.6e-19
    printed = 20 * math.log10(
        (q * full - current * seconds) / math.sqrt(q * seconds * current + q * (read**2 + dsnu**2))
    )
    return [
        ("dark charge", f"{current * seconds / ELEMENTARY_CHARGE:.1f} electron", "1 fA for 10 ms"),
        ("DR, q^2 under the root", f"{right:.2f} dB", f"{right / (20 * math.log10(2)):.1f} stops"),
        ("DR, q as printed", f"{printed:.2f} dB", "wrong in any unit"),
    ]


def colour_section() -> list[Row]:
    """Eqs. 14-16."""
    gains = np.array([0.5844, 0.5753, 0.514])
    rows = [
        (
            "eq. 14 over its second",
            " ".join(f"{g:.4f}" for g in gains / gains[1]),
            f"and a factor {gains[1]:.4f} on everything",
        )
    ]
    white = np.ones(3)
    for name, matrix in (
        ("printed", matrices.EQ16_AS_PRINTED),
        ("0.020 for 0.229", matrices.EQ16_CORRECTED),
        ("full precision", matrices.RGB_TO_XYZ_PAL),
    ):
        x, y, z = matrix @ white
        rows.append(
            (f"white by eq. 16, {name}", f"{x:.3f} {y:.3f} {z:.3f}", f"xy {x / (x + y + z):.4f} {y / (x + y + z):.4f}")
        )
    worst = float(np.abs(matrices.EQ16_CORRECTED - matrices.RGB_TO_XYZ_PAL).max())
    rows.append(("corrected - full precision", f"{worst:.5f}", "largest entry: three digits of PAL primaries, D65"))
    for exponent in (0.45, 2.2):
        rows.append(
            (
                f"0.18 by eq. 15, gamma {exponent:g}",
                f"{float(encoding.gamma_signed(0.18, exponent)):.3f}",
                "brighter" if exponent < 1 else "darker",
            )
        )
    return rows


SECTIONS: dict[str, Callable[[], list[Row]]] = {
    "points": points,
    "diffraction": diffraction_section,
    "falloff": falloff,
    "pixel": pixel,
    "sampling": sampling,
    "sharpening": sharpening,
    "range": dynamic_range,
    "colour": colour_section,
}


# -- what needs a run -------------------------------------------------------------------------------------------


def order(physical: Path, paper: Path) -> list[Row]:
    """The same scene through both orders: what each does to blacks, highlights, even areas and edges."""
    import xarray

    rows = []
    for title, folder, last in (("physical", physical, "sharpen"), ("paper's", paper, "dynamic_range_clip")):
        tree = xarray.open_datatree(folder / "data.zarr", engine="zarr")
        green = tree[last].rgb_camera.sel(channel="G").values.astype(float)
        shown = tree["encode"].rgb_display.values.astype(float)
        rows.append(
            (f"{title} order: green at 0 or below", f"{100 * float((green <= 0).mean()):.2f} %", f"behind {last}")
        )
        sky = shown[:, 60:120, 200:250]  # even blue behind the sitter
        flat = sky - sum(np.roll(np.roll(sky, a, 1), b, 2) for a in (-1, 0, 1) for b in (-1, 0, 1)) / 9
        rows.append(
            (
                f"{title} order: roughness of the sky",
                f"{float(flat[:, 1:-1, 1:-1].std()):.4f}",
                "rms about the mean of 3 x 3, encoded",
            )
        )
        rows.append((f"{title} order: mean of the picture", f"{float(shown.mean()):.3f}", "encoded"))
    return rows


def times(physical: Path, paper: Path) -> list[Row]:
    """Three integration times in both orders."""
    import xarray

    rows = []
    found = xarray.open_datatree(physical / "data.zarr", engine="zarr")
    for at in np.sort(found["exposure_report"].integration_time.values):
        clipped = 100 * float(found["exposure_report"].clipped_fraction.sel(integration_time=at))
        ratio = float(found["exposure_report"].mean_snr.sel(integration_time=at))
        rows.append(
            (f"physical order, {1e3 * at:g} ms: pixels at the full well", f"{clipped:.1f} %", f"mean SNR {ratio:.1f}")
        )
    found = xarray.open_datatree(paper / "data.zarr", engine="zarr")
    for at in np.sort(found["dynamic_range_clip"].integration_time.values):
        planes = found["dynamic_range_clip"].rgb_camera.sel(integration_time=at).values
        high, low = (100 * float(share.mean()) for share in ((planes >= 1), (planes <= 0)))
        rows.append((f"paper's order, {1e3 * at:g} ms: values at the full well", f"{high:.1f} %", f"at 0: {low:.1f} %"))
    return rows


def cost(pipeline: Path, repeat: int = 5) -> list[Row]:
    """What a run takes, best of several: inside a process that has everything loaded, and as a command."""
    from etendue.contract.registry import installed_stages
    from etendue.pipeline.file import read_pipeline
    from etendue.plan.planner import make_plan
    from etendue.session import Options, execute

    found: list[tuple[float, float, float]] = []
    for _ in range(repeat + 1):
        wall, processor = time.perf_counter(), time.process_time()
        done = execute(
            make_plan(read_pipeline(pipeline), installed_stages()), options=Options(scheduler="serial", pictures=False)
        )
        if done.failed:
            raise SystemExit(f"{pipeline}: {done.failed[0].stage} failed: {done.failed[0].message}")
        took = time.process_time() - processor, time.perf_counter() - wall
        found.append((*took, sum(report.seconds for ref, report in done.reports.items() if ref[0] in BEHIND)))
    commands = [_command(pipeline) for _ in range(3)]
    warm = found[1:]
    return [
        (
            "plan and run, in a process",
            f"{min(one[0] for one in warm):.2f} s",
            "processor time on one core, modules loaded",
        ),
        ("the same on the clock", f"{min(one[1] for one in warm):.2f} s", "the paper: about 5 s"),
        ("of it behind the optics", f"{1e3 * min(one[2] for one in warm):.0f} ms", "mosaic to XYZ, noise included"),
        (
            "etendue run, as a command",
            f"{min(one[0] for one in commands):.1f} s",
            "processor time: imports, archive, contact sheet too",
        ),
        ("the same on the clock", f"{min(one[1] for one in commands):.1f} s", f"{os.cpu_count()} cores"),
    ]


def _command(pipeline: Path) -> tuple[float, float]:
    """Processor and wall seconds of ``etendue run`` into a new archive."""
    with tempfile.TemporaryDirectory() as folder:
        wall, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "etendue", "run", str(pipeline), "--quiet", "--archive", f"{folder}/archive"]
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.perf_counter() - wall


def lines(rows: list[Row]) -> list[str]:
    """Columns, each as wide as its widest entry."""
    first, second = (max(len(row[i]) for row in rows) for i in (0, 1))
    return [f"{name:<{first}}  {value:>{second}}  {remark}".rstrip() for name, value, remark in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "what",
        nargs="*",
        metavar="SECTION",
        help=", ".join([*SECTIONS, "order ARCHIVE ARCHIVE", "times ARCHIVE ARCHIVE", "cost PIPELINE"]),
    )
    asked = parser.parse_args().what
    needs: dict[str, tuple[Any, int]] = {"order": (order, 2), "times": (times, 2), "cost": (cost, 1)}
    if asked and asked[0] in needs:
        function, count = needs[asked[0]]
        if len(asked) != 1 + count:
            parser.error(f"{asked[0]} takes {count} more {'words' if count > 1 else 'word'}; see --help")
        print("\n".join(lines(function(*map(Path, asked[1:])))))
        return
    unknown = [name for name in asked if name not in SECTIONS]
    if unknown:
        parser.error(f"there is no section {unknown[0]}; there are {', '.join(SECTIONS)}, order, times, cost")
    for name in asked or SECTIONS:
        if len(asked) != 1:
            print(f"\n{name}")
        print("\n".join(lines(SECTIONS[name]())))


if __name__ == "__main__":
    main()
