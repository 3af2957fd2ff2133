"""Laws of spectral tables as bin means: exact averaging, exact round trips, and lights of known colour."""

import subprocess
import sys
from importlib.resources import files
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera import spectra
from etendue_camera.spectra import authority, library, shipped

VISIBLE_5 = np.arange(380.0, 781.0, 5.0)
VISIBLE_10 = np.arange(380.0, 781.0, 10.0)
ROUNDING = 1e-13  # sums of a few hundred positive float64 terms


def widths(edges):
    return np.diff(edges)


def xyz(reflectance, edges):
    """XYZ under D65, Y of the perfect diffuser 1, from the public bin means alone."""
    weight = spectra.illuminant("D65", edges)[:, None] * spectra.colour_matching(edges) * widths(edges)[:, None]
    return reflectance.T @ weight / weight[:, 1].sum()


def whole(step):
    """Bins over all that an eye sees."""
    return np.arange(360.0, 830.0 + step, step)


def d65_weights(edges):
    """(n, 3): XYZ of a reflectance under D65, which holds its end values beyond 780 nm, Y of the perfect diffuser 1."""
    inside = np.clip(edges, 300.0, 780.0)
    last = spectra.illuminant("D65", [780.0 - 1e-6, 780.0])[0]
    power = np.array([spectra.illuminant("D65", [a, b])[0] * (b - a) if b > a else 0.0 for a, b in pairwise(inside)])
    power += last * (widths(edges) - widths(inside))
    weight = power[:, None] * spectra.colour_matching(edges)
    return weight / weight[:, 1].sum()


def tables(edges):
    """Every kind of table, as one (n, k) array."""
    return np.column_stack(
        [
            spectra.illuminant("D65", edges),
            spectra.illuminant("FL11", edges),
            spectra.illuminant("2856 K", edges),
            spectra.colour_matching(edges),
            spectra.cone_fundamentals(edges),
            spectra.camera_sensitivity("Nikon 5100 (NPL)", edges)[1],
            spectra.display_primaries("Apple Studio Display", edges),
            spectra.colorchecker(edges)[1].T,
        ]
    )


def run_python(code, *flags):
    return subprocess.run(
        [sys.executable, *flags, "-c", code], capture_output=True, text=True, timeout=120, check=False
    )


# --------------------------------------------------------------------------------------------- the import


