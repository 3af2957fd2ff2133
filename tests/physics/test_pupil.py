"""Laws of pupils and what they image: areas, closed forms, autocorrelation, flux, shift, symmetry, order of
convergence.
"""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.strategies import floats, integers
from numpy.testing import assert_allclose

from etendue_camera.optics import airy, annulus, diffraction, imaging, pupil
from etendue_camera.optics.pupil import (
    Aperture,
    PolygonOtf,
    amplitude,
    cell_centres,
    cell_edges,
    disc_cover,
    polygon,
    polygon_cover,
)

WAVELENGTH, F_NUMBER = 0.55, 2.8
PENTAGON = PolygonOtf(5)


def path_of(samples, function, reach=1.0):
    centres = cell_centres(samples, reach)
    return function(centres[:, None], centres)


# -- what the aperture covers


@settings(deadline=None, max_examples=30)
@given(
    shape=integers(0, 2),
    samples=integers(2, 70),
    hole=floats(0.01, 0.95),
    blades=integers(3, 20),
    turn=floats(-7, 7),
    rounding=floats(0, 1),
)
def test_covered_cells_sum_to_the_area_of_the_aperture(shape, samples, hole, blades, turn, rounding):
    aperture = (Aperture(), Aperture("annular", hole), Aperture("polygonal", 0.0, blades, turn, rounding))[shape]
    cells = amplitude(aperture, samples)
    assert cells.min() >= 0.0 and cells.max() <= 1.0
    area = cells.sum() * (2 * aperture.reach() / samples) ** 2
    # a second difference of areas of order 1 in each of samples^2 cells
    assert_allclose(area, math.pi * aperture.area(), rtol=1e-12)


def test_a_cell_across_the_edge_holds_its_exact_share():
    edges = np.array([0.6, 1.0])
    # the corner region x, y > 0.6 of the disc: from 36.87 to 53.13 degrees, a sector less two triangles
    angle = math.asin(0.8) - math.asin(0.6)
    area = 0.5 * angle - 0.6 * (0.8 - 0.6)
    assert_allclose(disc_cover(edges, edges), area / 0.16, rtol=1e-13)


def test_the_disc_is_its_own_mirror_image_to_the_last_bit():
    cells = amplitude(Aperture("annular", 0.3), 37)
    assert np.array_equal(cells, cells[::-1]) and np.array_equal(cells, cells[:, ::-1])


def test_a_square_aperture_covers_whole_cells():
    square = polygon(4, math.pi / 4)
    side = math.sqrt(math.pi)
    edges = cell_edges(6, 1.5 * side / 2)
    cells = polygon_cover(square, edges, edges)
    assert_allclose(cells[1:5, 1:5], 1.0, rtol=0, atol=1e-13)
    assert_allclose(cells.sum(), 16.0, rtol=1e-13)


@settings(deadline=None, max_examples=30)
@given(blades=integers(3, 12), turn=floats(0, 1), rounding=floats(0, 1))
def test_polygons_have_the_area_of_the_circle_whatever_their_blades(blades, turn, rounding):
    y, x = polygon(blades, turn, rounding).T
    assert_allclose(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)), math.pi, rtol=1e-13)


def test_fully_rounded_blades_are_the_circle():
    # 256 chords: 1 - cos(pi/256) = 8e-5, half of it to either side of the circle
    assert_allclose(np.hypot(*polygon(7, 0.3, 1.0).T), 1.0, rtol=0, atol=1e-4)


# -- closed transfer functions


@given(obstruction=floats(0, 0.99))
def test_annular_transfer_function_runs_from_exactly_one_to_exactly_zero(obstruction):
    nu = np.linspace(0, 1.2, 121)
    values = annulus.annular_otf(nu, 1.0, 1.0, obstruction)
    assert values[0] == 1.0 and np.all(values[nu >= 1.0] == 0.0) and values.min() >= 0.0 and values.max() <= 1.0


