"""The two light models in the whole engine: flux, sign, pixels, dark light beside highlights, the same bits however
it is run.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

import etendue
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.session import load
from etendue_camera.optics import diffraction
from etendue_camera.optics.undershoot import LARGEST_OF_A_POINT, LARGEST_OF_A_SCENE, undershoot
from etendue_camera.sensor import photodiode
from tests.run.small import SWEEP, assert_same_archives, assert_same_arrays, by_labels, plan_of, run

ONE_BAND = {"wavelength_from": 540, "wavelength_to": 560, "bin_width": 20}


def document(scene, *stages, camera=None, **more):
    """A pipeline of a scene, the irradiance and what follows."""
    return {
        "name": "light",
        "camera": {"peak_qe": [1, 1, 1], **(camera or {})},
        "stages": [{"name": "scene", "white_luminance": 100, **ONE_BAND, **scene}, {"use": "irradiance"}, *stages],
        **more,
    }


def spot(spacing, size, light, **more):
    """One spot far smaller than a sample or a cell, in the middle of an odd frame."""
    return {
        "use": "points",
        "light": light,
        "spacing": spacing,
        "width": size * spacing,
        "height": size * spacing,
        "pitch": 4 * size * spacing,
        "spot_sigma": 0.1 * spacing,
        "softness": 0,
        "background": 0,
        **more,
    }


@pytest.mark.parametrize("number", [1.4, 4.0, 22.0])
@pytest.mark.parametrize("spacing", [0.3, 2.64, 5.3])
def test_a_point_in_cells_keeps_its_light_and_makes_no_other(number, spacing):
    tree = etendue.simulate(document(spot(spacing, 61, "cells"), {"use": "diffraction"}, camera={"f_number": number}))
    before, behind = (tree[name].irradiance.values[0] for name in ("irradiance", "diffraction"))
    assert behind.min() >= 0
    share = behind.sum() / before.sum()
    # what leaves a frame that is as good as endless in one direction only: at least what leaves its outer circle
    assert share <= 1 + 1e-12
    assert share >= diffraction.airy_encircled(30.5 * spacing, 0.55, number) - 1e-12


@pytest.mark.parametrize(("spacing", "number"), [(1.0, 1.4), (0.55, 1.4), (2.64, 4.0), (5.3, 4.0), (1.0, 8.0)])
def test_a_point_in_band_limited_light_falls_below_zero_by_no_more_than_is_said(spacing, number):
    tree = etendue.simulate(
        document(spot(spacing, 61, "bandlimited"), {"use": "diffraction"}, camera={"f_number": number})
    )
    behind = tree["diffraction"].irradiance.values[0]
    point, _ = undershoot(0.5 / spacing * 0.55 * number)
    assert point <= LARGEST_OF_A_POINT
    # the bound is that of a point on another, larger periodic plane
    assert_allclose(max(-behind.min(), 0) / behind.max(), point, rtol=0.02, atol=1e-12)


def test_no_ratio_has_a_larger_undershoot_than_the_largest():
    found = np.array([undershoot(float(ratio)) for ratio in np.linspace(0.02, 1.2, 119)])
    assert_allclose(found.max(axis=0), [LARGEST_OF_A_POINT, LARGEST_OF_A_SCENE], rtol=2e-3)
    assert (found.max(axis=0) <= [LARGEST_OF_A_POINT, LARGEST_OF_A_SCENE]).all()
    assert (found[-20:] == 0).all()
    with pytest.raises(ValueError, match="ratio"):
        undershoot(0.0)


def test_a_scene_that_hurts_most_reaches_the_undershoot_of_scenes():
    """Bright exactly where the point spread function is negative, on a periodic plane."""
    count, ratio = 128, 0.6
    f = np.fft.fftfreq(count)[:, None], np.fft.rfftfreq(count)[None, :]
    otf = diffraction.circular_otf(np.hypot(*f), 1.0, 2 * ratio)
    kernel = np.fft.irfft2(otf, s=(count, count))
    scene = (kernel < 0).astype(float)
    behind = np.fft.irfft2(np.fft.rfft2(scene) * otf, s=(count, count))
    assert_allclose(-behind.min(), undershoot(ratio)[1], rtol=1e-12)


def test_the_plan_says_how_far_light_falls_below_zero_and_what_to_do_and_is_silent_in_cells():
    def warnings(light):
        chart = {"use": "slanted_edge", "softness": 0.4, "spacing": 1, "width": 40, "height": 40, "light": light}
        pipeline = load(document(chart, {"use": "diffraction"}, camera={"f_number": 1.4}), {})
        return " ".join(make_plan(pipeline, installed_stages()).warnings)

    assert "light = 'cells'" in warnings("bandlimited")
    point, scene = undershoot(round(0.5 * 0.55 * 1.4, 2))
    assert f"{point:.2%}" in warnings("bandlimited")
    assert f"{scene:.1%}" in warnings("bandlimited")
    assert "too coarse" not in warnings("cells")


@pytest.mark.parametrize(("light", "softness"), [("bandlimited", 2.0), ("cells", 0.0)])
@pytest.mark.parametrize("contrast", [1e5, 1e8])
@pytest.mark.parametrize("precision", ["auto", "float32"])
def test_dark_light_beside_a_highlight_is_right_in_the_precision_that_the_plan_chooses(
    light, softness, contrast, precision
):
    """A half plane behind a Gaussian lens: the integral of the normal distribution; in cells its mean over each."""
    spacing, sigma = 1.0, 2.0
    chart = {
        "use": "slanted_edge",
        "angle": 0,
        "low": 1 / contrast,
        "high": 1.0,
        "softness": softness,
        "light": light,
        "spacing": spacing,
        "width": 256,
        "height": 64,
    }
    tree = etendue.simulate(document(chart, {"use": "lens_gaussian", "sigma": sigma}, precision=precision))
    found = tree["lens_gaussian"].irradiance.values[0, 32]
    assert found.dtype == ("float64" if precision == "auto" else "float32")
    x = np.arange(256) - 127.5
    if light == "cells":

        def ramp(t):
            return t * ndtr(t / sigma) + sigma * np.exp(-0.5 * (t / sigma) ** 2) / np.sqrt(2 * np.pi)

        near = np.clip(x, -20 * sigma, 20 * sigma)
        share = (ramp(near + 0.5 * spacing) - ramp(near - 0.5 * spacing)) / spacing
    else:
        share = ndtr(x / np.hypot(sigma, softness * spacing))
    truth = 1 / contrast + (1 - 1 / contrast) * share
    level = tree["irradiance"].irradiance.values[0, 32, -40]
    inside = slice(30, -30)  # away from the border, behind which the light is a mirror image
    wrong = np.abs(found[inside].astype(float) / level / truth[inside] - 1).max()
    if precision == "auto":
        assert wrong <= 1e-4
    else:
        assert wrong > 1e-4  # what single precision would have done to the darkest


@pytest.mark.parametrize("pitch", [2.7, 2.5, 1.1])
def test_a_hard_edge_on_pixels_is_the_fourier_integral_of_optics_diffusion_and_aperture(pitch):
    """Whole and fractional numbers of cells to a pixel. Cells with a border on the edge hold it exactly."""
    from etendue_camera.sensor import silicon

    spacing, fraction, number, count = 0.9, 0.741, 4.0, 40
    chart = {
        "use": "slanted_edge",
        "angle": 0,
        "low": 0.1,
        "high": 0.9,
        "softness": 0,
        "light": "cells",
        "spacing": spacing,
    }
    tree = etendue.simulate(
        document(
            {**chart, "width": 324, "height": 36},
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": 4, "columns": count},
            camera={"f_number": number, "pixel_pitch": pitch, "aperture_fraction": fraction},
            precision="float64",
        )
    )
    rate = tree["pixel"].photon_rate.values[1, 2]
    x = (np.arange(count) - 0.5 * (count - 1)) * pitch
    f = (np.arange(200000) + 0.5) * 1e-5
    otf = diffraction.circular_otf(f, 0.55, number) * photodiode.aperture_otf(f, pitch * fraction)
    otf *= photodiode.collection_mtf(f, float(silicon.absorption(np.array(0.55))), 1.8, 10.0, 50.0)
    profile = 0.5 + np.array([np.sum(np.sin(2 * np.pi * f * p) * otf / (np.pi * f)) * 1e-5 for p in x])
    measured = (rate / np.mean(rate + rate[::-1]) - 0.1) / 0.8
    # behind the borders stands a mirror image of the edge, in the tails of the Airy pattern: 2 lambda N/(pi^2 160 um)
    assert_allclose(measured, profile, rtol=0, atol=3e-3)
    assert_allclose(np.diff(measured), np.diff(profile), rtol=0, atol=1e-4)


def test_the_two_light_models_agree_on_pixels_where_the_grid_is_fine():
    """A soft chart: its means differ from its samples by the curvature over a cell, here 4e-4, and that falls by
    four.
    """
    errors = []
    for spacing in (0.5, 0.25):
        chart = {
            "use": "slanted_edge",
            "angle": 7,
            "softness": 1.5 / spacing,
            "spacing": spacing,
            "width": 64,
            "height": 48,
        }
        rates = [
            etendue.simulate(
                document(
                    {**chart, "light": light},
                    {"use": "diffraction"},
                    {"use": "diffusion"},
                    {"use": "pixel", "rows": 8, "columns": 8},
                    camera={"f_number": 2.8, "pixel_pitch": 2.0},
                    precision="float64",
                )
            )["pixel"].photon_rate.values
            for light in ("bandlimited", "cells")
        ]
        errors.append(np.abs(rates[1] - rates[0]).max() / rates[0].max())
    assert errors[0] < 2e-3
    assert_allclose(errors[0] / errors[1], 4.0, rtol=0.1)


def test_uniform_light_is_the_same_in_both_models():
    rates = [
        etendue.simulate(
            document(
                {"use": "uniform", "light": light, "width": 40, "height": 40},
                {"use": "diffraction"},
                {"use": "pixel"},
                precision="float64",
            )
        )["pixel"].photon_rate.values
        for light in ("bandlimited", "cells")
    ]
    assert_allclose(rates[1], rates[0], rtol=1e-13)


def test_one_cell_for_one_pixel_without_optics_is_that_cell():
    """``sampling = "paper"``: the aperture lies inside its cell, whose light is the same all over."""
    chart = {
        "use": "siemens_star",
        "light": "cells",
        "softness": 0,
        "spacing": 5.4,
        "width": 108,
        "height": 108,
        "radius": 50,
        "cycles": 6,
    }
    tree = etendue.simulate(
        document(chart, {"use": "pixel", "sampling": "paper"}, camera={"pixel_pitch": 5.4}, precision="float64")
    )
    light, rate = tree["irradiance"].irradiance.values[0], tree["pixel"].photon_rate.values[1]
    assert_allclose(rate / rate.max(), light / light.max(), rtol=0, atol=1e-13)


CELLS = {"scene.light": "cells", "scene.softness": 0}


@pytest.fixture(scope="module", params=["float32"])
def reference(request):
    plan = plan_of({**SWEEP, **CELLS, "precision": request.param})
    outcome = run(plan)
    assert not outcome.failed
    return plan, by_labels(plan, outcome.arrays)


@pytest.mark.parametrize(
    "options",
    [
        {"scheduler": "threads", "workers": 2, "batch_seconds": 0.0},
        pytest.param({"scheduler": "processes", "workers": 2, "batch_seconds": 0.02}, marks=pytest.mark.long),
    ],
    ids=lambda o: o["scheduler"],
)
def test_schedulers_and_batches_change_no_bit_of_cells(reference, options):
    plan, expected = reference
    outcome = run(plan, **options)
    assert not outcome.failed
    assert_same_arrays(by_labels(plan, outcome.arrays), expected)


@pytest.mark.parametrize("keep", [["pixel"], ["diffraction", "pixel"], ["diffusion"]])
def test_what_is_kept_changes_no_bit_of_cells(reference, keep):
    plan, expected = reference
    less = plan_of({**SWEEP, **CELLS, "precision": plan.precision, "keep": keep})
    assert_same_arrays(by_labels(less, run(less).arrays), {key: a for key, a in expected.items() if key[0][0] in keep})


def test_a_resumed_archive_of_cells_equals_an_uninterrupted_one(tmp_path):
    plan = plan_of({"sweep.f_number": [2, 5.6], **CELLS})
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    run(plan, whole)
    run(plan, broken)
    for path in (
        sorted((broken / "data.zarr" / "diffusion").rglob("c.*"))[:1]
        + sorted((broken / "data.zarr" / "pixel").rglob("c.*"))[:1]
    ):
        path.unlink()
    assert 0 < run(plan, broken).computed < len(plan.cells)
    assert_same_archives(broken, whole)


def test_cells_enter_keys_and_stand_in_the_archive_in_the_words_of_cf():
    plain, cells = plan_of({"scene.softness": 0}), plan_of(CELLS)
    assert {c.key for c in plain.of("scene")}.isdisjoint(c.key for c in cells.of("scene"))
    assert cells.of("diffraction")[0].grids["irradiance"].line("x").cells
    tree = run(cells).tree
    assert tree["diffraction"].irradiance.attrs["cell_methods"] == "y: mean x: mean"
    assert "cell_methods" not in tree["pixel"].photon_rate.attrs


def test_a_uniform_scene_in_cells_is_handed_on_bit_by_bit():
    plan = plan_of({"scene.use": "uniform", "scene.light": "cells", "camera.focal_length": "1 m"})
    arrays = {key[0][0]: array for key, array in by_labels(plan, run(plan).arrays).items() if key[1] == "irradiance"}
    for name in ("falloff", "diffraction", "diffusion"):
        assert arrays[name].tobytes() == arrays["irradiance"].tobytes()


@pytest.mark.long
@pytest.mark.parametrize("name", ["diffraction", "lens_gaussian", "pixel"])
def test_transfer_stages_keep_every_law_on_cells(name):
    from etendue.contract.arrays.grid import Bands, Grid, Line
    from etendue.testing import check_stage
    from etendue.testing.examples import EDGES

    needed = {
        "pixel": {"peak_qe": (0.4, 0.4, 0.4), "pixel_pitch": 4.0},
        "lens_gaussian": {},
        "diffraction": {"f_number": 2.8},
    }
    lines = {dim: Line(size, -0.5 * (size - 1) * 2.0, 2.0, cells=True) for dim, size in (("y", 9), ("x", 12))}
    grid = Grid.of({"wavelength": Bands(EDGES), **lines})
    assert check_stage(installed_stages().load(name)(**needed[name]), {"irradiance": grid}) == []


def test_the_pictures_of_a_point_on_black_show_a_point_and_no_noise():
    stages = [
        {
            "use": "points",
            "name": "scene",
            "white_luminance": 100,
            "width": 101,
            "height": 101,
            "light": "cells",
            "pitch": 5000,
            "background": 0,
            "bin_width": 100,
        },
        {"use": "irradiance"},
        {"use": "diffraction"},
    ]
    with np.errstate(all="raise", under="ignore"):
        tree = etendue.simulate(
            {"name": "point", "precision": "float64", "camera": {"peak_qe": [0.5]}, "stages": stages}, leave_out=False
        )
    preview = tree["frames"].preview.values
    assert np.all(preview.max(axis=(1, 2, 3)) == 255)
    assert preview.mean() < 0.05 * 255  # of 101 x 101 cells a spot of a dozen is bright
