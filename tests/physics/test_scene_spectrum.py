"""What light holds by ring of frequency, and what blurs change of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue.transfer import mixtures, sampling
from etendue.transfer import rings as scene_rings

SIZES = st.tuples(st.integers(5, 70), st.integers(5, 70))


def sums(plane, step=(0.7, 1.1)):
    edges = scene_rings.ring_edges(*plane.shape, *step)
    return edges, *scene_rings.ring_sums(plane, *step, edges)


@settings(max_examples=40, deadline=None)
@given(sizes=SIZES, seed=st.integers(0, 999), smooth=st.floats(0, 4))
def test_power_bounds_the_mean_square_and_amplitude_the_largest_value_of_any_filtered_plane(sizes, seed, smooth):
    """Whatever the factors: real, complex, larger than one. Parseval and the triangle inequality, on the window in
    the padded plane.
    """
    random = np.random.default_rng(seed)
    plane = random.random(sizes)
    step = (0.7, 1.1)
    edges, power, amplitude = sums(plane, step)
    rows = sampling.frequencies(sizes[0], step[0], half=False)[:, None]
    columns = sampling.frequencies(sizes[1], step[1], half=True)[None, :]
    radial = np.hypot(rows, columns)
    factor = (1 - np.exp(-((smooth * radial) ** 2))) * 3 * np.cos(5 * radial)
    half = sampling.transform(plane) * factor
    half[0, 0] = 0
    left = sampling.planes_of(half, *sizes)
    ring = scene_rings.rings_of(radial, edges)
    largest = np.array([np.abs(factor[ring == i]).max(initial=0.0) for i in range(edges.size - 1)])
    assert np.sqrt((left**2).mean()) <= np.sqrt((largest**2 * power).sum()) * (1 + 1e-9)
    assert np.abs(left).max() <= (largest * amplitude).sum() * (1 + 1e-9) + 1e-15


def test_a_wave_lies_in_its_ring_with_its_own_mean_square_and_amplitude():
    # with its padding a whole number of periods of a wave of 8 samples, so that the continuation is the wave itself
    n = 128
    assert sampling.padded_size(n) % 8 == 0
    wave = np.cos(2 * np.pi * (np.arange(n) + 0.5) / 8)[None, :] * np.ones((n, 1))
    edges, power, amplitude = sums(wave, (1.0, 1.0))
    ring = int(scene_rings.rings_of(np.array(1 / 8), edges))
    assert edges[ring] < 1 / 8 <= edges[ring + 1]
    area = (sampling.padded_size(n) / n) ** 2
    assert_allclose(power[ring] / area, 0.5, rtol=0.02)  # the cross-faded mirror behind the frame is not quite the wave
    assert_allclose(power.sum() / area, 0.5, rtol=0.02)
    assert amplitude.sum() >= 1 - 1e-9


@settings(max_examples=30, deadline=None)
@given(sizes=SIZES, step=st.tuples(st.floats(0.05, 20), st.floats(0.05, 20)))
def test_every_frequency_lies_in_one_ring(sizes, step):
    edges = scene_rings.ring_edges(*sizes, *step)
    rows = sampling.frequencies(sizes[0], step[0], half=False)[:, None]
    columns = sampling.frequencies(sizes[1], step[1], half=True)[None, :]
    radial = np.hypot(rows, columns).ravel()[1:]
    ring = scene_rings.rings_of(radial, edges)
    assert np.all(radial <= edges[ring + 1] * (1 + 1e-9))
    assert np.all(radial >= edges[ring] * (1 - 1e-9))


def test_uniform_light_holds_nothing_but_its_mean():
    _, power, amplitude = sums(np.full((20, 31), 3.0))
    assert power.sum() < 1e-28
    assert amplitude.sum() < 1e-12  # rounding of each of 1500 terms


@pytest.mark.parametrize("distance", [0.0, 0.3, 5.0])
def test_what_is_moved_changes_by_no_more_than_twice_its_waves(distance):
    edges = np.array([0.0, 0.01, 0.1, 1.0])
    found = scene_rings.moved(distance, edges)
    assert np.all(found <= 2)
    frequency = np.linspace(0, 1, 1001)
    change = np.abs(1 - np.exp(2j * np.pi * frequency * distance))
    for low, high, most in zip(edges[:-1], edges[1:], found, strict=True):
        assert change[(frequency >= low) & (frequency <= high)].max() <= most + 1e-12


def test_low_terms_of_a_spectrum_evaluate_to_the_plane_where_there_is_nothing_beyond():
    """A Gaussian has 2e-11 of its largest amplitude at half the Nyquist frequency, of some hundred terms along each
    axis.
    """
    ny, nx = 96, 101
    y, x = np.arange(ny)[:, None], np.arange(nx)[None, :]
    plane = np.exp(-((y - 47.3) ** 2 + (x - 51.1) ** 2) / 40)
    half = sampling.transform(plane)
    shape = (2 * sampling.kept_terms(ny, 0.5) + 1, sampling.kept_terms(nx, 0.5) + 1)
    low = sampling.low_terms(half, shape)
    assert low.shape == shape
    place = ((0.25, 1.5, 20), (0.6, 2.1, 20))
    assert_allclose(sampling.sample(low, ny, nx, *place), sampling.sample(half, ny, nx, *place), atol=1e-6)
    for size in (20, ny):  # by matrices or by an inverse transform, as the size asks
        samples = ((0.0, 1.0, size), (0.0, 1.0, nx))
        assert_allclose(sampling.sample(low, ny, nx, *samples), plane[:size], atol=1e-6)
    rows = sampling.frequencies(ny, 1.0, half=False, share=0.5)
    assert rows.size == shape[0]
    assert_allclose(np.sort(rows), -np.sort(-rows)[::-1])


@settings(max_examples=30, deadline=None)
@given(sizes=SIZES, seed=st.integers(0, 999), level=st.sampled_from((1e-9, 1.0, 1e9)))
def test_a_mixture_has_the_content_of_each_of_its_bands(sizes, seed, level):
    """Both transform in single precision, in another order: 1e-5 of the largest number of a band."""
    random = np.random.default_rng(seed)
    planes, weights = random.random((3, *sizes)), level * random.random((4, 3))
    weights[2] = 0  # a band without light
    step = (0.7, 1.1)
    edges, widths = scene_rings.ring_edges(*sizes, *step), scene_rings.blur_widths(*sizes, *step)
    found = mixtures.looked_at(planes, weights, step, edges, widths)
    for plane, numbers in zip(np.tensordot(weights, planes, 1), found, strict=True):
        high = plane.max() or 1.0
        own = (plane / high).astype(np.float32)
        power, amplitude = scene_rings.ring_sums(own, *step, edges)
        peaks = scene_rings.largest_behind(own, *step, widths) * (plane.max() > 0)
        truth = (plane.min(), plane.mean(), plane.max(), power * high**2, amplitude * high, peaks * high)
        for one, other in zip(numbers, truth, strict=True):
            assert_allclose(one, other, atol=1e-5 * float(np.max(np.abs(other), initial=0.0)), rtol=0)
    assert mixtures.looked_at(planes, np.full_like(weights, np.inf), step, edges, widths) is None
