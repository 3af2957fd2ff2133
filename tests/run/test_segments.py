"""Segments: transfer functions joined into one pass, padded once; evaluation between samples."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue.compute import tables
from etendue.compute.joined.segments import Light, LightBands
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.transfer import sampling
from tests.run.small import assert_same_bits, by_labels, plan_of, run

sizes = st.integers(1, 70)


def light(seed, ny, nx, dtype="float64"):
    return np.random.default_rng(seed).uniform(0.0, 1e3, (ny, nx)).astype(dtype)


@pytest.mark.parametrize(("precision", "bound"), [("float32", 1e-6), ("float64", 1e-12)])
def test_joined_equals_one_stage_after_the_other_on_the_same_padded_domain(precision, bound):
    """Relative to full scale. One after the other: back to planes and forth to spectra between the stages."""
    plan = plan_of({"precision": precision})
    arrays = {
        key[0][0]: array
        for key, array in by_labels(plan, run(plan).arrays).items()
        if key[1] in ("irradiance", "photon_rate")
    }
    ny, nx = arrays["falloff"].shape[-2:]
    padded = sampling.pad(arrays["falloff"])
    for name in ("diffraction", "diffusion"):
        cell = next(c for c in plan.of(name))
        grid = cell.input_grids["irradiance"]
        fy = sampling.frequencies(ny, grid.line("y").step, half=False)[:, None]
        fx = sampling.frequencies(nx, grid.line("x").step, half=True)[None, :]
        wavelength = np.array(grid.bands().values())[:, None, None] * 1e-3
        otf = cell.stage.transfer(fy, fx, wavelength).astype(precision)
        padded = np.fft.irfft2(np.fft.rfft2(padded) * otf, s=padded.shape[-2:]).astype(precision)
        assert abs(padded[..., :ny, :nx] - arrays[name]).max() <= bound * arrays[name].max()
        assert arrays[name].dtype == precision


def test_a_segment_that_is_left_out_hands_on_its_input_bit_by_bit():
    """A transform there and back would change bits under a key that says nothing changed."""
    plan = plan_of({"scene.use": "uniform", "camera.focal_length": "1 m"})
    left_out = ("falloff", "diffraction", "diffusion")
    assert all(cell.left_out for name in left_out for cell in plan.of(name))
    assert {cell.key for name in left_out for cell in plan.of(name)} == {plan.of("irradiance")[0].key}
    arrays = {key[0][0]: array for key, array in by_labels(plan, run(plan).arrays).items() if key[1] == "irradiance"}
    for name in left_out:
        assert_same_bits(arrays[name], arrays["irradiance"])


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40))
def test_evaluation_equals_the_trigonometric_sum(seed, ny, nx):
    """Below 2e-14 of the largest value: sums of some thousand terms in double precision."""
    rng = np.random.default_rng(seed)
    plane = light(seed, ny, nx)
    y, x = ((rng.uniform(-5, 5), rng.uniform(0.1, 3.0), 5) for _ in range(2))
    found = sampling.evaluate(sampling.transform(plane), ny, nx, y, x)
    padded = sampling.pad(plane)
    total_y, total_x = padded.shape
    whole = np.fft.fft2(padded)
    at = [start + step * np.arange(size) for start, step, size in (y, x)]
    waves = []
    for positions, total in zip(at, (total_y, total_x), strict=True):
        k = np.rint(np.fft.fftfreq(total) * total)
        wave = np.exp(2j * np.pi * positions[:, None] * k[None, :] / total)
        if total % 2 == 0:
            wave[:, total // 2] = np.cos(np.pi * positions)
        waves.append(wave)
    direct = np.einsum("ik,kl,jl->ij", waves[0], whole, waves[1], optimize=True).real / (total_y * total_x)
    assert_allclose(found, direct, rtol=0, atol=2e-14 * np.abs(plane).max() * np.sqrt(total_y * total_x))


@given(st.integers(0, 2**32 - 1), sizes, sizes)
def test_evaluation_at_the_samples_gives_the_samples(seed, ny, nx):
    plane = light(seed, ny, nx)
    found = sampling.evaluate(sampling.transform(plane), ny, nx, (0.0, 1.0, ny), (0.0, 1.0, nx))
    assert_allclose(found, plane, rtol=0, atol=1e-12 * plane.max())


@given(st.integers(0, 2**32 - 1), st.integers(8, 60), st.integers(1, 4), st.integers(0, 3))
def test_whole_step_decimation_equals_evaluation(seed, size, step, first):
    plane = light(seed, size, size)
    spectrum = sampling.transform(plane)
    where = (float(first), float(step), (size - 1 - first) // step + 1)
    assert sampling.whole_steps(0.0, 1.0, *where, size) is not None
    assert_allclose(
        sampling.sample(spectrum, size, size, where, where),
        sampling.evaluate(spectrum, size, size, where, where),
        rtol=0,
        atol=1e-12 * plane.max(),
    )


@given(st.integers(0, 2**32 - 1), sizes, sizes, st.floats(0.3, 4.0))
def test_a_transfer_function_keeps_the_flux_of_the_padded_plane(seed, ny, nx, sigma):
    """It is 1 at zero frequency; 1e-12 of the sum is rounding."""
    plane = light(seed, ny, nx)
    fy, fx = sampling.frequencies(ny, 1.0, half=False)[:, None], sampling.frequencies(nx, 1.0, half=True)[None, :]
    spectrum = sampling.transform(plane) * np.exp(-2 * (np.pi * sigma) ** 2 * (fy**2 + fx**2))
    padded = sampling.pad(plane)
    assert_allclose(np.fft.irfft2(spectrum, s=padded.shape).sum(), padded.sum(), rtol=1e-12)


@given(st.integers(0, 2**32 - 1), sizes, sizes)
def test_padding_keeps_the_frame_and_stays_within_its_values(seed, ny, nx):
    plane = light(seed, ny, nx)
    padded = sampling.pad(plane)
    assert padded.shape == (sampling.padded_size(ny), sampling.padded_size(nx))
    assert_same_bits(np.ascontiguousarray(padded[:ny, :nx]), plane)
    assert padded.shape[0] - ny >= 32
    assert padded.min() >= plane.min() * (1 - 1e-14)
    assert padded.max() <= plane.max() * (1 + 1e-14)


@given(st.integers(20, 200), st.floats(-3, 3), st.floats(0.1, 2.0))
def test_padding_has_no_seam(size, slope, curve):
    """On a smooth plane no step of the periodic continuation is much larger than the largest step inside it."""
    x = np.linspace(-1, 1, size)
    plane = np.tile(slope * x + curve * x**2, (size, 1))
    inside = np.abs(np.diff(plane, axis=1)).max()
    padded = sampling.pad(plane)
    around = np.concatenate([padded, padded[:, :1]], axis=1)
    gap = padded.shape[1] - size
    # The two mirrored ends are cross-faded: their difference is bridged in ``gap`` samples, at most pi/2 times as steep
    # as a straight line.
    bridge = 0.5 * np.pi * 2 * np.ptp(plane) / gap
    assert np.abs(np.diff(around, axis=1)).max() <= 2 * inside + bridge


def test_fast_lengths_are_those_of_scipy():
    assert [sampling.fast_length(n) for n in range(1, 5000)] == [
        scipy.fft.next_fast_len(n, real=True) for n in range(1, 5000)
    ]


@settings(deadline=None)
@given(st.integers(1, 600))
def test_padded_sizes_are_fast(size):
    rest = sampling.padded_size(size)
    for prime in (2, 3, 5, 7, 11):
        while rest % prime == 0:
            rest //= prime
    assert rest == 1


def test_the_sum_over_wavelength_is_the_same_in_frequency_and_in_space():
    rng = np.random.default_rng(1)
    planes, weights = rng.uniform(0, 1, (5, 30, 34)), rng.uniform(0, 1, (3, 5))
    summed = sampling.sum_over_bands(weights, np.ascontiguousarray(sampling.transform(planes)))
    assert_allclose(
        sampling.planes_of(summed, 30, 34),
        np.einsum("cw,wyx->cyx", weights, planes),
        rtol=0,
        atol=1e-13 * planes.shape[0],
    )


@given(st.integers(0, 2**32 - 1), sizes, sizes, st.booleans(), st.sampled_from(["float32", "float64"]))
def test_light_band_by_band_is_that_of_the_whole_bit_for_bit(seed, ny, nx, half, dtype):
    """Also where only the rows of a transfer function are kept that differ, and whether or not a transform exists."""
    grid = Grid.of({"wavelength": Bands((400.0, 500.0, 600.0, 700.0)), "y": Line(ny, 0, 1), "x": Line(nx, 0, 1)})
    planes = np.stack([light(seed + n, ny, nx, dtype) for n in range(3)])
    fy, fx = sampling.frequencies(ny, 1.0, half=False)[:, None], sampling.frequencies(nx, 1.0, half=True)
    full = np.stack([np.exp(-w * np.hypot(fy, fx)) for w in (1.0, 2.0, 3.0)]).astype(dtype)
    otf = full[:, : full.shape[1] // 2 + 1] if half else full
    expected = sampling.planes_of(sampling.transform(planes) * full * full, ny, nx)
    made = Light(lit=slice(0, 3), made=(sampling.transform(planes), (otf, otf)))
    for one in (Light(planes, slice(0, 3), (None, (otf, otf))), made):
        bands = LightBands(one, grid, dtype)
        assert_same_bits(bands.whole(), expected)
        assert_same_bits(np.stack([bands[n] for n in range(3)]), expected)
        assert_same_bits(sampling.planes_of(one.whole(), ny, nx), expected)


def test_transforms_of_a_sweep_share_a_part_of_the_cache(monkeypatch):
    """The newest stays, whatever its size; what is not a transform stays too."""
    monkeypatch.setattr(tables, "LARGEST_TRANSFORMS", 1000)
    cache = tables.Cache(1 << 20)
    cache.get("table", lambda: np.zeros(100))
    for number in range(9):
        cache.get(number, lambda: np.zeros(50), transform=True)
        cache.get(0, lambda: np.zeros(50), transform=True)
    assert set(cache.entries) == {"table", 0, 8}
    cache.get("large", lambda: np.zeros(1000), transform=True)
    assert set(cache.entries) == {"table", "large"}
    assert cache.held == 8800
