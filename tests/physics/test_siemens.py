"""The Siemens star gives back the transfer function that blurred it, and finds its own centre."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ive

from etendue_camera.resolution.siemens import Star, star_response
from etendue_camera.scene import charts
from etendue_camera.scene.charts import Rendering

CENTRE = (150.3, 154.8)
FIFTY = np.sqrt(np.log(2) / 2) / np.pi  # MTF50 of a Gaussian of 1 pixel rms


def star(sigma, cycles=36, contrast=0.8, centre=CENTRE, shape=(300, 311), phase=0.4):
    """An endless sinusoidal star through a Gaussian: a pair of Bessel functions, exact."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    y, x = y - centre[0], x - centre[1]
    z = (y**2 + x**2) / (4 * sigma**2)
    left = np.sqrt(np.pi * z / 2) * (ive((cycles - 1) / 2, z) + ive((cycles + 1) / 2, z))
    return 0.5 * (1 + contrast * left * np.cos(cycles * np.arctan2(y, x) + phase))


@pytest.mark.parametrize("sigma", [0.35, 0.6, 1.2])
@pytest.mark.parametrize(("cycles", "bound"), [(36, 2e-3), (72, 5e-4)])
def test_a_gaussian_comes_back(sigma, cycles, bound):
    """The star mixes frequencies by 1/(6 cycles^2) of the third derivative; few pixels in the inner rings add to it."""
    found = star_response(star(sigma, cycles), Star(cycles, 140.0), centre=CENTRE, contrast=0.8)
    assert_allclose(found.mtf50, FIFTY / sigma, rtol=bound)  # 1.8e-3 and 3e-4 measured
    good = found.frequency < 0.45
    assert_allclose(
        found.sfr[good], np.exp(-2 * (np.pi * found.frequency[good] * sigma) ** 2), atol=1.5 * bound
    )  # 1.4e-3 and 5e-4 measured
    assert found.above_nyquist == (sigma < 0.37)
    assert not found.not_reached


def test_the_centre_is_found_and_nothing_hangs_on_where_it_was_sought():
    image = star(0.6)
    found = star_response(image, Star(36, 140.0), centre=(CENTRE[0] + 0.6, CENTRE[1] - 0.5), contrast=0.8)
    assert_allclose(found.centre, CENTRE, atol=1e-3)
    assert_allclose(
        found.mtf50, star_response(image, Star(36, 140.0), centre=CENTRE, refine=False, contrast=0.8).mtf50, rtol=1e-4
    )
    lost = star_response(image, Star(36, 140.0), centre=(CENTRE[0] + 0.6, CENTRE[1] - 0.5), contrast=0.8, refine=False)
    assert lost.mtf50 < 0.9 * found.mtf50  # what the search is for


def test_without_its_contrast_the_outer_rings_say_it():
    found = star_response(star(0.6), Star(36, 140.0), centre=CENTRE)
    assert_allclose(found.contrast, 0.8, rtol=1e-3)
    assert_allclose(found.mtf50, FIFTY / 0.6, rtol=2e-3)


def test_the_chart_that_the_scene_draws_can_be_measured():
    """Its softness is a Gaussian by local frequency: 1/cycles^2 from the exact convolution."""
    y, x = np.arange(300) - CENTRE[0], np.arange(311) - CENTRE[1]
    image = charts.siemens_star(y, x, 72, 145.0, Rendering(0.6, low=0.1, high=0.9))
    found = star_response(image, Star(72, 145.0), centre=CENTRE, contrast=0.8)
    assert_allclose(found.mtf50, FIFTY / 0.6, rtol=1e-3)


def test_noise_scatters_the_answer_about_the_truth():
    """4 % of the mean: 0.9 % rms, and no bias, because the noise is taken out of the sum of squares."""
    image, rng = star(0.6), np.random.default_rng(0)
    found = [
        star_response(image + rng.normal(0, 0.02, image.shape), Star(36, 140.0), centre=CENTRE, contrast=0.8)
        for _ in range(16)
    ]
    error = np.array([one.mtf50 for one in found]) * 0.6 / FIFTY - 1
    assert error.std() < 0.015
    assert abs(error.mean()) < 4 * error.std() / 4 + 1e-3
    pull = np.array([(one.sfr - np.exp(-2 * (np.pi * one.frequency * 0.6) ** 2)) / one.doubt for one in found])
    assert 0.8 < pull[:, pull.shape[1] // 4 : pull.shape[1] // 2].std() < 1.2  # the stated error is the true one


def test_light_and_turning_change_nothing():
    first = star_response(star(0.6), Star(36, 140.0), centre=CENTRE)
    again = star_response(1000 * star(0.6, phase=2.0), Star(36, 140.0), centre=CENTRE)
    assert_allclose(again.mtf50, first.mtf50, rtol=2e-3)  # other pixels in the same rings
    turned = star_response(star(0.6).T, Star(36, 140.0), centre=CENTRE[::-1])
    assert_allclose(turned.mtf50, first.mtf50, rtol=1e-6)


def test_what_lies_outside_the_rings_is_said_to():
    soft = star_response(star(4.0), Star(36, 140.0), centre=CENTRE, contrast=0.8)
    assert np.isnan(soft.mtf50) == (FIFTY / 4.0 < soft.frequency[0])
    sharp = star_response(star(0.3), Star(36, 140.0), centre=CENTRE, contrast=0.8, highest=0.4)
    assert sharp.not_reached
    assert sharp.mtf50_limited == 0.5


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"cycles": 5}, "cycles is 5"),
        ({"cycles": 36.5}, "cycles is 36.5"),
        ({"radius": 0.0}, "radius is 0"),
        ({"radius": 9.0}, "fewer than four rings"),
        ({"radius": 200.0}, "inside the picture"),
        ({"contrast": 1.5}, "contrast is 1.5"),
        ({"highest": 2.0}, "highest is 2"),
        ({"picture": np.zeros(4)}, "picture must be"),
        ({"picture": np.random.default_rng(0).normal(1, 0.1, (300, 311))}, "no measurable star"),
    ],
)
def test_nonsense_is_refused_with_its_name_and_what_is_allowed(arguments, match):
    given = {"picture": star(0.6), "cycles": 36, "radius": 140.0, "centre": CENTRE} | arguments
    with pytest.raises(ValueError, match=match):
        star_response(given.pop("picture"), Star(given.pop("cycles"), given.pop("radius")), **given)