def test_importing_spectra_and_asking_the_version_does_not_import_colour():
    done = run_python(
        "import sys, etendue_camera.spectra as s\nprint(s.colour_version()); assert 'colour' not in sys.modules"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == spectra.colour_version()


def test_tables_load_without_any_warning_where_matplotlib_is_missing():
    done = run_python(
        "import sys; sys.modules['matplotlib'] = None\n"
        "from etendue_camera.spectra.authority import rows; rows('illuminant', 'D65'); assert 'colour' in sys.modules",
        "-W",
        "error",
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


# --------------------------------------------------------------------------------------- what is shipped


ULPS = (
    64 * 2.0**-52
)  # what BLAS inverts and interpolates differs so far from processor to processor; the tables themselves do not


def test_every_shipped_table_is_that_of_the_library_to_the_last_bit():
    import colour

    assert str(shipped.arrays()[shipped.VERSION]) == spectra.colour_version()
    held = {
        "illuminant": colour.SDS_ILLUMINANTS,
        "camera": colour.MSDS_CAMERA_SENSITIVITIES,
        "display": colour.MSDS_DISPLAY_PRIMARIES,
    }
    for kind, tables in held.items():
        assert list(shipped.names(kind)) == list(tables)
        for name in tables:
            nodes, values = shipped.curve(kind, name)
            assert nodes.tobytes() == tables[name].wavelengths.tobytes()
            assert values.tobytes() == np.ascontiguousarray(tables[name].values).tobytes()
    for name in authority.OBSERVERS:
        assert shipped.curve("observer", name)[1].tobytes() == colour.MSDS_CMFS[name].values.tobytes()
    for name in colour.RGB_COLOURSPACES:
        own, its = shipped.space(name), colour.RGB_COLOURSPACES[name]
        assert_allclose(own["matrix"], its.matrix_RGB_to_XYZ, rtol=ULPS, atol=1e-16)
        assert str(own["white_name"]) == its.whitepoint_name
        assert_array_equal(own["primaries"].ravel(), np.ravel(its.primaries))
        assert_array_equal(own["white"], its.whitepoint)
    whites = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]
    assert {name: tuple(shipped.white(name)) for name in shipped.names("white")} == {
        name: tuple(whites[name]) for name in whites
    }
    for name, matrix in colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS.items():
        assert_array_equal(shipped.adaptation(name), matrix)


def test_every_smooth_table_is_what_the_interpolator_of_the_library_gives():
    import colour

    smooth = {
        "patch": colour.SDS_COLOURCHECKERS[authority.COLORCHECKER],
        "smooth camera": colour.MSDS_CAMERA_SENSITIVITIES,
    }
    smooth["basis"] = {authority.BASIS: colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019}
    for kind, tables in smooth.items():
        assert list(shipped.names(kind)) == list(tables)
        for name in tables:
            nodes, values = shipped.curve(kind, name)
            given = tables[name]
            columns = np.asarray(given.values).reshape(len(given.wavelengths), -1).T
            curves = [
                np.maximum(colour.SpragueInterpolator(given.wavelengths, column)(nodes), 0.0) for column in columns
            ]
            assert_allclose(values, np.stack(curves, axis=-1).reshape(values.shape), rtol=ULPS, atol=1e-15)


@pytest.mark.bits
def test_the_shipped_file_is_what_the_command_makes_now():
    with (files("etendue_camera") / "data" / "spectra.npz").open("rb") as file, np.load(file) as held:
        made = shipped.made()
        assert list(held) == list(made)
        for name in held:
            assert held[name].dtype == np.asarray(made[name]).dtype
            if held[name].dtype.kind == "f":
                assert_allclose(held[name], made[name], rtol=ULPS, atol=1e-15, err_msg=name)
            else:
                assert_array_equal(held[name], made[name])


def test_where_another_version_of_the_library_is_installed_its_tables_are_taken_and_kept(tmp_path, monkeypatch):
    """Keys hold the version that is installed, so the tables must be of that version too."""
    theirs = dict(shipped.made())
    theirs["illuminant/rows"] = 2.0 * theirs["illuminant/rows"]
    asked = []
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path))
    monkeypatch.setattr(authority, "colour_version", lambda: "9.9")
    monkeypatch.setattr(shipped, "made", lambda: asked.append("made") or theirs)
    original = shipped.arrays.__wrapped__
    for _ in range(2):
        assert_array_equal(original()["illuminant/rows"], theirs["illuminant/rows"])
    assert asked == ["made"]
    for kept in (tmp_path / "spectra").iterdir():
        kept.write_bytes(kept.read_bytes()[:5000])
    assert_array_equal(original()["illuminant/rows"], theirs["illuminant/rows"])
    assert asked == ["made", "made"]
    (tmp_path / "authority.py").write_text("edited")
    monkeypatch.setattr(authority, "__file__", str(tmp_path / "authority.py"))
    original()
    assert asked == ["made", "made", "made"]  # what other code has made is not taken


def test_a_name_beyond_the_shipped_ones_is_asked_of_the_library(monkeypatch):
    monkeypatch.setitem(shipped._places("illuminant"), "D65", None)
    nodes, values = shipped.curve("illuminant", "D65")
    monkeypatch.undo()
    assert all(map(np.array_equal, (nodes, values), shipped.curve("illuminant", "D65")))
    with pytest.raises(ValueError, match=r"unknown illuminant 'D66'; nearest names: .*'D65'"):
        shipped.curve("illuminant", "D66")


# ---------------------------------------------------------------------------------------------- bin means


@given(cuts=st.lists(st.floats(0.02, 0.98), min_size=1, max_size=3, unique=True))
@settings(max_examples=15, deadline=None)
def test_bins_that_split_a_bin_average_back_to_it(cuts):
    parts = np.unique(np.concatenate([[550.0], 550.0 + 10.0 * np.array(cuts), [560.0]]))
    average = widths(parts) @ tables(parts) / 10.0
    assert_allclose(average, tables(np.array([550.0, 560.0]))[0], rtol=ROUNDING)


