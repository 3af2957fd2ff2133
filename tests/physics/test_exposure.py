"""Dark charge, limiting currents, signal-to-noise ratio, dynamic range, and the converter behind them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.constants import ELEMENTARY_CHARGE
from etendue_camera.electronics import converter, dynamic_range
from tests.physics.reference import cases

electrons = st.floats(0.0, 1e9)
noises = st.floats(0.0, 1e4)


def dark(case):
    return case["idc_A"] * case["t_s"] / ELEMENTARY_CHARGE


GROUPS = {
    "i_max": lambda c: dynamic_range.saturation_current(c["Qmax_e"], c["t_s"], c["idc_A"]),
    "i_min": lambda c: dynamic_range.smallest_current(c["t_s"], c["idc_A"], c["sr_e"], c["sdsnu_e"]),
    "dr_db": lambda c: dynamic_range.dynamic_range_elgamal(c["Qmax_e"], dark(c), c["sr_e"], c["sdsnu_e"]),
    "snr_db": lambda c: dynamic_range.snr_db(c["Ne"], dark(c), c["sr_e"], c["sdsnu_e"], c["prnu"]),
    "emva_snr": lambda c: dynamic_range.emva_snr(c["mu_p"], c["eta"], c["K_DN_per_e"], c["sigma_d_e"]),
    "emva_mu_p_min": lambda c: dynamic_range.emva_smallest_photons(c["eta"], c["K_DN_per_e"], c["sigma_d_e"]),
    "emva_mu_p_min_approx": lambda c: dynamic_range.emva_smallest_photons_approx(
        c["eta"], c["K_DN_per_e"], c["sigma_d_e"]
    ),
}


@pytest.mark.parametrize("group", GROUPS)
def test_the_high_precision_cases_are_held(group):
    for case, expected, rtol in cases(group):
        assert_allclose(GROUPS[group](case), expected, rtol=rtol, err_msg=str(case))


def test_one_femtoampere_for_a_second_is_6241_electrons():
    # 1 fA on 5.4 um square: 1e-15 / q = 6241.5; four roundings
    density = 1e-15 / (5.4**2 * 1e-8)
    assert_allclose(dynamic_range.dark_electrons(density, 5.4**2, 1.0), 1e-15 / ELEMENTARY_CHARGE, rtol=1e-15)


@given(well=st.floats(10, 1e7), time=st.floats(1e-6, 1e2), read=st.floats(0.1, 1e3), dsnu=noises)
def test_dynamic_range_is_the_ratio_of_the_limiting_currents(well, time, read, dsnu):
    current = 0.3 * well * ELEMENTARY_CHARGE / time
    filled = current * time / ELEMENTARY_CHARGE
    largest = dynamic_range.saturation_current(well, time, current)
    ratio = largest / dynamic_range.smallest_current(time, current, read, dsnu)
    # dB of a rounded ratio: 8.7 x a few 1e-16, absolute
    expected = dynamic_range.dynamic_range_elgamal(well, filled, read, dsnu)
    assert_allclose(20 * np.log10(ratio), expected, rtol=1e-14, atol=2e-14)


@given(well=st.floats(1, 1e9), dark=electrons, more=st.floats(1e-3, 1e9), read=noises, dsnu=noises)
def test_more_dark_charge_never_widens_the_dynamic_range(well, dark, more, read, dsnu):
    for quantity in (
        lambda n: dynamic_range.dynamic_range_elgamal(well, n, read, dsnu),
        lambda n: dynamic_range.dynamic_range_emva(well, n, read, 0.1),
    ):
        assert quantity(dark + more) <= quantity(dark)


def test_a_well_full_of_dark_charge_has_no_dynamic_range_and_a_noiseless_pixel_no_limit():
    assert dynamic_range.dynamic_range_elgamal(1e4, 1e4, 0.0, 0.0) == -np.inf
    assert dynamic_range.dynamic_range_elgamal(1e4, 2e4, 5.0, 0.0) == -np.inf
    assert dynamic_range.dynamic_range_elgamal(1e4, 0.0, 0.0, 0.0) == np.inf
    assert dynamic_range.dynamic_range_emva(1e4, 2e4, 5.0, 1.0) == -np.inf
    assert dynamic_range.snr_db(0.0, 0.0, 0.0, 0.0, 0.0) == -np.inf


@given(eta=st.floats(0.01, 1.0), gain=st.floats(1e-3, 1e3), noise=noises)
def test_the_signal_to_noise_ratio_is_one_at_the_smallest_photons(eta, gain, noise):
    photons = dynamic_range.emva_smallest_photons(eta, gain, noise)
    assert_allclose(dynamic_range.emva_snr(photons, eta, gain, noise), 1.0, rtol=2e-15)


@given(well=st.floats(10, 1e9), dark=st.floats(0, 5), read=noises, gain=st.floats(1e-3, 1e3))
def test_asking_for_snr_one_is_stricter_than_asking_for_the_dark_noise(well, dark, read, gain):
    strict = dynamic_range.dynamic_range_emva(well, dark, read, gain)
    assert strict < dynamic_range.dynamic_range_elgamal(well, dark, read, 0.0)
    # a noiseless camera still needs one electron for SNR = 1
    assert_allclose(dynamic_range.dynamic_range_emva(well, 0.0, 0.0, np.inf), 20 * np.log10(well), rtol=1e-14)


def test_infinite_light_is_limited_by_prnu_alone():
    # at 1e30 electrons the shot noise is 1e-13 of the PRNU's: 20 log10(1/prnu) to rounding, and no overflow
    assert_allclose(dynamic_range.snr_db(1e30, 0.0, 20.0, 10.0, 0.01), 40.0, rtol=1e-14)
    assert_allclose(dynamic_range.snr_db(np.float32(1e30), np.float32(0), *np.float32([20, 10, 0.01])), 40, rtol=1e-6)


def test_float32_maps_stay_float32():
    charge = np.linspace(0, 1e4, 7, dtype=np.float32)
    scalars = np.float32([12.0, 3.0, 1.0, 0.01])
    assert dynamic_range.snr_db(charge, *scalars).dtype == np.float32
    assert dynamic_range.dynamic_range_elgamal(charge, *scalars[:3]).dtype == np.float32


@pytest.mark.parametrize(
    "call",
    [
        lambda: dynamic_range.dark_electrons(-1e-9, 1.0, 1.0),
        lambda: dynamic_range.saturation_current(1e4, 0.0, 0.0),
        lambda: dynamic_range.smallest_current(1.0, 0.0, np.nan, 0.0),
        lambda: dynamic_range.dynamic_range_elgamal(1e4, 0.0, [1.0, -1.0], 0.0),
        lambda: dynamic_range.emva_snr(1.0, 0.0, 1.0, 0.0),
        lambda: dynamic_range.emva_smallest_photons(1.0, 0.0, 0.0),
    ],
)
def test_impossible_sensors_are_refused(call):
    with pytest.raises(ValueError, match=r"allowed: numbers (at or )?above 0"):
        call()


@given(bits=st.integers(1, 32), gain=st.floats(1e-3, 1e3), seed=st.integers(0, 2**32 - 1))
def test_codes_are_whole_clipped_and_rise_with_the_charge(bits, gain, seed):
    top = 2**bits - 1
    black = 0.1 * top
    charge = np.sort(np.random.default_rng(seed).uniform(-0.3 * top / gain, 1.3 * top / gain, 50))
    codes = converter.digitise(charge, gain, black, bits)
    assert codes.dtype == (np.uint16 if bits <= 16 else np.uint32)
    assert np.all(np.diff(codes.astype(np.int64)) >= 0)
    inside = (charge * gain + black > 0) & (charge * gain + black < top)
    error = codes[inside] - (charge * gain + black)[inside]
    assert np.all(np.abs(error) <= 0.5 + 1e-15 * top)  # half a step, and the rounding of the two products
    assert_array_equal(converter.digitise([-np.inf, np.inf], gain, black, bits), [0, top])


def test_halves_round_up():
    assert_array_equal(converter.digitise([0.5, 1.5, 2.5, 2.49], 1.0, 0.0, 8), [1, 2, 3, 2])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bits", [8, 12, 16, 24, 32])
def test_black_becomes_zero_white_one_and_the_dark_tail_stays_negative(bits, dtype):
    black, top = 2 ** (bits - 4), 2**bits - 1
    linear = converter.linearise(np.array([0, black, top], np.uint32), black, bits, dtype)
    assert linear.dtype == dtype
    assert_allclose(linear[0], -black / (top - black), rtol=1.2e-7 if dtype == np.float32 else 2e-16)
    assert linear[1] == 0
    assert linear[2] == 1


@given(bits=st.integers(1, 32), seed=st.integers(0, 2**32 - 1))
def test_digitising_what_was_linearised_returns_the_codes(bits, seed):
    top = 2**bits - 1
    black = top // 8
    codes = np.random.default_rng(seed).integers(0, top, 50, endpoint=True)
    linear = converter.linearise(codes, black, bits, np.float64)
    assert_array_equal(converter.digitise(linear, float(top - black), black, bits), codes)


@pytest.mark.parametrize(
    ("charge", "gain", "black", "bits", "name"),
    [
        ([1.0, np.nan], 1.0, 0.0, 8, "charge"),
        ([1.0], 0.0, 0.0, 8, "gain_dn_per_electron"),
        ([1.0], 1.0, 255.0, 8, "black_level"),
        ([1.0], 1.0, -1.0, 8, "black_level"),
        ([1.0], 1.0, 0.0, 33, "bits"),
        ([1.0], 1.0, 0.0, 7.5, "bits"),
    ],
)
def test_impossible_converters_are_refused_by_name(charge, gain, black, bits, name):
    with pytest.raises(ValueError, match=name):
        converter.digitise(charge, gain, black, bits)