def test_annulus_without_a_hole_is_the_circle_and_with_a_tiny_one_nearly():
    nu = np.linspace(0, 1.1, 333)
    circle = diffraction.circular_otf(nu, 0.55, 2.8)
    assert np.array_equal(annulus.annular_otf(nu, 0.55, 2.8, 0.0), circle)
    for hole in (1e-3, 1e-8, 1e-200):
        # the hole's area is all it can change, twice over: numerator and area
        assert_allclose(annulus.annular_otf(nu, 0.55, 2.8, hole), circle, rtol=0, atol=3 * hole**2 + 1e-15)


@pytest.mark.parametrize("obstruction", [0.2, 0.5, 0.9])
def test_annular_spread_function_and_transfer_function_are_a_transform_pair(obstruction):
    nodes, weights = np.polynomial.legendre.leggauss(60)
    joints = [0.0, *sorted({0.5 * (1 - obstruction), 0.5 * (1 + obstruction), obstruction}), 1.0]
    from scipy.special import j0

    for r in (0.0, 0.3, 1.0, 2.7):
        total = 0.0
        for a, b in itertools.pairwise(joints):
            nu = a + (b - a) * (0.5 - 0.5 * np.cos(0.5 * np.pi * (1 + nodes)))  # crowded at the joints
            slope = (b - a) * 0.25 * np.pi * np.sin(0.5 * np.pi * (1 + nodes))
            total += np.sum(
                weights
                * slope
                * 2
                * np.pi
                * nu
                * j0(2 * np.pi * r * nu)
                * annulus.annular_otf(nu, 1.0, 1.0, obstruction)
            )
        # Born and Wolf eq. 8.6.19; the joints are powers 3/2, softened by the change of variable
        v = math.pi * r
        spread = (airy.amplitude(v) - obstruction**2 * airy.amplitude(obstruction * v)) ** 2 / (1 - obstruction**2)
        assert_allclose(total, math.pi / 4 * spread, rtol=0, atol=1e-8)


@pytest.mark.parametrize("obstruction", [0.0, 0.3, 0.8])
def test_quadrature_over_the_shared_area_finds_the_closed_forms(obstruction):
    nu = np.linspace(0, 1, 101)
    found = imaging.radial_otf(nu, lambda s: 0 * s, 0.55, obstruction, 24)
    assert_allclose(found, annulus.annular_otf(nu, 1.0, 1.0, obstruction), rtol=0, atol=1e-13)


@pytest.mark.parametrize("waves", [0.25, 1.0, 3.0])
def test_defocused_transfer_function_is_the_integral_of_hopkins_and_stokseth(waves):
    nodes, weights = np.polynomial.legendre.leggauss(200)
    nu = np.linspace(0, 0.98, 30)[:, None]
    angle = 0.25 * np.pi * (1 + nodes)
    chord = np.sqrt(1 - nu**2) * np.sin(angle)
    half = np.sqrt(1 - chord**2) - nu
    # over x the phase is linear: 2 pi 4 W nu x, integrated to a sinc
    inner = 2 * half * np.sinc(8 * waves * nu * half)
    hopkins = (2 / np.pi) * (inner * np.sqrt(1 - nu**2) * np.cos(angle)) @ (0.25 * np.pi * weights)
    found = imaging.radial_otf(nu[:, 0], lambda s: waves * s, 1.0, nodes=60)
    assert_allclose(found, hopkins, rtol=0, atol=1e-13)


def shared_area(corners, shift):
    """Area of a convex polygon (y, x; turning from x to y) and its shifted copy, cut edge by edge."""
    cut = [tuple(c) for c in corners + np.asarray(shift)]
    for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        sides = [(x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) for y, x in cut]
        kept = []
        for k, (point, side) in enumerate(zip(cut, sides, strict=True)):
            before, was = cut[k - 1], sides[k - 1]
            if (side > 0) != (was > 0):
                t = was / (was - side)
                kept.append(tuple(b + t * (p - b) for b, p in zip(before, point, strict=True)))
            if side > 0:
                kept.append(point)
        cut = kept
        if not cut:
            return 0.0
    y, x = np.array(cut).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