def test_five_nm_bins_average_to_ten_nm_bins_over_the_whole_axis():
    fine = tables(VISIBLE_5)
    assert_allclose(0.5 * (fine[::2] + fine[1::2]), tables(VISIBLE_10), rtol=ROUNDING, atol=1e-18)


def test_feet_of_a_curve_keep_their_relative_precision():
    # y-bar is 5e-7 here: differences of one running integral, which is 107, would leave eight digits
    parts = np.array([820.0, 823.7, 829.1, 830.0])
    average = widths(parts) @ spectra.luminous_efficiency(parts) / 10.0
    assert_allclose(average, spectra.luminous_efficiency([820.0, 830.0])[0], rtol=1e-14)


def test_a_bin_centred_on_a_row_of_a_linear_table_is_weighted_one_six_one():
    # D65 at 450, 455, 460 nm is 117.008, 117.410, 117.812 (CIE): bin of one spacing about the middle row
    assert_allclose(spectra.illuminant("D65", [452.5, 457.5])[0], (117.008 + 6 * 117.410 + 117.812) / 8, rtol=ROUNDING)


def test_equal_energy_is_one_hundred_in_every_bin():
    assert_array_equal(spectra.illuminant("E", [200.0, 333.3, 1200.0]), [100.0, 100.0])


def test_a_spectral_line_puts_its_energy_into_the_bin_that_owns_it():
    edges = np.array([500.0, 540.0, 550.0, 575.0])
    assert_array_equal(spectra.illuminant("546.1 nm", edges), [0.0, 0.1, 0.0])
    assert_array_equal(spectra.illuminant("550 nm", edges), [0.0, 0.0, 0.04])
    assert_array_equal(spectra.illuminant("575 nm", edges), [0.0, 0.0, 0.04])
    with pytest.raises(ValueError, match="499.*outside the bins, 500 to 575 nm"):
        spectra.illuminant("499 nm", edges)


@given(wavelength=st.floats(380.0, 780.0))
@settings(max_examples=30, deadline=None)
def test_every_spectral_line_has_unit_energy(wavelength):
    assert spectra.illuminant(f"{wavelength!r} nm", VISIBLE_10) @ widths(VISIBLE_10) == pytest.approx(1, abs=1e-15)


def test_sensitivities_are_zero_and_reflectances_held_outside_their_tables():
    beyond = np.array([1000.0, 1050.0])
    assert not spectra.colour_matching(beyond).any()
    assert not spectra.cone_fundamentals(beyond).any()
    assert not spectra.camera_sensitivity("Sigma SDMerill (NPL)", beyond)[1].any()
    assert not spectra.display_primaries("Typical CRT Brainard 1997", beyond).any()
    assert_allclose(spectra.colorchecker(beyond)[1], spectra.colorchecker([729.999, 730.0])[1], rtol=1e-4)


def test_a_row_stands_for_half_a_step_beyond_its_table_and_no_farther():
    def mean(low, high):
        return spectra.camera_sensitivity("Sigma SDMerill (NPL)", [low, high])[1][0]

    first = mean(400.0, 400.0 + 1e-9)  # rows every 10 nm from 400
    assert_allclose(mean(395.0, 400.0), first, rtol=1e-6)
    assert_allclose(mean(390.0, 400.0), 0.5 * first, rtol=1e-6)
    assert not mean(390.0, 395.0).any()


def test_no_table_is_negative():
    assert tables(VISIBLE_5).min() >= 0


def test_cached_arrays_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        spectra.illuminant("D65", VISIBLE_10)[0] = 1.0


# -------------------------------------------------------------------------------------------------- light


def test_d65_has_the_chromaticity_of_daylight():
    white = xyz(np.ones((len(VISIBLE_5) - 1, 1)), VISIBLE_5)[0]
    # products of bin means, against the CIE's sums at 1 nm: 7.1e-5 measured for 5 nm bins
    assert_allclose(white[:2] / white.sum(), [0.3127, 0.3290], atol=2e-4)


def test_illuminant_a_is_a_planck_radiator():
    # the CIE wrote it with c2 = 1.435e-2 m K and 2848 K; chords of its 5 nm rows lie 6e-4 above it at 380 nm
    planck = spectra.illuminant(f"{2848 * 1.4387769 / 1.435} K", VISIBLE_5)
    assert_allclose(spectra.illuminant("A", VISIBLE_5), planck, rtol=7e-4)


