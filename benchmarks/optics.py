"""The optics: CPU of a 512 x 512 x 31 frame on one thread, and error against run time for every knob of fidelity.

    python benchmarks/optics.py [--knobs optics_knobs.png]

Without an argument: seconds of the stages as the engine's own ledger has them, on one thread, best of three. With
``--knobs``: each knob is varied, everything else held; error is the largest of the wanted variable against the knob's
reference, as a share of its largest value; seconds are those of all cells of the run. The figure shows them against
each other.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402

import etendue  # noqa: E402
from etendue.compute.tables import TABLES  # noqa: E402

CAMERA = {"peak_qe": [0.4, 0.5, 0.35], "f_number": 4.0, "pixel_pitch": 4.0, "focal_length": 8}
FRAME = {
    "use": "composite",
    "name": "scene",
    "white_luminance": 100,
    "width": 512,
    "height": 512,
    "wavelength_from": 395,
    "wavelength_to": 705,
}
ISETCAM = 5.1  # s of CPU for the optics of the same frame, Octave, measured on a machine of this kind


def camera(
    *stages: dict[str, Any], wanted: str, precision: str = "float32", scene: dict[str, Any] | None = None
) -> dict[str, Any]:
    return {
        "name": "optics",
        "precision": precision,
        "camera": CAMERA,
        "wanted": [wanted],
        "keep": [wanted],
        "stages": [{**FRAME, **(scene or {})}, {"use": "irradiance"}, *stages],
    }


def run(document: dict[str, Any]) -> tuple[Any, dict[str, float]]:
    """The wanted variable, and seconds by stage; tables are made anew."""
    TABLES.clear()
    tree = etendue.simulate(document, scheduler="serial", leave_out=False)
    ledger = tree["ledger"].to_dataset()
    seconds = dict(zip(map(str, ledger.stage.values), ledger.seconds.values.astype(float), strict=True))
    stage, _, variable = document["wanted"][0].partition(".")
    return tree[stage][variable].values, seconds


def whole_frame() -> int:
    blur = ({"use": "falloff"}, {"use": "diffraction"})
    cases = (
        ("irradiance, fall-off, diffraction: 31 blurred planes", camera(*blur, wanted="diffraction.irradiance"), 0.5),
        (
            "the same with diffusion, to the pixels of three channels",
            camera(*blur, {"use": "diffusion"}, {"use": "pixel"}, wanted="pixel.photon_rate"),
            0.5,
        ),
        (
            "the same, 8 terms over wavelength",
            camera(*blur, {"use": "diffusion"}, {"use": "pixel", "wavelength_terms": 8}, wanted="pixel.photon_rate"),
            0.5,
        ),
    )
    beyond = 0
    print(f"{'512 x 512 x 31, one thread':60s} {'s CPU':>7s} {'bound':>7s} {'ISETCam':>8s}")
    for what, document, bound in cases:
        seconds = min(sum(s for stage, s in run(document)[1].items() if stage != "scene") for _ in range(3))
        beyond += seconds > bound
        print(f"{what:60s} {seconds:7.3f} {bound:7.2f} {ISETCAM:8.1f}")
    print("beyond the bound: " + (str(beyond) if beyond else "none"))
    return int(beyond > 0)


def bank(folder: Path) -> str:
    """Spread functions that widen and turn into comets with the field."""
    from etendue_camera.field.psf_bank import PsfBank

    size, heights = 33, np.linspace(0, 370, 7)
    y, x = np.mgrid[:size, :size] - size // 2
    pictures = []
    for height in heights / heights[-1]:
        spots = [
            np.exp(-0.5 * (((y - 3 * t * height) / (1 + t)) ** 2 + (x / (1 + 0.6 * t)) ** 2))
            for t in np.linspace(0, 2, 9)
        ]
        pictures.append(np.sum(spots, axis=0)[None])
    path = folder / "bank.npz"
    PsfBank(heights, np.array([0.55]), np.array(pictures), 1.0).save(path)
    return str(path)


def psf_table(folder: Path) -> str:
    radius = np.linspace(0, 12, 241)
    path = folder / "psf.csv"
    path.write_text("radius_um,psf\n" + "\n".join(f"{r},{np.exp(-0.5 * (r / 2) ** 2)}" for r in radius))
    return str(path)


def knobs(folder: Path) -> dict[str, tuple[Any, list[Any], Any]]:
    """By name: a function of the value that gives a document, the values, the reference."""
    few = {"wavelength_from": 400, "wavelength_to": 700, "bin_width": 100, "width": 384, "height": 384}
    pixel, diffraction, diffusion = {"use": "pixel"}, {"use": "diffraction"}, {"use": "diffusion"}
    file, table = bank(folder), psf_table(folder)
    rate = "pixel.photon_rate"

    def one(stage: dict[str, Any], name: str, **fixed: Any) -> Any:
        use = stage["use"]
        return lambda v: camera({**stage, **fixed, name: v}, wanted=f"{use}.irradiance", precision="float64", scene=few)

    def chain(where: str, name: str) -> Any:
        def made(value: Any) -> dict[str, Any]:
            stages = [{**s, name: value} if s["use"] == where else s for s in (diffraction, diffusion, pixel)]
            return camera(*stages, wanted=rate, precision="float64", scene={name: value} if where == "scene" else None)

        return made

    return {
        "scene.spacing": (chain("scene", "spacing"), [4.0, 2.0, 1.0], 0.5),
        "scene.bin_width": (chain("scene", "bin_width"), [62.0, 31.0, 10.0, 5.0], 2.0),
        "pixel.wavelength_terms": (chain("pixel", "wavelength_terms"), [3, 5, 7, 9, 12], 0),
        "diffusion.nodes": (chain("diffusion", "nodes"), [64, 256, 1024, 4096], 0),
        "lens_psf.nodes": (one({"use": "lens_psf", "file": table}, "nodes"), [128, 512, 2048, 8192], 65536),
        "wavefront.pupil_samples": (
            one({"use": "wavefront", "aperture": "polygonal", "blades": 7, "defocus": 0.01}, "pupil_samples"),
            [32, 64, 128, 256],
            1024,
        ),
        "aberrations.accuracy": (
            one({"use": "aberrations", "coma": 0.5, "astigmatism": 0.3}, "accuracy"),
            [0.1, 0.05, 0.02, 0.01],
            0.005,
        ),
        "aberrations.heights": (
            one({"use": "aberrations", "coma": 0.5, "astigmatism": 0.3}, "heights", accuracy=0.01),
            [3, 5, 9, 17],
            33,
        ),
        "aberrations.bands": (
            lambda v: camera(
                {"use": "aberrations", "coma": 0.5, "bands": v, "accuracy": 0.02},
                wanted="aberrations.irradiance",
                precision="float64",
                scene={**few, "bin_width": 25},
            ),
            [3, 5, 7, 9],
            12,
        ),
        "aberrations.pupil_samples": (
            one({"use": "aberrations", "coma": 0.5, "astigmatism": 0.3}, "pupil_samples", accuracy=0.02),
            [32, 64, 128, 256],
            512,
        ),
        "lens_psf_field.tolerance": (
            one({"use": "lens_psf_field", "file": file}, "tolerance"),
            [0.3, 0.1, 0.03, 0.01],
            0.003,
        ),
        "distortion.order": (one({"use": "distortion", "k1": -0.05, "reference_radius": 0.25}, "order"), [1, 3, 5], 5),
        "distortion.oversampling": (
            one({"use": "distortion", "k1": -0.05, "reference_radius": 0.25}, "oversampling", order=3),
            [1, 2],
            4,
        ),
    }


def draw(path: Path) -> int:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter

    with tempfile.TemporaryDirectory() as folder:
        found: dict[str, list[tuple[float, float, Any]]] = {}
        print(f"{'knob':28s} {'value':>10s} {'error':>10s} {'seconds':>9s}")
        for knob, (document, values, reference) in knobs(Path(folder)).items():
            finest = document(reference)
            if knob == "distortion.order":
                finest["stages"][-1]["oversampling"] = 4
            truth, own = run(finest)
            scale = np.abs(truth).max()
            print(f"{knob:28s} {reference!s:>10s} {'reference':>10s} {sum(own.values()):9.3f}")
            for value in values:
                result, seconds = min(
                    (run(document(value)) for _ in range(2)), key=lambda found: sum(found[1].values())
                )
                if result.shape != truth.shape:
                    step = [max(1, n // m) for n, m in zip(truth.shape, result.shape, strict=True)]
                    raise SystemExit(f"{knob}: {result.shape} against {truth.shape}, step {step}")
                error, total = float(np.abs(result - truth).max() / scale), sum(seconds.values())
                found.setdefault(knob, []).append((total, error, value))
                print(f"{knob:28s} {value!s:>10s} {error:10.1e} {total:9.3f}", flush=True)
    columns = 4
    rows = -(-len(found) // columns)
    figure, axes = pyplot.subplots(rows, columns, figsize=(4 * columns, 3 * rows))
    for axis, (knob, points) in zip(axes.flat, found.items(), strict=False):
        axis.loglog([p[0] for p in points], [max(p[1], 1e-17) for p in points], "o-")
        for seconds, error, value in points:
            axis.annotate(
                f"{value:g}", (seconds, max(error, 1e-17)), fontsize=7, xytext=(3, 3), textcoords="offset points"
            )
        axis.set_title(knob, fontsize=9)
        axis.set_xlabel("seconds of CPU", fontsize=7)
        axis.set_ylabel("largest error / full scale", fontsize=7)
        axis.tick_params(labelsize=7)
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.set_minor_formatter(NullFormatter())
        low, high = min(p[0] for p in points), max(p[0] for p in points)
        axis.set_xlim(10 ** np.floor(np.log10(low)), 10 ** np.ceil(np.log10(high)))
    for axis in axes.flat[len(found) :]:
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    print(f"drawn: {path}")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--knobs", type=Path)
    asked = parser.parse_args()
    return draw(asked.knobs) if asked.knobs else whole_frame()


if __name__ == "__main__":
    sys.exit(main())
