"""What is done to the mosaic in front of the demosaicer: claims and what is measured, and what each correction costs.

    python benchmarks/raw_corrections.py [--pictures FOLDER] [--figure FILE.png]

FOLDER holds pictures (.png, .tif), such as ../shared/data/demosaic/kodak: defects are put into their mosaics and
corrected. Without it the sample picture of matplotlib is taken. A claim is printed with its bound; what misses it is
marked and makes the exit code 1.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import etendue
from etendue.contract.registry import installed_stages
from etendue_camera.colour import difference
from etendue_camera.mosaic import defect_correction, shading, white_balance
from etendue_camera.quality import artefacts
from etendue_camera.sensor import cfa

MISSED: list[str] = []
D65 = np.array([0.95047, 1.0, 1.08883])
BAYER = cfa.parse("RGGB")
CAMERA = {"peak_qe": [0.36, 0.44, 0.40], "f_number": 2.8}


def claim(what: str, bound: str, measured: str, holds: bool) -> None:
    print(f"  {what:78s} {bound:>14s} {measured:>22s}{'' if holds else '   MISSED'}")
    if not holds:
        MISSED.append(what)


def best_time(call: Callable[[], Any], times: int = 5) -> float:
    """Smallest CPU time of this thread, s."""
    found = []
    for _ in range(times):
        start = time.thread_time()
        call()
        found.append(time.thread_time() - start)
    return min(found)


def run(stages: list[Any], wanted: list[str], **camera: Any) -> Any:
    entries = [{"use": s} if isinstance(s, str) else s for s in stages]
    return etendue.simulate({"name": "raw", "camera": {**CAMERA, **camera}, "stages": entries, "wanted": wanted})


def values(tree: Any, where: str) -> Any:
    name, _, variable = where.partition(".")
    return np.asarray(tree[name][variable].squeeze(), float)


# -- balance in front of the demosaicer -----------------------------------------------------------------------

EDGE = {
    "use": "slanted_edge",
    "name": "scene",
    "white_luminance": 300,
    "width": 420,
    "height": 420,
    "spacing": 0.7,
    "bin_width": 20,
    "wavelength_from": 400,
    "wavelength_to": 700,
    "low": 0.1,
    "high": 0.9,
}


LEVELS = {"white": "white", "clipping_level": "ideal_mosaic"}  # those of the mosaic: planes have none


def edge(demosaic: str, balanced: bool, illuminant: str) -> tuple[Any, Any]:
    """XYZ of a grey slanted edge at 5 degrees, adapted to D65, noise-free: demosaiced, and as full planes."""
    stages: list[Any] = [
        EDGE,
        "irradiance",
        "diffraction",
        "diffusion",
        {"use": "pixel", "rows": 128, "columns": 128},
        "mosaic",
        "ideal_mosaic",
    ]
    stages += [
        "white",
        *(["balance_mosaic"] if balanced else []),
        {"use": demosaic, "name": "demosaic"},
        "colour_fit",
        "camera_to_xyz",
        "balance",
    ]
    planes: list[Any] = [
        "no_mask",
        {"use": "ideal_mosaic", "name": "planes", "clip": False},
        *([{"use": "balance_mosaic", "name": "planes_balanced", "from": {"white": "white"}}] if balanced else []),
        "no_demosaicing",
        {
            "use": "camera_to_xyz",
            "name": "planes_xyz",
            "from": LEVELS | ({"white": "balance_mosaic"} if balanced else {}),
        },
        {"use": "balance", "name": "truth"},
    ]
    found = run(
        [*stages, *planes],
        ["balance.xyz_scene", "truth.xyz_scene"],
        illuminant=illuminant,
        pixel_pitch=2.8,
        integration_time="4 ms",
    )
    return tuple(values(found, f"{name}.xyz_scene")[:, 8:-8, 8:-8] for name in ("balance", "truth"))  # type: ignore[return-value]


def coloured_edges(figure: str) -> None:
    print(
        "balance_mosaic: a grey slanted edge, f/2.8, 2.8 um pixels, demosaiced from the camera's own channels and from "
        "balanced ones"
    )
    print(
        f"  {'demosaicer':32s} {'light':6s} {'chroma rms, C*':>22s} {'largest C*':>20s} {'zipper, share':>20s} "
        f"{'false colour':>20s}"
    )
    names = [n for n in installed_stages().names() if n.startswith("demosaic_")]
    shown: dict[tuple[str, str, bool], Any] = {}
    rms: dict[tuple[str, str, bool], float] = {}
    for name in names:
        for light in ("D65", "A"):
            found = []
            for balanced in (False, True):
                picture, truth = (difference.lab(xyz, D65) for xyz in edge(name, balanced, light))
                chroma = np.hypot(picture[1], picture[2])
                rms[name, light, balanced] = float(np.sqrt(np.mean(chroma**2)))
                zipper, false = artefacts.zipper(picture, truth), artefacts.false_colour(picture, truth)
                found.append((rms[name, light, balanced], chroma.max(), zipper, false))
                shown[name, light, balanced] = picture
            pairs = "".join(f" {a:9.3g} -> {b:7.3g}" for a, b in zip(*found, strict=True))
            print(f"  {name:32s} {light:6s} {pairs}")
    for name in ("demosaic_nearest", "demosaic_bilinear", "demosaic_any"):
        apart = max(abs(rms[name, light, False] / rms[name, light, True] - 1) for light in ("D65", "A"))
        claim(f"{name}, one channel at a time, does not care", "< 1e-4", f"{apart:.1e}", apart < 1e-4)
    name = "demosaic_colour_difference"
    for light, least in (("D65", 2.0), ("A", 6.0)):
        times = rms[name, light, False] / rms[name, light, True]
        claim(f"{name} under {light}: chroma rms before over after", f"> {least:g}", f"{times:.2f}", times > least)
    apart = abs(rms[name, "A", True] / rms[name, "D65", True] - 1)
    claim(f"{name}, balanced: the light's colour no longer matters", "< 0.1", f"{apart:.3f}", apart < 0.1)
    if figure:
        draw(figure, shown)


def draw(figure: str, shown: dict[tuple[str, str, bool], Any]) -> None:
    """The middle of the edge, demosaiced before and after the balance."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(9, 7), dpi=110, layout="constrained")
    FigureCanvasAgg(canvas)
    axes = canvas.subplots(2, 2)
    for row, light in zip(axes, ("D65", "A"), strict=True):
        for axis, balanced in zip(row, (False, True), strict=True):
            picture = shown["demosaic_colour_difference", light, balanced][:, 40:72, 40:72]
            drawn = axis.imshow(np.hypot(picture[1], picture[2]), cmap="inferno", vmin=0, vmax=60)
            axis.set_title(f"light {light}, {'balanced first' if balanced else 'own channels'}", fontsize=10)
            axis.set_axis_off()
    canvas.colorbar(drawn, ax=axes, label="chroma C* of a grey edge: 0 is the truth", shrink=0.7)
    canvas.savefig(figure)
    print(f"  figure: {figure}")


