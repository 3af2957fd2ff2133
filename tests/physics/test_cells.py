"""Light as cell means: flux, sign, exact areas and integrals, symmetries, and the way the two light models meet."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue.transfer import cell_pixels, cells
from etendue_camera.optics import lens
from etendue_camera.optics.diffraction import airy_outside, circular_otf, cutoff_frequency, pixel_airy
from etendue_camera.sensor import photodiode


def airy(wavelength, number):
    return lambda fy, fx: circular_otf(np.hypot(fy, fx), wavelength, number)


def gaussian(sigma):
    return lambda fy, fx: lens.gaussian_otf(fy, fx, sigma)


def silicon_at_650(fy, fx):
    return photodiode.collection_mtf(np.hypot(fy, fx), 0.28, 1.8, 10.0, 50.0)


def lopsided(wavelength, number):
    """Two spots of unequal strength, apart by a fraction of a cell: a complex transfer function of light that is
    nowhere negative.
    """
    own = airy(wavelength, number)
    return lambda fy, fx: own(fy, fx) * (0.7 + 0.3 * np.exp(-2j * np.pi * (0.8 * fy - 1.3 * fx)))


def nothing(fy, fx):
    return np.ones((1, 1))


def means(otf, plane, step):
    """Cell means behind a transfer function, on the plane taken as periodic."""
    y, x = (cells.PeriodicAxis(size, step) for size in plane.shape)
    table = cells.folded(otf, cells.reach_of(otf, step), y, x, cells.mean_rule(y, False), cells.mean_rule(x, True))
    return cells.planes_of(np.fft.rfft2(plane) * table, y, x)


def point(ny, nx):
    plane = np.zeros((ny, nx))
    plane[ny // 2, nx // 2] = 1.0
    return plane


BLURS = {
    "airy": airy(0.55, 2.8),
    "lopsided": lopsided(0.55, 2.8),
    "silicon": silicon_at_650,
    "gaussian": gaussian(0.8),
    "narrow gaussian": gaussian(0.1),
    "nothing": nothing,
}


@pytest.mark.parametrize("number", [1.4, 2.8, 4.0, 11.0, 64.0])
@pytest.mark.parametrize("spacing", [0.3, 1.0, 2.64, 5.3, 6.0])
def test_a_point_keeps_its_flux_and_makes_no_negative_light_at_any_sampling(number, spacing):
    found = means(airy(0.55, number), point(60, 63), spacing)
    assert abs(found.sum() - 1) <= 1e-14
    assert found.min() >= -1e-16  # rounding of a transform whose largest value is below 1


@pytest.mark.parametrize("name", BLURS)
@settings(max_examples=12, deadline=None)
@given(ny=st.integers(24, 45), nx=st.integers(24, 45), spacing=st.floats(0.4, 6.0), seed=st.integers(0, 2**32 - 1))
def test_flux_is_kept_and_light_stays_light_behind_every_blur(name, ny, nx, spacing, seed):
    plane = np.random.default_rng(seed).uniform(0, 1, (ny, nx)) ** 8
    found = means(BLURS[name], plane, spacing)
    assert_allclose(found.sum(), plane.sum(), rtol=1e-13)
    assert found.min() >= -1e-15
    assert found.max() <= plane.max() + 1e-15


def test_what_a_point_leaves_in_each_cell_is_the_energy_of_the_airy_pattern_averaged_over_the_cell_it_comes_from():
    """Reference: cells cut into n x n, each a point that gives its neighbours ``pixel_airy``; the error falls as
    1/n^2.
    """
    spacing, number, wavelength, parts = 2.0, 2.8, 0.55, (6, 12, 24)
    sums = []
    for n in parts:
        tent = (n - np.abs(np.arange(-n + 1, n))) / n  # how often two parts of two cells are this far apart, over n
        away = np.arange(-n + 1, n)
        row = [
            [
                (
                    tent[:, None]
                    * tent
                    * pixel_airy(i * n + away[:, None], j * n + away, spacing / n, wavelength, number)
                ).sum()
                for j in range(3)
            ]
            for i in range(3)
        ]
        sums.append(np.array(row))
    reference = sums[2] + (sums[2] - sums[1]) / 3
    assert np.abs(sums[1] - sums[0]).max() / np.abs(sums[2] - sums[1]).max() > 3.5  # the order of the reference
    # the padded plane is periodic: all its images together add the tails beyond 600 cells, 2/(pi v) of the energy over
    # 360,000 cells
    found = means(airy(wavelength, number), point(600, 600), spacing)[300:303, 300:303]
    assert_allclose(found, reference, rtol=0, atol=3e-6)


@pytest.mark.parametrize(
    ("pitch", "wavelength", "number"), [(5.4, 0.55, 2.8), (1.12, 0.65, 1.8), (2.64, 0.55, 4.0), (5.4, 0.55, 22.0)]
)
def test_pixels_hold_the_exact_energy_of_an_airy_pattern(pitch, wavelength, number):
    """The source is one small cell; smeared over it, a pixel's energy changes by the cell's variance times its
    curvature.
    """
    parts, frame = 21, 25
    spacing, size = pitch / parts, frame * parts
    axis = cells.PeriodicAxis(size, spacing)
    otf = airy(wavelength, number)
    rules = [cells.window_rule(axis, pitch, 0.0, half) for half in (False, True)]
    table = cells.folded(otf, cells.reach_of(otf, spacing), axis, axis, *rules)
    found = np.fft.irfft2(table, s=(size, size))[::parts, ::parts] * parts**2
    reach = parts // 2 + 3
    index = np.arange(-reach, 2 * parts + reach + 1)
    fine = pixel_airy(index[:, None], index, spacing, wavelength, number)

    def exact(row, column, down=0, across=0):
        """A pixel cut into parts, moved by whole parts."""
        rows, columns = (
            slice(first := reach - parts // 2 + where, first + parts)
            for where in (row * parts + down, column * parts + across)
        )
        return fine[rows, columns].sum()

    # the mean over a cell from values one cell apart, in central differences: 1 + d^2/24 - 17 d^4/5760 + 367 d^6/967680
    second, fourth, sixth = [0, 0, 1, -2, 1, 0, 0], [0, 1, -4, 6, -4, 1, 0], [1, -6, 15, -20, 15, -6, 1]
    mean = np.eye(7)[3] + np.array(second) / 24 - 17 * np.array(fourth) / 5760 + 367 * np.array(sixth) / 967680
    # periodic images add what leaves the frame, spread over it; the next order of the smear is below 1e-6
    allowed = 2 * airy_outside(0.5 * frame * pitch, wavelength, number) / frame**2 + 1e-6
    for row, column in ((0, 0), (0, 1), (1, 1), (2, 1)):
        assert_allclose(exact(row, column), pixel_airy(row, column, pitch, wavelength, number), rtol=1e-10)
        smeared = sum(mean[i] * mean[j] * exact(row, column, i - 3, j - 3) for i in range(7) for j in range(7))
        assert abs(found[row, column] - smeared) <= allowed


def test_a_pixel_of_the_paper_converges_to_its_exact_energy_in_the_second_order():
    """0.898608540025 for 5.4 um at f/2.8 and 0.55 um: the limit of 9, 15 and 25 cells to a pixel."""
    found, parts = [], np.array([9, 15, 25])
    for count in parts:
        size, spacing = 41 * count, 5.4 / count
        axis = cells.PeriodicAxis(size, spacing)
        otf = airy(0.55, 2.8)
        rules = [cells.window_rule(axis, 5.4, 0.0, half) for half in (False, True)]
        table = cells.folded(otf, cells.reach_of(otf, spacing), axis, axis, *rules)
        found.append(np.fft.irfft2(table, s=(size, size))[0, 0] * count**2)
    # the smear of the source: its variance times the curvature of a pixel's energy, and the next order
    limit = np.linalg.solve(np.stack([parts**0.0, parts**-2.0, parts**-4.0], axis=1), found)[0]
    errors = np.abs(np.array(found) - limit)
    assert_allclose(np.log(errors[1] / errors[2]) / np.log(25 / 15), 2.0, atol=0.1)
    # periodic images: eight neighbours and theirs, 41 pixels away and more, leave 1.2e-6
    assert_allclose(limit, 0.898608540025, rtol=0, atol=5e-6)


@pytest.mark.parametrize("spacing", [0.5, 2.0, 7.0])
def test_a_hard_edge_behind_a_gaussian_lens_is_the_exact_integral_over_cells(spacing):
    """Bars of half the period; the integral of the normal distribution, twice: once for the edge, once over the
    cell.
    """
    from scipy.special import ndtr

    sigma, count = 0.8, 48
    plane = np.zeros((3, count))
    plane[:, count // 4 : 3 * count // 4] = 1.0

    def ramp(t):
        return t * ndtr(t / sigma) + sigma * np.exp(-0.5 * (t / sigma) ** 2) / np.sqrt(2 * np.pi)

    left = (np.arange(count) - 0.5) * spacing
    truth = np.zeros(count)
    for image in (-1, 0, 1):
        for edge, sign in ((count / 4 - 0.5, 1), (3 * count / 4 - 0.5, -1)):
            t = left - (edge + image * count) * spacing
            truth += sign * (ramp(t + spacing) - ramp(t)) / spacing
    assert_allclose(means(gaussian(sigma), plane, spacing), np.tile(truth, (3, 1)), rtol=0, atol=2e-14)


@pytest.mark.parametrize("name", BLURS)
def test_folding_and_the_extended_transform_agree_on_pixels_between_the_cells(name):
    otf, rng = BLURS[name], np.random.default_rng(3)
    for ny, nx, spacing, width in ((36, 45, 2.0, 2.9), (45, 40, 3.1, 0.7)):
        plane = rng.uniform(0, 1, (ny, nx))
        y, x = cells.PeriodicAxis(ny, spacing), cells.PeriodicAxis(nx, spacing)
        reach, half = cells.reach_of(otf, spacing), np.fft.rfft2(plane)
        rules = cells.window_rule(y, width, 0.3, False), cells.window_rule(x, width, -0.45, True)
        first = cells.planes_of(half * cells.folded(otf, reach, y, x, *rules), y, x)
        centres = np.arange(ny) + 0.3, np.arange(nx) - 0.45
        second = cell_pixels.evaluated([otf], [reach], np.ones((1, 1)), half[None], y, x, centres, (width, width))[0]
        assert_allclose(second, first, rtol=0, atol=1e-13)  # sums of up to 40,000 waves


def test_without_optics_a_pixel_is_the_exact_area_of_its_cells():
    plane = np.random.default_rng(0).uniform(0, 1, (20, 21))
    y, x = cells.PeriodicAxis(20, 1.5), cells.PeriodicAxis(21, 1.5)
    reach = cells.reach_of(nothing, 1.5)
    at = np.array([4.0, 7.3, 19.8]), np.array([0.1, 12.5])
    found = cell_pixels.evaluated([nothing], [reach], np.ones((1, 1)), np.fft.rfft2(plane)[None], y, x, at, (4.2, 0.6))[
        0
    ]
    fine = np.repeat(np.repeat(plane, 10, axis=0), 10, axis=1)  # tenths of a cell, periodic
    for i, v in enumerate(at[0]):
        for j, u in enumerate(at[1]):
            rows = np.round((v + 0.5 + np.array([-1.4, 1.4])) * 10).astype(int)
            columns = np.round((u + 0.5 + np.array([-0.2, 0.2])) * 10).astype(int)
            part = fine.take(np.arange(*rows), axis=0, mode="wrap").take(np.arange(*columns), axis=1, mode="wrap")
            assert_allclose(found[i, j], part.mean(), rtol=1e-12)


@given(
    st.lists(st.floats(-50, 50), min_size=1, max_size=5),
    st.one_of(st.just(0.0), st.floats(1e-3, 9)),
    st.integers(10, 30),
)
def test_overlaps_are_shares(centres, width, size):
    shares = cells.overlaps(np.array(centres), width, size)
    assert shares.min() >= 0
    assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-10)  # a thousandth of a cell, 50 cells away


@pytest.mark.parametrize("name", ["airy", "silicon", "gaussian"])
def test_round_blurs_commute_with_turns_and_mirrors(name):
    plane = np.random.default_rng(5).uniform(0, 1, (32, 32))
    blurred = means(BLURS[name], plane, 2.2)
    for turn in (lambda a: a[::-1], lambda a: a[:, ::-1], lambda a: a.T, np.rot90):
        assert_allclose(means(BLURS[name], np.ascontiguousarray(turn(plane)), 2.2), turn(blurred), rtol=0, atol=2e-15)


def test_a_complex_transfer_function_moves_light_to_its_side():
    """exp(-2 pi i f d) with d of one cell moves the plane by one cell, folded or not."""
    otf = airy(0.55, 2.8)
    plane = np.random.default_rng(6).uniform(0, 1, (24, 27))
    moved = means(lambda fy, fx: otf(fy, fx) * np.exp(-2j * np.pi * 3.0 * (fy - 2 * fx)), plane, 3.0)
    assert_allclose(moved, np.roll(means(otf, plane, 3.0), (1, -2), axis=(0, 1)), rtol=0, atol=1e-14)


def test_the_two_light_models_meet_in_the_second_order_of_the_spacing():
    """A smooth plane behind a lens: the means differ from the samples by spacing^2 times the curvature over 24,
    twice.
    """
    errors = []
    for count in (32, 64, 128):
        step = 96.0 / count
        phase = 2 * np.pi * (np.arange(count) * step) / 96.0
        plane = np.tile(0.5 + 0.4 * np.cos(3 * phase), (4, 1))
        f = np.fft.rfftfreq(count, step)[None, :]
        samples = np.fft.irfft2(np.fft.rfft2(plane) * airy(0.55, 8.0)(0 * f, f), s=plane.shape)
        errors.append(np.abs(means(airy(0.55, 8.0), plane, step) - samples).max())
    assert_allclose(np.log2(errors[0] / errors[1]), 2.0, atol=0.05)
    assert_allclose(np.log2(errors[1] / errors[2]), 2.0, atol=0.02)


def test_the_end_of_a_transfer_function_is_found_from_either_side():
    for number, spacing in ((1.4, 6.0), (64.0, 0.3), (2.8, 1.0)):
        reach = cells.reach_of(airy(0.55, number), spacing)
        cutoff = cutoff_frequency(0.55, number)
        assert cutoff <= reach.radius <= 1.2 * cutoff
        assert reach.even
        assert not reach.separable
        assert reach.rest == 0
    assert cells.reach_of(gaussian(0.8), 2.0).separable
    assert not cells.reach_of(lopsided(0.55, 2.8), 2.0).even
    assert cells.reach_of(nothing, 2.0) == (0.0, 1.0, True, True)
    endless = cells.reach_of(silicon_at_650, 2.0)
    assert 0.3 < endless.rest < 0.6  # what is absorbed in the depletion layer does not wander


def test_what_lies_beyond_the_aliases_kept_is_as_small_as_stated():
    """Diffusion in silicon never ends: 16 aliases against 48."""
    axis = cells.PeriodicAxis(30, 2.0)
    rules = cells.mean_rule(axis, False), cells.mean_rule(axis, True)
    reach = cells.reach_of(silicon_at_650, 2.0)
    far = 3 * reach.radius
    rest = float(silicon_at_650(np.array([[2 * far]]), np.zeros((1, 1))).item())
    kept = cells.folded(silicon_at_650, reach, axis, axis, *rules)
    more = cells.folded(silicon_at_650, reach._replace(radius=far, rest=rest), axis, axis, *rules)
    assert 1e-9 < np.abs(kept - more).max() <= 2e-6


@given(st.floats(0.05, 1.0), st.floats(0.05, 1.0), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.5, 20.0))
def test_a_window_is_read_off_its_transfer_function(wy, wx, sy, sx, pitch):
    def window(fy, fx):
        phase = np.exp(2j * np.pi * pitch * (sy * fy + sx * fx))
        return np.sinc(fy * wy * pitch) * np.sinc(fx * wx * pitch) * phase

    found = cell_pixels.box_of(window, pitch)
    assert found is not None
    assert_allclose(np.array(found).ravel() / pitch, [wy, sy, wx, sx], rtol=0, atol=2e-12)


def test_what_is_no_window_is_said_to_be_none():
    assert cell_pixels.box_of(gaussian(0.8), 2.0) is None


@pytest.mark.parametrize("width", [-1.0, float("inf"), float("nan")])
def test_widths_that_cannot_be_are_refused(width):
    with pytest.raises(ValueError, match="width"):
        cells.window_rule(cells.PeriodicAxis(8, 1.0), width, 0.0, False)
