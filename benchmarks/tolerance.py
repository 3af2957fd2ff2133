"""What a tolerance buys: four pipelines, five tolerances: cells left out, knobs chosen, global error, seconds of the
stages.

    python benchmarks/tolerance.py [--pipelines sweep ...] [--tolerances 1e-2 ...] [--hold] [--repeats 2]
    [--whole-frames] [--json]

Seconds are thread time of the stages, storage apart, the least of some runs; "whole" is the same with nothing left out
at default knobs, "reference" the run of --nothing-left-out, "cells" places of the sweep at which the global error is
measured. With --hold each row asks `studies.holding` for the tolerance that keeps that global error.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from etendue.accuracy.holding import hold
from etendue.accuracy.measuring import Measurement
from etendue.accuracy.reference import reference_of
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.planner import make_plan, summary
from etendue.session import Options, execute, load

FOLDER = Path(__file__).parent.parent / "pipelines"
NAMES = ("sweep", "paper_physical", "sensors", "real_lens")
TOLERANCES = (1e-2, 3e-3, 1e-3, 1e-4, 1e-6)
# the reference of the ray-traced lens is dear: the middle of the frame, in fewer bands and rays; said in front of the
# rows
SMALLER = {
    "real_lens": {
        "scene.width": "0.4 mm",
        "scene.height": "0.4 mm",
        "scene.bin_width": "70 nm",
        "pixel.rows": 60,
        "pixel.columns": 60,
        "lens.heights": 3,
        "lens.wavelengths": [450, 650],
        "lens.pupil_samples": 128,
        "illumination.wavelengths": [450, 650],
        "illumination.pupil_samples": 64,
        "wanted": ["rgb_display", "irradiance.white_irradiance"],
    },
}
LIGHT = ("scene", "irradiance", "falloff", "distortion", "illumination", "lens", "aperture", "diffusion", "pixel")


def seconds(plan: Any, repeats: int) -> dict[str, float]:
    """Thread time by stage."""
    best: dict[str, float] = {}
    for _ in range(repeats):
        own: dict[str, float] = {}
        for report in execute(plan, None, Options("serial", pictures=False)).reports.values():
            own[report.stage] = own.get(report.stage, 0.0) + report.seconds
        if not best or sum(own.values()) < sum(best.values()):
            best = own
    return best


def told(spent: dict[str, float]) -> str:
    light = sum(value for name, value in spent.items() if name in LIGHT)
    return f"{sum(spent.values()):7.2f} s: light and optics {light:.2f}, resolution {spent.get('resolution', 0.0):.2f}"


def rows(
    name: str, tolerances: list[float], holds: bool, repeats: int, cells: int, smaller: Mapping[str, Any]
) -> list[dict[str, Any]]:
    registry, pipeline = installed_stages(), load(FOLDER / f"{name}.toml", smaller.get(name))
    whole = seconds(make_plan(pipeline, registry, False), repeats)
    if name in smaller:
        print(f"{name} with {', '.join(f'{key} = {value}' for key, value in smaller[name].items())}")
    print(f"{name}\n  whole      {told(whole)}", flush=True)
    exact = seconds(make_plan(reference_of(pipeline, registry).pipeline, registry), 1)
    print(f"  reference  {told(exact)}", flush=True)
    measurement, found = Measurement(pipeline, registry, cells, Options("threads")), []
    for tolerance in tolerances:
        plan = make_plan(replace(pipeline, tolerance=tolerance), registry)
        stages = summary(plan)["stages"]
        left = {s["name"]: s["left_out"]["cells"] for s in stages if s["left_out"]}
        knobs = {f"{s['name']}.{a['knob']}": a["value"] for s in stages for a in s["approximated"] or []}
        spent, errors = seconds(plan, repeats), measurement.errors(tolerance).errors
        known = {n: e.rms for n, e in errors.items() if e.rms is not None}
        worst = max(known, key=lambda n: known[n])
        print(
            f"  {tolerance:<9g}  {told(spent)}; left out {left}; knobs {knobs}; global error {known[worst]:.1e} "
            f"({worst}), "
            f"rgb_display {known.get('rgb_display', float('nan')):.1e}, {len(errors) - len(known)} of {len(errors)} "
            f"not comparable",
            flush=True,
        )
        row = {
            "pipeline": name,
            "tolerance": tolerance,
            "left_out": left,
            "knobs": knobs,
            "seconds": spent,
            "errors": known,
        }
        if holds:
            held = hold(pipeline, registry, tolerance, cells, Options("threads"))
            print(
                f"    hold {tolerance:g}: tolerance {held.tolerance:g}, worst {held.measured.worst:.1e}, "
                f"{'held' if held.held else f'not held: {held.missed}, to blame: {dict(held.blame)}'}",
                flush=True,
            )
            row["hold"] = held.document()
        found.append(row)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pipelines", nargs="*", default=NAMES)
    parser.add_argument("--tolerances", nargs="*", type=float, default=TOLERANCES)
    parser.add_argument("--hold", action="store_true")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--cells", type=int, default=8)
    parser.add_argument("--whole-frames", action="store_true", help="every pipeline as it stands in its file")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = []
    for name in given.pipelines:
        try:
            found += rows(
                name, given.tolerances, given.hold, given.repeats, given.cells, {} if given.whole_frames else SMALLER
            )
        except RequestError as error:
            print(f"{name}: {error}")
    if given.json:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