@given(temperature=st.floats(100.0, 1e9))
@settings(max_examples=50, deadline=None)
def test_planck_spectra_are_finite_and_positive_at_any_temperature(temperature):
    power = spectra.illuminant(f"{temperature!r} K", [300.0, 560.0, 700.5, 1100.0, 2500.0])
    assert np.all(np.isfinite(power)) and np.all(power > 0)


def test_planck_bins_hold_the_stefan_boltzmann_law():
    # over nearly all wavelengths the integral is pi^4/15 (T/c2)^4 times the scale that makes 100 at 560 nm
    temperature, c2 = 5000.0, library.SECOND_RADIATION_CONSTANT
    edges = np.geomspace(50.0, 1e6, 400)
    total = spectra.illuminant(f"{temperature} K", edges) @ widths(edges)
    scale = 100.0 * 560.0**5 * np.expm1(c2 / (560.0 * temperature))
    tail = scale * temperature / (4 * c2 * 1e6**4)  # Rayleigh-Jeans beyond the last edge
    assert_allclose(total + tail, scale * np.pi**4 / 15 * (temperature / c2) ** 4, rtol=1e-8)


def test_planck_tends_to_the_inverse_fourth_power_of_wavelength_when_hot():
    edges = np.array([559.999, 560.001, 1119.999, 1120.001])
    power = spectra.illuminant("1e9 K", edges)
    assert_allclose(power[2] / power[0], 2.0**-4, rtol=1e-4)  # first correction c2 / (2 lambda T) = 1.3e-5


# -------------------------------------------------------------------------------------- eyes and matrices


def test_luminous_efficiency_is_the_second_matching_function():
    assert_array_equal(spectra.luminous_efficiency(VISIBLE_10), spectra.colour_matching(VISIBLE_10)[:, 1])


def test_matching_functions_enclose_equal_areas():
    edges = np.arange(360.0, 831.0, 10.0)
    areas = widths(edges) @ spectra.colour_matching(edges)
    assert_allclose(areas / areas[1], 1.0, atol=4e-4)  # the CIE's table at 1 nm: 106.865, 106.857, 106.892


def test_cones_peak_at_one_in_the_order_l_m_s():
    edges = np.arange(390.0, 831.0, 1.0)
    cones = spectra.cone_fundamentals(edges)
    assert_allclose(cones.max(axis=0), 1.0, atol=1e-3)
    peaks = edges[np.argmax(cones, axis=0)]
    assert peaks[0] > peaks[1] > peaks[2]


def test_xyz_to_lms_residual_is_orthogonal_to_the_matching_functions():
    edges = np.array([*np.arange(380.0, 600.0, 10.0), *np.arange(600.0, 781.0, 20.0)])
    matching, cones = spectra.colour_matching(edges), spectra.cone_fundamentals(edges)
    residual = cones - matching @ spectra.xyz_to_lms_matrix(edges).T
    assert_allclose(matching.T @ (widths(edges)[:, None] * residual), 0.0, atol=1e-11)


def test_two_bins_cannot_carry_three_cones():
    with pytest.raises(ValueError, match="at least three bins"):
        spectra.xyz_to_lms_matrix([400.0, 550.0, 700.0])


def test_rgb_white_goes_to_its_white_point():
    matrix, white = spectra.rgb_space_matrix("sRGB")
    total = matrix @ np.ones(3)
    assert_allclose(total[:2] / total.sum(), white, atol=5e-5)  # the standard prints four digits
    assert_allclose(white, [0.3127, 0.3290], atol=0)


def test_both_names_of_the_pal_space_give_one_matrix():
    first, second = (spectra.rgb_space_matrix(name)[0] for name in ("ITU-R BT.470 - 625", "Pal/Secam"))
    assert_array_equal(first, second)


@pytest.mark.parametrize("name", ["Bradford", "CAT02", "CAT16", "XYZ Scaling"])
def test_adaptation_matrices_respond_to_equal_energy_with_about_one(name):
    # each was published so; Bradford's digits leave the largest remainder
    assert_allclose(spectra.adaptation_matrix(name) @ np.ones(3), 1.0, atol=0.02)


