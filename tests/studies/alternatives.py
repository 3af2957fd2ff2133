"""Stages of a third party, good and bad, as entry points of a registry of their own."""

from dataclasses import dataclass
from importlib.metadata import EntryPoint

import numpy as np

from etendue.api import RGB, Labels, Stage, hookimpl, param, quantity
from etendue.contract.registry import Registry
from etendue.plugins.discovery import Discovery, installed
from etendue.plugins.hookspecs import GROUP
from etendue_camera.quality.stages.ideal import IdealMosaic


@dataclass(frozen=True, kw_only=True)
class Grey(Stage):
    """The same value in all channels."""

    reads = {"mosaic_linear": "y x [1]"}
    writes = {"rgb_camera": "channel y x [1]"}
    creates = {"channel": RGB}
    negative = "keep"

    offset: float = param(0.0)

    def run(self, mosaic_linear):
        return {"rgb_camera": np.stack([mosaic_linear + self.offset] * 3)}


@dataclass(frozen=True, kw_only=True)
class BreaksOff(Grey):
    """Breaks off."""

    def run(self, mosaic_linear):
        raise RuntimeError("this picture has too many pixels")


@dataclass(frozen=True, kw_only=True)
class WritesNaN(Grey):
    """Writes what is no number."""

    def run(self, mosaic_linear):
        return {"rgb_camera": np.full((3, *mosaic_linear.shape), np.nan)}


@dataclass(frozen=True, kw_only=True)
class ForXTrans(Grey):
    """Knows one pattern only."""

    pattern: str = quantity("pattern")

    def __post_init__(self):
        if self.pattern != "X-Trans":
            raise ValueError(f"knows X-Trans only, and the pattern is {self.pattern!r}")


@dataclass(frozen=True, kw_only=True)
class NeedsANumber(Grey):
    """Has a parameter without a default."""

    slope: float = param(doc="how steep")


@dataclass(frozen=True, kw_only=True)
class ReadsMore(Grey):
    """Reads what the other demosaicers do not."""

    reads = {"mosaic_linear": "y x [1]", "white": "channel [1]"}

    def run(self, mosaic_linear, white):
        return {"rgb_camera": mosaic_linear * np.ones_like(white)[:, None, None]}


@dataclass(frozen=True, kw_only=True)
class Softer(Stage):
    """Changes camera values, and says nothing about what for."""

    reads = {"rgb_camera": "channel y x [1]"}
    writes = {"rgb_camera": "channel y x [1]"}
    negative = "keep"

    def run(self, rgb_camera):
        return {"rgb_camera": 0.5 * (rgb_camera + np.roll(rgb_camera, 1, -1))}


@dataclass(frozen=True, kw_only=True)
class Perfect(IdealMosaic):
    """A demosaicer that knows the light: noise-free and unclipped."""

    role = "demosaicing"
    reads = {"photon_rate": "channel y x [electron/s]"}
    writes = {"rgb_camera": "channel y x [1]"}

    def run(self, photon_rate):
        return {
            "rgb_camera": photon_rate
            * photon_rate.dtype.type(self.integration_time * self.dn_per_electron() / self.white())
        }


@dataclass(frozen=True, kw_only=True)
class Polariser(Stage):
    """Four frames of one exposure, behind a polariser that turns."""

    reads = {"photocurrent": "y x [electron/s]"}
    writes = {"photocurrent": "angle y x [electron/s]"}
    creates = {"angle": Labels((0.0, 45.0, 90.0, 135.0), "deg")}

    def run(self, photocurrent):
        return {"photocurrent": np.stack([0.5 * photocurrent] * 4)}


STAGES = {
    "polariser": Polariser,
    "grey": Grey,
    "breaks_off": BreaksOff,
    "writes_nan": WritesNaN,
    "for_xtrans": ForXTrans,
    "needs_a_number": NeedsANumber,
    "reads_more": ReadsMore,
    "softer": Softer,
    "perfect": Perfect,
}


@hookimpl
def etendue_stages():
    return {**STAGES, "cannot_load": "tests.studies.no_such_module:Stage"}


def registry():
    """The installed stages, and these."""
    return Registry(Discovery([*installed().points, EntryPoint("own", __name__, GROUP)]))
