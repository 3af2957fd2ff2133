"""What a run resolves of a star and of dead leaves, against the mean of the analytic curve over directions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import etendue
from tests.camera.test_resolution import COLOUR, QE, READ_OUT

pytestmark = pytest.mark.long

ANGLES = (0.0, 15.0, 30.0, 45.0)  # a square pixel looks the same from all others
STAR = {"radius": 370.0}


def document(chart, tail, f_number=8.0, scene=None, camera=None, rows=144):
    """A chart under equal-energy light, which is what the analytic curve is weighted with."""
    return {
        "name": "texture",
        "precision": "float64",
        "seed": 5,
        "camera": {
            "peak_qe": list(QE),
            "pixel_pitch": 4.0,
            "f_number": f_number,
            "focal_length": 50,
            "illuminant": "E",
            **(camera or {}),
        },
        "stages": [
            {
                "use": chart,
                "name": "scene",
                "white_luminance": 2e4,
                "width": 776.0,
                "height": 776.0,
                "spacing": 2.0,
                "wavelength_from": 400.0,
                "wavelength_to": 700.0,
                "bin_width": 100.0,
                **(scene or {}),
            },
            {"use": "irradiance"},
            {"use": "diffraction", "name": "lens"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": rows, "columns": rows},
            *({"use": use} if isinstance(use, str) else use for use in tail),
        ],
    }


def analytic(tree):
    return np.mean([tree[f"at_{angle:g}"].mtf50.values for angle in ANGLES], axis=0)


def angles(rendering):
    return [{"use": "resolution", "name": f"at_{angle:g}", "angle": angle, "rendering": rendering} for angle in ANGLES]


@pytest.mark.parametrize("f_number", [4.0, 8.0, 16.0])
def test_a_star_resolves_what_lens_diffusion_and_pixel_do(f_number):
    """1 %: 36 cycles and the mean over directions of contrast for that of frequencies."""
    tree = etendue.simulate(
        document("siemens_star", ({"use": "star_resolution", **STAR}, *angles(True)), f_number, STAR)
    )
    found = tree["star_resolution"].to_dataset()
    assert list(found.stage.values) == ["irradiance", "lens", "diffusion", "pixel"]
    assert_allclose(found.star_mtf50[1:], analytic(tree), rtol=0.01)
    assert_allclose(found.star_mtf50_cycles, found.star_mtf50 * 4, rtol=1e-12)  # camera pixels
    assert (found.star_mtf10[:3] > found.star_mtf50[:3]).all()


@pytest.mark.parametrize("f_number", [5.6, 16.0])
def test_leaves_resolve_what_lens_diffusion_and_pixel_do(f_number):
    """3 %: one chart of random leaves; what it is drawn with is in front of the lens too and cancels."""
    tree = etendue.simulate(document("dead_leaves", ("leaves_resolution", *angles(False)), f_number))
    found = tree["leaves_resolution"].to_dataset()
    assert np.isnan(found.leaves_mtf50[0])  # the reference itself
    assert_allclose(found.leaves_mtf50[1:], analytic(tree), rtol=0.03)
    assert_allclose(found.leaves_mtf50_cycles, found.leaves_mtf50 * 4, rtol=1e-12)


@pytest.mark.parametrize("chart", ["uniform", "slanted_edge", "dead_leaves"])
def test_a_scene_without_a_star_says_nothing(chart):
    found = etendue.simulate(document(chart, ("star_resolution",)))["star_resolution"].to_dataset()
    assert all(np.isnan(found[name]).all() for name in ("star_mtf50", "star_mtf50_cycles", "star_mtf10"))


@pytest.mark.parametrize("chart", ["uniform", "slanted_edge"])
def test_a_scene_without_texture_says_nothing(chart):
    found = etendue.simulate(document(chart, ("leaves_resolution",)))["leaves_resolution"].to_dataset()
    assert np.isnan(found.leaves_mtf50).all()


@pytest.mark.parametrize("rows", [4, 40])
def test_too_small_a_picture_is_no_error(rows):
    tail = ({"use": "star_resolution", **STAR}, "leaves_resolution")
    tree = etendue.simulate(document("siemens_star", tail, scene=STAR, rows=rows))
    assert np.isnan(tree["star_resolution"].star_mtf50[-1])
    assert np.isnan(tree["leaves_resolution"].leaves_mtf50[-1])


def test_behind_the_mosaic_the_star_is_measured_in_every_colour_state():
    """Bilinear: softer than the pixels; display values are decoded first."""
    camera = {"full_well_density": 1e9, "bits": 16, "integration_time": 0.001}
    doc = document(
        "siemens_star",
        (*READ_OUT, *COLOUR, {"use": "star_resolution", **STAR}),
        11.0,
        {**STAR, "white_luminance": 1e10},
        camera,
    )
    found = etendue.simulate(doc)["star_resolution"].to_dataset().star_mtf50
    assert np.isnan(found.sel(stage="linearise"))
    assert found.sel(stage="demosaic") < found.sel(stage="pixel")
    assert_allclose(found.sel(stage="encode"), found.sel(stage="display"), rtol=1e-3)
