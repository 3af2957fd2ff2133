"""The same in the form that survives."""

from dataclasses import dataclass

import numpy as np

from etendue_camera.sensor import photodiode, silicon
from naive import stages


@dataclass(frozen=True, kw_only=True)
class Diffusion(stages.Diffusion):
    """By a form without sinh or cosh."""

    def transfer(self, fy, fx, wavelength):
        radius = np.asarray(np.hypot(fy, fx), dtype=float)
        planes = [
            photodiode.collection_mtf(
                radius, float(silicon.absorption(float(one))), self.layer, self.depth, self.length
            )
            for one in np.ravel(wavelength)
        ]
        return np.stack(planes)


@dataclass(frozen=True, kw_only=True)
class SoftWell(stages.SoftWell):
    """By expm1."""

    def run(self, charge):
        return {"charge": -charge.dtype.type(self.well) * np.expm1(-charge / charge.dtype.type(self.well))}


@dataclass(frozen=True, kw_only=True)
class Gamma(stages.Gamma):
    """The power of the size, with the sign of the value."""

    def run(self, rgb_linear):
        return {"rgb_display": np.sign(rgb_linear) * np.abs(rgb_linear) ** rgb_linear.dtype.type(self.exponent)}


@dataclass(frozen=True, kw_only=True)
class Variance(stages.Variance):
    """The mean of squared distances from the mean, summed in double precision at least."""

    def run(self, mosaic_linear):
        wide = mosaic_linear.astype(np.result_type(mosaic_linear, np.float64))
        return {"unevenness": np.asarray(((wide - wide.mean()) ** 2).mean())}


@dataclass(frozen=True, kw_only=True)
class Shade(stages.Shade):
    """Where there is no light there is nothing to divide."""

    def run(self, irradiance):
        return {"irradiance": irradiance * (1 - irradiance.dtype.type(self.strength))}


@dataclass(frozen=True, kw_only=True)
class Veil(stages.Veil):
    """Summed in pairs, in double precision at least."""

    def run(self, irradiance):
        mean = irradiance.mean(axis=(1, 2), keepdims=True, dtype=np.result_type(irradiance, np.float64))
        return {"irradiance": (irradiance + self.share * mean).astype(irradiance.dtype)}


@dataclass(frozen=True, kw_only=True)
class Scatter(stages.Scatter):
    """The variance is the square of the deviation."""

    def variance(self, charge):
        return self.deviation**2
