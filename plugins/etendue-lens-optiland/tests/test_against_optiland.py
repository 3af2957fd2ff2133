"""The lens against optiland's own analysis of it: rays aimed at the paraxial entrance pupil, as optiland's are by
default.
"""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("optiland")

from etendue_lens_optiland import pupil
from etendue_lens_optiland.lens import open_lens
from numpy.testing import assert_allclose
from optiland.analysis import Distortion
from optiland.psf import FFTPSF, HuygensPSF

WAVELENGTHS = (0.45, 0.55, 0.65)
FIELDS = (0.0, 22.0, 30.0)


def sample(f_number, focal_length=6.93):
    """optiland's ReverseTelephoto at the paper's focal length, fields and wavelengths, everything else its own."""
    from optiland.samples.objectives import ReverseTelephoto

    optic = ReverseTelephoto()
    optic.wavelengths.wavelengths.clear()
    for wavelength in WAVELENGTHS:
        optic.wavelengths.add(value=wavelength, is_primary=wavelength == 0.55)
    optic.fields.fields.clear()
    for angle in FIELDS:
        optic.fields.add(y=angle)
    optic.updater.scale_system(focal_length / float(np.ravel(optic.paraxial.f2())[0]))
    optic.set_aperture("EPD", focal_length / f_number)
    return optic


def tangent(degrees):
    return float(np.tan(np.radians(degrees)))


def ours(f_number, **how):
    return open_lens(f_number=f_number, aiming="paraxial", **how)


def test_paraxial_figures_are_optilands():
    optic, lens = sample(4.0), ours(4.0)
    # two real rays beside the axis, extrapolated
    assert_allclose(lens.focal_length_um, 1e3 * float(np.ravel(optic.paraxial.f2())[0]), rtol=1e-9)
    assert_allclose(lens.pupil * lens.scale, 1e3 * float(np.ravel(optic.paraxial.EPL())[0]), rtol=1e-8)
    assert_allclose(lens.f_number, float(np.ravel(optic.paraxial.FNO())[0]), rtol=1e-9)


def test_chief_rays_land_where_optiland_has_them():
    optic, lens = sample(4.0), ours(4.0)
    for wavelength in WAVELENGTHS:
        heights = lens.chief(np.array([tangent(f) for f in FIELDS]), wavelength)[1]
        theirs = [1e3 * optic.trace_generic(0.0, f / 30, 0.0, 0.0, wavelength).y[0] for f in FIELDS]
        # the same rays through the same surfaces, scaled before or after
        assert_allclose(heights, theirs, rtol=0, atol=1e-6)


def test_distortion_is_optilands():
    optic, lens = sample(4.0), ours(4.0)
    theirs = np.ravel(Distortion(optic, wavelengths=[0.55], num_points=61).data[0])
    angles = np.linspace(1e-10, 30.0, 61)[1:]
    tangents = np.tan(np.radians(angles))
    found = 100 * (lens.chief(tangents, 0.55)[1] / (lens.image_distance_um * tangents) - 1)
    assert theirs[-1] < -1.0  # barrel: the comparison is about something
    # per cent; our scale on the axis is an extrapolation
    assert_allclose(found, theirs[1:], rtol=0, atol=1e-6)


def test_the_axial_picture_is_that_of_optilands_fourier_transform():
    optic, lens = sample(6.7), ours(6.7)
    theirs = FFTPSF(optic, (0, 0), 0.55, num_rays=256, grid_size=2048)
    step = 0.55 * theirs._get_working_FNO() * 255 / 2048
    at = np.arange(-40, 41)
    psf = theirs.psf[np.ix_(1024 + at, 1024 + at)] / 100
    found = pupil.intensity(lens.bundle(0.0, 0.55, 256), at * step, at * step)
    # optiland drops or keeps whole cells at the edge of the pupil, and its amplitude is even over the entrance pupil
    assert np.abs(found - psf).max() < 3e-3 * psf.max()


def test_the_axial_picture_is_that_of_optilands_huygens_sum():
    optic, lens = sample(6.7), ours(6.7)
    theirs = HuygensPSF(optic, (0, 0), 0.55, num_rays=128, image_size=24, pixel_pitch=1e-3)
    x, y, _ = theirs._get_image_coordinates()
    found = pupil.intensity(lens.bundle(0.0, 0.55, 128), 1e3 * y[:, 0], 1e3 * x[0])
    # each over its own value in the middle: optiland's sum for the ideal wave has no obliquity factor of its own
    psf = theirs.psf / theirs.psf.max()
    assert np.abs(found / found.max() - psf).max() < 5e-3


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("wavelength", WAVELENGTHS)
def test_strehl_ratios_are_optilands(field, wavelength):
    optic, lens = sample(6.7), ours(6.7)
    theirs = FFTPSF(optic, (0, field / 30), wavelength, num_rays=128, grid_size=1024).strehl_ratio()
    # whole cells at optiland's edge, its peak looked for on samples only; 4e-3 at most over these nine
    assert_allclose(pupil.strehl(lens.bundle(tangent(field), wavelength, 128)), theirs, rtol=0, atol=5e-3)


def test_a_fast_lens_at_the_edge_of_what_it_can_is_still_optilands():
    """f/2.5 on the axis: a Strehl ratio of 0.09. What remains is the amplitude, which optiland takes as even."""
    theirs = FFTPSF(sample(2.5), (0, 0), 0.55, num_rays=256, grid_size=1024).strehl_ratio()
    bundle = ours(2.5).bundle(0.0, 0.55, 256)
    even = pupil.strehl(replace(bundle, filled=bundle.open))
    # 1 per cent of 0.09: their edge of whole cells, where the phase turns by a radian from cell to cell
    assert_allclose(even, theirs, rtol=0.01)
    assert_allclose(pupil.strehl(bundle), even, rtol=0.02)


def test_relative_illumination_is_the_area_of_optilands_aimed_edge_rays():
    """optiland has no such analysis; its rays aimed at the rim of the stop enclose the cone."""
    optic = sample(11.0)
    optic.ray_tracer.set_aiming("iterative", max_iter=30, tol=1e-9)
    around = np.linspace(0.0, 2 * np.pi, 721)[:-1]
    areas = []
    for field in FIELDS:
        rays = optic.trace_generic(0.0, field / 30, 0.99999 * np.cos(around), 0.99999 * np.sin(around), 0.55)
        areas.append(0.5 * abs(np.sum(rays.L * np.roll(rays.M, -1) - np.roll(rays.L, -1) * rays.M)))
    lens = open_lens(f_number=11.0)
    found = lens.illumination(np.array([tangent(f) for f in FIELDS]), (0.55,), 64)[0]
    # these rays belong to one object point, the light to one image point: apart by the defocus over the distance of the
    # pupil, twice (60 um of 10 mm). The law that is sharp is conservation, in test_lens
    assert_allclose(found / found[0], np.array(areas) / areas[0], rtol=0.02)
    assert found[2] < found[1] < found[0]
