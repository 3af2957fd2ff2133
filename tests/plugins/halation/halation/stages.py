"""Light that comes back from behind the layer, spread evenly: in front of the pixels.

In:  ``irradiance`` (wavelength, y, x).
Out: the same with some of its mean added; ``halo`` (y, x), percent.
"""

from dataclasses import dataclass

import numpy as np

from etendue.api import Stage, quantity


@dataclass(frozen=True, kw_only=True)
class Halation(Stage):
    """A tenth comes back from a base of 1 mm, less from a thinner one."""

    role = "halation"
    reads = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes = {"irradiance": "wavelength y x [W m-2 nm-1]", "halo": "y x [percent]"}

    film_base: float = quantity("film_base")

    def run(self, irradiance):
        share = self.back * self.film_base / 1000
        mean = irradiance.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
        more = (irradiance + share * mean).astype(irradiance.dtype)
        return {
            "irradiance": more,
            "halo": (100 * (more - irradiance).sum(axis=0) / more.sum(axis=0)).astype(irradiance.dtype),
        }

    @property
    def back(self):
        return 0.1


@dataclass(frozen=True, kw_only=True)
class Backed(Halation):
    """The same with a backing that takes most of it."""

    @property
    def back(self):
        return 0.01
