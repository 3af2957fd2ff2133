"""Every installed stage, from whichever distribution, keeps what it declares; each where it is ordinary and where it
is not.
"""

import pytest

from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import MISSING
from etendue.testing import StageConformance
from etendue.testing.cases import ordinary
from etendue.testing.laws.extreme_laws import ExtremeLaws
from etendue.testing.laws.range_laws import RangeLaws
from etendue.testing.laws.state_laws import StateLaws

CELLS = {"light": "cells"}
HARD = {"light": "cells", "softness": 0.0}
WHOLE = {"wavelength_from": 380.0, "wavelength_to": 780.0, "width": 120.0, "height": 80.0}

VARIANTS = {
    "uniform": [{"reflectance": 0.0}, {"illuminant": "A"}, CELLS],
    "slanted_edge": [{"low": 0.0}, {"softness": 0.0, "angle": 0.0}, CELLS, {"low": 0.0, **HARD}],
    "siemens_star": [{"low": 0.0, "radius": 8.0}, {"radius": 8.0, **HARD}],
    "zone_plate": [{"low": 0.0, "radius": 8.0}, {"radius": 8.0, **HARD}],
    "step_wedge": [{"low": 0.9, "high": 0.01}, WHOLE, {**WHOLE, **HARD}],
    "patch_chart": [{"across": 1}, {"across": 3, "background": 0.0}, CELLS, {"gap": 0.0, **HARD}],
    "points": [{"background": 0.0}, {"pitch": 9.0, "spot_sigma": 0.5}, {"spot_sigma": 1e-3, "background": 0.0, **HARD}],
    "dead_leaves": [
        {"smallest": 1.0, "largest": 9.0, "low": 0.0},
        {"smallest": 2.0, "largest": 3.0, "exponent": 1.0, "seed": 7, "oversampling": 2},
        {"smallest": 0.5, "largest": 8.0, **HARD},
    ],
    "colorchecker": [WHOLE, {"background": 1.0, **WHOLE}, {"background": 0.026, **WHOLE}, {**WHOLE, **HARD}],
    "composite": [WHOLE, {"low": 0.026, "high": 1.0, **WHOLE}, {**WHOLE, **HARD}],
    "irradiance": [
        {"aperture_model": "flat_disc"},
        {"f_number": 0.5},
        {"f_number": 1e6, "magnification": -1.0},
        {"t_number": 3.2, "focus_distance": 100.0},
    ],
    "falloff": [
        {"model": "disc"},
        {"geometry": "paper"},
        {"focal_length": 0.01},
        {"focal_length": 1e4},
        {"model": "disc", "pupil_magnification": 3.0},
    ],
    "diffraction": [
        {"f_number": 0.5},
        {"f_number": 1.4},
        {"f_number": 128.0},
        {"obstruction": 0.4},
        {"obstruction": 0.95, "f_number": 1.4},
    ],
    "wavefront": [
        {"defocus": 0.02},
        {"f_number": 16.0, "aperture": "polygonal", "blades": 5, "rounding": 0.3},
        {"aperture": "annular", "obstruction": 0.3, "zernike": (0.0, 0.3, 0.0, 0.02, 0.05, 0.0, 0.04), "f_number": 5.6},
        {
            "coma": 0.5,
            "astigmatism": 0.3,
            "field_y": 2.0,
            "field_x": 1.0,
            "focus_distance": 500.0,
            "object_distance": 450.0,
        },
        {"aperture": "polygonal", "rotation": 10.0, "spherical": 0.4, "coma": 0.2, "field_x": 3.0, "pupil_samples": 64},
    ],
    "aberrations": [
        {"accuracy": 0.2, "coma": 0.3, "full_height": 0.2, "heights": 3, "bands": 2, "pupil_samples": 32},
        {
            "accuracy": 0.2,
            "astigmatism": 0.3,
            "full_height": 0.2,
            "heights": 3,
            "bands": 1,
            "pupil_samples": 32,
            "method": "tiles",
            "obstruction": 0.3,
        },
    ],
    "lens_gaussian": [{"sigma": 0.0}, {"sigma": 30.0}],
    "lens_psf_field": [
        {"weights": "image"},
        {"method": "eigen", "centre": "centroid"},
        {"method": "tiles", "tolerance": 0.05},
    ],
    "distortion": [
        {"k1": -0.02, "reference_radius": 0.01},
        {"k1": 0.1, "k2": -0.01, "reference_radius": 0.01, "lateral_colour": 0.01, "order": 3},
        {"lateral_colour": -0.02, "order": 1, "oversampling": 2},
    ],
    "lens_psf": [{"nodes": 256}],
    "optical_filter": [{"cut_off": float("inf")}, {"cut_off": 550.0, "edge": 0.5}],
    "vignetting": [
        {"rim_radius": 1.3, "rim_distance": 500.0},
        {"rim_radius": 1.3, "rim_distance": 80.0, "magnification": -0.01},
    ],
    "angular_response": [
        {"power": 2.0, "focal_length": 0.02},
        {"power": 1.5, "exit_pupil_distance": float("inf"), "microlens_shift": -900.0},
    ],
    "glare": [
        {"fraction": 0.03, "veil": 0.02, "radius": 20.0},
        {"fraction": 1.0, "radius": 0.4},
        {"fraction": 0.5, "power": 2.1, "radius": 1.0},
    ],
    "birefringent": [{"separation_y": 2.0, "separation_x": 2.0}, {"separation_x": 3.7, "rotation": 30.0}],
    "pixel_etendue": [{"f_number": 0.5}, {"aperture_model": "flat_disc", "magnification": -2.0}],
    "illuminance": [{"grey": 1.0}],
    "diffusion": [
        {"back": "reflecting"},
        {"diffusion_length": float("inf")},
        {"depletion_depth": 0.1, "diffusion_depth": 1000.0},
    ],
    "crosstalk": [
        {"crosstalk": "through_filter"},
        {
            "crosstalk": "through_filter",
            "pattern": "X-Trans",
            "pixel_pitch": 1.1,
            "peak_qe": (0.4,),
            "back": "reflecting",
        },
        {
            "crosstalk": "through_filter",
            "pattern": "WG/BW",
            "sensitivity_kind": "filter_transmittance",
            "diffusion_depth": float("inf"),
        },
    ],
    "pixel": [
        {"aperture_offset_y": 0.1, "aperture_offset_x": -0.12, "microlens_gain": 1.5},
        {"pixel_pitch": 1.1},
        {"pixel_pitch": 2.0, "sampling": "paper"},
        {"pixel_pitch": 2.0, "aperture_fraction": 0.01},
    ],
    "mosaic": [{"pattern": "GBRG"}, {"pattern": "quad-BGGR"}, {"pattern": "X-Trans"}, {"pattern": "RGB/BRG/GBR"}],
    "exposure": [{"prnu": 0.0, "dark_nonuniformity": 0.0}, {"dark_current_density": 0.0}, {"integration_time": 1e-6}],
    "bracket": [{"repeats": 1, "brackets": (-2.0, 0.0, 3.0)}],
    "merge_frames": [{"method": "mean"}, {"method": "sigma_clipped"}, {"around": 0}],
    "meter": [{"metering": "highlight", "ev_bias": -1.0}, {"metering": "centre"}, {"metering": "exposure_value"}],
    "defects": [{"hot": 0.0, "dead": 0.0}, {"hot": 0.5, "dead": 0.4}],
    "stuck_pixels": [{"stuck": 0.0}, {"stuck": 0.5, "level": 1.0}],
    "line_pattern": [
        {"row_pattern": 3.0, "column_pattern": 2.0, "row_noise": 1.0, "column_noise": 1.0},
        {"noise": "common"},
    ],
    "shot_noise": [{"exact_below": float("inf")}, {"noise": "common"}],
    "full_well": [{"full_well_density": 1e7}, {"full_well_density": 1.0}],
    "read_noise": [
        {"read_noise": 0.0, "dsnu": 0.0},
        {"noise": "common"},
        {"iso": 800.0, "base_iso": 100.0, "read_noise_after": 20.0},
    ],
    "adc": [{"bits": 1, "black_level": 0}, {"bits": 16, "conversion_gain": 3.0}, {"analogue_gain": 16.0}],
    "linearise": [{"black_level": 0}, {"bits": 8, "black_level": 254}],
    "charge_fraction": [{"reference_time": 100.0}],
    "paper_exposure": [{"integration_time": 1.0}, {"read_noise": 0.0, "dsnu": 0.0, "dark_current_density": 0.0}],
    "no_mask": [{"crosstalk": "through_filter"}],
    "ideal_mosaic": [{"integration_time": 100.0}, {"conversion_gain": 1.0}, {"clip": False}],
    "crosstalk_planes": [
        {"crosstalk": "through_filter"},
        {"crosstalk": "through_filter", "pattern": "X-Trans", "pixel_pitch": 1.1, "peak_qe": (0.4,)},
    ],
    "demosaic_nearest": [{"pattern": "BGGR"}],
    "demosaic_bilinear": [{"pattern": "GRBG"}],
    "demosaic_colour_difference": [{"pattern": "GBRG"}],
    "demosaic_directional": [{"pattern": "GRBG"}, {"pattern": "BGGR", "floor": 0.1}],
    "demosaic_residual": [{"pattern": "GRBG"}],
    "demosaic_any": [
        {"pattern": "X-Trans"},
        {"pattern": "quad-RGGB"},
        {"pattern": "RGBW"},
        {"pattern": "RCCC"},
        {"pattern": "mono"},
    ],
    "sharpen": [{"strength": 0.0}, {"strength": 4.0}],
    "sharpen_mosaic": [{"strength": 0.0}, {"strength": 4.0, "planes": "mixed"}, {"pattern": "X-Trans"}],
    "unsharp": [{"amount": 0.0}, {"amount": 10.0, "radius": 5.0}, {"threshold": 0.05}, {"radius": 0.01}],
    "denoise": [
        {"strength": 0.0},
        {"strength": 5.0, "radius": 4},
        {"read_noise": 0.0, "dsnu": 0.0, "full_well_density": 1e5},
    ],
    "wiener": [{"nodes": 64}, {"exponent": 0.0, "noise_variance": 1e-12}, {"largest_gain": 1.0, "aliasing": "ignored"}],
    "richardson_lucy": [
        {"nodes": 64, "stop": 0.0},
        {"iterations": 40, "stop": 0.0},
        {"total_variation": 0.01, "start": "mean"},
    ],
    "exposure_numbers": [{"temperature": 400.0}, {"analogue_gain": 4.0}],
    "white": [
        {"crosstalk": "through_filter", "pattern": "X-Trans"},
        {"conversion_gain": 1.0},
        {"sensitivity_kind": "filter_transmittance"},
        {"sensitivity_per": "energy"},
        {"render_exposure": 100.0},
    ],
    "white_estimate": [
        {"method": "illuminant"},
        {"method": "white_patch"},
        {"method": "shades_of_grey", "cell": 1},
        {"method": "preset", "gains": (2.1, 1.0, 1.6), "floor": 0.1},
    ],
    "balance_mosaic": [{"highlights": "keep"}, {"pattern": "X-Trans"}, {"brightness": "camera"}],
    "lens_shading": [
        {"strength": 0.0},
        {"focal_length": 0.03, "model": "disc"},
        {"focal_length": 0.02, "largest_gain": 1.5, "power": 1.0},
    ],
    "correct_defects": [{"by": "map"}, {"by": "detection"}, {"pattern": "X-Trans", "threshold": 1.0, "contrast": 0.0}],
    "correct_found_defects": [{"threshold": 1.0}, {"pattern": "mono", "prnu": 0.0, "read_noise": 0.0}],
    "colour_fit": [
        {"white": "fitted", "ridge": 0.01},
        {"sensitivity_kind": "filter_transmittance"},
        {"crosstalk": "through_filter", "pixel_pitch": 1.1},
        {"sensitivity_kind": "filter_transmittance", "pattern": "RGBW", "peak_qe": (0.5,)},
        {"sensitivity_kind": "filter_transmittance", "pattern": "mono", "peak_qe": (0.5,)},
    ],
    "balance": [{"gains": "as_printed"}, {"space": "Bradford", "target": "A"}, {"space": "CAT16"}, {"floor": 0.3}],
    "display": [
        {"display": "Adobe RGB (1998)"},
        {"display": "Apple Studio Display"},
        {"display": "Typical CRT Brainard 1997"},
    ],
    "to_cones": [{"display": "Typical CRT Brainard 1997"}, {"display": "sRGB"}],
    "from_cones": [{"display": "Typical CRT Brainard 1997"}, {"display": "ITU-R BT.2020"}],
    "to_xyz": [{"matrix": "eq16_as_printed"}, {"matrix": "sRGB"}, {"matrix": "Display P3"}],
    "decode": [{"encoding": "BT.709"}, {"encoding": "power"}, {"encoding": "power", "exponent": 5.0}],
    "encode": [{"encoding": "BT.709"}, {"encoding": "power"}, {"encoding": "power", "exponent": 5.0}],
    "dynamic_range": [
        {"read_noise": 0.0, "dsnu": 0.0, "dark_current_density": 0.0},
        {"integration_time": 1e6},
        {"dark_doubling": 6.0},
    ],
    "lens_numbers": [
        {"f_number": 0.5},
        {"magnification": -1.0},
        {"focus_distance": 2000.0, "pupil_magnification": 0.4},
    ],
    "resolution": [{"highest": 0.01}, {"nodes": 16}, {"angle": 37.0}, {"rendering": True, "pixel_pitch": 0.5}],
    "star_resolution": [{"cycles": 8, "radius": 8.0, "contrast": 0.8}, {"encoding": "power", "pattern": "mono"}],
    "leaves_resolution": [{"encoding": "power", "pattern": "mono"}],
    "detail_information": [{"pattern": "mono"}, {"contrast_ratio": 1e6, "object_size": 0.5}],
    "edge_resolution": [
        {"region_height": 5.0, "region_width": 5.0},
        {"encoding": "power", "tails": False, "pattern": "mono"},
    ],
}
CASES = [
    pytest.param(name, variant, id=f"{name}-{'-'.join(f'{k}={v}' for k, v in variant.items())}")
    for name in installed_stages().names()
    for variant in VARIANTS.get(name, [])
]


