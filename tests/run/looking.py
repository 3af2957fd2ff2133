"""Stages of no use but to look at others: a small plugin for the tests beside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Labels, Probe, Stage, hookimpl, param


@dataclass(frozen=True, kw_only=True)
class Restore(Stage):
    """A picture times the transfer function of the camera in front of it, at one frequency."""

    reads: ClassVar = {"rgb_camera": "channel y x [1]", "transfers": "*.transfer [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    negative: ClassVar = "keep"

    at: float = param(0.05, units="cycles/um", at_least=0)

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        _, otf = transfers[-1]
        weighted = otf.weights @ np.abs(otf(np.array([self.at])))[:, 0] / otf.weights.sum(axis=1)
        return {"rgb_camera": rgb_camera * weighted[:, None, None].astype(rgb_camera.dtype)}


@dataclass(frozen=True, kw_only=True)
class Nosy(Restore):
    """Looks at a variable of all stages, which only probes may."""

    reads: ClassVar = {"rgb_camera": "channel y x [1]", "transfers": "*.photon_rate [electron/s]"}


@dataclass(frozen=True, kw_only=True)
class Sizes(Probe):
    """Number of rows and step of every picture, by variable."""

    with_grids: ClassVar = True
    reads: ClassVar = {"pictures": "*.rgb_camera channel y x [1]", "planes": "*.photon_rate channel y x [electron/s]"}
    writes: ClassVar = {"rows": "stage [1] nan", "step": "stage [um] nan"}

    def run(self, pictures: Any, planes: Any, stage: Any) -> dict[str, Any]:
        own = {name: (array.shape[-2], grid.line("y").um()[1]) for name, array, grid in [*pictures, *planes]}
        return {"rows": np.array([own[name][0] for name in stage]), "step": np.array([own[name][1] for name in stage])}


@dataclass(frozen=True, kw_only=True)
class Parts(Probe):
    """How many stages each transfer function is the product of, and what the scene's rendering leaves at 0.1
    cycles/um.
    """

    creates: ClassVar = {"side": Labels(("parts", "rendered"))}
    reads: ClassVar = {"transfers": "*.transfer [1]"}
    writes: ClassVar = {"parts": "stage side [1]"}

    def run(self, transfers: Any) -> dict[str, Any]:
        return {
            "parts": np.array([[len(o.parts), o.scene_along(np.zeros(1), np.full(1, 0.1))[0]] for _, o in transfers])
        }


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"restore": Restore, "nosy": Nosy, "sizes": Sizes, "parts": Parts}
