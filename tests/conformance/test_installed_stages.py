"""Every installed stage, from whichever distribution, keeps what it declares; each where it is ordinary and where it is not."""

import numpy as np
import pytest

from etendue.registry import installed_stages
from etendue.spec.stage import MISSING, is_source, parameters_of
from etendue.testing import StageConformance

LIGHT = {"white_luminance": 1000.0, "width": 21.0, "height": 17.0, "bin_width": 20.0}
NEEDED = {"white_luminance": 1000.0, "peak_qe": (0.36, 0.44, 0.40)}
WHOLE = {"wavelength_from": 380.0, "wavelength_to": 780.0, "width": 120.0, "height": 80.0}

VARIANTS = {
    "uniform": [{"reflectance": 0.0}, {"illuminant": "A"}],
    "slanted_edge": [{"low": 0.0}, {"softness": 0.0, "angle": 0.0}],
    "siemens_star": [{"low": 0.0, "radius": 8.0}],
    "zone_plate": [{"low": 0.0, "radius": 8.0}],
    "step_wedge": [{"low": 0.9, "high": 0.01}, WHOLE],
    "points": [{"background": 0.0}, {"pitch": 9.0, "spot_sigma": 0.5}],
    "colorchecker": [WHOLE, {"background": 1.0, **WHOLE}, {"background": 0.026, **WHOLE}],
    "composite": [WHOLE, {"low": 0.026, "high": 1.0, **WHOLE}],
    "irradiance": [{"aperture_model": "flat_disc"}, {"f_number": 0.5}, {"f_number": 128.0, "magnification": -1.0}],
    "falloff": [{"model": "disc"}, {"geometry": "paper"}, {"focal_length": 0.01}, {"focal_length": 1e4}],
    "diffraction": [{"f_number": 0.5}, {"f_number": 1.4}, {"f_number": 128.0}],
    "lens_gaussian": [{"sigma": 0.0}, {"sigma": 30.0}],
    "lens_psf": [{"nodes": 256}],
    "optical_filter": [{"cut_off": float("inf")}, {"cut_off": 550.0, "edge": 0.5}],
    "diffusion": [{"back": "reflecting"}, {"diffusion_length": float("inf")}, {"depletion_depth": 0.1, "diffusion_depth": 1000.0}],
    "pixel": [{"pixel_pitch": 1.1}, {"pixel_pitch": 2.0, "sampling": "paper"}, {"pixel_pitch": 2.0, "aperture_fraction": 0.01}],
    "mosaic": [{"pattern": "GBRG"}],
    "exposure": [{"prnu": 0.0, "dark_nonuniformity": 0.0}, {"dark_current_density": 0.0}, {"integration_time": 1e-6}],
    "shot_noise": [{"exact_below": float("inf")}, {"noise": "common"}],
    "full_well": [{"full_well_density": 1e7}, {"full_well_density": 1.0}],
    "read_noise": [{"read_noise": 0.0, "dsnu": 0.0}, {"noise": "common"}],
    "adc": [{"bits": 1, "black_level": 0}, {"bits": 16, "conversion_gain": 3.0}],
    "linearise": [{"black_level": 0}, {"bits": 8, "black_level": 254}],
    "charge_fraction": [{"reference_time": 100.0}],
    "paper_exposure": [{"integration_time": 1.0}, {"read_noise": 0.0, "dsnu": 0.0, "dark_current_density": 0.0}],
    "demosaic_nearest": [{"pattern": "BGGR"}],
    "demosaic_bilinear": [{"pattern": "GRBG"}],
    "demosaic_colour_difference": [{"pattern": "GBRG"}],
    "sharpen": [{"strength": 0.0}, {"strength": 4.0}],
    "white": [{"conversion_gain": 1.0}, {"sensitivity_kind": "filter_transmittance"}, {"sensitivity_per": "energy"}],
    "colour_fit": [{"sensitivity_kind": "filter_transmittance"}],
    "balance": [{"gains": "as_printed"}, {"space": "Bradford", "target": "A"}, {"space": "CAT16"}],
    "display": [{"display": "Apple Studio Display"}, {"display": "Typical CRT Brainard 1997", "render_exposure": 100.0}],
    "to_xyz": [{"matrix": "eq16_as_printed"}, {"matrix": "sRGB"}],
    "encode": [{"encoding": "BT.709"}, {"encoding": "power"}, {"encoding": "power", "exponent": 5.0}],
    "dynamic_range": [{"read_noise": 0.0, "dsnu": 0.0, "dark_current_density": 0.0}, {"integration_time": 1e6}],
    "lens_numbers": [{"f_number": 0.5}, {"magnification": -1.0}],
    "resolution": [{"highest": 0.01}, {"nodes": 16}],
}
CASES = [
    pytest.param(name, variant, id=name if not variant else f"{name}-{'-'.join(f'{k}={v}' for k, v in variant.items())}")
    for name in installed_stages().names()
    for variant in ({}, *VARIANTS.get(name, []))
]


def files(folder):
    """The smallest files that stages with a required file can read."""
    from PIL import Image

    picture, table = folder / "picture.png", folder / "psf.csv"
    noise = np.random.default_rng(0).integers(1, 256, (13, 20, 3), dtype=np.uint8)
    Image.fromarray(noise).save(picture)
    radius = np.linspace(0.0, 6.0, 61)
    table.write_text("radius_um,psf\n" + "\n".join(f"{r},{v}" for r, v in zip(radius, np.exp(-(radius**2)), strict=True)))
    return {"photograph": str(picture), "lens_psf": str(table)}


@pytest.fixture(scope="module")
def examples(tmp_path_factory):
    return files(tmp_path_factory.mktemp("examples"))


@pytest.mark.parametrize(("name", "variant"), CASES)
class TestInstalled(StageConformance):
    @pytest.fixture(autouse=True)
    def _instance(self, name, variant, examples):
        kind = installed_stages().load(name)
        values = {n: v for n, v in NEEDED.items() if n in parameters_of(kind)}
        if is_source(kind):
            values |= {n: v for n, v in LIGHT.items() if n in parameters_of(kind)}
        if name in examples:
            values["file"] = examples[name]
        self.stage = kind(**{**values, **variant})


@pytest.mark.parametrize("name", [n for n in installed_stages().names() if installed_stages().installed(n).distribution == "etendue"])
def test_every_built_in_stage_says_how_wrong_it_is_and_what_its_parameters_mean(name):
    kind = installed_stages().load(name)
    assert hasattr(kind, "error")
    assert kind.__doc__
    required = [n for n, (_, _, default) in parameters_of(kind).items() if default is MISSING]
    assert set(required) <= {*NEEDED, "file"}


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("slanted_edge", {"low": 0.9, "high": 0.1}),
        ("siemens_star", {"low": 0.9, "high": 0.1}),
        ("zone_plate", {"low": 0.9, "high": 0.1}),
        ("composite", {"low": 0.9, "high": 0.1}),
        ("points", {"pitch": 5.0, "spot_sigma": 1.0}),
        ("uniform", {"bin_width": 7.0}),
    ],
)
def test_a_chart_that_cannot_be_drawn_is_refused_before_anything_is_computed(name, values):
    source = installed_stages().load(name)(white_luminance=100.0, **values)
    with pytest.raises(ValueError, match=r"low and high|six softened|does not divide"):
        source.describe()


def test_every_variant_names_an_installed_stage():
    assert set(VARIANTS) <= set(installed_stages().names())