@pytest.mark.parametrize("blades", [3, 4, 5, 6, 8])
def test_polygonal_transfer_function_is_the_area_that_shifted_polygons_share(blades):
    outline, corners = PolygonOtf(blades, 0.2), polygon(blades, 0.2)
    shifts = np.random.default_rng(blades).uniform(-1.6, 1.6, (60, 2))
    found = outline(0.5 * shifts[:, 0], 0.5 * shifts[:, 1])
    # the table's own error, as its docstring says
    assert_allclose(found, [shared_area(corners, shift) / math.pi for shift in shifts], rtol=0, atol=6e-6)


def test_polygon_of_many_blades_is_the_circle():
    nu = np.linspace(0, 1, 60)
    gaps = []
    for blades in (8, 16, 32, 64):
        found = PolygonOtf(blades)(0.3 * nu, nu * math.sqrt(0.91))
        gaps.append(np.abs(found - diffraction.circular_otf(nu, 1.0, 1.0)).max())
    # outlines differ by (pi/n)^2/6 of the radius: four times less for twice the blades, down to the table's 6e-6
    assert gaps[0] < (math.pi / 8) ** 2 / 6
    assert all(after < before / 2.5 for before, after in itertools.pairwise(gaps))


@given(turn=floats(-3, 3), angle=floats(0, 6), nu=floats(0, 1.1))
@settings(deadline=None, max_examples=15)
def test_polygonal_transfer_function_turns_with_the_polygon(turn, angle, nu):
    still, turned = PENTAGON, PolygonOtf(5, turn)
    a = still(np.array(nu * math.sin(angle)), np.array(nu * math.cos(angle)))
    b = turned(np.array(nu * math.sin(angle + turn)), np.array(nu * math.cos(angle + turn)))
    assert_allclose(a, b, rtol=0, atol=1e-12)  # rounding of the direction


# -- from the pupil to the point


@pytest.mark.parametrize(("samples", "most"), [(128, 1e-4), (256, 2.5e-5), (512, 6e-6)])
def test_edges_weighted_by_area_beat_edges_in_or_out_tenfold(samples, most):
    axis = 0.5 * (np.arange(256) - 128)
    exact = diffraction.airy_psf_density(np.hypot(axis[:, None], axis), WAVELENGTH, F_NUMBER)
    centres = cell_centres(samples)
    binary = (np.hypot(centres[:, None], centres) <= 1).astype(float)
    rough, smooth = (
        np.abs(imaging.pupil_psf(cells, None, WAVELENGTH, F_NUMBER, axis, axis) - exact).max() / exact.max()
        for cells in (binary, amplitude(Aperture(), samples))
    )
    assert smooth < most  # four times less for twice the samples
    assert smooth < rough / 10


def test_folded_sums_are_the_plain_ones():
    axis = np.linspace(-9.0, 11.0, 31)
    for samples in (20, 21):
        cells = amplitude(Aperture(), samples)
        folded = imaging.pupil_psf(cells, None, WAVELENGTH, F_NUMBER, axis[:20], axis[:25])
        centres = cell_centres(samples) / (2 * WAVELENGTH * F_NUMBER)
        waves = [np.exp(-2j * np.pi * np.outer(axis[:n], centres)) for n in (20, 25)]
        plain = np.abs(waves[0] @ cells @ waves[1].T) ** 2
        assert_allclose(folded / folded.max(), plain / plain.max(), rtol=0, atol=1e-14)


@pytest.mark.parametrize("aperture", [Aperture(), Aperture("annular", 0.4), Aperture("polygonal", blades=5)])
def test_the_spread_function_holds_all_of_the_light(aperture):
    samples = 48
    reach = aperture.reach()
    cells = amplitude(aperture, samples)
    path = path_of(samples, lambda y, x: 0.2 * (y * y + x * x) + 0.1 * x**3, reach)
    # over one period of a sampled pupil, at twice as many positions as cells, Parseval's theorem is exact
    period = 2 * WAVELENGTH * F_NUMBER * samples / (2 * reach)
    axis = period * (np.arange(2 * samples) - samples + 0.5) / (2 * samples)
    spread = imaging.pupil_psf(cells, path, WAVELENGTH, F_NUMBER, axis, axis, reach)
    energy = spread.sum() * (period / (2 * samples)) ** 2
    # cells cut by the edge count with the square of their share
    assert_allclose(energy, np.sum(cells**2) / np.sum(cells), rtol=1e-12)


