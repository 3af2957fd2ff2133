"""Twelve scenes of which a stage is left out and bounded, and twelve counter-scenes of which it is kept.

    python benchmarks/left_out.py [--tolerance 1e-3] [--repeats 3]

Of each: the bound at the stage and at what is wanted; the true error at both (the stage left out by force where the
plan keeps it); the seconds of the stages with the stage and without it. Exit code 1 if a scene is not as it should be
or a bound does not hold.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

from bounds import arrays_of, undone

from etendue.accuracy.differences import difference
from etendue.contract.registry import installed_stages
from etendue.contract.stage import writes_of
from etendue.plan.model import LeftOut
from etendue.plan.planner import make_plan
from etendue.session import load

WANTED = "mosaic_linear"
NOISE = ("read_noise",)  # means do not show it: the bound is a share of the variance
Case = tuple[str, dict[str, Any], dict[str, Any]]
SOFT, POINTS = {"use": "step_wedge", "softness": 4.0}, {"use": "points"}
STAR = {"use": "siemens_star"}
FAINT = {"use": "slanted_edge", "low": 0.55, "high": 0.6, "softness": 4.0}

# stage, (scene, camera, settings of the stage) where it is left out, the same where it is kept
PAIRS: tuple[tuple[str, Case, Case], ...] = (
    (
        "diffraction",
        ("faint soft edge, f/1.4", FAINT, {"f_number": 1.4}),
        ("points, f/8, 0.95 um pixels", POINTS | {"spacing": "0.25 um"}, {"f_number": 8, "pixel_pitch": "0.95 um"}),
    ),
    (
        "lens_gaussian",
        ("soft wedge, 0.05 um", SOFT, {"lens_gaussian.sigma": "0.05 um"}),
        ("points, 0.3 um", POINTS, {"lens_gaussian.sigma": "0.3 um"}),
    ),
    ("diffusion", ("soft wedge", SOFT, {"diffusion_depth": "0.3 um"}), ("star", STAR, {"diffusion_depth": "4 um"})),
    ("falloff", ("50 mm lens", STAR, {"focal_length": "50 mm"}), ("1 mm lens", STAR, {"focal_length": "1 mm"})),
    (
        "vignetting",
        ("wide rim", STAR, {"vignetting.rim_radius": "40 mm"}),
        ("narrow rim", STAR, {"vignetting.rim_radius": "1.24 mm", "vignetting.rim_distance": "9 mm"}),
    ),
    ("distortion", ("k1 = 1e-4", STAR, {"distortion.k1": 1e-4}), ("k1 = 5", STAR, {"distortion.k1": 5.0})),
    (
        "birefringent",
        ("soft wedge, 0.1 um", SOFT, {"birefringent.separation_x": "0.1 um"}),
        ("points, 1 um", POINTS, {"birefringent.separation_x": "1 um"}),
    ),
    ("glare", ("veil of 1e-4", STAR, {"glare.veil": 1e-4}), ("veil of 0.02", STAR, {"glare.veil": 0.02})),
    (
        "optical_filter",
        ("far beyond red", STAR, {"optical_filter.cut_off": "2000 nm"}),
        ("in the red", STAR, {"optical_filter.cut_off": "650 nm"}),
    ),
    ("full_well", ("0.1 ms", STAR, {"integration_time": "0.1 ms"}), ("1 s", STAR, {"integration_time": "1 s"})),
    (
        "read_noise",
        ("0.05 electron", {"use": "uniform"}, {"read_noise": 0.05, "dsnu": 0}),
        ("2 electron", {"use": "uniform"}, {"read_noise": 2, "dsnu": 0}),
    ),
    ("sharpen_mosaic", ("strength 0", STAR, {"sharpen_mosaic.strength": 0}), ("0.1", STAR, {})),
)
DEFAULTS: dict[str, dict[str, Any]] = {
    "optical_filter": {"cut_off": "2000 nm"},
    "vignetting": {"rim_radius": "40 mm", "rim_distance": "1 mm"},
    "distortion": {"k1": 1e-4, "order": 5, "oversampling": 1},
    "lens_gaussian": {"sigma": "0.5 um"},
    "sharpen_mosaic": {"strength": 0.1},
}
LIGHT = ("diffraction", "lens_gaussian", "birefringent", "glare", "diffusion")


def document(stage: str, scene: Mapping[str, Any], given: Mapping[str, Any], tolerance: float) -> dict[str, Any]:
    """A camera with the stage that a case is about, and few others."""
    own = {"name": "scene", "white_luminance": "1000 cd m-2", "width": "160 um", "height": "160 um"}
    own |= {"spacing": "0.5 um", "wavelength_from": "400 nm", "wavelength_to": "700 nm", "bin_width": "30 nm"} | scene
    names = ["irradiance", *(n for n in ("optical_filter", "distortion", "falloff", "vignetting") if n == stage)]
    names += [n for n in LIGHT if n == stage or (n == "diffusion" and stage not in LIGHT)]
    names += ["pixel", "mosaic", "exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise"]
    names += ["sharpen_mosaic"] if stage == "sharpen_mosaic" else []
    settings = {name: {"use": name} | DEFAULTS.get(name, {}) for name in names}
    camera: dict[str, Any] = {"peak_qe": [0.36, 0.44, 0.4], "integration_time": "0.5 ms", "pixel_pitch": "2 um"}
    for name, value in given.items():
        where, _, parameter = name.rpartition(".")
        (settings[where] if where else camera)[parameter] = value
    stages = [own, *settings.values()]
    return {"name": "case", "tolerance": tolerance, "precision": "float64", "camera": camera, "stages": stages}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tolerance", type=float, default=1e-3)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    registry, wrong = installed_stages(), 0
    print(f"{'stage':15s} {'scene':29s} {'plan':10s} {'bound':8s}  at wanted  {'true':8s} at wanted  with s  without s")
    for stage, out, kept in PAIRS:
        for wanted, (name, scene, setting) in ((True, out), (False, kept)):
            pipeline = load(document(stage, scene, setting, given.tolerance) | {"wanted": [WANTED]})
            plan = make_plan(pipeline, registry, expected=True)
            (cell,) = plan.of(stage)
            left = cell.left_out is not None
            forced = plan if left else undone(plan, cell.ref, {"left_out": LeftOut(0.0, "by force")})
            with_it = undone(plan, cell.ref, {"left_out": None})
            ends = [(cell.ref, next(d.variable for d in writes_of(type(cell.stage)).values()))]
            ends += [(one.ref, WANTED) for one in plan.of([n.name for n in plan.nodes if WANTED in n.writes][-1])]
            asked = {ref: {variable} for ref, variable in ends}
            runs = [[arrays_of(p, asked) for _ in range(given.repeats)] for p in (with_it, forced)]
            seconds = [min(spent for _, spent in own) for own in runs]
            true = []
            for place in ends:
                declared = next(d for d in plan.node(place[0][0]).writes.values() if d.variable == place[1])
                apart = difference(runs[1][0][0][place], runs[0][0][0][place], declared, plan.cells[place[0]].stage)
                true.append(apart.rms / apart.scale if apart.scale else 0.0)
            bounds = [cell.left_out.bound, cell.at_wanted(cell.left_out.bound)] if cell.left_out else []
            holds = all(t <= b + 1e-11 for t, b in zip(true, bounds, strict=False)) or stage in NOISE
            wrong += left != wanted or not holds
            shown = "  ".join(f"{b:8.1e}" for b in bounds) if bounds else "       -         -"
            verdict = "left out" if left else "kept    "
            row = f"{stage:15s} {name:29s} {verdict}  {shown}   {true[0]:8.1e} {true[1]:8.1e}   "
            right = left == wanted and holds
            print(f"{row}{seconds[0]:7.4f}  {seconds[1]:7.4f}{'' if right else '  WRONG'}", flush=True)
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    main()
