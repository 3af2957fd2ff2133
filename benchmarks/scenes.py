"""Twelve small scenes: what each does not need at tolerance 1e-3, with bound, true error and time saved.

    python benchmarks/scenes.py [--json]

The true error is that of expected values (noise-free) against the reference, measured with everything the plan left out
or made coarser, in the light and pixels (rms of full scale) and in the wanted picture. Time is thread time of the
stages, the least of three runs, against the same pipeline with nothing left out at default settings. Exit code 1 where
a true error is beyond its bound.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan, summary
from etendue.session import Options, collect, execute, load

FOLDER = Path(__file__).parent.parent / "pipelines" / "scenes"
REPEATS = 3


def seconds(plan: Any) -> float:
    """Thread time of all stages, without pictures and archive."""
    runs = [execute(plan, None, Options("serial", pictures=False)) for _ in range(REPEATS)]
    return min(sum(report.seconds for report in run.reports.values()) for run in runs)


def row(path: Path) -> dict[str, Any]:
    """One scene."""
    registry, pipeline = installed_stages(), load(path)
    stages = summary(make_plan(pipeline, registry))["stages"]
    decided = [(s["name"], "left out", s["left_out"]["bound"]) for s in stages if s["left_out"]]
    decided += [(s["name"], f"{a['knob']} {a['value']}", a["bound"]) for s in stages for a in s["approximated"] or []]
    plan = make_plan(pipeline, registry, expected=True)
    exact = make_plan(replace(pipeline, precision="float64"), registry, False, expected=True)
    picture = plan.wanted[-1]
    asked = {(picture[0], ()): {picture[1]}, ("pixel", ()): {"photon_rate"}}
    found, truth = (
        collect(one, {ref: list(names) for ref, names in asked.items()}, Options("serial")).arrays
        for one in (plan, exact)
    )

    def error(stage: str, variable: str, axes: tuple[int, ...]) -> float:
        own, reference = (np.asarray(arrays[stage, ()][variable], float) for arrays in (found, truth))
        scale = np.abs(reference).max() or 1.0
        return float((np.sqrt(((own - reference) ** 2).mean(axis=axes)) / scale).max())

    front = [cell.bound for node in plan.nodes for cell in plan.of(node.name) if node.name in light(plan)]
    return {
        "scene": path.stem,
        "decided": decided,
        "bound": sum(front),
        "pixels": error("pixel", "photon_rate", (1, 2)),
        "picture": error(*picture, (-2, -1)),
        "seconds": seconds(make_plan(pipeline, registry)),
        "seconds_whole": seconds(make_plan(pipeline, registry, False)),
    }


def light(plan: Any) -> list[str]:
    """The stages up to the pixels."""
    names = [node.name for node in plan.nodes]
    return names[: names.index("pixel") + 1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true")
    rows = [row(path) for path in sorted(FOLDER.glob("*.toml"))]
    if parser.parse_args().json:
        print(json.dumps(rows))
    else:
        for one in rows:
            saved = 1 - one["seconds"] / one["seconds_whole"]
            print(
                f"{one['scene']:20s} pixels: true {one['pixels']:.1e}, bound {one['bound']:.1e}; picture "
                f"{one['picture']:.1e}; "
                f"{1e3 * one['seconds']:.0f} of {1e3 * one['seconds_whole']:.0f} ms, {100 * saved:.0f} % saved"
            )
            for stage, what, bound in one["decided"]:
                print(f"    {stage} {what}: at most {bound:.1e}")
    # float32 rounding stands beside every bound
    sys.exit(any(one["pixels"] > 1.2 * one["bound"] + 5e-6 for one in rows))


if __name__ == "__main__":
    main()
