"""Laws of the traced lens: limits, conservation, scaling, convergence."""

import numpy as np
import pytest

pytest.importorskip("optiland")

import scipy
from etendue_lens_optiland import banks, pupil
from etendue_lens_optiland.lens import open_lens
from numpy.testing import assert_allclose


def tangent(degrees):
    return float(np.tan(np.radians(degrees)))


@pytest.mark.parametrize(("cells", "bound"), [(32, 4e-4), (128, 3e-5)])
def test_covered_cells_add_up_to_the_disc(cells, bound):
    at = (np.arange(cells) + 0.5) / cells * 2.2 - 1.1
    share = pupil.covered(np.hypot(at[:, None], at[None, :] + 0.013) - 1.0)
    # a rim taken as straight within a cell errs by its curvature: the square of the cell
    assert abs(share.sum() * (2.2 / cells) ** 2 / np.pi - 1) < bound
    assert share.min() == 0.0
    assert share.max() == 1.0


@pytest.mark.parametrize("slope", [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8), (-0.3, 0.01)])
def test_a_straight_rim_is_exact(slope):
    y, x = np.mgrid[0:8, 0:8] - 3.5
    share = pupil.covered(slope[0] * y + slope[1] * x - 0.21)
    fine = (np.arange(800) + 0.5) / 100 - 4.0
    counted = (slope[0] * fine[:, None] + slope[1] * fine - 0.21 <= 0).reshape(8, 100, 8, 100).mean(axis=(1, 3))
    assert_allclose(share, counted, rtol=0, atol=1e-2)  # of counting hundredths


def test_a_lens_small_enough_tends_to_the_airy_pattern():
    """Aberrations shrink with the lens, wavelengths do not: a tenth of a millimetre at f/8 is perfect."""
    bundle = open_lens(focal_length_mm=0.1, f_number=8.0, focus="best").bundle(0.0, 0.55, 128)
    number = 0.5 * np.sqrt(np.pi / bundle.solid_angle)
    at = np.linspace(-30.0, 30.0, 61)
    v = np.pi * np.hypot(at[:, None], at) / (0.55 * number)
    airy = np.where(v == 0, 1.0, (2 * scipy.special.j1(v) / np.where(v == 0, 1.0, v)) ** 2)
    # Strehl ratio 1 - 4e-5, the pupil's edge 1e-4
    assert np.abs(pupil.intensity(bundle, at, at) - airy).max() < 5e-4
    assert pupil.strehl(bundle) > 0.999


@pytest.mark.parametrize("field", [0.0, 22.0, 30.0])
def test_a_wide_window_holds_the_flux_of_the_pupil(field):
    bundle = open_lens(f_number=8.0).bundle(tangent(field), 0.55, 128)
    spacing = 0.25 * 0.55 / bundle.range
    size = 2 * round(100.0 / spacing) + 1
    held = pupil.picture(bundle, size, spacing).sum() * spacing**2 / pupil.flux(bundle)
    # outside lies 2/(pi v) of an Airy pattern and what the square's corners take back; aberrations add little at f/8
    outside = 2 * 2 * 0.55 / bundle.range / np.pi**2 / 200.0
    assert 1 - 2 * outside < held < 1 - 0.3 * outside


def test_waves_multiplied_from_place_to_place_are_those_of_every_place_by_itself():
    """One exponential per ray and place; 500 products of unit numbers lose at most 500 roundings."""
    bundle = open_lens(f_number=5.6).bundle(tangent(22.0), 0.55, 32)
    y, x = np.linspace(-90.0, 40.0, 500), np.linspace(-30.0, 30.0, 31)
    k = 2 * np.pi / bundle.wavelength
    rows = np.exp(1j * k * (bundle.path + np.multiply.outer(y, bundle.cosine_y))) * bundle.amplitude
    direct = (np.abs(rows @ np.cos(k * np.multiply.outer(bundle.cosine_x, x))) / bundle.amplitude.sum()) ** 2
    assert np.abs(pupil.intensity(bundle, y, x) - direct).max() < 1e-12 * direct.max()
    with pytest.raises(ValueError, match="evenly spaced"):
        pupil.intensity(bundle, y**3, x)


def test_pictures_are_their_own_mirror_images_across_the_meridian():
    bundle = open_lens(f_number=5.6).bundle(tangent(22.0), 0.55, 64)
    at = np.linspace(-20.0, 20.0, 41)
    found = pupil.intensity(bundle, at, at)
    assert_allclose(found, found[:, ::-1], rtol=0, atol=1e-14)
    assert_allclose(pupil.picture(bundle, 41, 1.0), found, rtol=0, atol=1e-14)
    assert np.abs(found - found[::-1]).max() > 0.01  # but not the other way: coma


def test_a_lens_twice_as_long_is_twice_as_wrong():
    one, two = (open_lens(f_number=5.6, focal_length_mm=f).bundle(tangent(22.0), 0.55, 64) for f in (5.0, 10.0))
    assert_allclose(two.height, 2 * one.height, rtol=1e-12)
    assert_allclose(two.wavefront_rms(), 2 * one.wavefront_rms(), rtol=1e-9)
    assert_allclose(two.solid_angle, one.solid_angle, rtol=1e-9)


