"""A response that bends never falls, is undone by its inverse, and is the one of its formula."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue_camera.electronics import periodic, response
from etendue_camera.electronics.stages.read_out import Adc, Linearise


@given(st.floats(0.5, 8), st.floats(0, 0.5), st.floats(1, 1e6))
def test_the_inverse_undoes_the_response(order, share, full):
    bend = share / (order + 1)
    charge = full * np.concatenate([[-0.1, 0.0, 1e-9], np.linspace(0.001, 1, 101)])
    back = response.unbent(response.bent(charge, bend, order, full), bend, order, full)
    np.testing.assert_allclose(back, charge, rtol=4e-15, atol=1e-14 * full)


@given(st.floats(0.5, 8), st.floats(0.01, 0.99))
def test_the_response_never_falls_and_bends_by_what_it_says(order, share):
    bend, full = share / (order + 1), 1e4
    out = response.bent(full * np.linspace(-1, 5, 3001), bend, order, full)
    assert (np.diff(out) >= -1e-11 * full).all()
    assert response.bent(full, bend, order, full) == pytest.approx(full * (1 - bend), rel=1e-14)
    assert np.isfinite(response.bent(np.array([np.inf]), bend, order, full)).all() or bend == 0


def test_a_response_that_would_turn_is_refused():
    with pytest.raises(ValueError, match="below 0.25, where the response turns"):
        Adc(response_bend=0.3, response_order=3.0)


@pytest.mark.parametrize("order", [1.0, 3.0])
def test_linearise_is_proportional_to_light_whatever_the_bend(order):
    """Within half a code, over the slope of the response at the top."""
    given = {"response_bend": 0.04, "response_order": order, "conversion_gain": 0.25, "bits": 12, "black_level": 64}
    adc, straight = Adc(**given), Linearise(**given, read_noise=0.0, dsnu=0.0)
    charge = np.linspace(0, 0.999 * adc.saturation(), 500)
    raw = adc.run(charge)["raw"]
    found = straight.run(raw)["mosaic_linear"]
    step = 0.5 / (0.25 * (1 - 0.04 * (order + 1))) / adc.saturation()
    np.testing.assert_allclose(found, charge / adc.saturation(), atol=1.001 * step)


def test_without_a_bend_nothing_changes():
    charge = np.linspace(-10, 1e5, 400)
    assert (Adc(response_order=3.0).run(charge)["raw"] == Adc().run(charge)["raw"]).all()


@given(st.integers(0, 200), st.integers(0, 200), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-1, 1))
def test_a_window_of_a_periodic_pattern_is_the_crop_of_the_whole(row, column, fy, fx, phase):
    whole = periodic.offsets(np.arange(300), np.arange(300), [3.0], [fy], [fx], [phase])
    part = periodic.offsets(row + np.arange(90), column + np.arange(80), [3.0], [fy], [fx], [phase])
    np.testing.assert_allclose(part, whole[row : row + 90, column : column + 80], atol=1e-12)
    y, x = np.mgrid[:300, :300]
    np.testing.assert_allclose(whole, 3 * np.cos(2 * np.pi * (fy * y + fx * x + phase)), atol=1e-10)
