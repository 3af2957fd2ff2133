"""Laws of the test charts: known transfer, range, symmetry, and weights that share out every position."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import ive

from etendue.transfer import resampling
from etendue_camera.scene import charts, composite
from etendue_camera.scene.charts import Rendering

Y, X = (np.arange(120) - 59.5) * 0.5, (np.arange(160) - 79.5) * 0.5
SOFT = st.one_of(st.just(0.0), st.floats(1e-6, 20.0))
LEVELS = st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)).map(sorted)


def edge(y, x, low, high, softness):
    return charts.slanted_edge(y, x, 5.0, Rendering(softness, low=low, high=high), 1.5)


def star(y, x, low, high, softness):
    return charts.siemens_star(y, x, 24, 25.0, Rendering(softness, low=low, high=high))


def plate(y, x, low, high, softness):
    return charts.zone_plate(y, x, 0.5, 25.0, Rendering(softness, low=low, high=high))


def wedge(y, x, low, high, softness):
    return charts.step_wedge(y, x, np.linspace(low, high, 5), 60.0, 40.0, Rendering(softness))


def spots(y, x, low, high, softness):
    return charts.points(y, x, 130.0, 1.0, Rendering(softness, low=low, high=high))


def whole(y, x, low, high, softness):
    return composite.composite(
        y, x, 80.0, 60.0, Rendering(softness, low=low, high=high), composite.Panels(highest_frequency=0.5, cycles=12)
    ).grey


CHARTS = [edge, star, plate, wedge, spots]


def gaussian_transfer(frequency, softness):
    return np.exp(-2 * (np.pi * softness * frequency) ** 2)


# ----------------------------------------------------------------------------------------- for all charts


@pytest.mark.parametrize("chart", CHARTS)
@given(levels=LEVELS, softness=SOFT)
@settings(max_examples=15, deadline=None)
def test_every_chart_stays_inside_its_levels(chart, levels, softness):
    low, high = levels
    value = chart(Y, X, low, high, softness)
    assert value.shape == (len(Y), len(X))
    assert value.min() >= low and value.max() <= high


@pytest.mark.parametrize("chart", [*CHARTS, whole])
def test_every_chart_keeps_single_precision_even_with_numpy_scalars_as_arguments(chart):
    low, high, softness = np.float64(0.1), np.float64(0.8), np.float64(0.6)
    single = chart(Y.astype(np.float32), X.astype(np.float32), low, high, softness)
    assert single.dtype == np.float32
    # float32: a star's angle of 3.14 is good to 2e-7, times 24 cycles; a distance of 40 um to 4e-6
    assert_allclose(single, chart(Y, X, low, high, softness), atol=2e-5)


@pytest.mark.parametrize("chart", [star, plate, spots])
def test_star_plate_and_spots_look_the_same_in_both_mirrors(chart):
    value = chart(Y, X, 0.1, 0.8, 0.6)
    assert_allclose(value, value[::-1], rtol=0, atol=1e-13)
    assert_allclose(value, value[:, ::-1], rtol=0, atol=1e-13)


def test_plate_and_spots_do_not_care_which_axis_is_which():
    for chart in (plate, spots):
        assert_allclose(chart(Y, X, 0.1, 0.8, 0.6), chart(X, Y, 0.1, 0.8, 0.6).T, rtol=0, atol=1e-14)


@pytest.mark.parametrize("chart", [edge, star, plate, spots])
def test_levels_in_the_wrong_order_are_refused(chart):
    with pytest.raises(ValueError, match="0 <= low <= high, got low=0.8, high=0.1"):
        chart(Y, X, 0.8, 0.1, 1.0)


@pytest.mark.parametrize("chart", CHARTS)
def test_negative_reflectances_are_refused(chart):
    with pytest.raises(ValueError, match="low|levels"):
        chart(Y, X, -0.1, 0.8, 1.0)


@pytest.mark.parametrize("chart", [*CHARTS, whole])
@pytest.mark.parametrize("softness", [-1.0, np.nan, np.inf])
def test_softness_that_makes_no_sense_is_refused(chart, softness):
    with pytest.raises(ValueError, match="softness"):
        chart(Y, X, 0.1, 0.8, softness)


# ---------------------------------------------------------------------------------------- slanted edge


@pytest.mark.parametrize("angle", [0.0, 5.0, -12.0])
def test_derivative_along_the_normal_is_the_gaussian(angle):
    softness, step = 1.2, 1e-3
    normal = np.array([-np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))])
    distance = np.linspace(-6.0, 6.0, 41)

    def value(at):
        return np.array(
            [
                charts.slanted_edge([p * normal[0]], [p * normal[1]], angle, Rendering(softness, low=0.2, high=0.9))[
                    0, 0
                ]
                for p in at
            ]
        )

    slope = (value(distance + step) - value(distance - step)) / (2 * step)
    gaussian = 0.7 * np.exp(-0.5 * (distance / softness) ** 2) / (softness * np.sqrt(2 * np.pi))
    assert_allclose(slope, gaussian, atol=2e-7)  # step^2 / 6 times the largest third derivative, 0.14


def test_spectrum_of_the_edge_is_the_gaussian_transfer():
    softness, spacing = 1.5, 0.25
    x = (np.arange(512) - 255.5) * spacing
    line = np.diff(charts.slanted_edge([0.0], x, 0.0, Rendering(softness))[0])
    frequency = np.fft.rfftfreq(line.size, spacing)
    # differences of neighbours are means of the Gaussian over one spacing
    expected = gaussian_transfer(frequency, softness) * np.sinc(frequency * spacing)
    assert_allclose(np.abs(np.fft.rfft(line)), expected, atol=1e-14)


def test_edge_is_a_step_where_nothing_softens_it():
    value = charts.slanted_edge([0.0], [-1.0, 0.0, 1e-9], 5.0, Rendering(0.0, low=0.2, high=0.8))
    assert_array_equal(value, [[0.2, 0.5, 0.8]])


@given(angle=st.floats(-80, 80), offset=st.floats(-20, 20), y=st.floats(-50, 50), softness=SOFT)
@settings(max_examples=40, deadline=None)
def test_edge_is_half_way_on_its_line(angle, offset, y, softness):
    x = offset + y * np.tan(np.deg2rad(angle))
    value = charts.slanted_edge([y], [x], angle, Rendering(softness, low=0.2, high=0.8), offset)[0, 0]
    if softness == 0:
        assert 0.2 <= value <= 0.8
    else:  # rounding of positions up to 300 um, times the slope of the edge
        assert_allclose(value, 0.5, atol=1e-13 / softness + 1e-15)


def test_turning_the_edge_by_half_a_turn_swaps_dark_and_light():
    value = charts.slanted_edge(Y, X, 5.0, Rendering(1.0, low=0.2, high=0.8))
    assert_allclose(value + value[::-1, ::-1], 1.0, rtol=0, atol=1e-14)


def test_a_level_edge_is_refused():
    with pytest.raises(ValueError, match="angle_deg must lie between"):
        charts.slanted_edge(Y, X, 90.0, Rendering(1.0, low=0.1, high=0.9))


# ------------------------------------------------------------------------------------- star, zone plate


def test_star_is_mid_grey_at_the_centre_and_beyond_its_rim():
    value = charts.siemens_star([0.0], [0.0, 1e-300, 1e-9, 30.0, 1e6], 36, 20.0, Rendering(0.5, low=0.2, high=0.8))
    assert_allclose(value, 0.5, rtol=1e-15)


@pytest.mark.parametrize("cycles", [8, 36, 144])
def test_star_contrast_is_the_transfer_at_the_local_frequency(cycles):
    softness, radius = 1.0, 1e5
    x = np.linspace(cycles / 6, 4.0 * cycles, 50)
    contrast = 2 * charts.siemens_star([0.0], x, cycles, radius, Rendering(softness))[0] - 1
    assert_allclose(contrast, gaussian_transfer(cycles / (2 * np.pi * x), softness), rtol=0, atol=1e-15)


@pytest.mark.parametrize("cycles", [2, 8, 36, 144, 288])
def test_star_is_within_one_over_cycles_squared_of_the_exact_convolution(cycles):
    softness = 0.7
    x = np.geomspace(cycles / 40, 40 * cycles, 2000)
    rho = (x / softness) ** 2 / 4
    exact = np.sqrt(np.pi * rho / 2) * (ive((cycles - 1) / 2, rho) + ive((cycles + 1) / 2, rho))
    local = 2 * charts.siemens_star([0.0], x, cycles, 1e9, Rendering(softness))[0] - 1
    assert_allclose(local, np.nan_to_num(exact), rtol=0, atol=1 / cycles**2)


def test_star_repeats_after_one_period_of_angle():
    radius, cycles = 10.0, 12
    angles = 0.3 + 2 * np.pi * np.arange(cycles) / cycles
    value = [
        charts.siemens_star(
            [radius * np.sin(a)], [radius * np.cos(a)], cycles, 20.0, Rendering(0.5, low=0.1, high=0.9)
        )[0, 0]
        for a in angles
    ]
    assert_allclose(value, value[0], rtol=1e-13)


def test_a_star_with_a_seam_is_refused():
    with pytest.raises(ValueError, match="cycles must be a whole number"):
        charts.siemens_star(Y, X, 7.5, 10.0, Rendering(1.0, low=0.1, high=0.9))


def test_zone_plate_reaches_its_highest_frequency_at_its_radius():
    highest, radius, step = 0.4, 100.0, 1e-4
    # just inside the rim, cos and its slope give the local phase rate
    x = radius - 0.3 + step * np.arange(-1, 2)
    wave = 2 * charts.zone_plate([0.0], x, highest, radius, Rendering(0.0))[0] - 1
    rate = abs(wave[2] - wave[0]) / (2 * step) / np.sqrt(1 - wave[1] ** 2)
    assert_allclose(rate / (2 * np.pi), highest * (radius - 0.3) / radius, rtol=1e-6)


@pytest.mark.parametrize("softness", [0.2, 1.0, 3.0])
def test_zone_plate_is_within_its_bound_of_the_exact_convolution(softness):
    highest, radius = 0.5, 400.0
    x = np.linspace(0.0, 350.0, 20000)
    rate = np.pi * highest / radius
    c = 2 * rate * softness**2
    exact = (np.exp(1j * rate * x**2 / (1 - 1j * c)) / (1 - 1j * c)).real
    local = 2 * charts.zone_plate([0.0], x, highest, radius, Rendering(softness))[0] - 1
    assert_allclose(local, exact, rtol=0, atol=c)


def test_zone_plate_is_light_in_its_centre_and_mid_grey_far_out():
    value = charts.zone_plate([0.0], [0.0, 1000.0], 0.5, 100.0, Rendering(1.0, low=0.2, high=0.8))
    assert_allclose(value, [[0.8, 0.5]], rtol=1e-15)


# ----------------------------------------------------------------------------------------- wedge, points


def test_wedge_has_its_levels_in_its_bars_and_their_mean_around():
    levels = [0.1, 0.7, 0.4]
    x = [-100.0, -20.0, 0.0, 20.0, 100.0]
    value = charts.step_wedge([0.0, 90.0], x, levels, 60.0, 40.0, Rendering(0.5))
    assert_allclose(value, [[0.4, 0.1, 0.7, 0.4, 0.4], [0.4] * 5], rtol=1e-14)


@given(softness=st.floats(0.0, 3.0))
@settings(max_examples=20, deadline=None)
def test_softening_the_wedge_keeps_its_mean(softness):
    y, x = (np.arange(200) - 99.5) * 0.5, (np.arange(200) - 99.5) * 0.5
    value = charts.step_wedge(y, x, [0.1, 0.9, 0.3], 45.0, 30.0, Rendering(softness))
    # bars of 30 samples each, and a frame that ends 9 rms widths out: bars above and below the mean balance
    assert_allclose(value.mean(), (0.1 + 0.9 + 0.3) / 3, rtol=1e-13)


def test_spots_inside_the_frame_are_counted_by_their_volume():
    spacing, sigma, softness = 20.0, 1.0, 1.5
    y, x = np.arange(-47.0, 47.25, 0.25), np.arange(-58.0, 58.25, 0.25)
    value = charts.points(y, x, spacing, sigma, Rendering(softness, low=0.1, high=0.9))
    volume = np.sum(value - 0.1) * 0.25**2
    # 5 x 5 spots at -40 ... 40, none closer to the frame than 7 um = 3.9 rms widths: 5e-5 of a spot outside
    assert_allclose(volume, 25 * 0.8 * 2 * np.pi * sigma**2, rtol=1e-4)


def test_a_spot_has_the_widths_added_in_squares():
    x = np.array([0.0, 2.0])
    value = charts.points([0.0], x, 100.0, 3.0, Rendering(4.0))[0]
    assert_allclose(value, (3 / 5) ** 2 * np.exp(-0.5 * (x / 5) ** 2), rtol=1e-14)


def test_spots_repeat_with_their_spacing():
    y = np.arange(-10.0, 10.5, 0.5)
    x = np.arange(-60.0, 60.5, 0.5)
    value = charts.points(y, x, 30.0, 1.0, Rendering(0.5, low=0.2, high=0.8))
    inner = value[:, (x >= -45) & (x < -15)], value[:, (x >= 15) & (x < 45)]
    assert_allclose(inner[0], inner[1], rtol=1e-14)


def test_a_spot_beyond_the_frame_leaves_no_trace():
    value = charts.points([0.0], np.arange(-19.0, 19.1), 20.0, 3.0, Rendering(0.0))[0]
    assert_allclose(value[-1], np.exp(-0.5 * (19 / 3) ** 2), rtol=1e-13)


def test_spots_that_would_touch_are_refused():
    with pytest.raises(ValueError, match="spacing must be at least six"):
        charts.points(Y, X, 5.0, 1.0, Rendering(0.0))


# ----------------------------------------------------------------------------------------------- patches


@given(
    rows=st.integers(1, 5),
    columns=st.integers(1, 6),
    gap=st.floats(0.0, 5.0),
    softness=SOFT,
)
@settings(max_examples=30, deadline=None)
def test_patches_and_background_share_out_every_position_once(rows, columns, gap, softness):
    grid = (composite.PatchGrid(rows, columns, 60.0, 40.0, gap), Rendering(softness))
    planes = composite.patches(Y, X, *grid)
    rest = composite.background_weight(*composite.patches_factors(Y, X, *grid))
    assert planes.shape == (rows * columns, len(Y), len(X))
    assert min(planes.min(), rest.min()) >= 0 and max(planes.max(), rest.max()) <= 1
    assert_allclose(planes.sum(axis=0) + rest, 1.0, rtol=0, atol=1e-14)


def test_patches_without_gaps_are_one_rectangle():
    one = composite.patches(Y, X, composite.PatchGrid(1, 1, 60.0, 40.0, 0.0), Rendering(0.8))[0]
    assert_allclose(
        composite.patches(Y, X, composite.PatchGrid(4, 6, 60.0, 40.0, 0.0), Rendering(0.8)).sum(axis=0),
        one,
        rtol=0,
        atol=1e-14,
    )


def test_patches_run_row_by_row_from_the_top_left():
    planes = composite.patches(
        [-10.0, 10.0], [-20.0, 0.0, 20.0], composite.PatchGrid(2, 3, 60.0, 40.0, 0.0), Rendering(0.1)
    )
    assert_allclose(planes.reshape(6, 6), np.eye(6), atol=1e-14)


def test_each_patch_has_the_area_of_its_rectangle():
    planes = composite.patches(Y, X, composite.PatchGrid(2, 3, 40.0, 30.0, 4.0), Rendering(0.8))
    # sums of smooth profiles over a fine grid are exact to rounding: softness is 1.6 spacings,
    # whose first alias is exp(-2 pi^2 1.6^2)
    assert_allclose(planes.sum(axis=(1, 2)) * 0.25, (40 - 8) / 3 * (30 - 4) / 2, rtol=1e-12)


def test_contribution_of_patches_is_the_sum_over_their_planes():
    grid = (composite.PatchGrid(4, 6, 60.0, 40.0, 1.0), Rendering(0.8))
    spectra = np.random.default_rng(1).uniform(size=(24, 5))
    fast = composite.patch_contribution(*composite.patches_factors(Y, X, *grid), spectra)
    assert_allclose(fast, np.einsum("pl,pyx->lyx", spectra, composite.patches(Y, X, *grid)), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("rows", "gap", "message"), [(0, 0.0, "rows"), (2, -1.0, "gap"), (3, 20.0, "gap")])
def test_grids_of_patches_that_cannot_be_are_refused(rows, gap, message):
    with pytest.raises(ValueError, match=message):
        composite.patches_factors(Y, X, composite.PatchGrid(rows, 1, 60.0, 40.0, gap), Rendering(1.0))


# --------------------------------------------------------------------------------------------- composite


@given(levels=LEVELS, softness=st.floats(0.0, 3.0), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_possible_reflectances_give_a_composite_within_zero_and_one(levels, softness, seed):
    low, high = levels
    chart = composite.composite(
        Y, X, 80.0, 60.0, Rendering(softness, low=low, high=high), composite.Panels(highest_frequency=0.5, cycles=12)
    )
    spectra = np.random.default_rng(seed).uniform(size=(24, 3))
    cube = chart.grey[None] + composite.patch_contribution(chart.rows, chart.columns, spectra)
    assert cube.min() >= 0 and cube.max() <= 1 + 1e-15


def test_composite_is_seamless_outside_its_panels():
    y, x = np.arange(-300.0, 301.0), np.arange(-450.0, 451.0)
    chart = composite.composite(
        y, x, 900.0, 600.0, Rendering(1.0, low=0.1, high=0.7), composite.Panels(highest_frequency=0.2)
    )
    outside = np.ones((y.size, x.size), dtype=bool)
    for top, bottom, left, right in composite.composite_regions(900.0, 600.0).values():
        outside[np.ix_((y >= top - 10) & (y <= bottom + 10), (x >= left - 10) & (x <= right + 10))] = False
    assert outside.sum() > 30000
    assert_allclose(chart.grey[outside], 0.4, rtol=1e-14)


@pytest.mark.parametrize("angle", [-10.0, 0.0, 5.0, 10.0])
def test_each_edge_window_holds_one_edge_and_nothing_else(angle):
    width, height, softness = 900.0, 600.0, 1.0
    regions = composite.composite_regions(width, height)
    squares = regions["squares"]
    centre = 0.5 * (squares.top + squares.bottom)
    half = 0.2 * 300.0 / np.cos(np.deg2rad(angle))
    for name in ("edge_vertical", "edge_horizontal"):
        top, bottom, left, right = regions[name]
        y, x = np.linspace(top, bottom, 40), np.linspace(left, right, 41)
        value = composite.composite(
            y,
            x,
            width,
            height,
            Rendering(softness, low=0.1, high=0.7),
            composite.Panels(highest_frequency=0.2, angle_deg=angle),
        ).grey
        if name == "edge_vertical":  # light outside on the left: the edge chart with its levels swapped
            expected = 0.8 - charts.slanted_edge(y - centre, x, angle, Rendering(softness, low=0.1, high=0.7), -half)
        else:  # the same edge after a quarter turn, which takes (y, x) to (x, -y)
            expected = 0.8 - charts.slanted_edge(-x, y - centre, angle, Rendering(softness, low=0.1, high=0.7), -half).T
        assert_allclose(value, expected, rtol=0, atol=1e-12)


def test_panels_of_the_composite_are_the_single_charts():
    regions = composite.composite_regions(900.0, 600.0)
    single = {
        "star": lambda v, u: charts.siemens_star(v, u, 36, 135.0, Rendering(1.0, low=0.1, high=0.7)),
        "zone_plate": lambda v, u: charts.zone_plate(v, u, 0.2, 135.0, Rendering(1.0, low=0.1, high=0.7)),
        "wedge": lambda v, u: charts.step_wedge(v, u, np.linspace(0.1, 0.7, 8), 270.0, 270.0, Rendering(1.0)),
    }
    for name, chart in single.items():
        top, bottom, left, right = regions[name]
        y, x = np.linspace(top - 9, bottom + 9, 50), np.linspace(left - 9, right + 9, 51)
        value = composite.composite(
            y, x, 900.0, 600.0, Rendering(1.0, low=0.1, high=0.7), composite.Panels(highest_frequency=0.2)
        ).grey
        expected = chart(y - 0.5 * (top + bottom), x - 0.5 * (left + right))
        assert_allclose(value, expected, rtol=0, atol=1e-12)  # phases of 100 rad, positions of 300 um


@pytest.mark.parametrize("softness", [0.5, 8.0])
def test_leaving_out_the_far_tails_of_panels_changes_nothing(softness):
    y, x = np.arange(-300.0, 301.0, 3.0), np.arange(0.0, 451.0, 3.0)
    chart = composite.composite(
        y, x, 900.0, 600.0, Rendering(softness, low=0.1, high=0.7), composite.Panels(highest_frequency=0.2)
    )
    v, u = y + 150.0, x - 300.0
    panels = [
        composite._tilted_squares(v, x, 300.0, 5.0, Rendering(softness, low=0.1, high=0.7)),
        charts.siemens_star(y - 150.0, x, 36, 135.0, Rendering(softness, low=0.1, high=0.7)),
        charts.zone_plate(v, u, 0.2, 135.0, Rendering(softness, low=0.1, high=0.7)),
        charts.step_wedge(y - 150.0, u, np.linspace(0.1, 0.7, 8), 270.0, 270.0, Rendering(softness)),
    ]
    everywhere = 0.4 + sum(panel - 0.4 for panel in panels)
    covered = chart.rows.sum(axis=0)[:, None] * chart.columns.sum(axis=0)
    assert_allclose(chart.grey, np.clip(everywhere, 0.1, 0.7) * (1 - covered), rtol=0, atol=1e-12)


def test_regions_of_the_composite_do_not_overlap_and_lie_inside():
    regions = composite.composite_regions(900.0, 500.0)
    panels = [regions[name] for name in ("patches", "squares", "star", "zone_plate", "wedge")]
    for index, one in enumerate(panels):
        assert one.top > -250 and one.bottom < 250 and one.left > -450 and one.right < 450
        for other in panels[:index]:
            apart_y = one.top > other.bottom or other.top > one.bottom
            apart_x = one.left > other.right or other.left > one.right
            assert apart_y or apart_x


def test_the_patch_factors_of_the_composite_stay_in_the_left_third():
    chart = composite.composite(
        [0.0], X, 80.0, 60.0, Rendering(0.2, low=0.05, high=0.9), composite.Panels(highest_frequency=0.5)
    )
    assert chart.rows.shape == (4, 1) and chart.columns.shape == (6, len(X))
    assert chart.columns[:, X > -80 / 6].max() < 1e-6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"high": 1.2}, "high"),
        ({"angle_deg": 11.0}, "angle_deg"),
        ({"steps": 1}, "steps"),
        ({"cycles": 0}, "cycles"),
    ],
)
def test_a_composite_that_cannot_be_is_refused(change, message):
    drawn = Rendering(1.0, low=0.05, high=change.get("high", 0.9))
    change = {name: value for name, value in change.items() if name != "high"}
    with pytest.raises(ValueError, match=message):
        composite.composite(Y, X, 80.0, 60.0, drawn, composite.Panels(0.5, **change))


# ------------------------------------------------------------------------------------------- photographs


@given(n_in=st.integers(1, 60), n_out=st.integers(1, 60), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_area_averaging_keeps_the_mean_and_the_range(n_in, n_out, seed):
    weights = resampling.area_weights(n_in, n_out)
    row = np.random.default_rng(seed).uniform(size=n_in)
    assert weights.shape == (n_out, n_in) and weights.min() >= 0
    assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-14)
    assert_allclose(weights.sum(axis=0), n_out / n_in, rtol=1e-14)
    assert_allclose((weights @ row).mean(), row.mean(), rtol=1e-13)


@given(n_in=st.integers(1, 12), factor=st.integers(1, 6))
@settings(max_examples=20, deadline=None)
def test_enlarging_by_a_whole_factor_repeats_samples_and_reducing_undoes_it(n_in, factor):
    up, down = resampling.area_weights(n_in, n_in * factor), resampling.area_weights(n_in * factor, n_in)
    assert_array_equal(up, np.repeat(np.eye(n_in), factor, axis=0))
    assert_allclose(down @ up, np.eye(n_in), atol=1e-15)


def test_area_weights_are_overlaps_over_lengths():
    assert_allclose(resampling.area_weights(3, 2), [[2 / 3, 1 / 3, 0], [0, 1 / 3, 2 / 3]], rtol=1e-15)


def test_area_averaging_looks_the_same_from_both_ends():
    weights = resampling.area_weights(17, 5)
    assert_array_equal(weights, weights[::-1, ::-1])


@pytest.mark.parametrize(("n_in", "n_out", "message"), [(0, 1, "n_in"), (4, 0, "n_out"), (4, 2.5, "n_out")])
def test_counts_of_samples_must_be_whole_and_positive(n_in, n_out, message):
    with pytest.raises(ValueError, match=message):
        resampling.area_weights(n_in, n_out)


# ---------------------------------------------------------------------------------------- means over cells


def in_parts(paint, y, x, cell, parts=40):
    """Mean over cells by brute force: the middle of 40 x 40 parts."""
    within = ((np.arange(parts) + 0.5) / parts - 0.5) * cell
    fine = paint((y[:, None] + within).ravel(), (x[:, None] + within).ravel())
    return fine.reshape(y.size, parts, x.size, parts).mean(axis=(1, 3))


CELL_Y, CELL_X = (np.arange(21) - 10) * 1.7, (np.arange(24) - 11.5) * 1.7


@given(
    angle=st.floats(-89.0, 89.0), offset=st.floats(-10.0, 10.0), softness=st.sampled_from([0.0, 0.0, 0.05, 0.6, 3.0])
)
@settings(max_examples=60, deadline=None)
def test_the_mean_of_a_slanted_edge_over_cells_is_the_area_of_its_half_plane(angle, offset, softness):
    found = charts.slanted_edge(CELL_Y, CELL_X, angle, Rendering(softness, 1.7), offset)
    expected = in_parts(lambda y, x: charts.slanted_edge(y, x, angle, Rendering(softness), offset), CELL_Y, CELL_X, 1.7)
    # a hard edge passes through at most 80 of 1600 parts, each wrong by half a part; a soft one is smooth
    assert_allclose(found, expected, rtol=0, atol=80 / 1600 / 2 if softness < 0.1 else 2e-4)
    assert found.min() >= 0 and found.max() <= 1


@given(angle=st.floats(-80.0, 80.0), softness=st.floats(0.0, 3.0))
@settings(max_examples=40, deadline=None)
def test_cells_side_by_side_hold_what_the_large_cell_holds(angle, softness):
    """3 x 3 cells of a third of the side, whatever the edge; tilts of 1e-5 degrees lose 3.2e-10 by rounding."""
    y, x = np.arange(-6, 7) * 0.9, np.arange(-7, 8) * 0.9
    large = charts.slanted_edge(y, x, angle, Rendering(softness, 0.9), 0.2)
    within = np.array([-0.3, 0.0, 0.3])
    small = charts.slanted_edge(
        (y[:, None] + within).ravel(), (x[:, None] + within).ravel(), angle, Rendering(softness, 0.3), 0.2
    )
    assert_allclose(small.reshape(y.size, 3, x.size, 3).mean(axis=(1, 3)), large, rtol=0, atol=1e-9)


def test_an_edge_along_the_columns_covers_its_share_of_the_cells_it_cuts():
    found = charts.slanted_edge([0.0, 1.0], [-1.0, 0.0, 1.0], 0.0, Rendering(0.0, 1.0, 0.2, 1.0), 0.1)
    assert_allclose(found, [[0.2, 0.2 + 0.8 * 0.4, 1.0]] * 2, rtol=1e-15)


@pytest.mark.parametrize("softness", [0.0, 0.8])
@pytest.mark.parametrize(
    "name",
    ["siemens_star", "zone_plate", "step_wedge", "patches", "points", "squares"],
)
def test_means_over_cells_are_those_of_many_points(name, softness):
    cell = 1.7
    paints = {
        "siemens_star": lambda y, x, c: charts.siemens_star(y, x, 8, 15.0, Rendering(softness, c, 0.1, 0.9)),
        "zone_plate": lambda y, x, c: charts.zone_plate(y, x, 0.2, 15.0, Rendering(softness, c, 0.1, 0.9)),
        "step_wedge": lambda y, x, c: charts.step_wedge(y, x, [0.1, 0.4, 0.9], 28.0, 20.0, Rendering(softness, c)),
        "patches": lambda y, x, c: composite.patches(
            y, x, composite.PatchGrid(2, 3, 30.0, 24.0, 3.0), Rendering(softness, c)
        ).sum(axis=0),
        "points": lambda y, x, c: charts.points(y, x, 12.0, 0.7, Rendering(softness, c, 0.1, 0.9)),
        "squares": lambda y, x, c: composite._tilted_squares(y, x, 30.0, 7.0, Rendering(softness, c, 0.1, 0.9)),
    }
    paint = paints[name]
    found = paint(CELL_Y, CELL_X, cell)
    expected = in_parts(lambda y, x: paint(y, x, 0.0), CELL_Y, CELL_X, cell)
    # hard borders: half a part in 40 across a cell for the brute force, and 0.01 for the quadrature of curved ones
    assert_allclose(found, expected, rtol=0, atol=0.8 * (0.5 / 40 + 0.01) if softness == 0 else 1e-3)
    if name != "points":
        assert found.min() >= 0 and found.max() <= 1


@given(sigma=st.floats(1e-6, 2.0), where=st.floats(-0.5, 0.5))
@settings(max_examples=40, deadline=None)
def test_the_flux_of_a_spot_is_in_the_cells_however_narrow_it_is(sigma, where):
    y, x = np.arange(-20, 21) + where, np.arange(-22, 23) - where / 3
    spot = charts.points(y, x, 1000.0, sigma, Rendering(0.0, 1.0))
    # a place has the last bits of 20 um: beside the border of a cell they are a share of a narrow spot
    assert_allclose(spot.sum(), 2 * np.pi * sigma**2, rtol=1e-13 + 4e-15 / sigma)
    assert spot.min() >= 0


def test_cells_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="cell"):
        charts.slanted_edge(Y, X, 5.0, Rendering(0.0, -1.0, 0.1, 0.9), 0.0)
    with pytest.raises(ValueError, match="cell must be at most the spacing"):
        charts.points(Y, X, 10.0, 0.5, Rendering(0.0, 11.0, 0.1, 0.9))