def test_the_cone_on_the_axis_is_that_of_the_f_number():
    """pi / 4 N^2, but for the departure from Abbe's sine condition."""
    for f_number in (4.0, 16.0, 64.0):
        lens = open_lens(f_number=f_number, focus="paraxial")
        # 2 per cent at f/4, a tenth of it at f/16
        assert_allclose(
            lens.bundle(0.0, 0.55, 64).solid_angle, np.pi / (4 * f_number**2), rtol=0.02 * (4 / f_number) + 4e-4
        )


@pytest.mark.parametrize("field", [0.5, 10.0, 22.0, 30.0])
def test_illumination_conserves_the_flux_between_object_and_image(field):
    """Light through the entrance pupil from a ring of the sky lands on a ring of the image: E/L = A cos(t) sin(t) dt /
    (h dh).

    The left side is the area of the cone at the image point, the right side knows nothing of cones.
    """
    lens, angle, step = open_lens(f_number=11.0), np.radians(field), 1e-4
    bundle = lens.bundle(tangent(field), 0.55, 128)
    lower, upper = lens.chief(np.tan([angle - step, angle + step]), 0.55)[1]
    entering = 2 * bundle.open.sum() * lens.scale**2 * np.cos(angle) * np.sin(angle)
    # the ring is followed by its chief rays, not by its centroids: 3e-4 of it at 30 degrees; the pupil's edge 1e-4
    assert_allclose(bundle.solid_angle, entering * 2 * step / (bundle.height * (upper - lower)), rtol=5e-4)


def test_the_best_focus_has_the_smoothest_axial_wavefront():
    errors = {
        focus: open_lens(f_number=4.0, focus=focus).bundle(0.0, 0.55, 64).wavefront_rms()
        for focus in ("design", "paraxial", "best")
    }
    assert errors["best"] <= min(errors.values()) * (1 + 1e-9)
    assert errors["best"] < 0.5 * errors["paraxial"]


def test_more_cells_change_little_and_ever_less():
    lens = open_lens(f_number=5.6)
    strehl = [pupil.strehl(lens.bundle(tangent(22.0), 0.55, n)) for n in (32, 64, 128, 256)]
    steps = np.abs(np.diff(strehl))
    assert steps[2] < 1e-3
    assert steps[2] < 0.5 * steps[0]


def test_chief_rays_pass_the_middle_of_the_stop():
    lens = open_lens(f_number=4.0)
    tangents = np.tan(np.radians([0.0, 5.0, 22.0, 30.0]))
    entry, _ = lens.chief(tangents, 0.45)
    at_stop = lens.rays(entry, 0.0, tangents, 0.45)["stop"][1]
    assert np.abs(at_stop).max() < 1e-9 * lens.stop_radius
    assert entry[-1] != 0.0  # the entrance pupil moves with the field


def test_a_bank_has_the_heights_the_spacing_and_the_light_it_says():
    lens = open_lens(f_number=8.0)
    traced = banks.psf_bank(lens, banks.tangents_of([0.0, 22.0]), (0.5, 0.6), samples=64, lost=0.1)
    assert_allclose(traced.bank.heights_um, lens.chief(np.array([0.0, tangent(22.0)]), 0.55)[1])
    assert_allclose(traced.bank.psf.sum(axis=(2, 3)), 1.0, rtol=1e-12)
    assert (traced.enclosed > 0.9).all()
    assert (traced.enclosed < 1.0).all()
    for number, wavelength in enumerate((0.5, 0.6)):
        widest = max(lens.bundle(tangent(f), wavelength, 64).range for f in (0.0, 22.0))
        assert (
            0.8 < traced.bank.spacing_um[number] * 2 * widest / wavelength < 0.9
        )  # of what the cut-off frequency needs


def test_distortion_takes_every_height_back_to_its_pinhole():
    lens = open_lens(f_number=8.0)
    curve = banks.ideal_over_real(lens, 3500.0, (0.65,), 17)[0]
    tangents = np.tan(np.radians([3.0, 11.0, 19.0, 26.0]))
    real = lens.chief(tangents, 0.65)[1]
    # of the spline through 17 fields
    assert_allclose(real * curve(real**2), lens.image_distance_um * tangents, rtol=2e-6)


def test_a_frame_beyond_the_reach_of_the_lens_is_refused_with_its_reach():
    with pytest.raises(ValueError, match="reaches image heights of"):
        open_lens(f_number=8.0).tangent_for(50_000.0, (0.55,))


def test_unknown_words_and_fields_are_refused():
    with pytest.raises(ValueError, match="design, paraxial, best"):
        open_lens(focus="somewhere")
    for fields in ([10.0, 5.0], [-1.0, 3.0], [0.0, 89.5], []):
        with pytest.raises(ValueError, match="must ascend"):
            banks.tangents_of(fields)
    with pytest.raises(ValueError, match="use a larger f_number"):
        open_lens(f_number=0.6)