def test_a_tilt_moves_the_spot_two_f_numbers_times_its_slope():
    cells = amplitude(Aperture(), 64)
    axis = np.linspace(-4, 4, 41)
    slope = 0.3
    tilted = imaging.pupil_psf(cells, path_of(64, lambda y, x: slope * x + 0 * y), WAVELENGTH, F_NUMBER, axis, axis)
    still = imaging.pupil_psf(cells, None, WAVELENGTH, F_NUMBER, axis, axis - 2 * F_NUMBER * slope)
    assert_allclose(tilted, still, rtol=0, atol=1e-12 * still.max())


def test_even_aberrations_spread_evenly_and_coma_does_not():
    cells = amplitude(Aperture(), 64)
    axis = np.linspace(-8, 8, 33)
    even = path_of(64, lambda y, x: 0.4 * x * x - 0.2 * y * y + 0.3 * (x * x + y * y) ** 2)
    spread = imaging.pupil_psf(cells, even, WAVELENGTH, F_NUMBER, axis, axis)
    assert_allclose(spread, spread[::-1, ::-1], rtol=0, atol=1e-13 * spread.max())
    coma = path_of(64, lambda y, x: 0.4 * y * (x * x + y * y))
    spread = imaging.pupil_psf(cells, coma, WAVELENGTH, F_NUMBER, axis, axis)
    assert_allclose(spread, spread[:, ::-1], rtol=0, atol=1e-13 * spread.max())
    # the tail of positive coma lies where the path grows
    assert spread[18:].sum() > 2 * spread[:15].sum()


# -- from the pupil to the transfer function


@pytest.mark.parametrize("function", [lambda s: 0.2 * s, lambda s: 0.3 * s * s - 0.3 * s])
def test_lattice_and_rows_converge_to_the_quadrature_with_the_square_of_the_samples(function):
    nu = np.linspace(0, 0.999, 60)
    exact = imaging.radial_otf(nu, function, 0.5)
    clear = diffraction.circular_otf(nu, 1.0, 1.0)
    errors = []
    for samples in (64, 128, 256):
        cells = amplitude(Aperture(), samples)
        rows = imaging.radial_changes(cells, function, np.array([0.5]))[0]
        along = clear + imaging.from_radial(np.linspace(0, 1, samples + 1), rows, nu)
        errors.append(np.abs(along - exact).max())
    assert errors[0] < 1e-3
    assert errors[0] / errors[2] > 10  # 16 for the second order, staircase noise of the edge aside
    lattice = imaging.pupil_lattice(amplitude(Aperture(), 128), path_of(128, lambda y, x: function(y * y + x * x)), 0.5)
    slanted = clear + np.diag(imaging.from_lattice(lattice, 0.6 * nu / 0.5, 0.8 * nu / 0.5, 0.5, 1.0))
    assert_allclose(slanted, exact, rtol=0, atol=3e-4)


@pytest.mark.parametrize(
    "aperture", [Aperture(), Aperture("annular", 0.4), Aperture("polygonal", blades=5, rotation=0.3)]
)
def test_transfer_function_is_hermitian_one_at_zero_and_never_above_the_clear_one_by_more_than_its_error(aperture):
    samples, reach = 64, aperture.reach()
    cells = amplitude(aperture, samples)
    path = path_of(samples, lambda y, x: 0.3 * x * (x * x + y * y) + 0.2 * y * y, reach)
    lattice = imaging.pupil_lattice(cells, path, 0.5)
    assert lattice[samples + 2, samples + 2] == 0.0
    # autocorrelation: opposite shifts are conjugate, to rounding of a transform of 128 x 128
    assert_allclose(lattice, np.conj(lattice[::-1, ::-1]), rtol=0, atol=1e-15)
    clear = imaging.pupil_lattice(cells, np.full_like(path, 3.0), 0.5)
    assert_allclose(clear, 0.0, rtol=0, atol=1e-15)  # piston changes nothing