# -- white ----------------------------------------------------------------------------------------------------


def whites() -> None:
    print("white_estimate: angle to the illuminant's white, degrees; share of the picture it was looked for in")
    methods = ("illuminant", "grey_world", "shades_of_grey", "white_patch")
    print(f"  {'scene':16s} {'light':8s}" + "".join(f"{m:>20s}" for m in methods))
    common = {"name": "scene", "white_luminance": 300, "bin_width": 20, "wavelength_from": 400, "wavelength_to": 700}
    scenes = {
        "slanted_edge": {"width": 560, "height": 420, "spacing": 2.0},
        "colorchecker": {"width": 560, "height": 420, "spacing": 2.0},
        "composite": {"width": 560, "height": 420, "spacing": 2.0},
    }
    sensor = [
        "irradiance",
        {"use": "pixel", "rows": 150, "columns": 200},
        "mosaic",
        "exposure",
        "shot_noise",
        "full_well",
        "read_noise",
    ]
    sensor += ["adc", "linearise", "white"]
    worst: dict[str, float] = {}
    for scene, own in scenes.items():
        for light in ("D65", "A", "FL11"):
            cells = []
            for method in methods:
                stages = [{"use": scene, **common, **own}, *sensor, {"use": "white_estimate", "method": method}]
                found = run(stages, ["white_estimate"], illuminant=light, pixel_pitch=2.8, integration_time="4 ms")
                error = float(values(found, "white_estimate.white_error"))
                cells.append(f"{error:11.2f} ({float(values(found, 'white_estimate.white_used')):5.2f})")
                if scene == "slanted_edge":
                    worst[method] = max(worst.get(method, 0.0), error)
            print(f"  {scene:16s} {light:8s}" + "".join(f"{c:>20s}" for c in cells))
    for method, bound in (("illuminant", 0.0), ("grey_world", 0.5), ("shades_of_grey", 0.5), ("white_patch", 1.5)):
        claim(
            f"on a grey scene, with noise: {method}",
            f"<= {bound:g} deg",
            f"{worst[method]:.3f}",
            worst[method] <= bound,
        )


