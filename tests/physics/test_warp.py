"""DistortionCurve and lateral colour: the map, its inverse, folding, and planes moved by it."""

import numpy as np
import pytest
from scipy.special import erf

from etendue_camera.field import warp
from etendue_camera.field.warp import DistortionCurve

BARREL = DistortionCurve((-0.0648, 0.00596, -0.00047), 1000.0)  # a small asphere: -6.2 % at 1.02 mm
PINCUSHION = DistortionCurve((0.05, 0.01, 0.0), 2000.0, lateral_colour=0.002)


def table(curve, count=21, reach=1000.0, wavelengths=(0.45, 0.55, 0.65)):
    ideal = np.linspace(0.0, reach, count)
    return DistortionCurve(
        table=(ideal, np.array(wavelengths), np.stack([curve(ideal, w) for w in wavelengths], axis=1))
    )


@pytest.mark.parametrize("lens", [BARREL, PINCUSHION, table(BARREL.distort)])
@pytest.mark.parametrize("wavelength", [0.45, 0.55, 0.62])
def test_undistort_takes_back_what_distort_did(lens, wavelength):
    radius = np.r_[0.0, np.geomspace(1e-6, 1400.0, 200), -300.0]
    # a few units in the last place of the map, over its slope
    np.testing.assert_allclose(
        lens.undistort(lens.distort(radius, wavelength), wavelength), radius, rtol=4e-15, atol=1e-15
    )


def test_percent_of_a_pure_cubic_is_the_square_of_the_height():
    lens = DistortionCurve((-0.1, 0.0, 0.0), 500.0)
    np.testing.assert_allclose(lens.percent([0.0, 250.0, 500.0], 0.5), [0.0, -2.5, -10.0], atol=1e-12)


@pytest.mark.parametrize("lens", [BARREL, PINCUSHION, table(PINCUSHION.distort)])
def test_the_slope_is_the_derivative_of_the_map(lens):
    radius, step = np.linspace(10.0, 900.0, 40), 1e-3
    numeric = (lens.distort(radius + step, 0.6) - lens.distort(radius - step, 0.6)) / (2 * step)
    np.testing.assert_allclose(lens.slope(radius, 0.6), numeric, rtol=1e-8)


def test_lateral_colour_is_nothing_at_the_reference_wavelength_and_a_scale_elsewhere():
    lens = DistortionCurve((0.02, 0.0, 0.0), 1000.0, lateral_colour=0.001, reference_wavelength_um=0.55)
    plain = DistortionCurve((0.02, 0.0, 0.0), 1000.0)
    radius = np.linspace(0, 1000, 11)
    np.testing.assert_array_equal(lens.distort(radius, 0.55), plain.distort(radius, 0.55))
    np.testing.assert_allclose(lens.distort(radius, 0.65), 1.001 * plain.distort(radius, 0.55), rtol=1e-15)
    assert DistortionCurve().does_nothing()
    assert not DistortionCurve(lateral_colour=1e-6).does_nothing()


def test_a_table_goes_through_its_entries_and_converges_with_the_fourth_power():
    def curve(radius, wavelength):
        return BARREL.distort(radius, 0.55) * (1 + 1e-3 * (wavelength**-2.0 - 0.55**-2.0))

    lens = table(curve)
    for wavelength in (0.45, 0.55, 0.65):
        np.testing.assert_allclose(
            lens.distort(lens.table[0], wavelength), curve(lens.table[0], wavelength), rtol=1e-14
        )
    # between columns linear in 1/wavelength^2, which this curve is
    np.testing.assert_allclose(lens.distort(lens.table[0], 0.5), curve(lens.table[0], 0.5), rtol=1e-13)
    radius = np.linspace(0, 1000, 501)
    errors = [np.abs(table(curve, n).distort(radius, 0.5) - curve(radius, 0.5)).max() for n in (5, 9, 17)]
    assert errors[1] < errors[0] / 12
    assert errors[2] < errors[1] / 12
    # beyond the last height along the tangent
    slope = lens.slope(1000.0, 0.45)
    assert lens.distort(1100.0, 0.45) == pytest.approx(float(lens.distort(1000.0, 0.45) + 100.0 * slope), rel=1e-14)


