"""What stages say of themselves is said exactly where it is true: notes, reasons, bounds. Nothing is run."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.registry import installed_stages
from etendue.testing.cases import ordinary
from etendue_camera import colour_notes
from etendue_camera.optics import glare
from etendue_camera.spectra import ends


def stage(use, **given):
    kind = installed_stages().load(use)
    return kind(**{**ordinary(kind), **given})


def light(rows=8, columns=8, spacing=2.0, edges=(400.0, 500.0, 600.0, 700.0)):
    lines = {dim: Line(n, -0.5 * (n - 1) * spacing, spacing) for dim, n in (("y", rows), ("x", columns))}
    return Grid.of({"wavelength": Bands(edges), **lines})


LIGHT = Facts(uniform=False, low=0.0, high=1.0)


def said(one, grid=None, facts=LIGHT):
    return one.warn(facts, {name: grid or light() for name in ("irradiance", "white_radiance", "radiance")})


@pytest.mark.parametrize("noise", ["read_noise", "read_noise_after", "dsnu"])
def test_a_read_out_does_nothing_only_without_any_of_its_noises(noise):
    none = dict.fromkeys(("read_noise", "read_noise_after", "dsnu"), 0.0)
    assert stage("read_noise", **none).negligible(LIGHT, light())[0] == 0
    assert stage("read_noise", **{**none, noise: 1.0}).negligible(LIGHT, light()) is None


def test_lines_that_are_fixed_have_no_bounds_and_those_new_in_each_frame_keep_the_mean():
    facts = {"charge": Facts(low=1.0, high=2.0)}
    for name, bounded, halo in (
        ("row_pattern", False, 0),
        ("column_pattern", False, 0),
        ("row_noise", True, 0),
        ("column_noise", True, None),  # one draw serves all rows
    ):
        one = stage("line_pattern", **{name: 1.0})
        assert (one.carry(facts, {}).high == 2.0) == bounded, name
        assert one.halo() == halo, name


@pytest.mark.parametrize("black", [0, 1, 5, 20])
def test_a_pedestal_is_too_low_below_four_sigma_and_the_advised_one_is_not(black):
    one = stage("adc", black_level=black, read_noise=6.1, conversion_gain=1.0, bits=12)
    wide = one.read_sigma() * one.dn_per_electron()
    notes = one.warn(LIGHT, {})
    assert bool(notes) == (black < 4 * wide)
    for text in notes:
        share = float(text.split(" DN): ")[1].split(" of a dark frame")[0])
        codes = np.linspace(-12 * wide, 12 * wide, 400_001)  # Gaussian noise that rounds to a code below 0
        weight = np.exp(-0.5 * (codes / wide) ** 2)
        below = weight[np.rint(codes + black) < 0].sum() / weight.sum()
        assert_allclose(share, below, rtol=0.05)  # printed with two digits
        advised = int(text.split("; ")[1].split(" DN avoid")[0])
        again = {"black_level": advised, "read_noise": 6.1, "conversion_gain": 1.0, "bits": 12}
        assert not stage("adc", **again).warn(LIGHT, {})


def test_errors_of_codes_grow_by_the_brightest_charge_over_that_which_saturates():
    for gain in (0.5, 8.0):  # the well, or the top code, is reached first
        one = stage("adc", conversion_gain=gain, bits=12)
        high = 3 * one.saturation()
        assert_allclose(one.growth({"charge": Facts(low=0.0, high=high)}), 3.0, rtol=1e-12)
    assert one.saturation() < 0.9 * one.well()
    assert one.growth({"charge": Facts()}) == 1.0


def test_a_metered_time_is_within_the_bounds_that_the_plan_states():
    random = np.random.default_rng(3)
    for metering in ("mean", "centre", "highlight"):
        one = stage("meter", metering=metering, quantile=0.9, shortest=1e-9, longest=1e9)
        for power in (1.0, 8.0):
            rate = 1e4 * random.uniform(0.1, 1.0, (40, 50)) ** power
            facts = Facts(low=float(rate.min()), high=float(rate.max()), mean=float(rate.mean()))
            bounds = one.carry({"photocurrent": facts}, {})
            seconds = one.time(rate)
            assert bounds.low * (1 - 1e-12) <= seconds <= bounds.high * (1 + 1e-12)
    low, high = stage("meter", metering="highlight", quantile=0.9).levels(Facts(low=0.0, high=1.0, mean=0.95))
    assert_allclose((low, high), ((0.95 - 0.1) / 0.9, 1.0), rtol=1e-12)  # nine in ten at the level, the rest at 1


def test_bounds_of_brackets_are_those_of_the_shortest_and_the_longest_in_any_order():
    for brackets in ((-2.0, 0.0, 3.0), (0.0, 3.0, -2.0), (3.0, -2.0, 0.0)):
        one = stage("bracket", brackets=brackets, integration_time=0.5)
        times, facts = one.run()["integration_time"], one.carry({}, {})
        assert (facts.low, facts.high) == (times.min(), times.max()) == (0.125, 4.0)


def test_a_note_on_colours_names_the_space_and_the_curve_that_values_are_read_in():
    note = colour_notes.not_applied("its colour space (Display P3, PQ)")
    assert colour_notes.is_named(note, "Display P3", "PQ")
    assert not colour_notes.is_named(note, "Display P3", "sRGB")
    assert not colour_notes.is_named(note, "sRGB", "PQ")
    assert colour_notes.is_named(colour_notes.not_applied("its colour profile (Adobe RGB)"), "Adobe RGB (1998)", "x")
    assert not colour_notes.is_named("", "sRGB", "sRGB")


@pytest.mark.parametrize(("space", "index", "noted"), [(1, "R98", False), (2, "", True), (1, "R03", True)])
def test_adobe_rgb_is_known_by_either_entry(space, index, noted):
    class Exif(dict):
        def get_ifd(self, tag):
            own = {colour_notes.COLOUR_SPACE: space}
            return own if tag == colour_notes.EXIF_IFD else {1: index}

    assert bool(colour_notes.exif_note(Exif(), {})) == noted


def test_the_cone_of_a_flat_pupil_is_narrower_by_the_law_of_tangents():
    """1/(2 sin) of the half angle whose tangent is 1/(2 N)."""
    for number in (0.7, 1.4, 8.0):
        flat = stage(
            "diffraction", f_number=number, magnification=0.0, focus_distance=math.inf, aperture_model="flat_disc"
        )
        assert_allclose(flat.cone_f_number(), 0.5 / math.sin(math.atan(0.5 / flat.working_f_number())), rtol=1e-12)
        round_ = stage("diffraction", f_number=number, aperture_model="aplanatic")
        assert round_.cone_f_number() == round_.working_f_number()


def test_a_table_reaches_half_a_step_beyond_each_end_of_its_own():
    assert ends.reach_of(np.array([400.0, 404.0, 414.0])) == (398.0, 419.0)
    assert ends.reach_of(np.array([400.0, 430.0, 440.0])) == (400.0, 445.0)  # a step of 30 nm is a drawn curve


def test_what_is_cut_off_is_counted_with_the_end_value_of_its_own_side():
    rows, curve = np.array([400.0, 410.0, 420.0]), np.array([0.2, 1.0, 0.6])
    # over 395 to 425 nm: (5 x 0.2 + 10 x 0.6 + 10 x 0.8 + 5 x 0.6) = 18; beyond: 10 x 0.2 below, 20 x 0.6 above
    for lowest, highest, lost in ((385.0, 425.0, 2.0), (395.0, 445.0, 12.0), (385.0, 445.0, 14.0)):
        (text,) = ends.cut_off_note("a table", ["R"], rows, curve[:, None], lowest, highest)
        share = float(text.split("end values extended, ")[1].split(" %")[0])
        assert_allclose(share, 100 * lost / (18 + lost), rtol=0.05)  # printed with two digits
    assert not ends.cut_off_note("a table", ["R"], rows, curve[:, None], 395.0, 425.0)


def test_reflectances_held_before_their_table_are_noted_and_those_just_behind_it_are_not():
    assert not ends.held_in_the_infrared("ColorChecker", 380.0, 780.0)
    assert ends.held_in_the_infrared("ColorChecker", 380.0, 1000.0)
    (text,) = ends.held_in_the_infrared("ColorChecker", 300.0, 700.0)
    assert f"{100 * 75 / 400:.2g} %" in text  # 300 to 375 nm, half a step before the first row


def test_glare_beyond_half_the_shorter_side_is_noted():
    one = stage("glare", fraction=0.3, radius=20.0, power=3.0)
    for rows, columns in ((40, 400), (400, 40)):
        (text,) = said(one, light(rows, columns))
        outside = 30 * (1 - glare.tail_within(40.0, 20.0, 3.0))
        assert text.startswith(f"{outside:.2g} % of the light")
    assert not said(one, light(4000, 4000))


def test_a_fast_lens_is_noted_below_f_1_2():
    assert said(stage("irradiance", f_number=1.19)) and not said(stage("irradiance", f_number=1.2))


@pytest.mark.parametrize(
    ("pitch", "depth", "noted"),
    [(5.0, 0.1, False), (2.0, 0.1, True), (5.0, 1000.0, True)],
    ids=["large", "small", "deep"],
)
def test_charge_under_other_filters_is_noted_at_a_small_pitch_or_where_it_diffuses_far(pitch, depth, noted):
    one = stage("pixel", pixel_pitch=pitch, diffusion_depth=depth, depletion_depth=1.0, crosstalk="per_plane")
    assert any("charge diffuses into pixels" in text for text in said(one)) == noted


def test_a_gain_at_its_limit_is_told_as_limited_and_below_it_as_noise():
    grid = Grid.of({dim: Line(64, 0.0, 1.0, "1", (-3150.0, 100.0)) for dim in ("y", "x")})
    free = stage("lens_shading", focal_length=7.0)
    largest = free.largest(grid)
    for limit, told in ((largest, "gains are limited"), (1.01 * largest, "noise grows")):
        (text,) = stage("lens_shading", focal_length=7.0, largest_gain=limit).warn(LIGHT, {"mosaic_linear": grid})
        assert told in text


def test_a_grid_is_too_coarse_for_the_shortest_wave_that_the_lens_passes():
    """The cut-off 1/(lambda N) of the bluest band is the highest; above Nyquist, 1/(2 spacing), it is noted."""
    facts = Facts(uniform=False, band_limit=10.0)
    for spacing in (0.95, 1.05):  # um, around 0.4 um x 5 / 2 = 1 um
        one = stage("diffraction", f_number=5.0, magnification=0.0, focus_distance=math.inf)
        assert bool(said(one, light(spacing=spacing), facts)) == (spacing > 0.5 * 0.4 * one.cone_f_number() * 1.001)


@pytest.mark.parametrize(("y", "x"), [(0.0, 0.0), (2.0, 0.0), (0.0, 2.0)])
def test_coma_is_noted_on_the_axis_alone(y, x):
    notes = said(stage("wavefront", coma=0.1, field_y=y, field_x=x))
    assert any("zero on axis" in text for text in notes) == (y == x == 0)


def test_leaves_below_the_spacing_are_noted():
    for smallest in (0.5, 0.99, 1.0, 2.0):
        notes = said(stage("dead_leaves", smallest=smallest, largest=20.0, spacing=1.0))
        assert any("does not resolve them" in text for text in notes) == (smallest < 1)


def test_a_black_corner_is_noted():
    for columns in (8, 20_000):
        one, grid = stage("vignetting", rim_radius=1.3, rim_distance=4.0, focal_length=7.0), light(8, columns)
        corner = float(one.relative(0.5 * math.hypot(7 * 2.0, (columns - 1) * 2.0)))
        assert bool(said(one, grid)) == (corner == 0)
    assert corner == 0


def test_planes_across_which_charge_diffuses_are_noted_where_no_stage_does_it_in_planes():
    one, kinds = stage("no_mask", crosstalk="through_filter"), installed_stages()
    mixing, planes = kinds.load("crosstalk"), kinds.load("crosstalk_planes")
    assert one.warn_among({"crosstalk": mixing})
    assert not one.warn_among({"crosstalk": mixing, "crosstalk_planes": planes})
    assert not one.warn_among({}) and not stage("no_mask").warn_among({"crosstalk": mixing})