RANGES = {law for law in vars(RangeLaws) if law.startswith("test_")}


@pytest.mark.parametrize("name", installed_stages().names())
class TestInstalled(StageConformance):
    """Without the laws of ranges, which walk through every parameter: the command tests them on every installed stage
    (``tests/studies/test_stability.py``)."""

    vars().update(dict.fromkeys(RANGES))

    @pytest.fixture(autouse=True)
    def _instance(self, name):
        kind = installed_stages().load(name)
        self.stage = kind(**ordinary(kind))


@pytest.mark.long
@pytest.mark.parametrize(("name", "variant"), CASES)
class TestVariants(StageConformance):
    """Without the laws of stability: the command holds them at every end of every range
    (``tests/studies/test_stability.py``). Without those of ranges, which leave the ordinary stage by themselves, of
    state and of a million draws.
    """

    vars().update(dict.fromkeys(law for law in vars(ExtremeLaws) if law.startswith("test_")) | dict.fromkeys(RANGES))
    vars().update(dict.fromkeys(law for law in vars(StateLaws) if law.startswith("test_")))
    vars().update(test_its_draws_are_those_that_it_declares=None)

    @pytest.fixture(autouse=True)
    def _instance(self, name, variant):
        kind = installed_stages().load(name)
        self.stage = kind(**{**ordinary(kind), **variant})