def test_from_lattice_passes_through_the_lattice_and_ends_with_it():
    samples = 16
    lattice = imaging.pupil_lattice(
        amplitude(Aperture(), samples), path_of(samples, lambda y, x: 0.1 * x**3 + 0 * y), 0.5
    )
    steps = np.arange(-samples, samples + 1) / samples
    found = imaging.from_lattice(lattice, steps / 0.5, steps / 0.5, 0.5, 1.0)
    assert_allclose(found[1:-1, 1:-1], lattice[3:-3, 3:-3], rtol=0, atol=1e-14)
    assert np.all(imaging.from_lattice(lattice, np.array([2.5, -9.0]), steps, 0.5, 1.0) == 0.0)


def test_transfer_function_is_the_transform_of_the_spread_function():
    samples, reach = 96, 1.0
    cells = amplitude(Aperture(), samples)
    path = path_of(samples, lambda y, x: 0.15 * x * (x * x + y * y) + 0.1 * y * y)
    axis = 0.6 * (np.arange(240) - 120)  # lambda N = 1.54 um: band-limited below 0.77 um
    spread = imaging.pupil_psf(cells, path, WAVELENGTH, F_NUMBER, axis, axis, reach)
    lattice = imaging.pupil_lattice(cells, path, WAVELENGTH)
    fy, fx = np.array([0.0, 0.05, 0.2, -0.3]), np.array([0.0, 0.1, 0.25, 0.4])
    clear = diffraction.circular_otf(np.hypot(fy[:, None], fx), WAVELENGTH, F_NUMBER)
    found = clear + imaging.from_lattice(lattice, fy, fx, WAVELENGTH, F_NUMBER)
    waves = [np.exp(-2j * np.pi * np.outer(f, axis)) for f in (fy, fx)]
    direct = 0.36 * waves[0] @ spread @ waves[1].T
    # the window of 144 um leaves out 2/(pi v) = 0.4 % of the light, smooth: it shows at zero frequency and little
    # beyond
    assert_allclose(found[1:, 1:], direct[1:, 1:], rtol=0, atol=2e-3)


def test_nonsense_is_refused_by_name():
    cells = np.ones((8, 8))
    with pytest.raises(ValueError, match="obstruction is 1"):
        annulus.annular_otf(0.1, 0.55, 2.8, 1.0)
    with pytest.raises(ValueError, match="blades is 2"):
        Aperture("polygonal", blades=2)
    with pytest.raises(ValueError, match="use shape 'annular'"):
        Aperture("circular", 0.2)
    with pytest.raises(ValueError, match="shape is 'oval'"):
        Aperture("oval")
    with pytest.raises(ValueError, match="rounding is 1.5"):
        polygon(5, 0.0, 1.5)
    with pytest.raises(ValueError, match="samples is 1"):
        cell_edges(1)
    with pytest.raises(ValueError, match="use more"):
        imaging.pupil_psf(cells, None, 0.55, 2.8, np.array([0.0, 50.0]), np.zeros(1))
    with pytest.raises(ValueError, match="must be square"):
        imaging.pupil_psf(np.ones((8, 9)), None, 0.55, 2.8, np.zeros(1), np.zeros(1))
    with pytest.raises(ValueError, match="same square"):
        imaging.pupil_lattice(cells, np.zeros((4, 4)), 0.5)
    with pytest.raises(ValueError, match="sums to 0"):
        imaging.pupil_lattice(np.zeros((8, 8)), np.zeros((8, 8)), 0.5)
    with pytest.raises(ValueError, match="wavelength is 0"):
        imaging.radial_otf(0.1, lambda s: s, 0.0)
    with pytest.raises(ValueError, match="radius is 0"):
        pupil.disc_cover(np.array([0.0, 1.0]), np.array([0.0, 1.0]), 0.0)
