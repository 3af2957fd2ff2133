"""Area averages: what a picture becomes on another grid."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.transfer import resampling

sizes = st.integers(1, 40)


@given(n_in=sizes, n_out=sizes)
def test_weights_are_overlaps_over_the_length_of_a_sample(n_in, n_out):
    """Against the overlap of every pair of samples, counted in whole parts: equal bits."""
    out_start, in_start = n_in * np.arange(n_out)[:, None], n_out * np.arange(n_in)
    overlap = np.minimum(out_start + n_in, in_start + n_out) - np.maximum(out_start, in_start)
    assert np.array_equal(resampling.area_weights(n_in, n_out), np.maximum(overlap, 0) / n_in)


@pytest.mark.parametrize("block", [1, 300, 1 << 22])
@pytest.mark.parametrize("size", [(1, 1), (7, 11), (60, 5), (80, 90)])
def test_a_picture_is_averaged_whatever_the_blocks(monkeypatch, block, size):
    """Against the two dense products; 20 to 30 positive terms are summed in another order: 4e-16 of the largest."""
    monkeypatch.setattr(resampling, "_BLOCK", block)
    picture = np.random.default_rng(2).integers(0, 256, (31, 23, 3)).astype(np.uint8)
    found = resampling.area_average(picture, *size, lambda values: (values / 255.0) ** 2)
    down, across = resampling.area_weights(31, size[0]), resampling.area_weights(23, size[1])
    truth = down @ ((picture / 255.0) ** 2).transpose(2, 0, 1) @ across.T
    np.testing.assert_allclose(found, truth, atol=4e-16, rtol=0)
    assert found.mean() == pytest.approx(((picture / 255.0) ** 2).mean(), abs=1e-14)


@pytest.mark.parametrize("block", [1, 300, 1 << 22])
def test_an_enlarged_picture_repeats_its_samples_and_averages_few(monkeypatch, block):
    """Bit for bit; sums are over as many rows as the picture has, whatever the size of the result."""
    monkeypatch.setattr(resampling, "_BLOCK", block)
    picture, summed, of = np.random.default_rng(3).random((3, 4, 3)), [], resampling._Pieces.of
    monkeypatch.setattr(resampling._Pieces, "of", lambda *given: (summed.append(found := of(*given)), found)[1])
    found = resampling.area_average(picture, 300, 200, np.square)
    assert np.array_equal(found, np.square(picture).transpose(2, 0, 1).repeat(100, axis=1).repeat(50, axis=2))
    assert sum(one.size for one in summed) <= 2 * picture.size
