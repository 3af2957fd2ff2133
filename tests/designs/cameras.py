"""Metrics of a camera whose Sobol' indices are known in closed form, over one design: the Airy disc and the cut-off of
a lens, the dynamic range, the signal-to-noise ratio of shot noise.

With independent factors, uniform in the logarithm: a product of powers x^p has the indices that the ratios of the
variance of each power to its squared mean give, and a sum of logarithms has their variances.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tests.designs.known import Known

ENDS = {
    "f_number": (2.8, 5.6),
    "lens_numbers.wavelength": (450.0, 650.0),
    "integration_time": (0.002, 0.008),
    "read_noise": (0.01, 0.04),  # so small that beside shot noise it adds less than 1e-5 of the ratio
    "full_well_density": (1000.0, 3000.0),
}


def factor_values(x: Any) -> dict[str, Any]:
    """Return the factors at numbers between 0 and 1."""
    return {name: low * (high / low) ** own for (name, (low, high)), own in zip(ENDS.items(), x, strict=True)}


def of_powers(name: str, powers: dict[str, float]) -> Known:
    """Return a product of powers of factors with its indices."""

    def function(x: Any) -> Any:
        own = factor_values(x)
        return np.prod([own[key] ** power for key, power in powers.items()], axis=0)

    squares = np.array([_relative_variance(*ENDS[key], powers.get(key, 0)) for key in ENDS])
    whole = np.prod(1 + squares) - 1
    return Known(name, function, squares / whole, squares * np.prod(1 + squares) / (1 + squares) / whole)


def _relative_variance(low: float, high: float, power: float) -> float:
    """Return the variance of x^p over its squared mean, for x uniform in the logarithm."""
    mean, square = (_mean(low, high, power * n) for n in (1, 2))
    return square / mean**2 - 1


def _mean(low: float, high: float, power: float) -> float:
    return (high**power - low**power) / (power * math.log(high / low)) if power else 1.0


def of_logarithms(name: str, weights: dict[str, float]) -> Known:
    """Return a sum of logarithms of factors with its indices: of each its share of the variance, alone."""

    def function(x: Any) -> Any:
        own = factor_values(x)
        return np.sum([weight * np.log(own[key]) for key, weight in weights.items()], axis=0)

    variances = np.array([(weights.get(key, 0) * math.log(high / low)) ** 2 / 12 for key, (low, high) in ENDS.items()])
    return Known(name, function, variances / variances.sum(), variances / variances.sum())


CAMERAS = (
    of_powers("airy_diameter", {"f_number": 1, "lens_numbers.wavelength": 1}),
    of_powers("cutoff_frequency", {"f_number": -1, "lens_numbers.wavelength": -1}),
    of_logarithms("dr_elgamal", {"full_well_density": 1, "read_noise": -1}),
    of_powers("mean_snr", {"f_number": -1, "integration_time": 0.5}),
)

PIPELINE = """
name = "closed"
precision = "float64"

[camera]
pixel_pitch = "3 um"
aperture_fraction = 1
peak_qe = [0.5, 0.5, 0.5]
dark_current_density = 0
dsnu = 0
black_level = 0
bits = 16

[[stages]]
use = "uniform"
name = "scene"
white_luminance = "400 cd m-2"
width = "20 um"
height = "20 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 4
columns = 4
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "full_well"
[[stages]]
use = "read_noise"
[[stages]]
use = "adc"
[[stages]]
use = "lens_numbers"
[[stages]]
use = "dynamic_range"
[[stages]]
use = "exposure_report"

[design]
method = "saltelli"
points = 8
seed = 2
[design.factors]
""" + "\n".join(f'"{name}" = {{ from = {low}, to = {high}, spacing = "log" }}' for name, (low, high) in ENDS.items())