# ------------------------------------------------------------------------------------ reflectance from RGB


@pytest.mark.parametrize("step", [1.0, 5.0, 10.0, 20.0])
def test_reflectance_from_rgb_gives_back_its_tristimulus_values(step):
    edges = whole(step)
    basis = spectra.upsampling_basis(edges)
    assert_allclose(basis.T @ d65_weights(edges), spectra.srgb_to_xyz(edges).T, atol=1e-13)


@given(rgb=st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3))
@settings(max_examples=30, deadline=None)
def test_every_rgb_survives_the_way_through_its_spectrum(rgb):
    edges = whole(10.0)
    spectrum = spectra.upsampling_basis(edges) @ np.array(rgb)
    back = np.linalg.solve(spectra.srgb_to_xyz(edges), spectrum @ d65_weights(edges))
    assert_allclose(back, rgb, atol=1e-13)


def test_a_window_has_the_reflectances_of_the_whole():
    whole_axis, window = np.arange(400.0, 701.0, 10.0), np.arange(500.0, 561.0, 10.0)
    assert_allclose(spectra.upsampling_basis(window), spectra.upsampling_basis(whole_axis)[10:16], rtol=ROUNDING)


@given(rgb=st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3))
@settings(max_examples=30, deadline=None)
def test_rgb_inside_the_cube_gives_a_possible_reflectance_in_ten_nm_bins(rgb):
    spectrum = spectra.upsampling_basis(VISIBLE_10) @ np.array(rgb)
    assert spectrum.min() >= 0 and spectrum.max() <= 1 + 1e-15


def test_white_rgb_is_the_perfect_diffuser_also_in_the_infrared():
    edges = np.arange(380.0, 1101.0, 10.0)
    assert_allclose(spectra.upsampling_basis(edges) @ np.ones(3), 1.0, atol=1e-14)


def test_white_rgb_has_the_white_of_the_same_bins():
    edges = whole(10.0)
    white = d65_weights(edges).sum(axis=0)
    assert_allclose(spectra.srgb_to_xyz(edges) @ np.ones(3), white, rtol=1e-13)
    assert_array_equal(spectra.srgb_to_xyz(VISIBLE_10), spectra.srgb_to_xyz(edges))


def test_binned_srgb_matrix_tends_to_the_standard_one():
    standard = spectra.rgb_space_matrix("sRGB")[0]
    # 2.2e-4 and 7.9e-4 measured: the four digits of the standard, and products of bin means
    assert_allclose(spectra.srgb_to_xyz(whole(1.0)), standard, atol=2.5e-4)
    assert_allclose(spectra.srgb_to_xyz(VISIBLE_10), standard, atol=8e-4)


@pytest.mark.parametrize("edges", [[380.0, 580.0, 780.0], [400.0, 550.0, 700.0], [800.0, 1100.0]])
def test_bins_that_cannot_tell_primaries_apart_are_refused(edges):
    with pytest.raises(ValueError, match="edges must"):
        spectra.upsampling_basis(edges)


def test_colorchecker_has_a_neutral_last_row_from_white_to_black():
    names, reflectance = spectra.colorchecker(VISIBLE_10)
    luminance = xyz(reflectance.T, VISIBLE_10)[:, 1]
    assert len(names) == 24 and names[0] == "dark skin" and names[-1].startswith("black")
    assert np.all(np.diff(luminance[18:]) < 0)
    assert_allclose(luminance[18], 0.9, atol=0.03)  # nominal density 0.05: 0.891


# --------------------------------------------------------------------------------------- names and ranges


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: spectra.illuminant("d65", VISIBLE_10), "unknown illuminant 'd65'.*'D65'.*<T> K"),
        (lambda: spectra.camera_sensitivity("Nikon 5100", VISIBLE_10), "camera.*'Nikon 5100 \\(NPL\\)'"),
        (lambda: spectra.display_primaries("Apple", VISIBLE_10), "display.*'Apple Studio Display'"),
        (lambda: spectra.rgb_space_matrix("sRBG"), "RGB space.*'sRGB'"),
        (lambda: spectra.adaptation_matrix("bradfort"), "adaptation.*'Bradford'"),
        (lambda: spectra.illuminant("99 K", VISIBLE_10), "100 K or more"),
    ],
)
def test_an_unknown_name_brings_the_nearest_known_ones(ask, message):
    with pytest.raises(ValueError, match=message):
        ask()


