"""What labels cost: one stage written on arrays and on xarray Datasets, by size of picture.

python benchmarks/labelled.py
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import xarray as xr

from etendue.api import Stage, labelled
from etendue.contract.stage import arguments_of

PLANES = "channel y x [1]"


@dataclass(frozen=True, kw_only=True)
class OnArrays(Stage):
    """Red is lifted."""

    reads: ClassVar = {"rgb_camera": PLANES}
    writes: ClassVar = {"rgb_camera": PLANES}

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        return {"rgb_camera": rgb_camera * np.array([1.5, 1, 1], rgb_camera.dtype)[:, None, None]}


@labelled
@dataclass(frozen=True, kw_only=True)
class OnLabels(OnArrays):
    """The same on labels."""

    def run(self, data: Any) -> Any:
        rgb = data["rgb_camera"]
        return data.assign(rgb_camera=rgb * xr.where(rgb.channel == "R", 1.5, 1.0).astype(rgb.dtype))


def shortest(stage: Any, given: dict[str, Any]) -> float:
    asked = {name: given[name] for name in arguments_of(type(stage))}
    taken = []
    for _ in range(40):
        began = time.perf_counter()
        stage.run(**asked)
        taken.append(time.perf_counter() - began)
    return 1e3 * min(taken)


def main() -> None:
    print("pixels      arrays ms  labels ms  difference ms")
    for side in (16, 64, 256, 1024):
        line = np.arange(float(side))
        given = {"rgb_camera": np.ones((3, side, side), np.float32), "y": line, "x": line, "y_um": line, "x_um": line}
        given["channel"] = np.array(["R", "G", "B"])
        plain, own = shortest(OnArrays(), given), shortest(OnLabels(), given)
        print(f"{side:4} x {side:<4} {plain:10.3f} {own:10.3f} {own - plain:12.3f}")


if __name__ == "__main__":
    main()
