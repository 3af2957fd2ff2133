"""The slanted edge gives back the transfer function that made it, at any angle, finer than the pixels sample."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.special import erf

from etendue_camera.resolution.edges.edge_bins import binned
from etendue_camera.resolution.edges.slanted_edge import slanted_edge

FINE, PERIOD = 32, 8192


def distances(angle, shape=(200, 400), bend=0.0):
    rows, columns = shape
    turn = np.radians(angle)
    y, x = np.mgrid[:rows, :columns]
    v = (y - 0.5 * (rows - 1)) / (0.5 * (rows - 1))
    return (x - 0.5 * (columns - 1) - 0.3 - bend * v**2) * np.cos(turn) + (y - 0.5 * (rows - 1) - 0.2) * np.sin(turn)


def profile(mtf):
    """The edge spread function of a transfer function along the normal: a square wave through it, near one of its
    edges.
    """
    size = FINE * PERIOD
    k = np.arange(size // 2 + 1)
    harmonic = np.where(k % 2 == 1, mtf(k / PERIOD) / (np.pi * np.maximum(k, 1)), 0.0)
    wave = 0.5 + np.fft.irfft(-1j * harmonic * size, size)
    near = np.arange(-500 * FINE, 500 * FINE)
    return CubicSpline(near / FINE, wave[near])


def gaussian(sigma):
    return lambda f: np.exp(-2 * (np.pi * f * sigma) ** 2)


def camera(cutoff, width, angle):
    """Diffraction and a square pixel, as seen along the normal of an edge at an angle."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))

    def mtf(f):
        x = np.clip(f / cutoff, 0, 1)
        return (
            2
            / np.pi
            * (np.arccos(x) - x * np.sqrt(1 - x * x))
            * np.abs(np.sinc(f * width * c) * np.sinc(f * width * s))
        )

    return mtf


def half(mtf):
    return brentq(lambda f: float(mtf(np.array(f))) - 0.5, 1e-4, 2.0)


def picture(mtf, angle, shape=(200, 400)):
    return 0.2 + 0.6 * profile(mtf)(distances(angle, shape))


@pytest.mark.parametrize("angle", [2, 5, 10, 40, 50, 85, 88, -5, 130])
@pytest.mark.parametrize("sigma", [0.3, 0.6, 1.5])
def test_a_gaussian_comes_back_at_every_angle(sigma, angle):
    """The half contrast of a Gaussian is at sqrt(ln 2 / 2)/(pi sigma): with sigma 0.3 pixels that is 0.62, above
    Nyquist.
    """
    found = slanted_edge(picture(gaussian(sigma), angle))
    assert_allclose(found.mtf50, np.sqrt(np.log(2) / 2) / (np.pi * sigma), rtol=5e-5)  # 1e-5 measured
    assert_allclose(found.sfr, gaussian(sigma)(found.frequency), atol=1e-4)  # 4e-5 measured, up to 1 cycle/pixel
    assert found.above_nyquist == (sigma < 0.37)
    assert not found.not_reached


@pytest.mark.parametrize("angle", [2, 5, 10, 40])
@pytest.mark.parametrize("cutoff", [10.4, 3.5, 1.2, 0.45, 0.09])
def test_diffraction_and_pixel_come_back_within_the_bound(cutoff, angle):
    """From f/1.4 on pixels of 8 um, where half the contrast at Nyquist folds back, to f/22 on 1.1 um. Bound 0.5 %."""
    mtf = camera(cutoff, 0.741, angle)
    found = slanted_edge(picture(mtf, angle))
    assert_allclose(found.mtf50, half(mtf), rtol=1e-3)  # 4e-4 measured
    below = found.frequency <= 0.5
    assert_allclose(found.sfr[below], mtf(found.frequency[below]), atol=2e-3)  # 1e-3 measured, of the sharp bend at 0


@pytest.mark.parametrize(
    ("angle", "vertical", "seen"), [(5, True, -5), (-7, True, 7), (85, False, -5), (40, True, -40), (60, False, -30)]
)
def test_the_edge_is_found_where_it_is(angle, vertical, seen):
    found = slanted_edge(picture(gaussian(0.6), angle))
    assert found.vertical == vertical
    assert found.angle == pytest.approx(seen, abs=1e-4)
    turn = np.radians(angle)
    crossing = 199.8 + 0.2 * np.tan(turn) if vertical else 99.7 + 0.3 / np.tan(turn)
    assert found.place == pytest.approx(crossing, abs=1e-4)
    assert found.contrast == pytest.approx(0.6, abs=1e-5)


