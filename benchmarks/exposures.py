"""One scene at many exposures: what falls when the light rises, and how the pictures look.

    python benchmarks/exposures.py [--pictures FOLDER]

Sixty exposures from a thousandth to a thousand times the one at which a diffuse white clips, noise-free: the worst fall
below the running maximum of the balanced mosaic, of any channel of `rgb_display`, and of its luma. Only the mosaic
cannot fall: where one channel of a colour is clipped, a matrix with negative entries, and the negative weights of
sharpening and of demosaicers that look across channels, make others fall. `--pictures` writes contact sheets of
`smallest.toml` and `colour.toml` at 1/10, 1, 10, 100 and 1000 times their exposure, with brightness by the scene and by
the camera, and one strip of the developed pictures for each.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

import etendue
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.session import execute, load

HERE = Path(__file__).resolve().parent
PIPELINES = HERE.parent / "pipelines"
LUMA = (0.2126, 0.7152, 0.0722)
RIGHT = 0.04  # s: about where a diffuse white clips in the camera below
WAYS = {
    "bilinear": ("demosaic_bilinear",),
    "bilinear, unsharp": ("demosaic_bilinear", "unsharp"),
    "colour differences": ("demosaic_colour_difference",),
    "colour differences, sharpened": ("demosaic_colour_difference", "sharpen"),
    "directional": ("demosaic_directional",),
    "residual": ("demosaic_residual",),
    "residual, sharpened": ("demosaic_residual", "sharpen"),
    "malvar": ("demosaic_malvar",),
    "malvar, sharpened": ("demosaic_malvar", "sharpen"),
}
COLOUR = ("colour_fit", "camera_to_xyz", "balance", "display", "encode")


def camera(chart: str, way: tuple[str, ...], brightness: str) -> dict:  # type: ignore[type-arg]
    size = {
        "width": "280 um",
        "height": "280 um",
        "spacing": "1 um",
        "bin_width": 60,
        "wavelength_from": 400,
        "wavelength_to": 700,
    }
    before = (
        "irradiance",
        "diffraction",
        "diffusion",
        {"use": "pixel", "rows": 48, "columns": 48},
        "mosaic",
        "ideal_mosaic",
    )
    stages = [{"use": s} if isinstance(s, str) else s for s in (*before, "white", "balance_mosaic", *way, *COLOUR)]
    return {
        "name": "exposures",
        "precision": "float64",
        "camera": {"peak_qe": [0.36, 0.44, 0.40], "f_number": 4, "brightness": brightness},
        "stages": [{"use": chart, "name": "scene", "white_luminance": 250, **size}, *stages],
        "sweep": {"integration_time": [float(RIGHT * t) for t in np.logspace(-3, 3, 60)]},
        "wanted": ["balance_mosaic.mosaic_linear", "encode.rgb_display"],
    }


def fall(values: np.ndarray) -> float:
    """Worst fall below what was reached at a shorter exposure."""
    return float((np.maximum.accumulate(values, axis=0) - values).max())


def falls() -> bool:
    print("worst fall below the running maximum, 60 exposures, noise-free")
    print(f"{'chart':13s} {'demosaicer':30s} {'brightness':11s} {'mosaic':>8s} {'display':>8s} {'luma':>8s}")
    held, installed = True, installed_stages()
    for chart in ("composite", "colorchecker"):
        for name, way in WAYS.items():
            if any(use not in installed for use in way):
                print(f"{chart:13s} {name:30s} not installed")
                continue
            for brightness in ("scene", "camera"):
                tree = etendue.simulate(camera(chart, way, brightness))
                mosaic = fall(tree["balance_mosaic"].mosaic_linear.values)
                picture = tree["encode"].rgb_display.values
                luma = fall(np.tensordot(LUMA, np.moveaxis(picture, 1, 0), axes=1))
                held = held and mosaic == 0 and (name != "bilinear" or luma <= 0.01)
                print(f"{chart:13s} {name:30s} {brightness:11s} {mosaic:8.2g} {fall(picture):8.3f} {luma:8.3f}")
    print("the balanced mosaic never falls, luma behind bilinear by 0.01 at most:", "held" if held else "NOT HELD")
    return held


def pictures(folder: Path) -> None:
    from PIL import Image

    folder.mkdir(parents=True, exist_ok=True)
    for name, time in (("smallest", 0.008), ("colour", 0.008)):
        for brightness in ("scene", "camera"):
            strip = []
            for factor in (0.1, 1, 10, 100, 1000):
                given = {"camera.integration_time": time * factor, "camera.brightness": brightness}
                if name == "smallest":
                    given |= {"camera.f_number": 4, "camera.pixel_pitch": "5.4 um"}
                else:
                    given["camera.illuminant"] = "D65"
                pipeline = load(PIPELINES / f"{name}.toml", given)
                with tempfile.TemporaryDirectory() as archive:
                    outcome = execute(make_plan(pipeline, installed_stages()), Path(archive) / "a")
                    sheet = folder / f"{name}-{brightness}-{factor:g}.png"
                    sheet.write_bytes(outcome.pictures[0].read_bytes())
                    import xarray

                    with xarray.open_datatree(Path(archive) / "a" / "data.zarr", engine="zarr") as tree:
                        group = next(g for g in tree["encode"].subtree if "rgb_display" in g)
                        strip.append(np.moveaxis(group.rgb_display.squeeze().values, 0, -1))
                print(
                    f"{name}, brightness by the {brightness}, {factor:g} x: mean display value {strip[-1].mean():.4f}, "
                    f"{sheet}"
                )
            whole = np.concatenate(strip, axis=1).repeat(3, axis=0).repeat(3, axis=1)
            Image.fromarray(np.rint(255 * whole).astype(np.uint8)).save(folder / f"{name}-{brightness}.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    folder = parser.parse_args().pictures
    if folder:
        pictures(folder)
        return
    sys.exit(0 if falls() else 1)


if __name__ == "__main__":
    main()
