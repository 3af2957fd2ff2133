"""Laws of light at the image plane: reference values, limits, and the relations between the models."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats
from numpy.testing import assert_allclose

from etendue_camera.constants import PLANCK, SPEED_OF_LIGHT
from etendue_camera.light.planck import planck_photon_radiance, planck_ratio
from etendue_camera.light.radiometry import (
    aplanatic_factor,
    cos4,
    disc_factor,
    disc_falloff,
    exit_pupil_distance,
    field_from_focal_length,
    flat_disc_factor,
    focal_length_from_field,
    photons_from_energy,
    plate_scale,
    t_number_of,
    working_f_number,
)
from tests.physics.reference import cases

f_numbers = floats(0.5, 1e6)
degrees = floats(0.0, 89.0)


def tangent(angle_deg):
    return np.tan(np.radians(angle_deg))


def test_aplanatic_factor_matches_the_reference():
    for given_, expected, rtol in cases("irradiance_abbe"):
        assert_allclose(aplanatic_factor(given_["N"], given_["m_signed"]), expected, rtol=rtol)


def test_flat_disc_with_cos4_matches_the_reference_for_real_images():
    for given_, expected, rtol in cases("irradiance_paraxial"):
        if given_["m_signed"] > 0.0:  # the paper's M = +1: refused, see below
            continue
        factor = flat_disc_factor(given_["N"], given_["m_signed"]) * cos4(tangent(given_["phi_deg"]))
        assert_allclose(factor, expected, rtol=rtol)


def test_exact_disc_matches_the_reference():
    for given_, expected, rtol in cases("irradiance_disk"):
        factor = disc_factor(given_["N"], tangent(given_["phi_deg"]), given_["m_signed"])
        assert_allclose(factor, expected, rtol=rtol)


def test_exact_disc_holds_in_float32():
    for given_, expected, _ in cases("irradiance_disk"):
        # the tangent is rounded to float32: t = 57 turns 6e-8 of it into 4 times as much of the result
        factor = disc_factor(given_["N"], np.float32(tangent(given_["phi_deg"])), given_["m_signed"])
        assert factor.dtype == np.float32
        assert_allclose(factor, expected, rtol=1e-6)


def test_photon_number_matches_the_reference():
    for given_, expected, rtol in cases("photons_from_energy"):
        assert_allclose(photons_from_energy(given_["E_J"], given_["lam_um"]), expected, rtol=rtol)


def test_planck_photon_radiance_matches_the_reference():
    for given_, expected, rtol in cases("planck_photon_radiance"):
        assert_allclose(planck_photon_radiance(given_["lam_um"], given_["T_K"]), expected, rtol=rtol)


def test_planck_ratio_matches_the_reference():
    for given_, expected, rtol in cases("planck_ratio"):
        ratio = planck_ratio(given_["lam_um"], given_["T_K"], given_["lam0_um"])
        assert_allclose(ratio, expected, rtol=rtol)


@given(f_number=f_numbers)
def test_aplanatic_lens_gains_exactly_one_quarter_over_the_square_of_the_f_number(f_number):
    ratio = aplanatic_factor(f_number) / flat_disc_factor(f_number)
    assert_allclose(ratio, 1.0 + 0.25 / f_number**2, rtol=1e-14)  # a few roundings


@given(f_number=f_numbers)
def test_exact_disc_on_the_axis_is_equation_five(f_number):
    assert_allclose(disc_factor(f_number, 0.0), flat_disc_factor(f_number), rtol=1e-14)  # a few roundings


@given(f_number=f_numbers, one=degrees, other=degrees)
def test_disc_falloff_is_one_on_the_axis_and_falls_outwards(f_number, one, other):
    inner, outer = sorted((tangent(one), tangent(other)))
    falloff = disc_falloff(f_number, np.array([0.0, inner, outer]))
    assert falloff[0] == 1.0
    assert np.all((falloff > 0.0) & (falloff <= 1.0))
    assert falloff[2] <= falloff[1] * (1.0 + 2e-15)  # rounding where the two angles coincide


@given(angle=degrees)
def test_small_pupils_fall_off_as_cos4(angle):
    # the next term is of order 1/(4 N^2) = 2.5e-9, times at most 2
    assert_allclose(disc_falloff(1e4, tangent(angle)), cos4(tangent(angle)), rtol=1e-8)


def test_exact_disc_equals_the_pupil_integral():
    # E/L is the integral of cos^4/z^2 over the pupil; rules of this size err below 1e-12
    for f_number, t in ((0.5, 0.3), (0.7, 1.0), (1.4, 3.0), (8.0, 0.6)):
        radius = 0.5 / f_number  # for a pupil at distance 1
        nodes, weights = np.polynomial.legendre.leggauss(60)
        r = 0.5 * radius * (1.0 + nodes)[:, None]
        angle = 2.0 * np.pi * (np.arange(400) + 0.5) / 400
        distance2 = 1.0 + t * t + r * r - 2.0 * r * t * np.cos(angle)
        ring = np.mean(1.0 / distance2**2, axis=1) * 2.0 * np.pi * r[:, 0]
        assert_allclose(disc_factor(f_number, t), 0.5 * radius * weights @ ring, rtol=1e-11)


@given(f_number=f_numbers, magnification=floats(-10.0, 0.0), pupil=floats(0.2, 5.0))
def test_a_closer_object_only_slows_the_lens(f_number, magnification, pupil):
    working = working_f_number(f_number, magnification, pupil)
    assert working >= f_number
    assert_allclose(disc_factor(working, 0.2), disc_factor(f_number, 0.2, magnification, pupil), rtol=1e-14)


def test_unit_magnification_doubles_the_working_f_number():
    assert working_f_number(8.0, -1.0) == 16.0


def test_the_signs_and_sizes_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match=r"magnification is 1\.0"):
        working_f_number(11.0, 1.0)
    for bad in (0.0, -2.8, np.nan):
        with pytest.raises(ValueError, match="f_number"):
            flat_disc_factor(bad)
    with pytest.raises(ValueError, match="pupil_magnification"):
        disc_factor(2.8, 0.0, -0.1, 0.0)
    with pytest.raises(ValueError, match=r"at least 0\.5"):
        aplanatic_factor(0.49)
    assert aplanatic_factor(0.4, -1.0) == pytest.approx(np.pi / (4 * 0.8**2))  # the working number counts


@given(wavelength=floats(0.1, 20.0), energy=floats(1e-25, 1e3))
def test_photons_carry_their_energy_back(wavelength, energy):
    quantum = PLANCK * SPEED_OF_LIGHT / (wavelength * 1e-6)
    assert_allclose(photons_from_energy(energy, wavelength) * quantum, energy, rtol=1e-14)  # a few roundings


def test_photon_radiance_integrates_to_the_photon_stefan_boltzmann_law():
    # total photon radiance: 2 zeta(3) Gamma(3) (kT)^3 / (h^3 c^2)
    total = 4.0 * 1.2020569031595943 * 1.380649e-23**3 / (PLANCK**3 * SPEED_OF_LIGHT**2) * 5000.0**3
    logs = np.linspace(np.log(0.01), np.log(1e6), 20001)
    wavelength = np.exp(logs)
    # trapezoid in ln(lambda): the integrand vanishes smoothly at the short end; the long end cuts off 1e-10
    integral = np.trapezoid(planck_photon_radiance(wavelength, 5000.0) * wavelength * 1e-6, logs)
    assert_allclose(integral, total, rtol=1e-8)


def test_planck_curves_survive_extremes_without_warnings():
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        assert planck_photon_radiance(0.1, 30.0) == 0.0
        assert planck_ratio(0.1, 30.0, 0.56) == 0.0
        assert planck_ratio(0.56, 2.0, 0.56) == 1.0
        assert np.isfinite(planck_photon_radiance(1e4, 1e6))


def test_planck_curves_refuse_cold_and_negative_inputs():
    for bad in ((0.0, 300.0), (0.5, 0.0), (-0.5, 300.0), (0.5, np.nan)):
        with pytest.raises(ValueError, match="above 0"):
            planck_photon_radiance(*bad)
        with pytest.raises(ValueError, match="above 0"):
            planck_ratio(*bad, 0.56)


@given(half_diagonal=floats(0.1, 100.0), half_field=floats(0.01, 1.5))
def test_field_and_focal_length_are_inverse(half_diagonal, half_field):
    focal = focal_length_from_field(half_diagonal, half_field)
    # the tangent's own sensitivity near pi/2 is 20
    assert_allclose(field_from_focal_length(half_diagonal, focal), half_field, rtol=1e-14)


def test_the_papers_sensor_needs_a_lens_of_seven_millimetres():
    focal = focal_length_from_field(4.0, np.radians(30.0))
    assert_allclose(focal, 4.0 * np.sqrt(3.0), rtol=1e-14)
    # equation 10 with its rounded constant
    assert_allclose(plate_scale(5.4, focal), 206265.0 * 5.4 / (1000.0 * focal), rtol=1e-6)


def test_impossible_geometry_is_refused():
    for bad in (0.0, np.pi / 2, -0.1, np.nan):
        with pytest.raises(ValueError, match="half_field_rad"):
            focal_length_from_field(4.0, bad)
    with pytest.raises(ValueError, match="focal_length_mm"):
        plate_scale(5.4, 0.0)
    with pytest.raises(ValueError, match="half_diagonal_mm"):
        field_from_focal_length(-1.0, 7.0)


@pytest.mark.parametrize("kernel", [cos4, lambda t: disc_factor(1.4, t), lambda t: disc_falloff(1.4, t)])
def test_field_kernels_keep_precision_shape_and_inputs(kernel):
    tangents = np.linspace(0.0, 5.0, 12, dtype=np.float32).reshape(3, 4)
    before = tangents.copy()
    result = kernel(tangents)
    assert result.dtype == np.float32
    assert result.shape == tangents.shape
    assert np.array_equal(tangents, before)
    assert_allclose(result, kernel(tangents.astype(float)), rtol=1e-6)  # float32 rounding


@given(
    f_number=floats(0.6, 64.0), transmittance=floats(0.01, 1.0), magnification=floats(-5.0, 0.0), pupil=floats(0.2, 5.0)
)
def test_a_t_number_is_the_f_number_of_a_lossless_lens_that_gives_as_much_light(
    f_number, transmittance, magnification, pupil
):
    t_number = t_number_of(f_number, transmittance)
    assert t_number >= f_number
    lossy = aplanatic_factor(f_number, magnification, pupil) * transmittance
    assert_allclose(aplanatic_factor(t_number, magnification, pupil), lossy, rtol=1e-14)  # a few roundings


@given(f_number=f_numbers, angle=floats(0.0, 80.0), magnification=floats(-3.0, 0.0), pupil=floats(0.2, 5.0))
def test_the_fall_off_stays_between_zero_and_one_for_any_lens(f_number, angle, magnification, pupil):
    falloff = disc_falloff(f_number, tangent(angle), magnification, pupil)
    assert 0.0 < falloff <= 1.0
    single = disc_falloff(f_number, np.float32(tangent(angle)), magnification, pupil)
    # the tangent is rounded to float32: at 80 degrees four times as much of the result
    assert_allclose(single, falloff, rtol=1e-6)


@given(f_number=floats(0.5, 1e6), angle=floats(0.0, 80.0))
def test_the_disc_tends_to_cos4_with_the_square_of_the_f_number(f_number, angle):
    t = tangent(angle)
    half_cone2 = 0.25 / f_number**2
    # the next term is of the order of the half cone squared, times at most 2 in the limit
    assert abs(disc_falloff(f_number, t) / cos4(t) - 1.0) <= 3.0 * half_cone2 + 1e-14


@given(focal=floats(1.0, 500.0), number=floats(0.7, 32.0), magnification=floats(-4.0, 0.0), pupil=floats(0.2, 5.0))
def test_the_cone_at_the_image_is_that_of_the_exit_pupil(focal, number, magnification, pupil):
    distance, diameter = exit_pupil_distance(focal, magnification, pupil), pupil * focal / number
    assert_allclose(distance / diameter, working_f_number(number, magnification, pupil), rtol=1e-14)


@given(focal=floats(1.0, 500.0), number=floats(0.7, 32.0), magnification=floats(-4.0, -1e-3), pupil=floats(0.2, 5.0))
def test_a_lens_keeps_the_etendue_between_object_and_image(focal, number, magnification, pupil):
    area = 7.3
    at_image = area * aplanatic_factor(max(number, 1.0), magnification, pupil)
    # on the object's side: the entrance pupil f/N stands f (1/m_p - 1/m) from the object, whose patch is area/m^2; the
    # sine condition makes |m| sin theta' of the marginal ray, which is half the pupil over its distance
    sine = 0.5 * focal / max(number, 1.0) / (focal * (1.0 / pupil - 1.0 / magnification))
    assert_allclose(area / magnification**2 * np.pi * sine**2, at_image, rtol=1e-13)


def test_what_no_lens_has_is_refused():
    for bad in (0.0, 1.1, np.nan):
        with pytest.raises(ValueError, match="transmittance is"):
            t_number_of(2.8, bad)
    with pytest.raises(ValueError, match="focal_length_mm is"):
        exit_pupil_distance(0.0)
    with pytest.raises(ValueError, match="magnification is 1"):
        exit_pupil_distance(50.0, 1.0)
    with pytest.raises(ValueError, match=r"at least 0\.5"):
        aplanatic_factor(0.3)
