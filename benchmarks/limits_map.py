"""What limits a camera: MTF50 by stage and the limiting factor over 6 f-numbers x 6 pitches x 6 times, drawn and
checked.

    python benchmarks/limits_map.py [--archive FOLDER] [--pictures FOLDER]

Runs pipelines/resolution.toml (or goes on with the archive of it), writes mtf50_by_stage.png, edge_mtf50_by_stage.png
and limiting_factor.png, and prints measured minus analytic: over the sweep, and for edges of 2, 5, 10 and 40 degrees on
200 x 400 pixels, where the bound of 0.5 % before the mosaic holds.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import xarray

import etendue
from etendue.contract.arrays.variables import variable
from etendue.present.plots.drawing.panels import Sides, map_of_figures, map_of_names
from etendue.present.plots.plot import Plot

PIPELINE = Path(__file__).parent.parent / "pipelines" / "resolution.toml"
BOUND = 0.5  # per cent of MTF50, noise-free, before the mosaic
ANGLES = (2.0, 5.0, 10.0, 40.0)


def sweep(archive: Path | None) -> xarray.DataTree:
    return etendue.simulate(PIPELINE, **({} if archive is None else {"archive": archive}))


def drawn(tree: xarray.DataTree, folder: Path) -> None:
    """The three maps."""
    analytic, measured = tree["resolution"].to_dataset(), tree["edge_resolution"].to_dataset()
    f_numbers, pitches = analytic.f_number.values, analytic.pixel_pitch.values
    sides = {"x": f_numbers, "y": pitches, "x_name": "f-number", "y_name": "pixel pitch, um"}
    values = analytic.mtf50_lp_mm.transpose("stage", "pixel_pitch", "f_number").values
    figure = map_of_figures(
        values, Sides(panels=analytic.stage.values, **sides), "MTF50 up to each stage, analytic", "lp/mm"
    )
    Plot(figure).save(folder / "mtf50_by_stage.png")
    longest = measured.isel(integration_time=-2)
    edges = 1e3 * longest.edge_mtf50.transpose("stage", "pixel_pitch", "f_number")
    title = f"MTF50 measured on a slanted edge, {1e3 * float(longest.integration_time):g} ms"
    figure = map_of_figures(edges.values, Sides(panels=edges.stage.values, **sides), title, "lp/mm")
    Plot(figure).save(folder / "edge_mtf50_by_stage.png")
    panels = ["transfer functions alone", *(f"{1e3 * t:g} ms" for t in measured.integration_time.values)]
    factors = np.concatenate(
        [
            analytic.limiting_factor.transpose("pixel_pitch", "f_number").values[None],
            measured.limiting_factor.transpose("integration_time", "pixel_pitch", "f_number").values,
        ]
    )
    names = [str(n) for n in measured.factor.values]
    figure = map_of_names(
        factors,
        names,
        Sides(panels=panels, **sides),
        "What limits resolution",
        said="clipped",
        tints=variable("limiting_factor").tints,
    )
    Plot(figure).save(folder / "limiting_factor.png")


def differences(tree: xarray.DataTree) -> None:
    """Measured minus analytic over the sweep, per cent of the analytic."""
    found = tree["edge_resolution"].to_dataset()
    apart = 100 * found.edge_difference / found.edge_analytic
    print("measured minus analytic MTF50 over the sweep, % (96 x 112 pixels, the chart's rendering included)")
    print(f"{'stage':16s}{'cells':>7s}{'mean':>9s}{'largest':>9s}")
    for stage in found.stage.values:
        own = apart.sel(stage=stage).values
        known = own[np.isfinite(own)]
        if known.size:
            print(f"{stage!s:16s}{known.size:7d}{known.mean():9.3f}{np.abs(known).max():9.3f}")
    print()


def counted(tree: xarray.DataTree) -> bool:
    """Which factor limits how often, and whether that makes sense where it must."""
    analytic, measured = tree["resolution"].to_dataset(), tree["edge_resolution"].to_dataset()
    names = [str(n) for n in measured.factor.values]
    for title, data, own in (("analytic", analytic, names[:4]), ("with the pictures", measured, names)):
        index = data.limiting_factor.values
        print(
            f"limiting factor, {title}: "
            + ", ".join(f"{n} {int((index == i).sum())}" for i, n in enumerate(own))
            + f" of {index.size}"
        )
    at = {n: i for i, n in enumerate(names)}
    slow = analytic.limiting_factor.sel(f_number=22.0).values
    fast = float(analytic.limiting_factor.sel(f_number=1.4, pixel_pitch=8.0))
    checks = {
        "f/22: the lens, at every pitch": bool(np.all(slow == at["lens"])),
        "8 um at f/1.4: geometry": fast == at["geometry"],
        "sampling somewhere between": bool((analytic.limiting_factor == at["sampling"]).any()),
        "shortest time at f/22: noise": bool(
            (measured.limiting_factor.sel(f_number=22.0).isel(integration_time=0) == at["noise"]).all()
        ),
    }
    for name, held in checks.items():
        print(f"  {name:40s}{'held' if held else 'NOT HELD'}")
    print()
    return all(checks.values())


def camera(angle: float) -> dict[str, Any]:
    """200 x 400 pixels of 5.4 um at f/4 with a margin of 60 wavelengths times the f-number, up to the pixels."""
    return {
        "name": "edge",
        "precision": "float64",
        "camera": {"peak_qe": [0.4, 0.5, 0.35], "pixel_pitch": 5.4, "f_number": 4.0, "focal_length": 50},
        "stages": [
            {
                "use": "slanted_edge",
                "name": "scene",
                "angle": angle,
                "white_luminance": 1000,
                "spacing": 1.8,
                "width": 2160 + 270,
                "height": 1080 + 270,
                "wavelength_from": 400.0,
                "wavelength_to": 700.0,
                "bin_width": 50.0,
            },
            {"use": "irradiance"},
            {"use": "diffraction", "name": "lens"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": 200, "columns": 400},
            {"use": "edge_resolution"},
        ],
    }


def angles() -> bool:
    print(f"measured minus analytic MTF50 on 200 x 400 pixels of 5.4 um at f/4, noise-free, % (bound {BOUND})")
    worst, head = 0.0, True
    for angle in ANGLES:
        found = etendue.simulate(camera(angle))["edge_resolution"].to_dataset()
        if head:
            print(f"{'angle':>7s}" + "".join(f"{stage!s:>14s}" for stage in found.stage.values))
            head = False
        apart = 100 * (found.edge_difference / found.edge_analytic).values
        worst = max(worst, float(np.nan_to_num(np.abs(apart), nan=np.inf).max()))
        print(f"{angle:7g}" + "".join(f"{value:14.3f}" for value in apart), flush=True)
    print(f"largest: {worst:.3f} of {BOUND}\n")
    return worst <= BOUND


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--archive", type=Path)
    parser.add_argument("--pictures", type=Path, default=Path())
    asked = parser.parse_args()
    held = angles()
    began, spent = time.perf_counter(), time.process_time()
    tree = sweep(asked.archive)
    print(f"216 cells: {time.perf_counter() - began:.0f} s, {time.process_time() - spent:.0f} s of processor time")
    differences(tree)
    held &= counted(tree)
    asked.pictures.mkdir(parents=True, exist_ok=True)
    drawn(tree, asked.pictures)
    print(f"written: mtf50_by_stage.png, edge_mtf50_by_stage.png, limiting_factor.png in {asked.pictures.resolve()}")
    return int(not held)


if __name__ == "__main__":
    sys.exit(main())
