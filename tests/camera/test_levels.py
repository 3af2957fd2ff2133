"""Absolute levels by hand arithmetic, and laws of the whole camera. In: small pipelines. Out: electrons, lux,
colours.
"""

import copy
import math

import numpy as np
import pytest

import etendue
from etendue_camera import spectra
from etendue_camera.constants import LUMINOUS_EFFICACY, PLANCK, SPEED_OF_LIGHT
from etendue_camera.optics import diffraction
from etendue_camera.sensor import photodiode

SENSOR = ("mosaic", "exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
COLOUR = ("demosaic_bilinear", "white", "colour_fit", "camera_to_xyz", "balance", "display", "encode")


def camera(*stages, chart="uniform", wanted=None, **tables):
    """A pipeline of a scene, the irradiance and the named stages; tables override parameters by stage."""
    document = {
        "name": "test",
        "precision": "float64",
        "camera": {
            "peak_qe": [0.4, 0.5, 0.3],
            "read_noise": 0,
            "dsnu": 0,
            "dark_current_density": 0,
            **tables.pop("camera", {}),
        },
        "stages": [
            {
                "use": chart,
                "name": "scene",
                "white_luminance": 100,
                "width": 64,
                "height": 48,
                **tables.pop("scene", {}),
            }
        ],
    }
    for name in ("irradiance", *stages):
        document["stages"].append({"use": name, **tables.get(name, {})})
    if wanted:
        document["wanted"] = wanted
    return document


@pytest.mark.parametrize(("model", "lux"), [("aplanatic", math.pi * 100 / 64), ("flat_disc", math.pi * 100 / 65)])
def test_a_white_surface_of_100_cd_per_m2_at_f4_gives_the_lux_of_the_closed_form(model, lux):
    tree = etendue.simulate(
        camera(camera={"f_number": 4, "aperture_model": model}, scene={"width": 2, "height": 2, "bin_width": 1})
    )
    data = tree["irradiance"].to_dataset()
    edges = np.append(data.wavelength_bounds.values[:, 0], data.wavelength_bounds.values[-1, 1])
    weight = LUMINOUS_EFFICACY * spectra.luminous_efficiency(tuple(edges)) * np.diff(edges)
    # products of means over bins of 1 nm: 8e-7 measured
    rendered = spectra.rendered_share("D65", 380, 780)
    np.testing.assert_allclose(np.tensordot(weight, data.irradiance.values, axes=1), lux * rendered, rtol=2e-6)


def test_electrons_of_a_uniform_555_nm_scene_are_those_of_hand_arithmetic():
    time, pitch, fraction = 0.01, 5.4, 0.741
    tree = etendue.simulate(
        camera(
            "pixel",
            "mosaic",
            "exposure",
            scene={"wavelength_from": 550, "wavelength_to": 560, "bin_width": 10},
            exposure={"prnu": 0, "dark_nonuniformity": 0},
            camera={
                "illuminant": "555 nm",
                "sensitivity": "flat",
                "f_number": 4,
                "integration_time": time,
                "pixel_pitch": pitch,
                "aperture_fraction": fraction,
            },
        )
    )
    irradiance = math.pi * 100 / LUMINOUS_EFFICACY / (4 * 4**2)  # W m-2, all of it in the one bin; V is 1 at 555 nm
    photons = irradiance * (pitch * fraction * 1e-6) ** 2 * time * 555e-9 / (PLANCK * SPEED_OF_LIGHT)
    charge = tree["exposure"].expected_charge.values
    expected = np.empty_like(charge)
    expected[0::2, 0::2], expected[1::2, 1::2] = 0.4 * photons, 0.3 * photons
    expected[0::2, 1::2] = expected[1::2, 0::2] = 0.5 * photons
    np.testing.assert_allclose(charge, expected, rtol=1e-12)


def test_a_grey_surface_stays_grey_through_the_whole_camera():
    document = camera(
        "pixel",
        *SENSOR,
        *COLOUR,
        scene={"reflectance": 0.5, "white_luminance": 2000},
        shot_noise={"exact_below": "inf"},
        exposure={"prnu": 0, "dark_nonuniformity": 0},
        camera={"bits": 16, "full_well_density": 1e6, "integration_time": 0.2, "illuminant": "A"},
    )
    tree = etendue.simulate(document)
    linear = tree["display"].rgb_linear.values.mean(axis=(1, 2))
    electrons = tree["exposure"].expected_charge.values.min()
    # mean of the pixels of one colour: shot noise of a quarter of the frame, quantisation far below
    standard_error = 1 / math.sqrt(electrons * linear.size * tree["adc"].raw.size / 12)
    np.testing.assert_allclose(linear, 0.5, rtol=12 * standard_error + 1e-4)


def test_a_window_of_the_sensor_equals_the_crop_of_the_whole():
    stages = ("pixel", *SENSOR[:-1])
    noisy = {"read_noise": 0, "dsnu": 20, "dark_current_density": 1e-8}
    whole = etendue.simulate(
        camera(
            *stages,
            scene={"width": 600, "height": 500},
            pixel={"rows": 80, "columns": 90},
            camera=noisy,
            wanted=["expected_charge"],
        )
    )
    part = etendue.simulate(
        camera(
            *stages,
            scene={"width": 600, "height": 500},
            pixel={
                "rows": 80,
                "columns": 90,
                "first_row": 30,
                "first_column": 50,
                "window_rows": 40,
                "window_columns": 33,
            },
            camera=noisy,
            wanted=["expected_charge"],
        )
    )
    crop = whole["exposure"].expected_charge.isel(y=slice(30, 70), x=slice(50, 83))
    assert np.array_equal(part["exposure"].y, crop.y)
    # fixed patterns bit for bit; the light of a uniform scene comes from another evaluation of the same spectrum
    np.testing.assert_allclose(part["exposure"].expected_charge.values, crop.values, rtol=1e-13)


def test_the_fixed_pattern_is_the_same_in_every_cell_and_another_sensor_has_another():
    document = camera(
        "pixel",
        *SENSOR[:-1],
        pixel={"rows": 6, "columns": 6},
        exposure={"prnu": 0.05, "dark_nonuniformity": 0},
        wanted=["expected_charge"],
    )
    document["sweep"] = {"integration_time": [0.001, 0.004]}
    charge = etendue.simulate(document)["exposure"].expected_charge.values
    np.testing.assert_allclose(charge[1], 4 * charge[0], rtol=1e-14)
    other = copy.deepcopy(document)
    other["camera"]["sensor_serial"] = "2"
    assert np.abs(etendue.simulate(other)["exposure"].expected_charge.values / charge - 1).max() > 0.01


def test_common_noise_moves_with_the_mean_and_independent_noise_does_not():
    def draws(noise):
        document = camera(
            "pixel",
            *SENSOR[:3],
            scene={"width": 400, "height": 400},
            exposure={"prnu": 0},
            camera={"noise": noise, "f_number": 16},
            wanted=["charge"],
        )
        document["sweep"] = {"integration_time": [0.01, 0.0101]}
        charge = etendue.simulate(document)["shot_noise"].charge.values
        return charge[1] - charge[0], charge

    difference, charge = draws("common")
    assert difference.min() >= 0  # inverse CDF of one uniform per pixel: monotone in the mean
    difference, charge = draws("independent")
    correlation = np.corrcoef((charge[0] - charge[0].mean()).ravel(), (charge[1] - charge[1].mean()).ravel())[0, 1]
    mosaic = np.corrcoef(charge[0, ::2, 1::2].ravel(), charge[1, ::2, 1::2].ravel())[0, 1]
    assert abs(mosaic) < 5 / math.sqrt(charge[0, ::2, 1::2].size)
    assert correlation > mosaic  # the mosaic's own pattern is common to both


@pytest.mark.parametrize("spacing", [0.5, 0.9])
def test_an_edge_behind_the_pixel_is_the_fourier_integral_of_optics_diffusion_and_aperture(spacing):
    pitch, fraction, number = 2.7, 0.741, 4.0
    document = {
        "name": "edge",
        "precision": "float64",
        "camera": {"peak_qe": [1, 1, 1], "f_number": number, "pixel_pitch": pitch, "aperture_fraction": fraction},
        "stages": [
            {
                "use": "slanted_edge",
                "name": "scene",
                "white_luminance": 100,
                "width": 300,
                "height": 40,
                "angle": 0,
                "spacing": spacing,
                "wavelength_from": 540,
                "wavelength_to": 560,
                "bin_width": 20,
            },
            {"use": "irradiance"},
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": 4, "columns": 100},
        ],
    }
    rate = etendue.simulate(document)["pixel"].photon_rate.values[1, 2]
    x = (np.arange(100) - 49.5) * pitch
    # the exact profile: integrate the analytic transfer function of an edge (odd part) over frequency
    f = (np.arange(200000) + 0.5) * 1e-5
    sigma = spacing
    otf = (
        diffraction.circular_otf(f, 0.55, number)
        * photodiode.collection_mtf(f, *_silicon(), 10.0, 50.0)
        * photodiode.aperture_otf(f, pitch * fraction)
        * np.exp(-2 * (np.pi * sigma * f) ** 2)
    )
    profile = 0.5 + np.array([np.sum(np.sin(2 * np.pi * f * p) * otf / (np.pi * f)) * 1e-5 for p in x])
    level = np.mean(rate + rate[::-1])  # low + high reflectance = 1, and the edge is odd about its centre
    measured = (rate / level - 0.1) / 0.8
    # what lies beyond the borders is a mirror image of the chart: its diffraction tails reach the middle with 2e-4
    np.testing.assert_allclose(measured[30:-30], profile[30:-30], atol=4e-4)


def _silicon():
    from etendue_camera.sensor import silicon

    return float(silicon.absorption(np.array(0.55))), 1.8
