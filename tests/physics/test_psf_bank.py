"""Point spread functions by height and wavelength: flux, position, direction, interpolation, files."""

import numpy as np
import pytest

from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.psf_kernels import Sampler

SPACING = 0.5


def comet(height, n=41, spacing=SPACING, width=1.1):
    """A Gaussian that grows and wanders with the height (um), with a tail that points outwards: even parts ~ h^2,
    odd ~ h.
    """
    step = (np.arange(n) - n // 2) * spacing
    y, x = step[:, None], step[None, :]
    h = height / 1000
    core = np.exp(-0.5 * (((y - 0.6 * h) / (width + 0.3 * h**2)) ** 2 + (x / (width + 0.1 * h**2)) ** 2))
    return core * (1 + 0.05 * h * y)


def bank(count=5, **kwargs):
    heights = np.linspace(0, 1000, count)
    wavelengths = np.array([0.45, 0.65])
    return PsfBank(
        heights, wavelengths, [[comet(h, width=0.8 + w, **kwargs) for w in wavelengths] for h in heights], SPACING
    )


def mean_position(kernel, spacing):
    step = (np.arange(kernel.shape[-1]) - kernel.shape[-1] // 2) * spacing
    return np.array([kernel.sum(axis=1) @ step, kernel.sum(axis=0) @ step])


@pytest.mark.long
@pytest.mark.parametrize("light", ["bandlimited", "cells"])
@pytest.mark.parametrize("spacing", [0.3, 0.5, 0.8, 1.4])
def test_a_kernel_keeps_flux_and_mean_position_at_every_place(light, spacing):
    pictures = bank()
    # 60 kernels at random places: sums and means are set in the last step, so only rounding is left
    for y, x in np.random.default_rng(1).uniform(-900, 900, (60 // 4, 2)):
        kernels = pictures.kernel_at(y, x, spacing, light=light)
        height = np.hypot(y, x)
        own = pictures.with_height(height)
        for kernel, picture in zip(kernels, own, strict=True):
            assert abs(kernel.sum() - 1) < 1e-14
            radial = mean_position(picture, SPACING)[0]
            # linear between the heights of the refined bank: 1e-4 of the flux over a few um
            np.testing.assert_allclose(mean_position(kernel, spacing), radial * np.array([y, x]) / height, atol=2e-4)


def test_on_its_own_grid_and_axis_a_band_limited_picture_comes_back():
    pictures = bank()
    kernel = pictures.kernel_at(500.0, 0.0, SPACING, 41)
    # resampling and quintic spline; the Gaussian holds 1e-6 beyond the Nyquist frequency
    assert 0.5 * np.abs(kernel - pictures.psf[2]).sum() < 5e-6


def test_a_turned_kernel_is_the_picture_in_the_direction_of_its_image_point():
    """Against the analytic picture evaluated at turned positions."""
    spacing, n = 0.4, 51
    height, angle = 750.0, 0.83
    step = (np.arange(n) - n // 2) * spacing
    y, x = step[:, None], step[None, :]
    c, s = np.cos(angle), np.sin(angle)
    radial, tangential = c * y + s * x, c * x - s * y
    h = height / 1000
    expected = np.exp(
        -0.5 * (((radial - 0.6 * h) / (1.25 + 0.3 * h**2)) ** 2 + (tangential / (1.25 + 0.1 * h**2)) ** 2)
    ) * (1 + 0.05 * h * radial)
    expected /= expected.sum()
    kernel = bank().kernel_at(height * c, height * s, spacing, n)[0]
    # the circle around the picture cuts 1e-5 off
    assert 0.5 * np.abs(kernel - expected).sum() < 5e-5


def test_kernels_of_two_places_a_quarter_turn_apart_are_the_same_turned():
    pictures = bank()
    one, other = pictures.kernel_at(300.0, 500.0, 0.7)[0], pictures.kernel_at(-500.0, 300.0, 0.7)[0]
    # (y, x) -> (-x, y): rows become columns
    np.testing.assert_allclose(other[::-1].T, one, atol=1e-13)


def test_light_in_cells_is_never_negative_and_is_the_light_that_falls_into_each_cell():
    pictures = bank()
    kernel = pictures.kernel_at(0.0, 0.0, 2.0, light="cells")[0]
    assert kernel.min() >= 0
    from scipy.special import erf

    edges = (np.arange(kernel.shape[0] + 1) - kernel.shape[0] / 2) * 2.0
    # linear between samples of 0.5 um widens a variance by 0.5^2/6
    exact = np.diff(erf(edges / np.sqrt(2 * (1.25**2 + 0.25 / 6)))) / 2
    np.testing.assert_allclose(kernel, np.outer(exact, exact), atol=2e-4)


def test_between_heights_the_error_falls_with_the_cube_of_the_step():
    heights = np.linspace(30.0, 970.0, 33)
    true = [comet(h, width=1.25) / comet(h, width=1.25).sum() for h in heights]

    def error(count):
        pictures = bank(count)
        return max(0.5 * np.abs(pictures.with_height(h)[0] - t).sum() for h, t in zip(heights, true, strict=True))

    errors = [error(count) for count in (3, 5, 9, 17)]
    assert errors[1] < errors[0] / 6
    assert errors[2] < errors[1] / 6
    assert errors[3] < errors[2] / 6


def test_a_refined_bank_mixes_linearly_within_its_bound():
    pictures = bank(3)
    fine = pictures.refined(1e-3)
    assert set(pictures.heights_um) <= set(fine.heights_um)
    for height in np.linspace(0, 1000, 41):
        low = np.clip(np.searchsorted(fine.heights_um, height, side="right") - 1, 0, fine.heights_um.size - 2)
        a = (height - fine.heights_um[low]) / np.diff(fine.heights_um)[low]
        mixed = (1 - a) * fine.psf[low] + a * fine.psf[low + 1]
        assert 0.5 * np.abs(mixed - pictures.with_height(height)).sum(axis=(1, 2)).max() < 1e-3


def test_centred_pictures_have_their_centroid_on_the_image_point():
    for light in ("bandlimited", "cells"):
        kernel = bank().kernel_at(400.0, 300.0, 0.6, light=light, centre="centroid")[1]
        np.testing.assert_allclose(mean_position(kernel, 0.6), 0.0, atol=1e-13)


def test_a_picture_on_the_axis_has_no_direction():
    psf = np.array([[comet(800.0)], [comet(1000.0)]])
    tilted = PsfBank([0.0, 1000.0], [0.55], psf, SPACING)
    assert tilted.roundness() > 0.05
    round_one = tilted.rounded()
    assert round_one.roundness() < 1e-5
    kernels = Sampler(tilted, SPACING).kernels(np.array([1e-6, -1e-6, 0.0]), np.array([0.0, 1e-6, 0.0]))
    assert np.abs(np.diff(kernels, axis=0)).max() < 1e-5 * kernels.max()
    # what is round already stays as it is
    same = bank()
    assert same.rounded() is same


def test_wavelengths_are_mixed_linearly_and_held_beyond_the_ends():
    weights = bank().mix([0.40, 0.45, 0.50, 0.65, 0.70])
    np.testing.assert_allclose(weights, [[1, 0], [1, 0], [0.75, 0.25], [0, 1], [0, 1]], atol=1e-12)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_a_bank_comes_back_from_its_file(tmp_path, suffix):
    pictures = PsfBank(
        [0.0, 10.0], [0.5, 0.6], np.random.default_rng(0).random((2, 2, 5, 5)), [0.3, 0.4], "a test\nin two lines"
    )
    pictures.save(tmp_path / f"bank{suffix}")
    again = PsfBank.load(tmp_path / f"bank{suffix}")
    for name in ("heights_um", "wavelengths_um", "spacing_um"):
        np.testing.assert_array_equal(getattr(again, name), getattr(pictures, name))
    np.testing.assert_allclose(again.psf, pictures.psf, rtol=1e-15)
    assert again.source == pictures.source


GOOD = "height_um,0,wavelength_um,0.5,spacing_um,1\n0,1,0\n1,2,1\n0,1,0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,2,3\n", "line 1: numbers before"),
        (GOOD + GOOD, "line 5.*twice"),
        (GOOD.replace("2,1", "2,x"), "line 3"),
        (GOOD.replace("1,2,1", "1,2"), "same number of lines"),
        (GOOD.replace("spacing_um", "spacing"), "line 1: expected height_um"),
        (GOOD + GOOD.replace("height_um,0", "height_um,5").replace("0.5", "0.6"), "needs each pair"),
        ("", "0 pictures"),
    ],
)
def test_a_broken_file_is_refused_with_its_line(tmp_path, text, message):
    path = tmp_path / "bank.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        PsfBank.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"heights_um": [5.0, 1.0]}, "heights_um"),
        ({"heights_um": [-1.0, 1.0]}, "heights_um"),
        ({"wavelengths_um": [0.0]}, "wavelengths_um"),
        ({"psf": np.ones((2, 1, 5, 4))}, "shape"),
        ({"psf": np.full((2, 1, 5, 5), np.nan)}, "not finite"),
        ({"psf": np.zeros((2, 1, 5, 5))}, "no light"),
        ({"psf": np.ones((2, 1, 5, 5)) - 1.5 * np.eye(5)}, "negative"),
        ({"spacing_um": 0.0}, "spacing_um"),
        ({"spacing_um": [1.0, 1.0, 1.0]}, "spacing_um"),
    ],
)
def test_a_bank_of_nonsense_is_refused(change, message):
    good = {"heights_um": [0.0, 1.0], "wavelengths_um": [0.5], "psf": np.ones((2, 1, 5, 5)), "spacing_um": 1.0}
    PsfBank(**good)
    with pytest.raises(ValueError, match=message):
        PsfBank(**{**good, **change})


def test_noise_below_zero_is_cut_off_and_recorded():
    psf = np.array([[comet(0.0)]])
    psf[0, 0, 0, 0] = -0.001 * psf.sum()
    noisy = PsfBank([0.0], [0.5], psf, SPACING)
    assert noisy.clipped == pytest.approx(0.001, rel=1e-2)
    assert noisy.psf.min() == 0
    with pytest.raises(ValueError, match="spacing"):
        noisy.kernel_at(0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="odd"):
        noisy.kernel_at(0.0, 0.0, 1.0, 4)