def test_an_illuminant_is_not_extrapolated():
    with pytest.raises(ValueError, match="'D65' is tabulated from 300 to 780 nm.*380 to 1100 nm"):
        spectra.illuminant("D65", np.arange(380.0, 1101.0, 10.0))


@pytest.mark.parametrize(
    "edges", [[400.0], [[400.0, 500.0]], [500.0, 400.0], [400.0, 400.0], [0.0, 1.0], [400.0, np.inf]]
)
def test_edges_that_are_no_axis_are_refused(edges):
    with pytest.raises(ValueError, match="edges must be"):
        spectra.colour_matching(edges)


# ---------------------------------------------------------------------------------------------- CSV files


def csv(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_csv_table_with_uneven_rows_is_averaged_exactly(tmp_path):
    path = csv(tmp_path, "# a filter\nwavelength_nm, a, b\n\n400,0,1\n410,1,1 # foot\n440,0,1\n")
    names, means = spectra.table_from_csv(path, [390.0, 400.0, 410.0, 425.0, 445.0])
    assert names == ["a", "b"]
    # triangles by hand; 5 nm in front, half a step, the first row holds; steps of 30 nm are a drawn curve, which ends
    # with its last row: the last bin is 3/4 inside for b, and holds half of a 15 nm x 0.5 triangle for a
    assert_allclose(means, [[0, 0.5], [0.5, 1], [0.75, 1], [0.25 * 15 / 20, 15 / 20]], rtol=ROUNDING)


def test_a_table_that_holds_has_its_end_values_everywhere(tmp_path):
    path = csv(tmp_path, "wavelength_nm,a\n400,0.2\n500,0.6\n")
    assert_allclose(
        spectra.table_from_csv(path, [300.0, 350.0, 600.0, 700.0], outside="hold")[1][[0, 2], 0],
        [0.2, 0.6],
        rtol=ROUNDING,
    )
    assert_allclose(spectra.table_from_csv(path, [300.0, 350.0, 600.0, 700.0])[1][[0, 2], 0], 0.0)


def test_a_table_that_must_cover_the_light_is_refused_beyond_half_a_step(tmp_path):
    path = csv(tmp_path, "wavelength_nm,a\n400,1\n410,1\n")
    spectra.require_rows(path, [395.0, 415.0])
    with pytest.raises(ValueError, match="rows from 400 to 410 nm, but the light extends from 394 to 415 nm"):
        spectra.require_rows(path, [394.0, 415.0])


def test_csv_columns_come_in_the_order_asked_for(tmp_path):
    path = csv(tmp_path, "wavelength_nm,a,b,c\n400,1,2,3\n500,1,2,3\n")
    names, means = spectra.table_from_csv(path, [400.0, 500.0], columns=["c", "a"])
    assert names == ["c", "a"]
    assert_allclose(means, [[3.0, 1.0]], rtol=ROUNDING)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no header"),
        ("400,1\n500,2\n", "line 1: header"),
        ("# x\nwavelength_nm\n400\n500\n", "line 2: header"),
        ("wavelength_nm,a,a\n400,1,1\n500,1,1\n", "distinct names"),
        ("wavelength_nm,a\n400,1\n", "1 rows"),
        ("wavelength_nm,a\n400,1\n\n500,1,2\n", "line 4: 3 cells, but the header has 2"),
        ("wavelength_nm,a\n400,1\n500,x\n", "line 3: 'x' in column 'a'"),
        ("wavelength_nm,a\n400,1\n500,nan\n", "line 3: 'nan' in column 'a'"),
        ("wavelength_nm,a\n400,1\n# c\n400,2\n", "line 4: wavelength 400 nm must be greater than"),
    ],
)
def test_a_broken_csv_file_is_named_with_its_line(tmp_path, text, message):
    path = csv(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        spectra.table_from_csv(path, [400.0, 500.0])
    assert str(path) in str(caught.value)


def test_a_missing_csv_column_brings_the_nearest_one(tmp_path):
    path = csv(tmp_path, "wavelength_nm,green\n400,1\n500,1\n")
    with pytest.raises(ValueError, match="'grean'; nearest names: 'green'"):
        spectra.table_from_csv(path, [400.0, 500.0], columns=["grean"])


def test_a_binary_file_is_refused_as_csv(tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(b"wavelength_nm,a\n\xff\xfe")
    with pytest.raises(ValueError, match="not a UTF-8 text file"):
        spectra.table_from_csv(path, [400.0, 500.0])


def test_the_list_of_names_for_plans_is_that_of_the_library():
    import colour

    from etendue_camera.spectra.names import tables

    for kind, held in (
        ("illuminant", colour.SDS_ILLUMINANTS),
        ("camera", colour.MSDS_CAMERA_SENSITIVITIES),
        ("display", colour.MSDS_DISPLAY_PRIMARIES),
    ):
        found = {name: (float(held[name].wavelengths[0]), float(held[name].wavelengths[-1])) for name in list(held)}
        assert tables(kind) == found


def test_a_file_named_colour_beside_a_script_is_not_taken_for_the_library(tmp_path):
    """Python looks beside the script first; the library itself looks there for another package of its name."""
    (tmp_path / "colour.py").write_text("raise ImportError('the wrong one')\n")
    (tmp_path / "script.py").write_text(
        "from etendue_camera.spectra import authority\nprint(authority.rows('illuminant', 'D50').shape)\n"
    )
    found = subprocess.run(
        [sys.executable, str(tmp_path / "script.py")], capture_output=True, text=True, timeout=120, check=False
    )
    assert found.stdout.strip() == "(97, 2)", found.stderr


SPDX = """<?xml version="1.0" encoding="UTF-8"?>
<IESTM2714 xmlns="http://www.ies.org/iestm2714" version="1.0"><Header><Description>a lamp</Description></Header>
<SpectralDistribution><SpectralQuantity>relative</SpectralQuantity>{}</SpectralDistribution></IESTM2714>"""


def spdx(rows):
    return SPDX.format("".join(f'<SpectralData wavelength="{nm}">{value}</SpectralData>' for nm, value in rows))


def test_an_spdx_file_is_the_csv_table_of_its_rows(tmp_path):
    rows = [(400, 0.2), (455.5, 1.0), (610, 0.4), (720, 0.1)]
    (tmp_path / "a.spdx").write_text(spdx(rows))
    (tmp_path / "a.csv").write_text("wavelength_nm,power\n" + "".join(f"{nm},{value}\n" for nm, value in rows))
    edges = np.arange(410.0, 701.0, 10.0)
    assert_array_equal(*(spectra.illuminant(str(tmp_path / f"a.{kind}"), edges) for kind in ("spdx", "csv")))
    assert_array_equal(
        *(spectra.table_from_csv(tmp_path / f"a.{kind}", edges, outside="hold")[1] for kind in ("spdx", "csv"))
    )


def test_an_spdx_file_of_the_library_is_read_as_it_was_written(tmp_path):
    colour = pytest.importorskip("colour")
    values = dict(zip(range(380, 781, 5), np.random.default_rng(2).uniform(0, 1, 81), strict=True))
    colour.SpectralDistribution_IESTM2714(str(tmp_path / "a.spdx"), data=values).write()
    names, nodes, found = spectra.csv_rows(tmp_path / "a.spdx")
    assert len(names) == 1
    assert_array_equal(nodes, list(values))
    assert_allclose(found[:, 0], list(values.values()), atol=6e-13)  # it writes 12 places


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength_nm,a", "is not an SPDX file"),
        ('<?xml version="1.0" encoding="of-no-kind"?><a/>', r"a\.spdx is not an SPDX file"),
        ('<?xml version="1.0" encoding="shift_jis"?><a/>', r"a\.spdx is not an SPDX file"),
        ("<a/>", "has 0 SpectralData elements"),
        (spdx([(400, 1), (400, 2)]), "400 nm must be greater than 400 nm"),
        (spdx([(400, 1), (500, "much")]), "'much' in SpectralData at 500 nm is not a finite number"),
    ],
)
def test_a_broken_spdx_file_is_named(tmp_path, text, message):
    (tmp_path / "a.spdx").write_text(text)
    with pytest.raises(ValueError, match=message):
        spectra.csv_rows(tmp_path / "a.spdx")
