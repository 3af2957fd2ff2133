"""The measurement of a sensor against sensors whose figures are known: few seeds here, 200 in benchmarks/emva.py."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue_camera.electronics import emva
from etendue_camera.electronics.jackknife import Jackknife, left_out

GAIN, WELL, READ, DARK, PRNU, DSNU, BLACK = 0.25, 12_000.0, 6.0, 300.0, 0.02, 8.0, 100.0
TIMES = np.concatenate([np.linspace(0.005, 0.07, 8), [0.08, 0.09, 0.1, 0.15, 0.2]])
RATE = WELL / 0.1


def sensor(seed, rate, shape=(48, 64), frames=2, gain=GAIN, times=TIMES, drift=0.0):
    """Raw frames by plain numpy, nothing of the product: (level, frame, y, x)."""
    pattern = np.random.default_rng([seed, 0])
    response, offset = 1 + PRNU * pattern.standard_normal(shape), DSNU * pattern.standard_normal(shape)
    noise = np.random.default_rng([seed, 1, int(rate > 0)])
    lamp = 1 + drift * noise.standard_normal((len(times), frames, 1, 1))
    expected = (rate * lamp * response + DARK) * times[:, None, None, None]
    charge = np.minimum(noise.poisson(np.broadcast_to(expected, (len(times), frames, *shape))), WELL)
    charge = charge + READ * noise.standard_normal(charge.shape) + offset
    return np.clip(np.floor(charge * gain + BLACK + 0.5), 0, 4095).astype(np.uint16)


@pytest.fixture(scope="module")
def measured():
    return [emva.measure(TIMES, sensor(seed, RATE), sensor(seed, 0.0)) for seed in range(12)]


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("gain", GAIN),
        ("read_noise", READ),
        ("dark_current", DARK),
        ("full_well", WELL),
        ("prnu", PRNU),
        ("dsnu", DSNU),
        ("absolute_sensitivity", 0.5 + math.sqrt(0.25 + READ**2 + 1 / (12 * GAIN**2))),
    ],
)
def test_what_was_put_in_comes_out_within_its_interval(measured, name, truth):
    assert not any(m.hidden for m in measured)
    estimates = [getattr(m, name) for m in measured]
    # fixed seeds; 12 intervals of 95 %: three outside has probability 0.02, and half of them outside never happens
    assert sum(e.low <= truth <= e.high for e in estimates) >= 10
    wide = np.mean([e.high - e.low for e in estimates]) / 2
    assert abs(np.mean([e.value for e in estimates]) - truth) < wide  # 3.5 standard errors of a mean of 12
    assert 0 < wide < 0.2 * truth


def test_a_larger_frame_has_narrower_intervals_as_the_root_of_its_pixels(measured):
    big = emva.measure(TIMES, sensor(1, RATE, (96, 128)), sensor(1, 0.0, (96, 128)))
    for name in ("gain", "prnu", "read_noise"):
        wide = [
            np.mean([getattr(m, name).high - getattr(m, name).low for m in measured]),
            getattr(big, name).high - getattr(big, name).low,
        ]
        # the width of a 64-block jackknife scatters by 1 / sqrt(2 x 63) = 9 %: 4 of them
        assert_allclose(wide[1] / wide[0], 0.5, rtol=0.36)


def test_saturation_by_the_variance_lies_under_the_full_well_by_less_than_two_levels(measured):
    for m in measured:
        assert 0.8 * WELL < m.saturation_capacity.value < WELL
        expected = 20 * math.log10(m.saturation_capacity.value / m.absolute_sensitivity.value)
        assert_allclose(m.dynamic_range.value, expected, rtol=1e-12)
        assert_allclose(m.snr_max.value, 10 * math.log10(m.saturation_capacity.value), rtol=1e-12)


def test_a_linear_sensor_is_linear_and_a_bent_one_is_not(measured):
    # each level's mean has a standard error of about 1e-4 of itself, from pixels and shot noise
    assert all(m.linearity_error.value < 1e-3 for m in measured)
    light, dark = sensor(0, RATE).astype(float), sensor(0, 0.0)
    bent = light - 0.05 * (light - BLACK) ** 2 / (GAIN * WELL)
    assert emva.measure(TIMES, bent, dark).linearity_error.value > 5e-3


def test_a_lamp_that_flickers_between_frames_does_not_become_noise_of_pixels():
    # 1 % of 12 000 electron is 120: as much as the shot noise at the top
    steady, flickering = (emva.measure(TIMES, sensor(3, RATE, drift=d), sensor(3, 0.0)) for d in (0.0, 0.01))
    assert abs(flickering.gain.value / steady.gain.value - 1) < 0.03


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_intervals_over_blocks_hold_the_truth_as_often_as_they_say(confidence):
    """2000 means of white noise: a share is right to 0.018 and 0.01, two standard errors."""
    rng, jackknife, count = np.random.default_rng(2), Jackknife(confidence), left_out(np.ones((16, 16)))
    found = [jackknife.of(left_out(rng.standard_normal((16, 16))) / count, "") for _ in range(2000)]
    held = np.mean([one.low <= 0 <= one.high for one in found])
    assert abs(held - confidence) < 2 * np.sqrt(confidence * (1 - confidence) / 2000)


def test_photons_give_the_quantum_efficiency():
    photons = RATE * TIMES / 0.6
    found = emva.measure(TIMES, sensor(4, RATE), sensor(4, 0.0), photons).quantum_efficiency
    assert found.low < 0.6 < found.high


def test_frames_that_never_saturate_say_nothing_of_saturation_and_hold_the_rest():
    found = emva.measure(TIMES, sensor(5, RATE / 4), sensor(5, 0.0))
    assert np.isnan(
        [found.full_well.value, found.saturation_capacity.value, found.dynamic_range.value, found.snr_max.value]
    ).all()
    assert found.gain.low < GAIN < found.gain.high
    assert found.prnu.low < PRNU < found.prnu.high


def test_quantisation_that_hides_the_read_noise_leaves_an_upper_limit():
    whole = emva.measure(TIMES, sensor(6, RATE, gain=0.02), sensor(6, 0.0, gain=0.02))
    found = whole.read_noise
    assert whole.hidden
    assert np.isnan(found.value)
    assert_allclose(found.high, 0.4 / 0.02, rtol=0.2)


def test_more_frames_a_level_serve_the_patterns():
    stacks = [sensor(7, r, frames=8) for r in (RATE, 0.0)]
    few = emva.measure(TIMES, [s[:2] for s in stacks[0]], [s[:2] for s in stacks[1]])
    many = emva.measure(
        TIMES,
        [s if i == 5 else s[:2] for i, s in enumerate(stacks[0])],
        [s if i == 5 else s[:2] for i, s in enumerate(stacks[1])],
    )
    assert many.pattern_level == 5
    assert many.dsnu.high - many.dsnu.low < few.dsnu.high - few.dsnu.low


@pytest.mark.parametrize(
    ("times", "light", "dark", "confidence", "said"),
    [
        (TIMES[:3], sensor(0, RATE)[:3], sensor(0, 0.0)[:3], 0.95, "times are"),
        (TIMES[::-1], sensor(0, RATE), sensor(0, 0.0), 0.95, "times are"),
        (TIMES, sensor(0, RATE)[:5], sensor(0, 0.0), 0.95, "light has 5 stacks"),
        (TIMES, sensor(0, RATE)[:, :1], sensor(0, 0.0), 0.95, "the stacks have frames"),
        (TIMES, sensor(0, RATE)[..., :7], sensor(0, 0.0)[..., :7], 0.95, "the stacks have frames"),
        (TIMES, sensor(0, RATE)[..., :9], sensor(0, 0.0), 0.95, "the frames are"),
        (TIMES, sensor(0, RATE), sensor(0, 0.0), 1.0, "confidence is 1"),
        (TIMES, sensor(0, 0.0), sensor(0, 0.0), 0.95, "photon transfer"),
    ],
)
def test_frames_that_are_no_measurement_are_refused(times, light, dark, confidence, said):
    with pytest.raises(ValueError, match=said):
        emva.measure(times, light, dark, confidence=confidence)