def test_an_image_that_folds_over_is_refused_with_the_radius_where_it_does():
    lens = DistortionCurve((-0.2, 0.0, 0.0), 1000.0)
    fold = 1000.0 / np.sqrt(0.6)  # 1 - 3 * 0.2 q = 0
    assert lens.folds_at(0.55) == pytest.approx(fold, rel=1e-12)
    top = float(lens.distort(fold, 0.55))
    assert lens.undistort(0.999 * top, 0.55) < fold
    with pytest.raises(ValueError, match=r"folds the image over 1290.99 um .* at a real height of 860.66"):
        lens.undistort(1.001 * top, 0.55)
    assert BARREL.folds_at(0.55) > 2000.0  # three times the field it is made for
    assert DistortionCurve((0.1, 0.0, 0.0)).folds_at(0.55) == np.inf
    with pytest.raises(ValueError, match="folds? over"):
        DistortionCurve(table=(np.array([0.0, 1.0, 2.0]), np.array([0.5]), np.array([[0.0], [1.0], [0.9]])))


def test_the_ratio_curve_is_undistort():
    for lens, bound in ((BARREL, 1e-11), (PINCUSHION, 1e-11), (table(BARREL.distort), 1e-9)):
        real = np.linspace(0.5, 900.0, 777)
        np.testing.assert_allclose(lens.ratio(900.0, 0.6)(real**2) * real, lens.undistort(real, 0.6), rtol=bound)


LINE = np.arange(96) - 47.5


def edge(x, y, softness, angle=0.1):
    return 0.5 + 0.5 * erf((x * np.cos(angle) + y * np.sin(angle) - 9.3) / np.sqrt(2) / softness)


def shrunk(plane, factor=0.93, **how):
    return warp.radial(plane, LINE, LINE, lambda square: np.full(np.shape(square), factor), **how)


def error(softness, order, oversampling=1):
    moved = shrunk(edge(LINE[None, :], LINE[:, None], softness), order=order, oversampling=oversampling)
    exact = edge(0.93 * LINE[None, :], 0.93 * LINE[:, None], softness)
    return float(np.abs(moved - exact)[16:-16, 16:-16].max())


@pytest.mark.parametrize("order", warp.ORDERS)
def test_the_error_of_a_moved_edge_falls_with_the_order_of_the_spline_and_stays_within_its_bound(order):
    errors = [error(s, order) for s in (1.0, 1.4, 2.0, 2.8, 4.0)]
    # sampled twice as finely: 2^(order + 1), less a fifth
    assert errors[4] < 1.25 * errors[2] / 2 ** (order + 1)
    for softness, found in zip((1.0, 1.4, 2.0, 2.8, 4.0), errors, strict=True):
        assert found <= warp.edge_error(order, softness)
        assert error(softness, order, 2) <= warp.edge_error(order, softness, 2)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("order", warp.ORDERS)
def test_a_uniform_plane_stays_as_it_is_bit_by_bit(kind, order):
    plane = np.full((20, 31), 0.1, dtype=kind)
    y, x = np.arange(20) - 3.0, np.arange(31) + 4.0
    for oversampling in (1, 3):
        moved = warp.radial(plane, y, x, BARREL.ratio(40.0, 0.5), order, oversampling)
        assert moved.dtype == kind
        np.testing.assert_array_equal(moved, plane)


def test_nothing_moves_where_the_ratio_is_one():
    plane = np.random.default_rng(0).random((30, 40))
    for order in warp.ORDERS:
        moved = warp.radial(plane, np.arange(30.0), np.arange(40.0), np.ones_like, order)
        np.testing.assert_allclose(moved, plane, atol=1e-13)


