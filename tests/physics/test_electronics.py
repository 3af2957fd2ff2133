"""Dark current by temperature, noise by gain, saturation: closed forms and limits."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.electronics import amplifier

KELVIN = st.floats(200.0, 400.0)


@given(reference=KELVIN, doubling=st.floats(0.0, 20.0))
def test_dark_current_is_as_given_at_its_reference_temperature(reference, doubling):
    assert amplifier.dark_current_factor(reference, reference, doubling) == 1.0


@given(temperature=KELVIN, reference=KELVIN)
def test_there_and_back_is_no_change_and_warmer_is_more(temperature, reference):
    there = amplifier.dark_current_factor(temperature, reference)
    assert_allclose(
        there * amplifier.dark_current_factor(reference, temperature), 1.0, rtol=1e-13
    )  # exponents of up to 30
    assert (there > 1) == (temperature > reference) or temperature == reference


def test_a_stated_doubling_doubles():
    assert amplifier.dark_current_factor(310.0, 300.0, 10.0) == 2.0
    assert amplifier.dark_current_factor(273.0, 300.0, 9.0) == 0.125


def test_the_activation_energy_is_half_the_band_gap():
    # d ln I / d(-1/kT) = Eg/2 - T/2 dEg/dT + 3/2 kT, by a central difference whose error is 1e-8 of it
    temperature, step = 300.0, 0.01
    energy = math.log(amplifier.dark_current_factor(temperature + step, temperature - step)) / (
        (1 / (temperature - step) - 1 / (temperature + step)) / amplifier.BOLTZMANN_EV
    )
    slope = -7.021e-4 * temperature * (temperature + 2 * 1108) / (temperature + 1108) ** 2
    expected = (
        0.5 * amplifier.silicon_band_gap(temperature)
        - 0.5 * temperature * slope
        + 1.5 * amplifier.BOLTZMANN_EV * temperature
    )
    assert_allclose(energy, expected, rtol=1e-6)
    # data sheets say "doubles every 6 to 10 K"
    assert 8 < math.log(2) / math.log(amplifier.dark_current_factor(298.65, 297.65)) < 9


def test_noise_behind_the_amplifier_vanishes_at_high_gain_and_noise_in_front_of_it_stays():
    assert amplifier.read_noise_at_gain(3.0, 4.0, 1.0) == 5.0
    assert amplifier.read_noise_at_gain(3.0, 0.0, 0.25) == 3.0
    assert amplifier.read_noise_at_gain(0.0, 8.0, 16.0) == 0.5
    assert_allclose(amplifier.read_noise_at_gain(3.0, 4.0, 1e9), 3.0, rtol=1e-15)


def test_saturation_is_the_well_or_the_top_code_whichever_comes_first():
    assert amplifier.saturation_charge(1000.0, 0.5, 55.0, 8) == 400.0
    assert amplifier.saturation_charge(300.0, 0.5, 55.0, 8) == 300.0


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: amplifier.dark_current_factor(20.0, 300.0), "temperature_K is 20"),
        (lambda: amplifier.dark_current_factor(300.0, float("nan")), "reference_K is nan"),
        (lambda: amplifier.dark_current_factor(300.0, 290.0, -1.0), "doubling_K is -1"),
        (lambda: amplifier.silicon_band_gap(-1.0), "temperature_K is -1"),
        (lambda: amplifier.read_noise_at_gain(-1.0, 0.0, 1.0), "before_gain is -1"),
        (lambda: amplifier.read_noise_at_gain(1.0, 0.0, 0.0), "analogue_gain is 0"),
        (lambda: amplifier.saturation_charge(1.0, 0.0, 0.0, 8), "gain_dn_per_electron is 0"),
        (lambda: amplifier.saturation_charge(1.0, 1.0, 255.0, 8), "black_level is 255"),
    ],
)
def test_impossible_electronics_are_refused(call, said):
    with pytest.raises(ValueError, match=f"^{said}"):
        call()