# -- shading --------------------------------------------------------------------------------------------------


def even_light() -> None:
    print(
        "lens_shading: even light behind fall-off, a rim and the pixels' response by angle, 34 degrees in the corner, "
        "noise-free"
    )
    rim = {"rim_radius": 1.3, "rim_distance": 1.5}
    flat = {
        "use": "uniform",
        "name": "scene",
        "white_luminance": 300,
        "width": 5600,
        "height": 4200,
        "spacing": 7.0,
        "bin_width": 100,
        "wavelength_from": 400,
        "wavelength_to": 700,
        "reflectance": 0.5,
    }
    before = [
        flat,
        "irradiance",
        {"use": "falloff", "model": "disc"},
        {"use": "vignetting", **rim},
        {"use": "angular_response", "power": 1.5},
    ]
    sensor = [{"use": "pixel", "rows": 300, "columns": 400}, "mosaic", "ideal_mosaic"]
    own = {"focal_length": "5 mm", "pixel_pitch": 14.0, "integration_time": "12 ms"}
    wanted = ["ideal_mosaic.mosaic_linear", "lens_shading.mosaic_linear"]
    tree = run([*before, *sensor, {"use": "lens_shading", "model": "disc", "power": 1.5, **rim}], wanted, **own)
    dark, even = (values(tree, w) for w in wanted)
    uneven = [
        max(np.abs(m[r::2, c::2] / m[150 + r, 200 + c] - 1).max() for r, c in ((0, 0), (0, 1), (1, 1)))
        for m in (dark, even)
    ]
    print(
        f"  without: the corner has {1 - uneven[0]:.3f} of the light of the axis, which is at {dark.max():.2f} of "
        f"saturation"
    )
    claim("by the model of the lens: largest unevenness", "< 1e-4", f"{uneven[1]:.1e}", uneven[1] < 1e-4)
    y, x = 0.014 * (np.arange(300) - 149.5), 0.014 * (np.arange(400) - 199.5)
    noisy = np.random.default_rng(1).poisson(dark * 2e4, (16, *dark.shape)).mean(axis=0) / 2e4
    radius = np.hypot(y[:, None], x[None, :])
    for what, field, bound in (
        ("one noise-free flat field", dark, 0.005),
        ("the mean of 16 noisy ones (20000 electrons at 1)", noisy, 0.02),
    ):
        table = shading.calibrated(field, BAYER, y, x)
        gains = cfa.pick(np.stack([np.interp(radius, table.heights_mm, column) for column in table.gains.T]), BAYER)
        worst = max(
            np.abs((m := dark * gains)[r::2, c::2] / m[150 + r, 200 + c] - 1).max() for r, c in ((0, 0), (0, 1), (1, 1))
        )
        claim(f"by a table from {what}: largest unevenness", f"< {bound:g}", f"{worst:.1e}", worst < bound)


