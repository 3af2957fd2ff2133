"""What a setting of a knob of the ray-traced stages adds, rms over the picture, is no more than the stage states.

Against a setting far beyond it, over soft scenes, frames of different size and wavelengths drawn at random.
"""

import dataclasses
import inspect

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

pytest.importorskip("optiland")

from etendue_lens_optiland.stages import Blur, Distortion, Illumination

from etendue.api import Bands, Facts, Grid, Line
from etendue.testing import coordinates_of

FINE = {
    "illumination": {"nodes": 33, "pupil_samples": 128},
    "distortion": {"nodes": 65, "order": 5, "oversampling": 4},
    "blur": {"pupil_samples": 128, "lost": 0.01, "tolerance": 0.03},
}
COARSE = {
    "illumination": [{"nodes": 5}, {"pupil_samples": 16}, {"pupil_samples": 32}],
    "distortion": [{"nodes": 5}, {"nodes": 9}, {"order": 1}, {"order": 3, "oversampling": 1}],
    "blur": [{"pupil_samples": 32}, {"lost": 0.2}, {"tolerance": 0.3}],
}


def frame(random, size):
    step, first = float(random.uniform(0.5, 2)) if size == 0 else size / 20, float(random.uniform(420, 560))
    lines = [Line(n, -0.5 * (n - 1) * step, step) for n in (24, 20)]
    return Grid.of({"wavelength": Bands((first, first + 40, first + 80)), "y": lines[0], "x": lines[1]})


def stage_of(name, random):
    if name == "blur":
        return Blur(f_number=8.0, fields=(0.0, 22.0), wavelengths=(500.0, 600.0), **FINE[name]), frame(random, 0)
    if name == "distortion":
        return Distortion(f_number=8.0, **FINE[name]), frame(random, 4000)
    return Illumination(f_number=8.0, wavelengths=(450.0, 650.0), **FINE[name]), frame(
        random, float(random.uniform(500, 4000))
    )


def done(stage, light, grid):
    known = coordinates_of({"irradiance": grid})
    given = {"irradiance": light, "prepared": stage.prepare(known), **known}
    return stage.run(**{name: given[name] for name in inspect.signature(type(stage).run).parameters if name != "self"})[
        "irradiance"
    ]


@pytest.mark.parametrize(
    "name", ["distortion", *(pytest.param(name, marks=pytest.mark.long) for name in ("illumination", "blur"))]
)
def test_no_setting_adds_more_than_its_stage_states(name):
    random = np.random.default_rng(4)
    stage, grid = stage_of(name, random)
    light = gaussian_filter(random.uniform(size=grid.shape(("wavelength", "y", "x"))), (0, 2, 2), mode="mirror")
    exact = done(stage, light, grid)
    facts = {"irradiance": Facts(band_limit=0.483 / (2 * grid.line("x").step))}  # of edges 2 samples wide, rms
    for setting in COARSE[name]:
        coarse = dataclasses.replace(stage, **setting)
        true = np.sqrt(np.mean((done(coarse, light, grid) - exact) ** 2)) / np.abs(exact).max()
        assert true <= coarse.error(facts, {"irradiance": grid}, "float64")[0], setting