@pytest.mark.parametrize(
    "name", [n for n in installed_stages().names() if installed_stages().installed(n).distribution == "etendue"]
)
def test_every_built_in_stage_says_how_wrong_it_is_and_what_its_parameters_mean(name):
    kind = installed_stages().load(name)
    assert hasattr(kind, "error")
    assert kind.__doc__
    required = [n for n, (_, _, default) in parameters_of(kind).items() if default is MISSING]
    assert all(parameters_of(kind)[n][0].example is not None for n in required)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("slanted_edge", {"low": 0.9, "high": 0.1}, "low and high"),
        ("siemens_star", {"low": 0.9, "high": 0.1}, "low and high"),
        ("zone_plate", {"low": 0.9, "high": 0.1}, "low and high"),
        ("composite", {"low": 0.9, "high": 0.1}, "low and high"),
        ("points", {"pitch": 5.0, "spot_sigma": 1.0}, "six softened"),
        ("uniform", {"bin_width": 7.0}, "must divide"),
    ],
)
def test_a_chart_that_cannot_be_drawn_is_refused_before_anything_is_computed(name, values, said):
    source = installed_stages().load(name)(white_luminance=100.0, **values)
    with pytest.raises(ValueError, match=said):
        source.describe()


def test_every_variant_names_an_installed_stage():
    assert set(VARIANTS) <= set(installed_stages().names())
