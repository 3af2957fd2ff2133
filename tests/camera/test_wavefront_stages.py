"""Laws of the stages that take a lens by its wavefront: limits, shifts, field, and the stated error."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.transfer import sampling
from etendue_camera.field.stages.aberrations import Aberrations
from etendue_camera.optics import diffraction, focus, imaging
from etendue_camera.optics.stages.gathering import Irradiance
from etendue_camera.optics.stages.lens import Diffraction
from etendue_camera.optics.stages.wavefront import Wavefront

BANDS = np.array([450.0, 550.0, 650.0])
FY = sampling.frequencies(40, 0.5, half=False)[:, None]
FX = sampling.frequencies(48, 0.5, half=True)[None, :]
GRID = {
    "irradiance": Grid.of(
        {"wavelength": Bands((400.0, 500.0, 600.0, 700.0)), "y": Line(40, 0.0, 0.5), "x": Line(48, 0.0, 0.5)}
    )
}


def transfer(stage, fy=FY, fx=FX):
    wavelength = BANDS[:, None, None] * 1e-3
    prepared = stage.prepare({"wavelength": BANDS}) if hasattr(stage, "prepare") else None
    return stage.transfer(fy, fx, wavelength) if prepared is None else stage.transfer(fy, fx, wavelength, prepared)


def test_a_clear_round_lens_without_aberrations_is_diffraction_bit_by_bit():
    assert np.array_equal(transfer(Wavefront()), transfer(Diffraction()))
    annulus = Wavefront(aperture="annular", obstruction=0.4, magnification=-0.5)
    assert np.array_equal(transfer(annulus), transfer(Diffraction(obstruction=0.4, magnification=-0.5)))


@pytest.mark.parametrize(("f_number", "magnification"), [(0.7, 0.0), (1.4, 0.0), (2.0, -0.5)])
def test_diffraction_ends_at_the_marginal_rays_of_the_model_that_sets_the_light(f_number, magnification):
    camera = {"f_number": f_number, "magnification": magnification}
    flat = Diffraction(**camera, aperture_model="flat_disc")
    sine = math.sin(math.atan(0.5 / (f_number * (1 - magnification))))
    for stage, cutoff in (
        (flat, 2 * sine / 0.45),
        (Diffraction(**camera), 1 / (0.45 * f_number * (1 - magnification))),
    ):
        inside, outside = transfer(stage, np.zeros((1, 1)), cutoff * np.array([[1 - 1e-9, 1 + 1e-9]]))[0, 0]
        assert inside > 0.0 and outside == 0.0
    assert np.array_equal(transfer(Wavefront(**camera, aperture_model="flat_disc")), transfer(flat))
    light = Irradiance(**camera, aperture_model="flat_disc").factor()
    assert_allclose(light, math.pi / (4 * flat.cone_f_number() ** 2), rtol=1e-15)  # a few roundings


def test_field_aberrations_change_nothing_on_the_axis():
    assert np.array_equal(
        transfer(Wavefront(coma=0.5, astigmatism=0.3, field_curvature=0.2, distortion=1.0)), transfer(Diffraction())
    )


@pytest.mark.parametrize(
    "values",
    [
        {"defocus": 0.01},
        {"defocus": 0.2},
        {"spherical": 0.5, "aperture": "annular", "obstruction": 0.3},
        {"coma": 0.4, "field_x": 3.0},
        {"aperture": "polygonal", "blades": 5, "coma": 0.3, "field_y": 2.0},
        {"aperture": "polygonal", "rounding": 0.5},
        {"zernike": (0.0, 0.2, -0.1, 0.05, 0.02, 0.0, 0.03)},
    ],
)
def test_transfer_functions_are_one_at_zero_hermitian_and_at_most_one(values):
    stage = Wavefront(**values)
    steps = np.linspace(-0.7, 0.7, 29)
    found = transfer(stage, steps[:, None], steps[None, :])
    assert np.all(found[:, 14, 14] == 1.0)
    assert_allclose(found, np.conj(found[:, ::-1, ::-1]), rtol=0, atol=1e-12)
    # an autocorrelation lies below its value at zero; cells and tables err by what the stage states for points
    assert np.abs(found).max() <= 1.0 + 1e-9
    cutoff = stage.shape().reach() / (0.65 * 2.8)
    assert np.all(found[2][np.hypot(steps[:, None], steps) > 1.0001 * cutoff] == 0.0)


def test_a_clear_pupil_in_focus_passes_no_frequency_reversed():
    for values in ({"aperture": "polygonal", "blades": 7}, {"aperture": "annular", "obstruction": 0.5}, {}):
        found = transfer(Wavefront(**values))
        assert np.isrealobj(found) and found.min() >= 0.0


def test_round_wavefronts_by_cells_and_by_quadrature_agree():
    # slightly out of round, the same lens goes by cells: coma of a millionth of a wave
    smooth = transfer(Wavefront(defocus=0.012, spherical=0.1))
    cells = transfer(Wavefront(defocus=0.012, spherical=0.1, coma=1e-6, field_y=4.0, pupil_samples=256))
    assert_allclose(cells, smooth, rtol=0, atol=5e-5)  # second order: 1.5e-5 for a wave at 256 samples


def test_more_pupil_samples_come_closer():
    values = {"coma": 0.4, "astigmatism": 0.2, "field_y": 3.0, "field_x": 1.0}
    exact = transfer(Wavefront(**values, pupil_samples=1024))
    point = np.zeros((40, 48))
    point[20, 24] = 1.0
    spectrum = sampling.transform(point)
    truth = sampling.planes_of(spectrum * exact[0], 40, 48)
    errors = []
    for samples in (64, 128, 256):
        stage = Wavefront(**values, pupil_samples=samples)
        found = sampling.planes_of(spectrum * transfer(stage)[0], 40, 48)
        errors.append(np.abs(found - truth).max() / truth.max())
        assert errors[-1] <= stage.error(None, GRID, "float64")[0]
    assert errors[0] / errors[2] > 8  # second order would be 16


def test_a_round_wavefront_too_steep_for_quadrature_errs_less_than_it_says():
    """The middle of its point may be dark, so it errs more, relative to the largest value, than one out of round."""
    spectrum = sampling.transform(np.pad(np.ones((1, 1)), ((20, 19), (24, 23))))
    found, stated = [], []
    for samples in (16, 256):
        stage = Wavefront(spherical=1.5, defocus=0.03, pupil_samples=samples)
        assert stage.round and not stage.by_quadrature(0.45)
        tables = stage.prepare({"wavelength": BANDS[:1]})
        contrast = stage.transfer(FY, FX, np.array([[[0.45]]]), tables)
        found.append(sampling.planes_of(spectrum * contrast[0], 40, 48))
        stated.append(stage.error(None, GRID, "float64")[0])
    off = np.abs(found[0] - found[1]).max() / found[1].max()
    assert 0.01 * stated[0] < off <= sum(stated)


def test_tilts_move_the_image_and_nothing_else():
    moved = transfer(Wavefront(distortion=0.4, field_x=2.0, full_height=2.0))
    shift = 2 * 2.8 * 0.4
    assert_allclose(moved, transfer(Diffraction()) * np.exp(-2j * np.pi * FX * shift), rtol=0, atol=1e-13)
    # Noll's second term is 2 x: rms 1 over the disc
    zernike = transfer(Wavefront(zernike=(7.0, 0.2)))
    assert_allclose(zernike, moved, rtol=0, atol=1e-12)


def test_an_object_out_of_focus_is_a_defocus_in_mm():
    cameras = {"focal_length": 25.0, "focus_distance": 2000.0}
    near = Wavefront(**cameras, object_distance=1950.0)
    moved = focus.defocus_mm(25.0, 2000.0, 1950.0)
    assert near.shift() > 0
    assert_allclose(transfer(near), transfer(Wavefront(**cameras, defocus=moved)), rtol=0, atol=1e-12)
    assert np.array_equal(transfer(Wavefront(**cameras, object_distance=2000.0)), transfer(Diffraction(**cameras)))
    assert Wavefront(**cameras).shift() == 0.0  # not given: that of the focus


def test_a_small_defocus_is_that_of_hopkins_with_the_cosine_of_the_cone():
    found = transfer(Wavefront(defocus=0.01))
    exact = imaging.radial_otf(
        np.minimum(np.hypot(FY, FX) * 0.55 * 2.8, 1.0), lambda s: 10 * (1 - np.sqrt(1 - s / 31.36)), 0.55
    )
    assert_allclose(found[1], exact, rtol=0, atol=3e-6)  # the table's stated error


def test_turning_field_and_aperture_turns_the_spot():
    values = {"aperture": "polygonal", "blades": 5, "coma": 0.4, "astigmatism": 0.2}
    along_x = transfer(
        Wavefront(**values, field_x=3.0, rotation=20.0), np.array([[0.1], [0.3]]), np.array([[0.05, 0.2]])
    )
    # a quarter turn takes +x to +y, and +y to -x
    along_y = transfer(
        Wavefront(**values, field_y=3.0, rotation=110.0), np.array([[0.05], [0.2]]), np.array([[-0.1, -0.3]])
    )
    assert_allclose(along_y, np.swapaxes(along_x, 1, 2), rtol=0, atol=1e-5)  # the polygon's table


def test_what_contradicts_itself_is_refused():
    with pytest.raises(ValueError, match="use shape 'annular'"):
        Wavefront(obstruction=0.2)
    with pytest.raises(ValueError, match="object|focal"):
        Wavefront(object_distance=5.0)
    with pytest.raises(ValueError, match="slope of the wavefront"):
        transfer(Wavefront(coma=1000.0, field_y=4.0))


def test_obstruction_of_diffraction_takes_contrast_in_the_middle_and_gives_it_near_the_cut_off():
    nu = np.array([[0.4, 0.9]]) / (0.55 * 2.8)
    clear, ring = (transfer(Diffraction(obstruction=hole), np.zeros((1, 1)), nu)[1, 0] for hole in (0.0, 0.5))
    assert ring[0] < clear[0] and ring[1] > clear[1]
    # beyond half the cut-off plus half the hole only the outer edges meet: more by 1/(1 - eps^2)
    assert_allclose(ring[1], clear[1] / 0.75, rtol=1e-12)


def test_aberrations_over_the_field_are_locally_those_of_one_wavefront():
    size, step = 64, 0.5
    y, x = 2000.0 + step * (np.arange(size) - 32), 1500.0 + step * (np.arange(size) - 32)
    values = {"coma": 0.4, "astigmatism": 0.3, "f_number": 2.0}
    stage = Aberrations(**values, accuracy=0.1, heights=3, bands=2, pupil_samples=64)
    bands = np.array([500.0, 520.0])
    light = np.zeros((2, size, size))
    light[:, 32, 32] = 1.0
    found = stage.run(light, stage.prepare({"y_um": y, "x_um": x, "wavelength": bands}))["irradiance"]
    local = Wavefront(**values, field_y=2.0, field_x=1.5)
    fy = sampling.frequencies(size, step, half=False)[:, None]
    fx = sampling.frequencies(size, step, half=True)[None, :]
    exact = sampling.planes_of(
        sampling.transform(light) * local.transfer(fy, fx, bands[:, None, None] * 1e-3), size, size
    )
    # the accuracy asked for; measured 2 %
    assert np.abs(found - exact).max() < 0.1 * exact.max()
    # and it is not the spot of a perfect lens
    assert exact.max() < 0.8 * diffraction.airy_psf_density(0.0, 0.5, 2.0) * step**2


def test_aberrations_over_the_field_leave_uniform_light_alone():
    line = 0.5 * (np.arange(24) - 12) + 3000.0
    stage = Aberrations(coma=1.0, accuracy=0.2, heights=2, bands=1, pupil_samples=32, f_number=2.0)
    prepared = stage.prepare({"y_um": line, "x_um": line, "wavelength": np.array([550.0])})
    assert_allclose(stage.run(np.ones((1, 24, 24)), prepared)["irradiance"], 1.0, rtol=0, atol=1e-12)
    assert math.isfinite(stage.error(None, GRID, "float32")[0])