def test_turning_mirroring_inverting_and_scaling_a_picture_change_nothing():
    image = picture(camera(3.5, 0.741, 5), 5)
    first = slanted_edge(image)
    for other in (image.T, image[::-1], image[:, ::-1], 1 - image, 4095 * image + 64):
        again = slanted_edge(other)
        assert_allclose(again.sfr, first.sfr, atol=2e-6)  # the line is found to 1e-5 pixels
        assert_allclose(again.mtf50, first.mtf50, rtol=1e-5)


def test_what_stays_above_one_half_is_said_to():
    found = slanted_edge(picture(gaussian(0.3), 5), highest=0.5)
    assert found.not_reached
    assert np.isnan(found.mtf50)
    assert not found.above_nyquist
    assert found.mtf50_limited == 0.5
    assert slanted_edge(picture(gaussian(0.3), 5)).mtf50_limited == 0.5
    soft = slanted_edge(picture(gaussian(0.6), 5))
    assert soft.mtf50_limited == soft.mtf50


def test_the_smallest_picture_is_enough_where_the_edge_is_clear():
    found = slanted_edge(picture(gaussian(0.6), 5, (32, 32)))
    assert_allclose(found.mtf50, np.sqrt(np.log(2) / 2) / (np.pi * 0.6), rtol=1e-4)


def test_without_tails_the_light_thrown_far_is_missed():
    """By s/(pi^2 w) of the response for a slope -s of the MTF at zero: here s = 4/(pi 0.25), w about 200 pixels."""
    mtf = camera(0.25, 0.741, 5)
    image = picture(mtf, 5)
    f = np.linspace(0.02, 0.2, 50)
    missed = np.interp(f, *_curve(slanted_edge(image, tails=False))) / mtf(f) - 1
    assert missed.mean() > 1e-3
    put_back = np.interp(f, *_curve(slanted_edge(image))) / mtf(f) - 1
    assert np.abs(put_back).mean() < 0.1 * missed.mean()


def _curve(found):
    return found.frequency, found.sfr


def test_a_bent_edge_is_straightened_by_its_polynomial():
    image = 0.2 + 0.6 * profile(gaussian(0.6))(distances(5, bend=1.5))
    true = np.sqrt(np.log(2) / 2) / (np.pi * 0.6)
    straight, bent = slanted_edge(image, order=1), slanted_edge(image, order=2)
    assert abs(bent.mtf50 / true - 1) < 1e-3  # the distance is exact to first order in the bend only
    assert abs(straight.mtf50 / true - 1) > 0.1
    assert straight.residual > 20 * bent.residual


