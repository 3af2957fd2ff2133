"""Bytes and errors of archives whose digits follow the tolerance, beside all digits: ``sweep.toml``, and a camera at
three f-numbers with everything kept.

    python benchmarks/digits.py            # both, some minutes
    python benchmarks/digits.py camera     # the camera alone

Bytes are those of data.zarr, and with the journal those of the whole archive. ``light`` and ``picture`` are measured
global errors of the light at the pixels and of the display picture before its encoding: rms and at the largest pixel,
relative to full scale, noise-free, at the worst of four places of the sweep.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from etendue.accuracy.measuring import Measurement
from etendue.contract.registry import installed_stages
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan, summary
from etendue.session import Options, execute

PIPELINES = Path(__file__).parents[1] / "pipelines"
CASES = {
    "sweep": ("sweep.toml", {}),
    "camera": ("smallest.toml", {"sweep.pixel_pitch": ["2.8 um"], "sweep.integration_time": ["10 ms"]}),
}
ERRORS = {"photon_rate": "light", "rgb_linear": "picture"}
SETTINGS = ((1e-3, "exact"), (1e-3, "stated"), (1e-4, "exact"), (1e-4, "stated"))


def size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def main(names: list[str]) -> None:
    print(f"numpy {np.__version__}; other programs may be running: seconds are those of this process")
    for name in names:
        file, over = CASES[name]
        whole: dict[float, tuple[int, int]] = {}
        for tolerance, digits in SETTINGS:
            given = {**over, "tolerance": tolerance, "archive.digits": digits}
            pipeline = read_pipeline(PIPELINES / file, given)
            plan = make_plan(pipeline, installed_stages())
            with tempfile.TemporaryDirectory() as room:
                began = time.process_time()
                execute(plan, Path(room) / "made", Options("threads"))
                seconds = time.process_time() - began
                data, every = size(Path(room) / "made" / "data.zarr"), size(Path(room) / "made")
            exact = whole.setdefault(tolerance, (data, every))
            told = summary(plan)["digits"]
            stated = f", the plan says {told['bytes'] / 1e6:.0f} MB" if told else ""
            print(
                f"{name} {tolerance:g} {digits}: {data / 1e6:.1f} MB ({data / exact[0]:.3f}), with journal "
                f"{every / 1e6:.1f} MB ({every / exact[1]:.3f}), {seconds:.1f} s of CPU{stated}"
            )
            wanted = read_pipeline(PIPELINES / file, {**given, "wanted": list(ERRORS)})
            for variable, error in Measurement(wanted, installed_stages(), 4).errors().errors.items():
                print(f"    {ERRORS[variable]}: rms {error.rms:.2g}, largest {error.max:.2g}")


if __name__ == "__main__":
    main(sys.argv[1:] or list(CASES))
