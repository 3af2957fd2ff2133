"""--hold by metric and by picture on pipelines that leave bins, spacing and surround open: is the answer held in truth?

    python benchmarks/hold.py [--only NAME ...] [--seconds 60]

Every pipeline is one of pipelines/, at the middle of its sweep, with a small frame. What it writes for bins and
spacing (and, if the chart extends, around it) is "auto". Each is held twice: a headline metric within 1 % of
its value, and one picture within 1e-2 of full scale. The truth is a run written independently of the search: a third of
the bins and of the spacing that were found, a surround larger by half of the longer side, nothing left out, 64 bits,
without noise. Printed as they are found: what was asked, the stated and the true error, seconds, what was refined, or
what the answer would need. Exit code 1 if a pipeline that is said to hold does not.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from etendue.accuracy.answers.error import is_number, part_between
from etendue.accuracy.answers.pilots import state_errors
from etendue.accuracy.answers.refinement import Point
from etendue.accuracy.holding import Asked, hold
from etendue.contract.registry import Registry, installed_stages
from etendue.errors import EtendueError
from etendue.pipeline.derived import at_value, with_values
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.plan.wiring.automatic import with_chosen
from etendue.session import Options, load

FOLDER = Path(__file__).parent.parent / "pipelines"
METRIC, PICTURE = 0.01, 1e-2
EXTEND = ("composite", "slanted_edge", "uniform")
# Name, metric, picture, and what makes it small.
CASES: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
    ("burst", "mean_snr", "rgb_display", {"rows": 32, "columns": 40}),
    ("colour", "mean_snr", "rgb_display", {"rows": 32, "columns": 48}),
    ("emva", "", "photon_rate", {"rows": 16, "columns": 16}),
    ("paper", "mtf50_lp_mm", "rgb_display", {"rows": 64, "columns": 64}),
    ("paper_physical", "mtf50_lp_mm", "rgb_display", {"rows": 48, "columns": 48}),
    ("raw_corrections", "mean_snr", "rgb_display", {"rows": 32, "columns": 48}),
    ("resolution", "mtf50_lp_mm", "rgb_display", {"rows": 48, "columns": 56}),
    ("sensors", "mtf50_lp_mm", "rgb_display", {"rows": 32, "columns": 40}),
    ("smallest", "mean_snr", "rgb_display", {"rows": 32, "columns": 40}),
    ("sweep", "mtf50_lp_mm", "photon_rate", {"rows": 32, "columns": 32}),
    ("sweep_die", "mean_snr", "rgb_display", {"rows": 32, "columns": 40}),
    ("real_lens", "mean_snr", "rgb_display", {"rows": 48, "columns": 64}),
)


@dataclass(frozen=True)
class Found:
    """One pipeline with one thing held. Errors are relative to what is asked."""

    name: str
    what: str
    held: bool
    stated: float
    true: float
    seconds: float
    refined: str

    def __str__(self) -> str:
        said = "yes" if self.held else "no"
        truth = "-" if math.isnan(self.true) else f"{self.true:8.3f}"
        return (
            f"{self.name:16} {self.what:22} {said:4} {self.stated:8.3f} {truth:>8} {self.seconds:7.1f}  {self.refined}"
        )


def opened(name: str, small: dict[str, Any], registry: Registry) -> PipelineFile:
    """Return a pipeline at the middle of its sweep, with a small frame and all discretisations left open."""
    pipeline = load(FOLDER / f"{name}.toml")
    plan = make_plan(pipeline, registry)
    middle = {axis.key: axis.values[len(axis.values) // 2] for axis in plan.axes}
    for key, written in pipeline.sweep.items():
        value = written[len(written) // 2] if isinstance(written, list | tuple) else middle[key]
        pipeline = at_value(pipeline, key, value)
    pipeline = replace(pipeline, sweep={}, wanted=None, keep=None)
    scene = pipeline.stages[0]
    cell = next(c for c in make_plan(pipeline, registry).cells.values() if "pixel_pitch" in vars(c.stage))
    side = {"height": small["rows"], "width": small["columns"]}
    size = {of: n * cell.stage.pixel_pitch for of, n in side.items()}
    extends = scene.use in EXTEND
    values: dict[str, Any] = {**size, "bin_width": "auto", "spacing": "auto"}
    if extends:
        values["surround"] = "auto"
    if scene.use == "composite":
        values["margin"] = 0.0
    if name == "emva":  # its light is one bin
        values.pop("bin_width")
    pipeline = with_values(pipeline, scene.name, values)
    for entry in pipeline.stages:
        if entry.use == "pixel":
            frame = {"sampling": "physical", **small}
            pipeline = with_values(pipeline, entry.name, frame, ("sensor_height", "sensor_width"))
    return pipeline


def truth_of(plan: Plan, registry: Registry, scene: str) -> Plan:
    """Return the plan of the same camera with everything finer."""
    stage: Any = plan.of(scene)[0].stage
    finer = {"spacing": stage.spacing / 3, "bin_width": stage.bin_width / 3}
    if plan.node(scene).alternatives[0].use in EXTEND:
        more = math.ceil(0.5 * max(stage.width, stage.height) / stage.spacing)
        finer["surround"] = stage.surround + more * stage.spacing
    made = replace(with_values(plan.pipeline, scene, finer), precision="float64", leave_out=False)
    return make_plan(made, registry, False, expected=True)


def measured(name: str, what: str, picture: bool, pipeline: PipelineFile, registry: Registry, seconds: float) -> Found:
    """Hold one thing and compare with the truth."""
    first = make_plan(replace(pipeline, wanted=(what,)), registry)
    pipeline = replace(pipeline, wanted=(what,))
    stage, variable = first.wanted[0]
    own_unit = is_number(first.node(stage).writes[variable])  # a metric of every frame is held relative to the largest
    limit = PICTURE if picture else METRIC
    if own_unit:
        point = Point(first, registry, {}, first.wanted)
        value = next(iter(point.values(point.base).values()))
        limit = METRIC * abs(float(np.ravel(value)[-1]))
    began = time.process_time()
    asked = Asked(None, {what: limit}) if own_unit else Asked(limit)
    found = hold(pipeline, registry, asked, options=Options("serial", hold_seconds=seconds))
    chosen = replace(with_chosen(pipeline, found.chosen.values), tolerance=found.tolerance)
    plan = make_plan(chosen, registry)
    parts = found.chosen.parts
    stated = next(iter(state_errors(plan, registry, None, seconds, known=parts).errors.values()))
    took = time.process_time() - began
    values_of = {f"{s}.{n}": value for s, own in found.chosen.values.items() for n, value in own.items()}
    refined = [f"{name.partition('.')[2]} {values_of[name]:.3g}" for name in found.chosen.refined]
    said = ", ".join(refined) or "nothing"
    for text in (found.chosen.needed, str(found.needed) if found.needed else ""):
        said += f"; needs: {text}" if text else ""
    if not found.held and found.blame:
        cause, share = max(found.blame.items(), key=lambda one: one[1])
        said += f"; cause: {cause}: {share:.2g}"
    true = math.nan
    if found.held:
        exact = truth_of(plan, registry, plan.nodes[0].name)
        own, other = (Point(one, registry, {}, one.wanted) for one in (plan, exact))
        values, reference = own.values(own.base), other.values(other.base)
        declared = exact.node(stage).writes[variable]
        away = part_between(values[stage, variable], reference[stage, variable], declared, exact.of(stage)[0].stage)
        true = away.rms / limit if not isinstance(away, str) else math.nan
    asked_text = f"{what} {limit:.3g}"
    return Found(name, asked_text, found.held, stated.rms / limit, true, took, said)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME")
    parser.add_argument("--seconds", type=float, default=60.0, help="that --hold may take")
    given = parser.parse_args()
    registry = installed_stages()
    print(
        f"{'pipeline':16} {'held':22} {'held':4} {'stated':>8} {'true':>8} {'seconds':>7}  refined (errors over asked)"
    )
    wrong = 0
    for name, metric, picture, small in CASES:
        if given.only and name not in given.only:
            continue
        for what in filter(None, (metric, picture)):
            try:
                pipeline = opened(name, small, registry)
                found = measured(name, what, what == picture, pipeline, registry, given.seconds)
            except EtendueError as error:
                print(f"{name:16} {what:22} refused: {' '.join(str(error).split())[:160]}", flush=True)
                continue
            print(found, flush=True)
            wrong += found.held and not math.isnan(found.true) and found.true > 1
    sys.exit(int(wrong > 0))


if __name__ == "__main__":
    main()