def test_more_knots_come_nearer_to_the_truth():
    """An edge whose response goes on far beyond Nyquist: the spline's knots are what limits it."""
    mtf = camera(10.4, 0.741, 5)
    image = picture(mtf, 5)
    errors = [abs(slanted_edge(image, knots_per_pixel=knots).mtf50 / half(mtf) - 1) for knots in (2, 3, 4, 8)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[3] < errors[2]


def test_noise_scatters_the_answer_about_the_truth():
    """With 1 % of the step: 0.7 % rms in the MTF50, its mean within the magnitude's bias of noise."""
    image = picture(gaussian(0.6), 5)
    true = np.sqrt(np.log(2) / 2) / (np.pi * 0.6)
    found = [slanted_edge(image + np.random.default_rng(seed).normal(0, 0.006, image.shape)) for seed in range(24)]
    error = np.array([one.mtf50 for one in found]) / true - 1
    assert np.std(error) < 0.0125
    assert abs(np.mean(error)) < 4 * np.std(error) / np.sqrt(24)
    assert_allclose([one.residual for one in found], 0.01, rtol=0.02)


def arc(radius, shape=(200, 400)):
    """An edge along a circle, at 10 degrees in the middle: the distance is exact."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    turn = np.radians(10)
    centre = np.array([0.5 * (shape[0] - 1), 0.5 * (shape[1] - 1)]) + radius * np.array([np.sin(turn), np.cos(turn)])
    return radius - np.hypot(y - centre[0], x - centre[1])


@pytest.mark.parametrize(("radius", "order"), [(4000, 2), (1000, 3), (600, 5)])
@pytest.mark.parametrize("sigma", [0.6, 1.2])
def test_a_curved_edge_is_measured_within_the_bound(radius, order, sigma):
    """Up to 8 pixels of bend. A blur of sigma alters the profile of a circle by sigma/(2 radius), far below the
    bound.
    """
    image = 0.2 + 0.6 * profile(gaussian(sigma))(arc(radius))
    found = slanted_edge(image, order=order)
    assert_allclose(found.mtf50, np.sqrt(np.log(2) / 2) / (np.pi * sigma), rtol=5e-4)  # bound 5e-3; 1e-4 measured


def test_the_other_figures_are_those_of_a_gaussian():
    found = slanted_edge(picture(gaussian(0.6), 5))
    assert_allclose(found.mtf10, np.sqrt(np.log(10) / 2) / (np.pi * 0.6), rtol=1e-4)
    assert_allclose(found.mtf_nyquist, gaussian(0.6)(0.5), rtol=1e-3)
    assert_allclose(found.rise, 2 * 1.2815515655 * 0.6, rtol=2e-4)  # 10 to 90 %
    beyond = 1 - erf(2 * np.pi * 0.6 * 0.5) / erf(2 * np.pi * 0.6 * 1.0)  # of the integral of exp(-4 pi^2 f^2 sigma^2)
    assert_allclose(found.aliasing, beyond, rtol=1e-3)
    assert slanted_edge(picture(gaussian(0.6), 5), highest=0.5).aliasing == 0


@pytest.mark.parametrize("angle", [2, 5, 10, 40, 85])
def test_the_bins_of_the_standard_err_by_percents_where_the_spline_does_not(angle):
    """Half contrast at 0.31 cycles/pixel: a bin takes sinc(f/4), the derivative's correction gives back more than is
    lost.
    """
    image = picture(gaussian(0.6), angle)
    true = np.sqrt(np.log(2) / 2) / (np.pi * 0.6)
    iso, spline = slanted_edge(image, method="iso"), slanted_edge(image)
    assert 2e-3 < abs(iso.mtf50 / true - 1) < 0.03
    assert abs(spline.mtf50 / true - 1) < 1e-4
    assert iso.angle == pytest.approx(spline.angle, abs=0.05)
    assert iso.contrast == pytest.approx(0.6, abs=0.01)


def test_each_correction_of_the_standard_does_what_it_is_for():
    """The three-point derivative loses 1 - sinc(2 f/4), a slant of 40 degrees shortens distances by its cosine."""
    image, f = picture(gaussian(0.6), 40), np.array([0.1, 0.2, 0.3])
    whole = binned(image)[1].response(f)
    cosine = binned(image, cosine=False)[1].response(f * np.cos(np.radians(40)))
    assert_allclose(cosine, whole, rtol=1e-3)  # the same curve over another axis
    plain = binned(image, derivative=False)[1].response(f)
    assert_allclose(plain, whole * np.sinc(2 * f * np.cos(np.radians(40)) / 4), rtol=1e-3)
    assert_allclose(binned(image, window="hamming")[1].response(f), whole, rtol=0.02)
    fine = binned(picture(gaussian(0.6), 5), bins=16)[1].response(f)
    assert_allclose(fine, gaussian(0.6)(f), atol=5e-3)  # finer bins take less
    assert (
        np.abs(binned(picture(gaussian(0.6), 5))[1].response(f) - gaussian(0.6)(f)).max()
        > 2 * np.abs(fine - gaussian(0.6)(f)).max()
    )


def test_the_bins_follow_a_curved_edge_too():
    image = 0.2 + 0.6 * profile(gaussian(0.6))(arc(1000))
    true = np.sqrt(np.log(2) / 2) / (np.pi * 0.6)
    assert abs(slanted_edge(image, order=3, method="iso").mtf50 / true - 1) < 0.03
    assert abs(slanted_edge(image, order=1, method="iso").mtf50 / true - 1) > 0.1


@pytest.mark.parametrize("angle", [0, 90, 45])
def test_an_edge_along_the_raster_is_refused(angle):
    with pytest.raises(ValueError, match="too few distances"):
        slanted_edge(picture(gaussian(0.6), angle, (100, 100)))


@pytest.mark.parametrize(
    "image",
    [np.ones((50, 50)), np.random.default_rng(1).normal(0, 1, (50, 50)), np.tile([0.0, 1.0], (50, 25))],
    ids=["even", "noise", "stripes"],
)
def test_what_is_no_edge_is_refused(image):
    with pytest.raises(ValueError, match="no edge that can be measured"):
        slanted_edge(image)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"order": 0}, "order is 0"),
        ({"knots_per_pixel": 0.5}, "knots_per_pixel is 0.5"),
        ({"half_width": 2}, "half_width is 2"),
        ({"highest": 3}, "highest is 3"),
        ({"samples": 1}, "samples is 1"),
        ({"method": "fft"}, "method is 'fft'"),
        ({"method": "iso", "sites": np.ones((40, 40), bool)}, "sites is given"),
        ({"sites": np.ones((40, 40))}, "sites has shape"),
    ],
)
def test_nonsense_is_refused_with_its_name_and_what_is_allowed(arguments, match):
    with pytest.raises(ValueError, match=match):
        slanted_edge(np.ones((40, 40)), **arguments)


@pytest.mark.parametrize("image", [np.ones((8, 8)), np.ones((3, 40, 40)), np.full((40, 40), np.nan)])
def test_a_picture_that_is_none_is_refused(image):
    with pytest.raises(ValueError, match="picture"):
        slanted_edge(image)