def test_a_point_lands_where_the_lens_puts_it():
    n, spacing = 161, 2.0
    line = (np.arange(n) - n // 2) * spacing
    lens = DistortionCurve((-0.08, 0.0, 0.0), 300.0)
    y, x = 60.0, -110.0
    plane = np.exp(-0.5 * (((line[:, None] - y) / 6) ** 2 + ((line[None, :] - x) / 6) ** 2))
    moved = warp.radial(plane, line, line, lens.ratio(300.0, 0.5))
    height = np.hypot(y, x)
    expected = np.array([y, x]) * lens.distort(height, 0.5) / height
    place = np.array(np.unravel_index(moved.argmax(), moved.shape)) - n // 2
    assert np.all(np.abs(place * spacing - expected) <= 0.5 * spacing + 0.05)
    # the peak is carried over, not spread: radiance is imaged
    assert moved.max() == pytest.approx(1.0, abs=0.03)


def test_a_turned_scene_gives_the_turned_image():
    plane = np.random.default_rng(0).random((33, 33))
    line = np.arange(33) - 16.0
    ratio = DistortionCurve((0.1, 0.0, 0.0), 20.0).ratio(30.0, 0.5)
    image = warp.radial(plane, line, line, ratio)
    for change in (np.rot90, np.transpose, lambda a: a[::-1]):
        np.testing.assert_allclose(warp.radial(change(plane), line, line, ratio), change(image), atol=1e-12)


def test_missing_light_is_measured_beyond_the_border():
    lens = DistortionCurve(
        (0.0, 0.0, 0.0), lateral_colour=-0.01, reference_wavelength_um=0.55
    )  # 650 nm: the image is 1 % smaller
    assert warp.missing_um((-100.0, 100.0), (-200.0, 200.0), lens, 0.55) == 0
    assert warp.missing_um((-100.0, 100.0), (-200.0, 200.0), lens, 0.65) == pytest.approx(200 / 0.99 - 200, rel=1e-9)
    assert warp.missing_um((-100.0, 100.0), (-200.0, 200.0), lens, 0.45) == 0


def test_a_table_is_read_in_either_unit_and_any_order_of_columns(tmp_path):
    path = tmp_path / "lens.csv"
    path.write_text("ideal_mm,650,450\n# comment\n0,0,0\n0.5,0.49,0.48\n1,0.96,0.94\n")
    ideal, wavelengths, real = warp.read_table(path)
    np.testing.assert_allclose(ideal, [0, 500, 1000])
    np.testing.assert_allclose(wavelengths, [0.45, 0.65])
    np.testing.assert_allclose(real, [[0, 0], [480, 490], [940, 960]])
    for text in ("height,550\n1,1\n", "ideal_um,550\n1,x\n", "ideal_um,550\n1\n", "", "ideal_um\n1\n"):
        path.write_text(text)
        with pytest.raises(ValueError, match=r"lens.csv"):
            warp.read_table(path)


@pytest.mark.parametrize(
    "arguments",
    [
        {"coefficients": (np.nan, 0.0, 0.0)},
        {"coefficients": (0.1, 0.0)},
        {"reference_um": 0.0},
        {"lateral_colour": np.inf},
        {"reference_wavelength_um": -1.0},
        {"coefficients": (0.1, 0.0, 0.0), "table": (np.arange(3.0), np.array([0.5]), np.arange(3.0)[:, None])},
        {"table": (np.arange(3.0), np.array([0.5]), np.arange(4.0)[:, None])},
        {"table": (np.arange(3.0), np.array([0.5]), np.arange(3.0)[:, None] + 1)},
    ],
)
def test_nonsense_is_refused(arguments):
    with pytest.raises(ValueError, match=r"coefficients|reference|lateral|table"):
        DistortionCurve(**arguments)


def test_orders_and_oversampling_out_of_range_are_refused():
    plane = np.zeros((4, 4))
    with pytest.raises(ValueError, match="order"):
        warp.radial(plane, np.arange(4.0), np.arange(4.0), np.ones_like, 6)
    with pytest.raises(ValueError, match="oversampling"):
        warp.radial(plane, np.arange(4.0), np.arange(4.0), np.ones_like, 3, 0)
    with pytest.raises(ValueError, match="inverts the image"):
        DistortionCurve(lateral_colour=-2.0).distort(1.0, 0.65)