# -- defects --------------------------------------------------------------------------------------------------


def pictures(folder: str) -> dict[str, Any]:
    """Linear planes (3, y, x), 0 to 0.9."""
    from PIL import Image

    files = sorted(p for p in Path(folder).rglob("*") if p.suffix.lower() in (".png", ".tif")) if folder else []
    if not files:
        import matplotlib

        files = [Path(matplotlib.get_data_path()) / "sample_data" / "grace_hopper.jpg"]
        print("  no --pictures FOLDER: the sample picture of matplotlib alone")
    found = {}
    for file in files[:12]:
        encoded = np.asarray(Image.open(file).convert("RGB"), float) / 255
        found[file.stem] = np.moveaxis(0.9 * encoded**2.2, -1, 0)
    return found


def by_median(mosaic: Any, sigma: Any, threshold: float) -> tuple[Any, Any]:
    """The peer: each pixel against the median of its neighbours of the same colour, which also replaces it."""
    from scipy.ndimage import median_filter

    ring = np.ones((5, 5), bool)
    ring[2, 2] = False
    ring[1::2, :] = ring[:, 1::2] = False
    quincunx = ring.copy()
    quincunx[1::2, 1::2] = True
    green = cfa.channel_index(BAYER, *mosaic.shape) == 1
    median = np.where(
        green,
        median_filter(mosaic, footprint=quincunx, mode="mirror"),
        median_filter(mosaic, footprint=ring, mode="mirror"),
    )
    chosen = np.abs(mosaic - median) > threshold * sigma(median)
    return np.where(chosen, median, mosaic), chosen


def corrected(truth: Any, rng: Any) -> dict[str, tuple[float, ...]]:
    """Share found of what stands out, false alarms, rms error of repaired pixels, ms/Mpixel: of one mosaic, by
    method.
    """
    electrons, dark = 1e4, 5e-4

    def sigma(m: Any) -> Any:
        return np.sqrt(dark**2 + np.maximum(m, 0) / electrons)

    noisy = rng.poisson(truth * electrons) / electrons + dark * rng.standard_normal(truth.shape)
    kind = rng.uniform(size=truth.shape)
    hot, dead = kind < 5e-4, (kind >= 5e-4) & (kind < 1e-3)
    broken = np.where(hot, np.minimum(noisy + rng.exponential(0.3, truth.shape), 1.0), noisy)
    broken = np.where(dead, dark * rng.standard_normal(truth.shape), broken)
    known = hot | dead
    visible = known & (np.abs(broken - truth) > 5 * sigma(truth))  # others are within their noise
    rows = {}

    def add(name: str, found: Any, chosen: Any, call: Callable[[], Any]) -> None:
        repaired = visible & chosen
        error = np.sqrt(np.mean((found - truth)[repaired] ** 2)) if repaired.any() else np.nan
        rows[name] = (chosen[visible].mean(), chosen[~known].mean(), error, 1e9 * best_time(call, 2) / truth.size)

    def search(contrast: float) -> Any:
        return defect_correction.outliers(
            broken, BAYER, defect_correction.PixelNoise(dark, electrons), contrast=contrast
        )

    for contrast in (0.0, 0.5, 1.0, 2.0):
        chosen = search(contrast)
        add(
            f"ours, contrast {contrast:g}",
            defect_correction.replaced(broken, chosen, BAYER)[0],
            chosen,
            lambda c=contrast: search(c),
        )  # type: ignore[misc]
    repaired, _ = defect_correction.replaced(broken, known, BAYER)
    add("ours, by the map", repaired, known, lambda: defect_correction.replaced(broken, known, BAYER))
    for threshold in (4.0, 20.0, 60.0):
        found, chosen = by_median(broken, sigma, threshold)
        add(
            f"peer: median of the neighbours, {threshold:g} sigma",
            found,
            chosen,
            lambda t=threshold: by_median(broken, sigma, t),
        )  # type: ignore[misc]
    every = np.where(known, by_median(broken, sigma, 0.0)[0], broken)
    add("peer: median of the neighbours, by the map", every, known, lambda: by_median(broken, sigma, 0.0))
    return rows


