"""A third party's lens, noise, correction and demosaicer; and a registry under which every stage has another name."""

from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint

import numpy as np

from etendue.api import RGB, Noisy, Stage, hookimpl, param, quantity
from etendue.contract.registry import Registry, installed_stages
from etendue.plugins.discovery import Discovery, installed
from etendue.plugins.hookspecs import GROUP


@dataclass(frozen=True, kw_only=True)
class SoftLens(Stage):
    """A lens that is no transfer function."""

    role = "lens"
    reads = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    negative = "keep"

    reach: int = param(6, at_least=0)

    def run(self, irradiance):
        return {
            "irradiance": np.mean(
                [np.roll(irradiance, step, -1) for step in range(-self.reach, self.reach + 1)], axis=0
            )
        }


@dataclass(frozen=True, kw_only=True)
class Window(Stage):
    """A window in front of the sensor that takes a tenth of the light."""

    reads = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    pointwise = True
    negative = "keep"

    def run(self, irradiance):
        return {"irradiance": irradiance * irradiance.dtype.type(0.9)}


@dataclass(frozen=True, kw_only=True)
class Reset(Noisy):
    """Noise of the reset, a share of the charge on top."""

    reads = {"charge": "y x [electron]"}
    writes = {"charge": "y x [electron]"}
    negative = "keep"

    sigma: float = param(40.0, units="electron")

    def variance(self, charge):
        return self.sigma**2 + 0.5 * charge

    def run(self, charge, rng):
        spread = np.sqrt(self.sigma**2 + 0.5 * np.maximum(charge, 0))
        return {"charge": charge + spread * rng.standard_normal(charge.shape)}


@dataclass(frozen=True, kw_only=True)
class Secretive(Stage):
    """Noise that nobody is told of."""

    reads = {"charge": "y x [electron]"}
    writes = {"charge": "y x [electron]"}
    negative = "keep"

    def run(self, charge, rng):
        return {"charge": charge + 40.0 * rng.standard_normal(charge.shape)}


@dataclass(frozen=True, kw_only=True)
class Flatten(Stage):
    """A correction of the mosaic: a gain for each colour."""

    role = "flattening"
    reads = {"mosaic_linear": "y x [1]"}
    writes = {"mosaic_linear": "y x [1]"}
    negative = "keep"

    pattern: str = quantity("pattern")
    gain_of_green: float = param(1.25)

    def run(self, mosaic_linear, y, x):
        if self.pattern == "RGGB":
            green = (y[:, None] + x[None, :]) % 2 == 1
        else:
            green = np.full(mosaic_linear.shape, self.pattern == "G")
        return {
            "mosaic_linear": np.where(
                green, mosaic_linear * mosaic_linear.dtype.type(self.gain_of_green), mosaic_linear
            )
        }


@dataclass(frozen=True, kw_only=True)
class BayerOnly(Flatten):
    """The same of one array, and of no other."""

    def __post_init__(self):
        if self.pattern != "RGGB":
            raise ValueError(f"knows RGGB only, and the pattern is {self.pattern!r}")


@dataclass(frozen=True, kw_only=True)
class Quads(Stage):
    """A demosaicer: every quad of a Bayer array has one colour."""

    role = "demosaicing"
    reads = {"mosaic_linear": "y x [1]"}
    writes = {"rgb_camera": "channel y x [1]"}
    creates = {"channel": RGB}
    negative = "keep"

    def run(self, mosaic_linear):
        m = mosaic_linear
        planes = [m[::2, ::2], (m[::2, 1::2] + m[1::2, ::2]) * m.dtype.type(0.5), m[1::2, 1::2]]
        return {"rgb_camera": np.stack([plane.repeat(2, 0).repeat(2, 1) for plane in planes])}


STAGES = {
    "soft_lens": SoftLens,
    "window": Window,
    "reset": Reset,
    "secretive": Secretive,
    "flatten": Flatten,
    "bayer_only": BayerOnly,
    "quads": Quads,
}


@hookimpl
def etendue_stages():
    return STAGES


def registry():
    """The installed stages, and these."""
    return Registry(Discovery([*installed().points, EntryPoint("own", __name__, GROUP)]))


PREFIX = "zz_"


class Renamed(Registry):
    """The installed stages, none under its own name."""

    def __init__(self):
        super().__init__(installed())
        self.known = installed_stages()

    def names(self):
        return [f"{PREFIX}{name}" for name in self.known.names()]

    def __contains__(self, name):
        return name in self.names()

    def installed(self, name):
        return self.known.installed(name.removeprefix(PREFIX))

    def load(self, name):
        return self.known.load(name.removeprefix(PREFIX))


def renamed(pipeline):
    """The same pipeline for that registry: the names of its stages stay, as random numbers hang on them."""
    return replace(pipeline, stages=tuple(replace(entry, use=f"{PREFIX}{entry.use}") for entry in pipeline.stages))
