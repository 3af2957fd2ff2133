"""Textbook formulas, each with the fault that its form has in numbers of finite length."""

from dataclasses import dataclass

import numpy as np

from etendue.api import Noisy, Stage, Transfer, param
from etendue_camera.sensor import silicon

IRRADIANCE = {"irradiance": "wavelength y x [W m-2 nm-1]"}


@dataclass(frozen=True, kw_only=True)
class Diffusion(Transfer):
    """Charge that wanders: sinh and cosh overflow, and where absorption meets diffusion a nought stands over a
    nought.
    """

    reads = writes = IRRADIANCE
    negative = "keep"

    layer: float = param(1.8, units="um", above=0, at_most=100)
    depth: float = param(10.0, units="um", above=0, at_most=1000)
    length: float = param(50.0, units="um", at_least=0.1, at_most=1e5)

    def collected(self, frequency, absorption):
        k = np.sqrt(1 / self.length**2 + (2 * np.pi * frequency) ** 2)
        a, depth = absorption, self.depth
        wanders = (a * np.sinh(k * depth) - k * np.cosh(k * depth) + k * np.exp(-a * depth)) / (
            (a**2 - k**2) * np.sinh(k * depth)
        )
        return 1 - np.exp(-a * self.layer) + np.exp(-a * self.layer) * a * wanders

    def transfer(self, fy, fx, wavelength):
        absorption = silicon.absorption(np.asarray(wavelength, dtype=float)).astype(np.asarray(wavelength).dtype)
        return self.collected(np.hypot(fy, fx), absorption) / self.collected(0 * fx[:1, :1], absorption)


@dataclass(frozen=True, kw_only=True)
class SoftWell(Stage):
    """A well that fills softly: 1 - exp loses its digits where it fills little."""

    reads = writes = {"charge": "y x [electron]"}

    well: float = param(1e5, units="electron", at_least=1e3, at_most=1e9)

    def run(self, charge):
        return {"charge": charge.dtype.type(self.well) * (1 - np.exp(-charge / charge.dtype.type(self.well)))}


@dataclass(frozen=True, kw_only=True)
class Gamma(Stage):
    """A power of whatever comes: of a negative value it is none."""

    reads = {"rgb_linear": "channel y x [1]"}
    writes = {"rgb_display": "channel y x [1]"}
    negative = "keep"

    exponent: float = param(0.45, at_least=0.1, at_most=5)

    def run(self, rgb_linear):
        return {"rgb_display": rgb_linear ** rgb_linear.dtype.type(self.exponent)}


@dataclass(frozen=True, kw_only=True)
class Variance(Stage):
    """The mean of squares less the square of the mean: two large numbers that cancel."""

    reads = {"mosaic_linear": "y x [1]"}
    writes = {"unevenness": "[1]"}
    negative = "keep"

    def run(self, mosaic_linear):
        return {"unevenness": np.asarray((mosaic_linear**2).mean() - mosaic_linear.mean() ** 2)}


@dataclass(frozen=True, kw_only=True)
class Shade(Stage):
    """Light as a share of its mean, with a small number so that nothing is divided by nought: light has no natural
    unit.
    """

    reads = writes = IRRADIANCE

    strength: float = param(0.5, at_least=0, at_most=1)

    def run(self, irradiance):
        mean = irradiance.mean(axis=(1, 2), keepdims=True)
        return {
            "irradiance": irradiance
            * (1 - irradiance.dtype.type(self.strength) * mean / (mean + irradiance.dtype.type(1e-6)))
        }


@dataclass(frozen=True, kw_only=True)
class Veil(Stage):
    """A share of the mean on top, summed one by one in 32 bits, whatever the light comes in."""

    reads = writes = IRRADIANCE

    share: float = param(0.1, at_least=0, at_most=1)

    def run(self, irradiance):
        summed = np.add.accumulate(irradiance.reshape(len(irradiance), -1), axis=1, dtype=np.float32)[:, -1]
        mean = (summed / irradiance[0].size).astype(irradiance.dtype)
        return {"irradiance": irradiance + irradiance.dtype.type(self.share) * mean[:, None, None]}


@dataclass(frozen=True, kw_only=True)
class Scatter(Noisy):
    """Noise of a stated deviation, which says that its variance is that deviation."""

    reads = writes = {"charge": "y x [electron]"}
    negative = "keep"

    deviation: float = param(5.0, units="electron", at_least=0.1, at_most=1e3)

    def variance(self, charge):
        return self.deviation

    def run(self, charge, rng):
        return {
            "charge": charge
            + charge.dtype.type(self.deviation) * rng.standard_normal(charge.shape).astype(charge.dtype)
        }
