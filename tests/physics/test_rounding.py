"""The mean error of rounding: a sawtooth that noise smooths away."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue_camera.electronics.rounding import lasting_error


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.2, 0.4])
def test_it_is_the_largest_mean_error_of_rounded_draws(noise):
    values = np.linspace(0, 1, 41)
    draws = np.random.default_rng(1).standard_normal(200_000)
    worst = max(abs(float(np.rint(v + noise * draws).mean()) - v) for v in values)
    assert lasting_error(1.0, noise) == pytest.approx(
        worst, abs=4e-3
    )  # four standard errors of 200,000 draws, and the grid of values


@given(step=st.floats(1e-6, 1e6), noise=st.floats(0, 3), more=st.floats(0, 1))
def test_it_scales_with_the_step_and_falls_with_noise(step, noise, more):
    found = lasting_error(step, noise * step)
    assert 0 <= found <= 0.5 * step
    assert found == pytest.approx(step * lasting_error(1.0, noise), rel=1e-9, abs=1e-12 * step)
    assert lasting_error(step, (noise + more) * step) <= found + 1e-3 * step  # where the two forms meet


def test_without_noise_it_is_half_a_step_and_both_forms_meet():
    assert lasting_error(2.0, 0.0) == 1.0
    assert lasting_error(0.0, 1.0) == 0.0
    below, above = lasting_error(1.0, 0.3), lasting_error(1.0, 0.3 + 1e-9)
    assert above == pytest.approx(below, rel=2e-3)
    assert above == pytest.approx(math.exp(-2 * (0.3 * math.pi) ** 2) / math.pi, rel=1e-6)
