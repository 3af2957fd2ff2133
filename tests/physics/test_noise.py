"""Counts against the exact Poisson law, codes against the exact rounding law, patterns against the sensor."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import special, stats

from etendue.compute import random
from etendue_camera.electronics import distributions, noise, poisson_table
from tests.physics.reference import cases


@pytest.mark.parametrize("group", ["poisson_pmf", "poisson_logpmf"])
def test_the_high_precision_probabilities_are_held(group):
    law = getattr(distributions, group)
    for case, expected, rtol in cases(group):
        assert_allclose(law(case["k"], case["lam"]), expected, rtol=rtol, err_msg=str(case))


def test_the_high_precision_moments_of_rounding_are_held():
    for case, expected, rtol in cases("quantised_gauss"):
        error, variance = distributions.quantised_gauss_moments(case["mu_lsb"], case["sigma_lsb"])
        # the file sets mean errors below 1e-50 to 0; the series gives 2e-78 there
        assert_allclose(error, expected[0], rtol=rtol, atol=1e-50, err_msg=str(case))
        # a variance that is all tail depends on sigma as exp(-1/(8 sigma^2)): its condition is 1/(4 sigma^2),
        # and half an ulp of 1/2 / sigma costs 1.6e-14 at sigma = 0.05
        condition = max(1.0, 0.25 / case["sigma_lsb"] ** 2) if case["sigma_lsb"] else 1.0
        assert_allclose(variance, expected[1], rtol=rtol * condition, err_msg=str(case))


@given(mean=st.floats(0, 1e4))
def test_probabilities_sum_to_one(mean):
    counts = np.arange(math.ceil(mean + 40 * math.sqrt(mean) + 60))
    # each relative error is 2e-16 x |log p| of a few tens; the weights sum to 1
    assert_allclose(distributions.poisson_pmf(counts, mean).sum(), 1.0, rtol=2e-14)


@given(mu=st.floats(-1e3, 1e3), sigma=st.floats(0.3, 0.4))
def test_the_two_ways_to_the_moments_of_rounding_agree(mu, sigma):
    offset = np.array([mu - math.floor(mu + 0.5)])
    tails = distributions._by_tails(offset, np.array([sigma]))
    series = distributions._by_series(offset, np.array([sigma]))
    assert_allclose(tails[0], series[0], rtol=0, atol=1e-15)  # terms of order 0.5
    assert_allclose(tails[1], series[1], rtol=2e-14)


@given(mu=st.floats(-100, 100), sigma=st.floats(1.5, 100))
def test_wide_noise_makes_rounding_error_uniform(mu, sigma):
    error, variance = distributions.quantised_gauss_moments(mu, sigma)
    # the first harmonic is exp(-2 pi^2 1.5^2) = 5e-20
    assert abs(error) < 1e-19
    assert_allclose(variance, sigma**2 + 1 / 12, rtol=1e-15)


def test_the_normal_form_is_within_a_thousandth_of_poisson_and_improves_with_the_mean():
    means = [10, 20, 30, 50, 100, 1e3, 1e4, 1e5]
    variation = [distributions.poisson_total_variation(m, 10.0) for m in means]
    assert max(variation) <= 1e-3
    assert variation == sorted(variation, reverse=True)
    # third-order expansion: the error falls as mean^-3/2
    assert_allclose(variation[-2] / variation[-3], 10**-1.5, rtol=0.02)
    # computed independently on a grid of normals: 5.5e-4 and 1.8e-4
    assert_allclose(variation[:2], [5.5e-4, 1.8e-4], rtol=0.03)
    assert distributions.poisson_total_variation(29.9) == 0
    assert distributions.poisson_total_variation(1e12) == variation[-1]


def test_total_variation_is_what_the_sampler_does():
    # the law of the sampler itself, from evenly spaced quantiles: resolved to k / n = 2e-4 / 4
    mean, n = 12.0, 200_000
    normal = special.ndtri((np.arange(n) + 0.5) / n)
    drawn = np.bincount(noise.cornish_fisher(np.full(n, mean), normal).astype(int), minlength=60) / n
    expected = distributions.poisson_pmf(np.arange(len(drawn)), mean)
    measured = 0.5 * np.abs(drawn - expected).sum()
    assert_allclose(measured, distributions.poisson_total_variation(mean, 10.0), rtol=0, atol=5e-5)


@pytest.mark.parametrize("mean", [10.0, 25.1, 30.0, 100.0, 1e4, 1e6])
def test_the_normal_form_keeps_the_skewness_of_poisson(mean):
    counts, weight = distributions.normal_form_pmf(mean)
    centred = counts - weight @ counts
    variance, third = weight @ centred**2, weight @ centred**3
    assert_allclose(weight.sum(), 1.0, rtol=1e-14)
    # the expansion is of third order: what is left falls as 1/mean; a rounded normal has 0 here
    assert_allclose(third / variance**1.5 * math.sqrt(mean), 1.0, rtol=0.2 / mean + 1e-5)
    with pytest.raises(ValueError, match="it must be"):
        distributions.normal_form_pmf(9.0)


def test_uniforms_of_a_sensor_are_uniform_and_a_window_is_the_crop():
    whole = random.tiled_uniform(b"sensor", -10, 5, 200, 150)
    assert whole.dtype == np.float64
    assert whole.min() >= 0
    assert whole.max() < 1
    for value in (
        whole,
        whole * 2**24 % 1,
        whole * 2**44 % 1,
    ):  # as even between steps of 24 bits, and of 44, as over all
        # 5 standard errors of a mean and of a variance of 30 000 uniforms
        assert abs(value.mean() - 0.5) < 5 / math.sqrt(12 * whole.size)
        assert abs(value.var() - 1 / 12) < 5 / math.sqrt(180 * whole.size)
    assert_array_equal(random.tiled_uniform(b"sensor", 60, 40, 30, 77), whole[70:100, 35:112])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("mean", [0.0, 1e-3, 1.0, 29.0, 31.0, 1e3])
def test_counts_follow_the_poisson_law(mean, dtype):
    n = 100_000
    counts = noise.poisson(np.full((100, n // 100), mean, dtype), np.random.default_rng(7))
    assert counts.dtype == dtype
    assert np.all(counts == np.floor(counts))
    drawn = np.bincount(counts.astype(int).ravel())
    expected = n * distributions.poisson_pmf(np.arange(len(drawn)), mean)
    some = expected > 10
    chi2 = np.sum((drawn - expected)[some] ** 2 / expected[some])
    # fixed seed: passes or fails once and for all; a wrong law at these n fails by far
    assert special.chdtrc(max(some.sum() - 1, 1), chi2) > 1e-3


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("mean", [1e5, 1e9, 1e12])
def test_large_counts_keep_mean_and_variance(mean, dtype):
    n = 100_000
    counts = noise.poisson(np.full(n, mean, dtype), np.random.default_rng(3))
    centred = counts.astype(float) - float(dtype(mean))
    # 5 standard errors: of the mean sqrt(variance/n), of the variance variance sqrt(2/n); float32 rounds
    # counts to its own step, which is up to 0.07 sigma here
    rounding = float(np.spacing(dtype(mean))) ** 2 / 12
    assert abs(centred.mean()) < 5 * math.sqrt((mean + rounding) / n)
    assert abs(centred.var() - mean - rounding) < 5 * (mean + rounding) * math.sqrt(2 / n)


def test_infinity_as_threshold_is_the_exact_sampler_beyond_the_table():
    means = np.geomspace(poisson_table.LIMIT, 1e15, 1000)
    drawn = noise.poisson(means, np.random.default_rng(1), math.inf)
    assert_array_equal(drawn, np.random.default_rng(1).poisson(means))


def test_small_counts_follow_the_poisson_law_at_two_hundred_means():
    """Chi-square of 20,000 draws at each mean, from the smallest to the end of the table, also at both ends of bins."""
    below = poisson_table.LIMIT
    bins = np.arange(1, 50) * below / 50
    means = np.concatenate([np.geomspace(1e-4, below, 102, endpoint=False), bins, np.nextafter(bins, 0)])
    assert len(means) == 200
    draws, rng = 20_000, np.random.default_rng(11)
    for mean in means:
        counts = noise.poisson(np.full(draws, mean), rng, 100.0)
        expected = draws * stats.poisson.pmf(np.arange(200), mean)
        # classes of at least five expected counts; all counts beyond the last form one
        low, high = np.flatnonzero(expected >= 5)[[0, -1]]
        sums = np.add.reduceat(expected, np.unique([0, *range(low, high + 2)]))
        drawn = np.add.reduceat(np.bincount(counts.astype(int), minlength=200), np.unique([0, *range(low, high + 2)]))
        some = sums > 1
        chi2 = np.sum((drawn - sums)[some] ** 2 / sums[some])
        assert stats.chi2.sf(chi2, max(some.sum() - 1, 1)) > 1e-6, mean


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_counts_from_the_table_are_the_inverse_of_the_distribution(dtype):
    """At random, at the ends of bins and cells, in both tails, and one rounding beside the steps of F: what is drawn
    from a uniform is decided by `pdtr` alone.
    """
    rng = np.random.default_rng(4)
    ends = np.arange(1, poisson_table.LIMIT * poisson_table.BINS) / poisson_table.BINS
    means = np.concatenate(
        [[0.0, 1e-300, 1e-9], ends, np.nextafter(ends, 0), rng.uniform(0, poisson_table.LIMIT, 3000)]
    )
    means = np.minimum(means.astype(dtype), np.nextafter(dtype(poisson_table.LIMIT), dtype(0)))
    exact = means.astype(float)
    steps = special.pdtr(special.pdtrik(rng.random(means.size), np.maximum(exact, 1e-9)).round(), exact)
    cells = rng.integers(0, poisson_table.CELLS, means.size) / poisson_table.CELLS
    tails = 2.0 ** -rng.integers(2, 54, means.size)
    for uniform in (
        rng.random(means.size),
        steps,
        np.nextafter(steps, 0),
        cells,
        np.nextafter(cells, 1),
        tails,
        1 - tails,
    ):
        uniform = np.clip(uniform, 0, 1 - 2.0**-53)
        counts = poisson_table.quantiles(means, uniform)
        assert counts.dtype == dtype
        k = counts.astype(float)
        assert np.all(uniform < special.pdtr(k, exact))
        some = k > 0
        assert np.all(uniform[some] >= special.pdtr(k[some] - 1, exact[some]))


def test_the_draws_of_a_frame_do_not_depend_on_the_blocks_they_are_made_in(monkeypatch):
    means = np.random.default_rng(2).permutation(np.geomspace(1e-3, 1e4, 5000)).astype(np.float32)
    whole = noise.poisson(means, np.random.default_rng(5), 300.0)
    monkeypatch.setattr(noise, "BLOCK", 77)
    assert_array_equal(noise.poisson(means, np.random.default_rng(5), 300.0), whole)


def test_a_mixed_frame_draws_few_and_many_each_their_own_way():
    means = np.tile([0.0, 5.0, 100.0, 1e6], 20_000).reshape(100, 800)
    counts = noise.poisson(means, np.random.default_rng(5)).reshape(-1, 4)
    assert_array_equal(counts[:, 0], 0)
    # 5 standard errors of the mean and of the variance (with the fourth cumulant at mean 5)
    m, n = means.reshape(-1, 4)[0, 1:], len(counts)
    assert np.all(np.abs(counts[:, 1:].mean(axis=0) - m) < 5 * np.sqrt(m / n))
    assert np.all(np.abs(counts[:, 1:].var(axis=0) - m) < 5 * np.sqrt((m + 2 * m**2) / n))


def test_empty_and_single_frames_are_frames():
    rng = np.random.default_rng(0)
    assert noise.poisson(np.empty((0, 3), np.float32), rng).shape == (0, 3)
    assert noise.poisson_by_inversion(np.empty((0, 3)), np.empty((0, 3))).shape == (0, 3)
    assert noise.poisson(np.float32(50), rng).dtype == np.float32
    assert noise.poisson(np.float32(5), rng).dtype == np.float32


@pytest.mark.parametrize("mean", [1e17, 1e19, 1e30])
def test_means_beyond_what_counts_hold_have_the_spread_of_a_poisson_law(mean):
    """A standard deviation of sqrt(mean), of 40,000 draws to 5 sigma: 1.8 %; float64 rounds 1e30 by 1e14, a tenth of
    it.
    """
    drawn = noise.poisson(np.full(40_000, mean), np.random.default_rng(1))
    assert (drawn - mean).std() == pytest.approx(np.sqrt(mean), rel=0.018)
    with pytest.raises(ValueError, match="mean ranges from"):  # every draw exact: beyond numpy's own sampler
        noise.poisson(np.array([1e19]), np.random.default_rng(1), np.inf)


@pytest.mark.parametrize("bad", [np.nan, -1e-12, 1e37])
def test_means_without_a_poisson_law_are_refused(bad):
    for call in (
        lambda m: noise.poisson(m, np.random.default_rng(0)),
        lambda m: noise.poisson_by_inversion(m, np.full(2, 0.5)),
    ):
        with pytest.raises(ValueError, match="mean ranges from"):
            call(np.array([1.0, bad]))


def test_thresholds_and_uniforms_out_of_range_are_refused():
    with pytest.raises(ValueError, match="exact_below"):
        noise.poisson([1.0], np.random.default_rng(0), 5.0)
    with pytest.raises(ValueError, match="exact_below"):
        noise.poisson_by_inversion([1.0], [0.5], math.inf)
    with pytest.raises(ValueError, match="exact_below"):
        distributions.poisson_total_variation(1.0, 0.0)
    for bad in (1.0, -0.1, np.nan):
        with pytest.raises(ValueError, match="uniform"):
            noise.poisson_by_inversion([1.0, 1.0], [0.5, bad])
    for count, mean in ((-1, 1.0), (0.5, 1.0), (1, -1.0), (1, np.nan), (np.nan, 1.0)):
        with pytest.raises(ValueError, match=r"count|mean"):
            distributions.poisson_logpmf(count, mean)


@given(
    uniform=st.floats(0, 1, exclude_max=True),
    mean=st.floats(0, 200) | st.floats(0, 1e15),
    step=st.floats(1e-9, 1e3),
    exact_below=st.sampled_from([10.0, 30.0, 200.0]),
)
@settings(max_examples=500)
def test_under_one_uniform_the_count_never_falls_when_the_mean_grows(uniform, mean, step, exact_below):
    low, high = noise.poisson_by_inversion([mean, mean * (1 + step)], uniform, exact_below)
    assert low <= high


@pytest.mark.parametrize("exact_below", [10.0, 30.0])
def test_under_one_uniform_nothing_falls_across_the_seam_either(exact_below):
    means = exact_below * np.concatenate([np.linspace(0.9, 3, 200), [1 - 1e-12, 1 + 1e-12]])
    means.sort()
    tails = 2.0 ** -np.arange(2, 54)
    uniforms = np.concatenate([np.linspace(0, 1, 500, endpoint=False), tails, 1 - tails])
    counts = noise.poisson_by_inversion(means[:, None], uniforms, exact_below)
    assert np.all(np.diff(counts, axis=0) >= 0)


@given(mean=st.floats(0, 29.9), uniform=st.floats(0, 1 - 2**-53))
def test_below_the_threshold_inversion_is_exact(mean, uniform):
    count = noise.poisson_by_inversion(mean, uniform)
    assert uniform < special.pdtr(count, mean)
    assert count == 0 or uniform >= special.pdtr(count - 1, mean)


@pytest.mark.parametrize("mean", [0.2, 12.0, 33.0, 400.0])
def test_evenly_spread_uniforms_give_the_poisson_law(mean):
    n = 40_000
    drawn = np.bincount(noise.poisson_by_inversion(mean, (np.arange(n) + 0.5) / n).astype(int)) / n
    expected = distributions.poisson_pmf(np.arange(len(drawn)), mean)
    # each count's share is resolved to 1/n; above the threshold the normal form adds its own
    allowed = 0.5 * len(drawn) / n + distributions.poisson_total_variation(mean)
    assert 0.5 * np.abs(drawn - expected).sum() <= allowed


def test_a_name_is_a_stream():
    first, again, other = (random.philox(w).random(4) for w in (b"seed 1", b"seed 1", b"seed 2"))
    assert_array_equal(first, again)
    assert not np.any(first == other)


@pytest.mark.parametrize("used", [0, 1, 3, 4, 5])
def test_a_renamed_generator_draws_what_a_new_one_does(used):
    generator = random.philox(b"seed 1")
    generator.random(used, dtype=np.float32)  # odd numbers leave half a word behind, others a part of a block
    again = random.renamed(generator, b"seed 2")
    for draw in (
        lambda rng: rng.random(7, dtype=np.float32),
        lambda rng: rng.standard_normal(9),
        lambda rng: rng.poisson(40.0, 11),
    ):
        fresh = random.philox(b"seed 2")
        assert_array_equal(draw(random.renamed(again, b"seed 2")), draw(fresh))
        assert again.bit_generator.state["buffer_pos"] == fresh.bit_generator.state["buffer_pos"]


@given(
    top=st.integers(-200, 200),
    left=st.integers(-200, 200),
    rows=st.integers(0, 150),
    columns=st.integers(0, 150),
    dtype=st.sampled_from([np.float32, np.float64]),
)
@settings(max_examples=30)
def test_a_window_equals_the_crop_of_the_sensor(top, left, rows, columns, dtype):
    margin = 70
    larger = (top - margin, left - margin, rows + 2 * margin, columns + 2 * margin)
    whole = random.tiled_normal(b"dsnu", *larger, dtype)
    window = random.tiled_normal(b"dsnu", top, left, rows, columns, dtype)
    assert window.dtype == dtype
    assert_array_equal(window, whole[margin : margin + rows, margin : margin + columns])
    assert_array_equal(window, random.tiled_normal(b"dsnu", top, left, rows, columns))  # whatever holds it


def test_sensor_patterns_are_standard_normal_and_differ_by_name_and_tile():
    pattern = random.tiled_normal(b"prnu", -256, 0, 512, 512)
    n = pattern.size
    # 5 standard errors of mean, variance, skewness and kurtosis
    assert abs(pattern.mean(dtype=float)) < 5 / math.sqrt(n)
    assert abs(pattern.var(dtype=float) - 1) < 5 * math.sqrt(2 / n)
    assert abs((pattern.astype(float) ** 3).mean()) < 5 * math.sqrt(15 / n)
    assert abs((pattern.astype(float) ** 4).mean() - 3) < 5 * math.sqrt(96 / n)
    tiles = pattern.reshape(8, 64, 8, 64).swapaxes(1, 2).reshape(64, -1)
    assert np.all(np.abs(np.corrcoef(tiles) - np.eye(64)) < 5.5 / 64)  # 1/sqrt(4096) each, 2016 pairs
    other = random.tiled_normal(b"dsnu", -256, 0, 512, 512)
    assert abs(np.corrcoef(pattern.ravel(), other.ravel())[0, 1]) < 5 / math.sqrt(n)
    with pytest.raises(ValueError, match="window"):
        random.tiled_normal(b"dsnu", 0, 0, -1, 4)


@pytest.mark.parametrize("rms", [0.0, 1e-9, 0.05, 0.1 - 1e-12, 0.1, 0.2, 0.5, 1.0])
def test_factors_that_are_never_negative_have_the_moments_of_a_cut_normal(rms):
    mean, variance = distributions.cut_normal_moments(rms)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    low, high = (max(-1 / rms, -12.0) if rms else -12.0), 12.0
    z = low + 0.5 * (high - low) * (nodes + 1)
    density = 0.5 * (high - low) * weights * np.exp(-0.5 * z**2) / math.sqrt(math.tau)
    expected = (density * (1 + rms * z)).sum()
    outside = special.ndtr(low) if rms else 0.0  # factors of 0
    assert_allclose(mean, expected, rtol=1e-13)
    about = (density * (1 + rms * z - expected) ** 2).sum() + outside * expected**2
    assert_allclose(variance, about, rtol=1e-11, atol=1e-25)  # the mean of the nodes is rounded


def test_the_moments_of_a_negative_spread_are_refused():
    for rms in (-0.1, math.nan, math.inf):
        with pytest.raises(ValueError, match="rms"):
            distributions.cut_normal_moments(rms)
