"""Laws of the photodiode: reference values, limits in every length, bounds, monotony and cost."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats, sampled_from
from numpy.testing import assert_allclose

from etendue_camera.optics.diffraction import circular_otf
from etendue_camera.sensor import silicon
from etendue_camera.sensor.photodiode import (
    aperture_otf,
    collection,
    collection_mtf,
    collection_mtf_bands,
    collection_per_absorption,
)
from tests.physics.reference import cases

DIODE = ("alpha_per_um", "Ld_um", "L_um", "Ln_um")
BACKS = ("absorbing", "reflecting")


def decades(low, high):
    return floats(low, high).map(lambda exponent: 10.0**exponent)


absorptions = decades(-6.0, 3.0)
depletions = decades(-3.0, 2.0)
depths = decades(-2.0, 3.0)
lengths = decades(-1.0, 5.0)
frequencies = decades(-5.0, 3.0)
backs = sampled_from(BACKS)


LEGENDRE = [np.array(values, np.longdouble) for values in np.polynomial.legendre.leggauss(40)]


def by_quadrature(frequency, alpha, depletion, depth, length, back):
    """D(f) by the integral over depth of light absorbed times the chance to come up, in the widest floats there are."""
    alpha, depletion, depth = (np.longdouble(v) for v in (alpha, depletion, depth))
    x = depth * np.hypot(np.longdouble(1.0) / length, 2 * np.pi * np.longdouble(frequency))
    a = alpha * depth
    edges = min(np.longdouble(1), 60 / (a + x)) * np.array([0, 0.02, 0.06, 0.12, 0.25, 0.5, 0.75, 1], np.longdouble)
    half = np.diff(edges)[:, None] / 2
    y = edges[:-1, None] + half * (1 + LEGENDRE[0])
    if back == "absorbing":  # sinh(x(1 - y))/sinh(x) without overflow
        chance = np.exp(-x * y) * np.expm1(-2 * x * (1 - y)) / np.expm1(-2 * x)
    else:
        chance = np.exp(-x * y) * (1 + np.exp(-2 * x * (1 - y))) / (1 + np.exp(-2 * x))
    below = a * np.sum(half * LEGENDRE[1] * np.exp(-a * y) * chance)
    return -np.expm1(-alpha * depletion) + np.exp(-alpha * depletion) * below


@given(alpha=absorptions, depletion=depletions, depth=depths, length=lengths, f=frequencies, back=backs)
def test_contrast_is_that_of_the_integral_over_depth_in_every_corner_of_the_box(
    alpha, depletion, depth, length, f, back
):
    exact = float(
        by_quadrature(f, alpha, depletion, depth, length, back)
        / by_quadrature(0.0, alpha, depletion, depth, length, back)
    )
    assert_allclose(collection_mtf(f, alpha, depletion, depth, length, back), exact, rtol=2e-14)
    single = np.float32(f)
    exact = float(
        by_quadrature(single, alpha, depletion, depth, length, back)
        / by_quadrature(0.0, alpha, depletion, depth, length, back)
    )
    found = collection_mtf(single, alpha, depletion, depth, length, back)
    assert found.dtype == np.float32
    assert_allclose(found, exact, rtol=1e-6)


FRAME = np.hypot(np.linspace(0.0, 7.0, 130)[:, None], np.linspace(0.0, 7.0, 140)[None, :])


@given(alpha=absorptions, depletion=depletions, depth=depths, length=lengths, back=backs, scale=decades(-2.0, 0.15))
def test_the_table_of_radii_errs_by_less_than_1e_12(alpha, depletion, depth, length, back, scale):
    alphas = alpha * np.array([1.0, 0.1, 3e-3])
    found = collection_mtf_bands(scale * FRAME, alphas, depletion, depth, length, back)
    exact = collection_mtf_bands(scale * FRAME, alphas, depletion, depth, length, back, nodes=0)
    assert_allclose(found, exact, rtol=0, atol=1e-12)
    assert np.all(found[:, 0, 0] == 1.0)
    assert found.min() >= 0.0 and found.max() <= 1.0
    assert np.diff(found[:, :, 0], axis=1).max() <= 2e-12  # falls, to within the error of two values


def test_the_table_errs_by_the_fourth_power_of_its_step_and_by_rounding_for_silicon():
    alphas = silicon.absorption(np.linspace(0.38, 0.78, 9))
    exact = collection_mtf_bands(FRAME, alphas, 1.8, 10.0, 50.0, nodes=0)
    errors = [
        np.abs(collection_mtf_bands(FRAME, alphas, 1.8, 10.0, 50.0, nodes=n) - exact).max()
        for n in (512, 1024, 2048, 4096)
    ]
    assert errors[0] > 12 * errors[1] > 144 * errors[2]  # 16 a halving, in the limit
    assert errors[3] < 4e-14


def test_the_table_has_the_limits_of_endless_silicon_and_of_no_absorption():
    alphas = np.array([0.0, 1e-12, 0.6])
    for depth, length in ((10.0, np.inf), (np.inf, 50.0), (0.0, 50.0), (10.0, 50.0), (1e-2, 1e5)):
        exact = collection_mtf_bands(FRAME, alphas, 1.8, depth, length, nodes=0)
        assert_allclose(collection_mtf_bands(FRAME, alphas, 1.8, depth, length), exact, rtol=0, atol=1e-12)
    assert np.array_equal(collection_mtf_bands(FRAME, alphas, np.inf, 10.0, 50.0), np.ones((3, *FRAME.shape)))


@given(alpha=absorptions, depletion=depletions, depth=depths, length=lengths, f=frequencies, back=backs)
def test_charge_per_absorption_times_absorption_is_the_charge(alpha, depletion, depth, length, f, back):
    found = alpha * collection_per_absorption(f, alpha, depletion, depth, length, back)
    assert_allclose(found, collection(f, alpha, depletion, depth, length, back), rtol=1e-14)


def test_window_matches_the_reference():
    for given_, expected, rtol in cases("mtf_geometric"):
        # at an exact zero of the sinc the reference's tolerance is 1e-14 absolute
        assert_allclose(aperture_otf(given_["f_cyc_per_um"], given_["w_um"]), expected, rtol=rtol)


def test_collection_matches_the_reference():
    for given_, expected, rtol in cases("diffusion_D"):
        found = collection(given_["f_cyc_per_um"], *(given_[key] for key in DIODE))
        assert_allclose(found, expected, rtol=rtol)


@pytest.mark.parametrize(
    ("group", "back"), [("diffusion_mtf", "absorbing"), ("diffusion_mtf_reflecting", "reflecting")]
)
@pytest.mark.parametrize(("precision", "unit"), [(np.float64, 1e-14), (np.float32, 3e-7)])
def test_diffusion_contrast_matches_the_reference(group, back, precision, unit):
    for given_, expected, rtol in cases(group, unit):
        frequency = precision(given_["f_cyc_per_um"])
        found = collection_mtf(frequency, *(given_[key] for key in DIODE), back=back)
        assert found.dtype == precision
        # the reference's frequency is a binary64: rounding it to float32 costs 6e-8 times a slope below 1
        assert_allclose(found, expected, rtol=rtol)


def test_optics_diffusion_and_window_multiply_to_the_reference():
    for given_, expected, rtol in cases("system_mtf_x"):
        f = given_["f_cyc_per_um"]
        found = (
            circular_otf(f, given_["lam_um"], given_["N"])
            * collection_mtf(f, *(given_[key] for key in DIODE))
            * aperture_otf(f, given_["w_um"])
        )
        assert_allclose(found, expected, rtol=rtol)


@given(
    alpha=absorptions,
    depletion=depletions,
    depth=depths,
    length=lengths,
    f=frequencies,
    g=frequencies,
    back=backs,
)
def test_contrast_lies_between_zero_and_one_and_falls(alpha, depletion, depth, length, f, g, back):
    low, high = sorted((f, g))
    zero, one, other = collection_mtf(np.array([0.0, low, high]), alpha, depletion, depth, length, back)
    assert zero == 1.0
    assert 0.0 <= other <= 1.0 and 0.0 <= one <= 1.0
    assert other <= one * (1.0 + 1e-14)  # rounding where the two frequencies nearly coincide


@given(alpha=absorptions, depletion=depletions, depth=depths, length=lengths, f=frequencies, back=backs)
def test_collection_lies_between_the_depletion_layer_and_all_the_silicon(alpha, depletion, depth, length, f, back):
    found = collection(f, alpha, depletion, depth, length, back)
    slack = 1.0 + 1e-14  # rounding
    assert -np.expm1(-alpha * depletion) <= found * slack
    assert found <= -np.expm1(-alpha * (depletion + depth)) * slack


@given(alpha=absorptions, depletion=depletions, depth=depths, length=lengths, f=frequencies)
def test_a_reflecting_back_collects_at_least_as_much_as_an_absorbing_one(alpha, depletion, depth, length, f):
    absorbing, reflecting = (collection(f, alpha, depletion, depth, length, back) for back in BACKS)
    assert absorbing <= reflecting * (1.0 + 1e-14)  # rounding where the back is out of reach


@given(alpha=absorptions, depth=depths, length=lengths, f=frequencies, back=backs)
def test_a_depletion_layer_on_top_only_takes_its_share_first(alpha, depth, length, f, back):
    bare = collection(f, alpha, 0.0, depth, length, back)
    layered = collection(f, alpha, 1.8, depth, length, back)
    assert_allclose(layered, -np.expm1(-1.8 * alpha) + np.exp(-1.8 * alpha) * bare, rtol=2e-14)


@given(alpha=absorptions, depletion=depletions, length=lengths, f=frequencies)
def test_endless_silicon_has_the_closed_form_of_crowell_and_labuda(alpha, depletion, length, f):
    decay = np.hypot(1.0 / length, 2.0 * np.pi * f)
    kept, alone = np.exp(-alpha * depletion), -np.expm1(-alpha * depletion)
    expected = alone + kept * alpha / (alpha + decay)
    assert_allclose(collection(f, alpha, depletion, np.inf, length), expected, rtol=2e-14)
    # 45 diffusion or absorption lengths deep the back is out of reach to rounding
    deep = 45.0 / min(decay, alpha) if min(decay, alpha) > 0.05 else np.inf
    for back in BACKS:
        assert_allclose(collection(f, alpha, depletion, deep, length, back), expected, rtol=2e-14)


@given(depletion=depletions, depth=depths, length=lengths, f=frequencies)
def test_weak_absorption_has_a_limit(depletion, depth, length, f):
    def reach(decay):  # D/alpha as alpha vanishes
        return depletion + np.tanh(0.5 * decay * depth) / decay

    expected = reach(np.hypot(1.0 / length, 2.0 * np.pi * f)) / reach(1.0 / length)
    assert_allclose(collection_mtf(f, 0.0, depletion, depth, length), expected, rtol=2e-14)
    # the first order in alpha is at most the thickness times alpha
    nearly = collection_mtf(f, 1e-12, depletion, depth, length)
    assert_allclose(nearly, expected, rtol=2e-14 + 1e-12 * (depletion + depth))
    assert collection(f, 0.0, depletion, depth, length) == 0.0


@given(depletion=depletions, depth=depths, length=lengths, f=floats(0.0, 10.0), back=backs)
def test_strong_absorption_keeps_all_contrast(depletion, depth, length, f, back):
    # what escapes below the depletion layer is exp(-alpha Ld); what a bare layer loses is L_f's share
    assert collection_mtf(f, 1e5 / depletion, depletion, depth, length, back) == 1.0


@given(alpha=absorptions, depletion=depletions, depth=depths, back=backs)
def test_without_recombination_a_uniform_pattern_follows_the_elementary_solution(alpha, depletion, depth, back):
    a = alpha * depth
    if back == "reflecting":
        below = -np.expm1(-a)  # everything comes back
    elif a > 0.1:
        below = 1.0 + np.expm1(-a) / a  # a straight-line chance to reach the top
    else:
        below = a * sum((-a) ** k / np.prod(np.arange(1.0, k + 3.0)) for k in range(12))
    expected = -np.expm1(-alpha * depletion) + np.exp(-alpha * depletion) * below
    rtol = 2e-14 if a > 1.0 or a <= 0.1 or back == "reflecting" else 2e-13  # the elementary form cancels below 1
    assert_allclose(collection(0.0, alpha, depletion, depth, np.inf, back), expected, rtol=rtol)


@given(alpha=absorptions, depth=depths, back=backs, step=floats(-1e-6, 1e-6))
def test_nothing_happens_where_absorption_and_diffusion_lengths_agree(alpha, depth, back, step):
    # the printed form is 0/0 at alpha L_f = 1; the sensitivity to f is below 2
    frequency = alpha / (2.0 * np.pi)
    at, beside = collection(frequency * np.array([1.0, 1.0 + step]), alpha, 0.0, depth, np.inf, back)
    assert_allclose(beside, at, rtol=2.0 * abs(step) + 2e-14)


def test_the_two_forms_meet_without_a_step():
    for alpha in (1e-6, 0.1, 1.0, 10.0, 1e3):
        # L/L_f = 1 within a few roundings for L = 5 and no recombination
        frequency = (1.0 + np.array([-4e-16, 0.0, 4e-16])) / (2.0 * np.pi * 5.0)
        values = collection(frequency, alpha, 0.0, 5.0, np.inf)
        assert_allclose(values, values[1], rtol=2e-14)


def test_infinite_lengths_in_every_place_have_their_limits():
    f = np.array([0.0, 0.05, np.inf])
    with np.errstate(all="raise", under="ignore"):
        for back in BACKS:
            assert np.array_equal(collection_mtf(f, 0.6, np.inf, 10.0, 50.0, back), [1.0, 1.0, 1.0])
            assert np.array_equal(collection(f, 0.6, np.inf, 10.0, 50.0, back), [1.0, 1.0, 1.0])
            # charge from infinitely far away: any pattern is lost
            assert np.array_equal(collection_mtf(f, 0.0, 1.8, np.inf, np.inf, back), [1.0, 0.0, 0.0])
            everything = collection(f, 0.6, 1.8, np.inf, np.inf, back)
            assert_allclose(everything[[0, 2]], [1.0, -np.expm1(-0.6 * 1.8)], rtol=1e-15)
            # a fine pattern survives in the depletion layer only
            assert_allclose(collection(np.inf, 0.6, 1.8, 10.0, 50.0, back), -np.expm1(-0.6 * 1.8), rtol=1e-15)
            assert np.array_equal(collection_mtf(f, 0.6, 1.8, 0.0, 50.0, back), [1.0, 1.0, 1.0])


@given(width=floats(0.0, 50.0), frequency=floats(-20.0, 20.0))
def test_window_is_even_bounded_and_the_mean_over_its_width(width, frequency):
    value = aperture_otf(frequency, width)
    assert value == aperture_otf(-frequency, width)
    assert abs(value) <= 1.0
    assert aperture_otf(0.0, width) == 1.0
    assert_allclose(value * np.pi * frequency * width, np.sin(np.pi * frequency * width), rtol=0.0, atol=1e-12)


def test_window_reverses_contrast_beyond_its_first_zero():
    assert aperture_otf(0.3, 4.0) < 0.0 < aperture_otf(0.2, 4.0)


@pytest.mark.parametrize("back", BACKS)
@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_kernels_keep_shape_precision_and_inputs_and_know_no_sign(back, precision):
    f = np.linspace(-0.5, 0.5, 24, dtype=precision).reshape(2, 3, 4)
    before = f.copy()
    for kernel in (collection, collection_mtf):
        found = kernel(f, np.float64(0.64), 1.8, 10.0, 50.0, back)
        assert found.shape == f.shape and found.dtype == precision
        assert np.array_equal(found, kernel(-f, 0.64, 1.8, 10.0, 50.0, back))
        exact = kernel(f.astype(float), 0.64, 1.8, 10.0, 50.0, back)
        assert_allclose(found, exact, rtol=1e-6)  # float32 rounding through some ten operations
    assert aperture_otf(f, np.float64(4.0)).dtype == precision
    assert np.array_equal(f, before)


def test_missing_frequencies_stay_missing():
    assert np.isnan(collection_mtf(np.array([0.1, np.nan]), 0.64, 1.8, 10.0, 50.0)[1])


def test_parameters_without_meaning_are_refused_by_name():
    good = {
        "absorption": 0.64,
        "depletion": 1.8,
        "diffusion_depth": 10.0,
        "diffusion_length": 50.0,
        "back": "absorbing",
    }
    faults = {
        "absorption": (-0.1, np.inf, np.nan),
        "depletion": (-0.1, np.nan),
        "diffusion_depth": (-0.1, np.nan),
        "diffusion_length": (0.0, -1.0, np.nan),
        "back": ("shiny",),
    }
    for name, values in faults.items():
        for value in values:
            for kernel in (collection, collection_mtf):
                with pytest.raises(ValueError, match=f"{name} is "):
                    kernel(0.1, **(good | {name: value}))
    with pytest.raises(ValueError, match="both 0"):
        collection_mtf(0.1, **(good | {"depletion": 0.0, "diffusion_depth": 0.0}))
    with pytest.raises(ValueError, match="width is -1"):
        aperture_otf(0.1, -1.0)


@pytest.mark.parametrize("back", BACKS)
def test_all_bands_at_once_have_the_bits_of_each_alone(back):
    """Strong and weak absorption, none, and one at which a product would lose its digits."""
    alphas, frequency = np.array([0.0, 1e-310, 1e-6, 0.3, 7.0, 900.0]), np.append(0.0, np.geomspace(1e-4, 10.0, 40))
    together = collection_mtf_bands(frequency, alphas, 1.0, 7.0, 50.0, back)
    for alpha, ours in zip(alphas, together, strict=True):
        assert ours.tobytes() == np.asarray(collection_mtf(frequency, float(alpha), 1.0, 7.0, 50.0, back)).tobytes()
