"""Laws of the diffraction-limited lens: reference values, closed forms, energy and symmetry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.strategies import floats, integers
from numpy.testing import assert_allclose
from scipy.special import roots_legendre

from etendue_camera.optics.diffraction import (
    AIRY_DIAMETER,
    RAYLEIGH,
    SPARROW,
    airy_diameter,
    airy_encircled,
    airy_intensity,
    airy_outside,
    airy_psf_density,
    circular_otf,
    cutoff_frequency,
    pixel_airy,
    rayleigh_separation,
    sparrow_separation,
    two_point_saddle,
)
from tests.physics.reference import cases, extra

wavelengths = floats(0.3, 1.2)
f_numbers = floats(0.7, 128.0)


@pytest.mark.parametrize(
    ("group", "kernel"),
    [
        # tolerances follow the sensitivity to v, which for the pattern itself grows with v: 1e-14 of the
        # envelope per unit of v is what the argument of a Bessel function leaves in binary64
        ("airy_intensity", airy_intensity),
        ("airy_psf_density", airy_psf_density),
        ("airy_encircled", airy_encircled),
        ("airy_outside", airy_outside),
        ("otf_diffraction", circular_otf),
    ],
)
def test_kernel_matches_the_reference(group, kernel):
    for given_, expected, rtol in cases(group):
        assert_allclose(kernel(*given_.values()), expected, rtol=rtol, atol=1e-300)


def test_energy_on_a_pixel_matches_the_reference():
    for given_, expected, _ in cases("pixel_airy"):
        # the four edges are each of order 0.1: their rounding is what a faint pixel is left with
        assert_allclose(pixel_airy(*given_.values()), expected, rtol=1e-14, atol=1e-15)


def test_resolution_numbers_match_the_reference():
    airy = {
        key: [float(v) for v in value] if isinstance(value, list) else float(value)
        for key, value in extra("airy").items()
    }
    rtol = 1e-15  # constants of 18 digits
    assert_allclose(AIRY_DIAMETER, airy["first_dark_ring_diameter_in_lamN"], rtol=rtol)
    assert_allclose(RAYLEIGH, airy["zeros_of_pattern_in_lamN(radius)"][0], rtol=rtol)
    assert_allclose(RAYLEIGH / 2.0, airy["rayleigh_sep_in_lambda_over_NA"], rtol=rtol)
    assert_allclose(SPARROW, airy["sparrow_sep_in_lamN"], rtol=rtol)
    zeros = np.array(airy["zeros_of_pattern_in_lamN(radius)"])
    # the amplitude at a dark ring is the rounding of v, 1e-15, times its slope, below 1: its square is less
    assert np.all(airy_intensity(zeros, 1.0, 1.0) < 1e-30)
    assert_allclose(airy_encircled(zeros, 1.0, 1.0), airy["encircled_at_zeros"], rtol=1e-14)
    half_width = airy["fwhm_diameter_in_lamN"] / 2.0
    assert_allclose(airy_intensity(half_width, 1.0, 1.0), 0.5, rtol=1e-14)


def test_two_spots_dip_as_in_the_reference():
    for given_, (ratio, offset), rtol in cases("two_point_saddle"):
        separation = given_["sep_in_lambda_over_NA"]
        found_ratio, found_offset = two_point_saddle(separation)
        assert_allclose(found_ratio, ratio, rtol=rtol)
        # near Sparrow's separation the peaks part as a square root, which magnifies the rounding of the input
        sensitivity = max(1.0, 0.5 * separation / abs(separation - SPARROW / 2.0))
        assert_allclose(found_offset, offset, rtol=rtol * sensitivity)


def test_spots_merge_exactly_at_sparrows_separation():
    ratio, offset = two_point_saddle(np.array([0.0, 0.3, SPARROW / 2.0 - 1e-6, SPARROW / 2.0 + 1e-4]))
    assert np.array_equal(ratio[:3], [1.0, 1.0, 1.0])
    assert np.array_equal(offset[:3], [0.0, 0.0, 0.0])
    assert ratio[3] < 1.0 and offset[3] > 0.0


@given(separation=floats(0.5, 50.0))
def test_peaks_of_separate_spots_stand_near_the_spots(separation):
    ratio, offset = two_point_saddle(separation)
    assert 0.0 <= ratio < 1.0
    # the other spot's rings move a peak by their slope over its curvature: 0.09 at 0.5, ever less beyond
    assert abs(offset - separation / 2.0) < 0.09


@given(v=floats(1e-9, 1e6))
def test_encircled_and_outside_energy_are_complementary(v):
    r = v / np.pi
    # a few ulp of 1, the finest such a sum can resolve
    assert_allclose(airy_encircled(r, 1.0, 1.0) + airy_outside(r, 1.0, 1.0), 1.0, rtol=0.0, atol=1e-15)


@given(v=floats(1e-12, 1e-3))
def test_encircled_energy_starts_as_the_square_of_the_radius(v):
    # v^2/4 (1 - v^2/8 + ...): the neglected term is below 1e-14
    assert_allclose(airy_encircled(v / np.pi, 1.0, 1.0), v * v / 4.0 * (1.0 - v * v / 8.0), rtol=2e-14)


@given(v=floats(1e3, 1e9))
def test_energy_outside_tends_to_two_over_pi_v(v):
    # the ripple is cos(2v)/(2v) relative
    assert_allclose(airy_outside(v / np.pi, 1.0, 1.0) * np.pi * v / 2.0, 1.0, rtol=0.0, atol=1.0 / v)


def test_outside_energy_is_continuous_where_its_two_forms_meet():
    r = 30.0 / np.pi * (1.0 + np.array([-1e-12, 1e-12]))
    inner, outer = airy_outside(r, 1.0, 1.0)
    assert_allclose(inner, outer, rtol=1e-11)  # slope times the step of 2e-12, and rounding


def test_density_integrates_to_the_encircled_energy():
    nodes, weights = roots_legendre(200)
    for reach in (0.5, 3.0, 40.0):
        r = 0.5 * reach * (1.0 + nodes)
        ring = airy_psf_density(r, 0.55, 2.8) * 2.0 * np.pi * r
        # 200 points resolve the 26 rings to rounding
        assert_allclose(0.5 * reach * weights @ ring, airy_encircled(reach, 0.55, 2.8), rtol=1e-13)


def test_pattern_is_one_at_the_centre_and_dark_at_infinity():
    radii = np.array([0.0, 5e-324, 1e-300, 1e-12, np.inf])
    with np.errstate(all="raise", under="ignore"):
        assert np.array_equal(airy_intensity(radii, 0.55, 2.8), [1.0, 1.0, 1.0, 1.0, 0.0])
        assert np.array_equal(airy_encircled(radii[[0, 4]], 0.55, 2.8), [0.0, 1.0])
        assert np.array_equal(airy_outside(radii[[0, 4]], 0.55, 2.8), [1.0, 0.0])


@given(wavelength=wavelengths, f_number=f_numbers)
def test_transfer_function_runs_from_exactly_one_to_exactly_zero(wavelength, f_number):
    cutoff = cutoff_frequency(wavelength, f_number)
    values = circular_otf(np.linspace(0.0, 1.2, 61) * cutoff, wavelength, f_number)
    assert values[0] == 1.0
    assert np.all(np.diff(values) <= 0.0)
    assert np.all(values[51:] == 0.0)
    assert np.all(values[:50] > 0.0)


@given(exponent=floats(-12.0, -3.0))
def test_transfer_function_leaves_the_cutoff_as_the_power_three_halves(exponent):
    nu = 1.0 - 10.0**exponent
    gap = 1.0 - nu  # what binary64 kept of it
    leading = 8.0 * np.sqrt(2.0) / (3.0 * np.pi) * gap**1.5
    # the slope is -(4/pi) sqrt(1 - nu^2), integrated term by term; the first term left out is 3/224 gap^2
    assert_allclose(circular_otf(nu, 1.0, 1.0), leading * (1.0 - 0.15 * gap), rtol=0.02 * gap**2 + 1e-14)


def test_transfer_function_has_its_closed_forms_half_way_and_in_area():
    # nu = 1/2: (2/pi)(pi/3 - sqrt(3)/4); two roundings
    assert_allclose(circular_otf(0.5, 1.0, 1.0), 2.0 / 3.0 - np.sqrt(3.0) / (2.0 * np.pi), rtol=1e-15)
    nodes, weights = roots_legendre(400)
    area = 0.5 * weights @ circular_otf(0.5 * (1.0 + nodes), 1.0, 1.0)
    assert_allclose(area, 4.0 / (3.0 * np.pi), rtol=1e-8)  # the cut-off's power 3/2 limits Gauss's rule


def test_peak_density_is_the_volume_under_the_transfer_function():
    nodes, weights = roots_legendre(400)
    nu = 0.5 * (1.0 + nodes)
    volume = 0.5 * weights @ (2.0 * np.pi * nu * circular_otf(nu, 1.0, 1.0))
    assert_allclose(volume, airy_psf_density(0.0, 1.0, 1.0), rtol=1e-8)  # as above


def test_transfer_function_broadcasts_over_wavelengths_and_stays_float32():
    frequency = np.linspace(0.0, 1.0, 300, dtype=np.float32).reshape(15, 20)
    values = circular_otf(frequency, 0.55, np.float64(2.8))
    assert values.dtype == np.float32
    # nu is rounded to float32, which costs 1.5/(1 - nu) times 6e-8: compare absolutely
    assert_allclose(values, circular_otf(frequency.astype(float), 0.55, 2.8), rtol=0.0, atol=3e-7)
    bands = np.array([0.45, 0.55, 0.65])[:, None, None]
    stacked = circular_otf(frequency, bands, 2.8)
    assert stacked.shape == (3, 15, 20)
    assert_allclose(stacked[1], circular_otf(frequency.astype(float), 0.55, 2.8), rtol=1e-12)


def test_missing_values_stay_missing():
    assert np.isnan(circular_otf(np.array([0.1, np.nan]), 0.55, 2.8)[1])
    assert np.isnan(airy_intensity(np.nan, 0.55, 2.8))


@settings(deadline=None, max_examples=30)  # a few hundred Bessel calls each
@given(row=integers(-40, 40), column=integers(-40, 40))
def test_eight_pixels_share_one_value(row, column):
    rows, columns = np.array([row, -row, column, -column]), np.array([column, column, -row, row])
    shares = pixel_airy(rows, columns, 3.0, 0.55, 4.0)
    assert np.all(shares == shares[0])


def test_pixels_hold_what_a_circle_leaves_them():
    # a square block of pixels: more than the inscribed circle's energy, less than the circumscribed circle's
    for pitch, f_number in ((5.4, 2.8), (1.12, 8.0), (1.12, 128.0)):
        index = np.arange(-20, 21)
        total = pixel_airy(index[:, None], index, pitch, 0.55, f_number).sum()
        inner, outer = airy_encircled(20.5 * pitch * np.array([1.0, np.sqrt(2.0)]), 0.55, f_number)
        assert inner < total < outer


def test_nine_small_pixels_make_a_large_one():
    # the corner pixel (1, 1) of pitch 3 covers the nine pixels 2..4 of pitch 1, over which both are exact
    index = np.arange(2, 5)
    parts = pixel_airy(index[:, None], index, 1.0, 0.55, 2.0).sum()
    assert_allclose(pixel_airy(1, 1, 3.0, 0.55, 2.0), parts, rtol=1e-13)


@settings(deadline=None, max_examples=30)
@given(row=integers(0, 60), column=integers(0, 60), f_number=floats(1.0, 128.0))
def test_tiny_pixels_sample_the_density(row, column, f_number):
    pitch = 1e-3
    centre = airy_psf_density(pitch * np.hypot(row, column), 0.55, f_number) * pitch**2
    # the pattern's curvature times pitch^2/24 is below 1e-6 of its value in this range
    assert_allclose(pixel_airy(row, column, pitch, 0.55, f_number), centre, rtol=1e-5)


def test_separations_scale_with_wavelength_and_f_number():
    assert_allclose(airy_diameter(0.555, 8.0), 2.44 * 0.555 * 8.0, rtol=3e-4)  # the paper's 10.83 um, rounded
    assert_allclose(rayleigh_separation(0.555, 8.0), airy_diameter(0.555, 8.0) / 2.0, rtol=1e-15)
    assert sparrow_separation(0.555, 8.0) < 1.0 / cutoff_frequency(0.555, 8.0) < rayleigh_separation(0.555, 8.0)


@pytest.mark.parametrize("kernel", [airy_intensity, airy_psf_density, airy_encircled, airy_outside, circular_otf])
def test_kernels_refuse_what_has_no_meaning_and_leave_inputs_alone(kernel):
    with pytest.raises(ValueError, match="wavelength is 0"):
        kernel(1.0, 0.0, 2.8)
    with pytest.raises(ValueError, match="f_number is -1"):
        kernel(1.0, 0.55, -1.0)
    values = np.linspace(-1.0, 1.0, 12, dtype=np.float32).reshape(3, 4)
    before = values.copy()
    result = kernel(values, 0.55, 2.8)
    assert result.dtype == np.float32 and result.shape == values.shape
    assert np.array_equal(values, before)
    assert_allclose(result, kernel(-values, 0.55, 2.8), rtol=0.0)  # radial: the sign does not matter


def test_other_arguments_are_refused_by_name():
    with pytest.raises(ValueError, match="whole numbers"):
        pixel_airy(0.5, 0, 5.4, 0.55, 2.8)
    with pytest.raises(ValueError, match="pitch is 0"):
        pixel_airy(0, 0, 0.0, 0.55, 2.8)
    with pytest.raises(ValueError, match="separation"):
        two_point_saddle(-0.1)
    for kernel in (airy_diameter, rayleigh_separation, sparrow_separation, cutoff_frequency):
        with pytest.raises(ValueError, match="f_number"):
            kernel(0.55, 0.0)
