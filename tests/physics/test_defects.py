"""Defective pixels: shares, lists, the law of hot pixels."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.sensor import defects


def test_every_kind_has_its_share_and_no_pixel_has_two():
    uniform = (np.arange(10_000).reshape(100, 100) + 0.5) / 10_000
    found = defects.drawn_map(uniform, 0.02, 0.01, 0.03)
    assert [np.count_nonzero(found == k) for k in range(4)] == [9400, 200, 100, 300]


def test_more_defects_keep_those_that_were_there():
    uniform = np.random.default_rng(0).random((50, 50))
    few, many = defects.drawn_map(uniform, 0.01, 0.0, 0.0), defects.drawn_map(uniform, 0.1, 0.0, 0.0)
    assert np.all(many[few == defects.HOT] == defects.HOT)


def test_hot_pixels_follow_the_exponential_law():
    rates = defects.hot_rates((np.arange(100_000) + 0.5) / 100_000, 50.0)
    # moments of an exponential; a midpoint rule in a logarithm loses 1e-5 at its end
    assert_allclose([rates.mean(), rates.std()], [50.0, 50.0], rtol=1e-3)
    assert defects.hot_rates(np.zeros(1, np.float32), 50.0).dtype == np.float32


def test_a_list_stands_at_absolute_pixels(tmp_path):
    file = tmp_path / "defects.csv"
    file.write_text("# of sensor 7\nrow,column,kind\n3,4,hot\n10,2,dead\n0,0,stuck\n")
    entries = defects.read_list(file)
    assert entries == ((3, 4, defects.HOT), (10, 2, defects.DEAD), (0, 0, defects.STUCK))
    whole = defects.listed_map(entries, np.arange(12.0), np.arange(6.0))
    assert whole[3, 4] == defects.HOT
    assert np.count_nonzero(whole) == 3
    assert_array_equal(defects.listed_map(entries, np.arange(2.0, 5.0), np.arange(3.0, 6.0)), whole[2:5, 3:6])


@pytest.mark.parametrize(
    "text", ["y,x,kind\n1,2,hot\n", "row,column,kind\n1,2,warm\n", "row,column,kind\n1.5,2,hot\n", ""]
)
def test_a_list_that_cannot_be_read_says_what_it_should_hold(tmp_path, text):
    file = tmp_path / "defects.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match="expected"):
        defects.read_list(file)


@pytest.mark.parametrize("shares", [(-0.1, 0.0, 0.0), (0.5, 0.4, 0.2), (float("nan"), 0.0, 0.0)])
def test_impossible_shares_are_refused(shares):
    with pytest.raises(ValueError, match="^hot, dead and stuck are"):
        defects.drawn_map(np.zeros((2, 2)), *shares)


def test_a_negative_rate_is_refused():
    with pytest.raises(ValueError, match="^mean_rate is -1"):
        defects.hot_rates(np.zeros(2), -1.0)