def defects(folder: str) -> None:
    print(
        "correct_defects: 0.1 % hot and dead pixels in mosaics with noise (10000 electrons at 1, 5 in the dark); means "
        "over the pictures"
    )
    rng = np.random.default_rng(3)
    heads = ("found", "false alarms", "rms error", "ms/Mpixel")
    print(
        f"  {'method':48s}"
        + "".join(f"{h:>14s}" for h in heads)
        + "   (of those 5 sigma off; of sound pixels; of repaired pixels)"
    )
    found = [corrected(cfa.pick(planes, BAYER), rng) for planes in pictures(folder).values()]
    means = {name: np.nanmean([own[name] for own in found], axis=0) for name in found[0]}
    for name, (share, alarms, error, cost) in means.items():
        print(f"  {name:48s}{share:14.3f}{alarms:14.2e}{error:14.4f}{cost:14.1f}")
    ours, peer = means["ours, contrast 2"], means["peer: median of the neighbours, 60 sigma"]
    claim(
        "contrast 2 against the median at 60 sigma: share of defects found",
        f"> {peer[0]:.3f}",
        f"{ours[0]:.3f}",
        ours[0] > peer[0],
    )
    claim("with fewer sound pixels replaced", f"< {peer[1]:.1e}", f"{ours[1]:.1e}", ours[1] < peer[1])
    claim("at several times its speed, ms/Mpixel", f"< {peer[3]:.0f}", f"{ours[3]:.0f}", ours[3] < peer[3])
    mapped, peer = means["ours, by the map"][2], means["peer: median of the neighbours, by the map"][2]
    claim("repair along lines against the median: rms error", f"< {peer:.4f}", f"{mapped:.4f}", mapped < peer)


def times() -> None:
    print("run time on 1 Mpixel, single precision, one thread (CPU time, best of 5)")
    mosaic = np.random.default_rng(0).uniform(0.2, 0.3, (1000, 1000)).astype(np.float32)
    flags = np.random.default_rng(1).uniform(size=mosaic.shape) < 1e-3
    line = np.arange(1000.0)
    corrected = installed_stages().load("lens_shading")(focal_length=3.0)
    calls = {
        "balance_mosaic": (lambda: white_balance.balanced(mosaic, [1.5, 1.0, 2.0], BAYER, ceiling=1.0), 10),
        "white_estimate": (
            lambda: white_balance.grey_world(white_balance.cell_means(mosaic, BAYER, 4, 0.98, 0.0)[0]),
            60,
        ),
        "lens_shading (cos4)": (lambda: corrected.run(mosaic, line, line, 2 * (line - 500), 2 * (line - 500)), 100),
        "correct_defects, search": (
            lambda: defect_correction.outliers(mosaic, BAYER, defect_correction.PixelNoise(1e-3, 1e4, 0.01)),
            150,
        ),
        "correct_defects, repair of 0.1 %": (lambda: defect_correction.replaced(mosaic, flags, BAYER), 20),
    }
    for name, (call, bound) in calls.items():
        found = 1e3 * best_time(call)
        claim(name, f"< {bound} ms", f"{found:.1f} ms", found < bound)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", default="", metavar="FOLDER")
    parser.add_argument("--figure", default="", metavar="FILE.png")
    asked = parser.parse_args()
    for part in (lambda: coloured_edges(asked.figure), whites, even_light, lambda: defects(asked.pictures), times):
        part()
        print()
    print(f"{len(MISSED)} claims missed" + (": " + "; ".join(MISSED) if MISSED else ""))
    return 1 if MISSED else 0


if __name__ == "__main__":
    sys.exit(main())
