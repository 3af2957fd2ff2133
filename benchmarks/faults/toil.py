"""A plugin with slow cells that misbehave as told; `cluster.py` runs it on a cluster."""

import os
import signal
import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Bands, Facts, Grid, Line, Source, Stage, hookimpl, param

LIGHT = "wavelength y x [W m-2 nm-1]"
SIZE = 32


@dataclass(frozen=True, kw_only=True)
class Lamp(Source):
    """A ramp of light that needs no tables."""

    writes: ClassVar = {"irradiance": LIGHT}

    def describe(self):
        return Facts(), {"irradiance": Grid.of({"wavelength": Bands((400.0, 700.0)), "y": Line(SIZE), "x": Line(SIZE)})}

    def run(self, out_x):
        return {"irradiance": np.broadcast_to(1.0 + out_x, (1, SIZE, SIZE))}


@dataclass(frozen=True, kw_only=True)
class Toil(Stage):
    """Light times a number, after a while; or misbehaviour."""

    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"irradiance": LIGHT}
    nanoseconds: ClassVar = 4e4  # 0.04 s per cell: about two per batch
    how: str = param("1", doc="a number, or in which way it misbehaves")
    pause: float = param(0.05, at_least=0, doc="seconds")

    def run(self, irradiance):
        if self.how == "leaves":
            os._exit(7)
        if self.how == "is killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.how == "hangs":
            time.sleep(600)
        if self.how == "grows":
            kept = []
            while True:
                kept.append(np.ones(1 << 21))
                time.sleep(0.02)
        time.sleep(self.pause)
        return {"irradiance": irradiance * int(self.how)}


@dataclass(frozen=True, kw_only=True)
class Witness(Stage):
    """Twice the light."""

    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"seen_light": LIGHT}
    nanoseconds: ClassVar = 4e4
    pause: float = param(0.02, at_least=0, doc="seconds")

    def run(self, irradiance):
        time.sleep(self.pause)
        return {"seen_light": irradiance * 2}


@hookimpl
def etendue_stages():
    return {"lamp": Lamp, "toil": Toil, "witness": Witness}
