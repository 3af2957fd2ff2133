"""What happens to the mosaic in front of the demosaicer: white, balance, shading, defects. In: small cameras. Out:
what each undoes.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import etendue
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.session import from_document
from etendue_camera.export.command import raw_frame
from etendue_camera.export.frames import Shelf
from etendue_camera.mosaic import shading
from etendue_camera.sensor import cfa

CAMERA = {"peak_qe": [0.36, 0.44, 0.40], "integration_time": "4 ms", "illuminant": "A"}
QUIET = {"prnu": 0.0, "dark_nonuniformity": 0.0}
EDGE = {
    "use": "slanted_edge",
    "name": "scene",
    "white_luminance": 300,
    "width": 200,
    "height": 200,
    "spacing": 1.0,
    "bin_width": 60,
    "wavelength_from": 400,
    "wavelength_to": 700,
    "low": 0.1,
    "high": 0.9,
}
FLAT = {
    "use": "uniform",
    "name": "scene",
    "white_luminance": 300,
    "width": 5600,
    "height": 4200,
    "spacing": 35.0,
    "bin_width": 100,
    "wavelength_from": 400,
    "wavelength_to": 700,
    "reflectance": 0.5,
}


def run(*stages, wanted, archive=None, **camera):
    entries = [{"use": s} if isinstance(s, str) else s for s in stages]
    document = {"name": "raw", "camera": {**CAMERA, **camera}, "stages": entries, "wanted": wanted}
    return etendue.simulate(document, archive=archive)


def stage(name, **values):
    return installed_stages().load(name)(**values)


def values(tree, where):
    name, _, variable = where.partition(".")
    return np.asarray(tree[name][variable].squeeze(), float)


# -- balance in front of the demosaicer -----------------------------------------------------------------------


def edge_over_white(demosaic, balanced, illuminant="A"):
    """A grey slanted edge behind the demosaicer, over its white: red, green, blue of the middle of the frame."""
    light = (
        "irradiance",
        "diffraction",
        {"use": "pixel", "rows": 64, "columns": 64},
        "mosaic",
        "ideal_mosaic",
        "white",
    )
    between = ("balance_mosaic",) if balanced else ()
    white = "balance_mosaic.white" if balanced else "white.white"
    tree = run(
        EDGE,
        *light,
        *between,
        {"use": demosaic, "name": "demosaic"},
        wanted=["rgb_camera", white],
        illuminant=illuminant,
        pixel_pitch=2.8,
    )
    return (values(tree, "demosaic.rgb_camera") / values(tree, white)[:, None, None])[:, 8:-8, 8:-8]


@pytest.mark.parametrize("demosaic", ["demosaic_nearest", "demosaic_bilinear", "demosaic_any"])
def test_demosaicers_that_keep_to_one_channel_do_not_care_where_the_balance_stands(demosaic):
    assert_allclose(edge_over_white(demosaic, True), edge_over_white(demosaic, False), atol=2e-6)  # single precision


def test_a_colour_difference_invents_less_colour_on_a_grey_edge_of_a_balanced_mosaic():
    """The channels of a grey edge differ by the white alone. Balanced, they are one plane, whatever the light;
    measured: 1.3 times less colour under D65 and 2.1 under A, whose white is farther from grey."""
    coloured = {}
    for illuminant in ("D65", "A"):
        for balanced in (False, True):
            rgb = edge_over_white("demosaic_colour_difference", balanced, illuminant)
            coloured[illuminant, balanced] = float(np.sqrt(np.mean((rgb - rgb.mean(axis=0)) ** 2)))
    assert coloured["A", True] == pytest.approx(
        coloured["D65", True], rel=0.02
    )  # diffraction differs a little with the spectrum
    assert coloured["D65", False] > 1.25 * coloured["D65", True]
    assert coloured["A", False] > 1.9 * coloured["A", True]


def test_highlights_are_white_behind_the_balance_and_white_is_equal_in_all_channels():
    mosaic = np.full((6, 6), 1.0)
    white = np.array([0.3, 0.5, 0.2])
    line = np.arange(6.0)
    neutral = stage("balance_mosaic").run(mosaic, white, 1.0, line, line, ["R", "G", "B"])
    assert_array_equal(neutral["mosaic_linear"], np.ones((6, 6)))
    assert_array_equal(neutral["white"], [0.5, 0.5, 0.5])
    assert_allclose(neutral["balance_gains"], [5 / 3, 1.0, 2.5], rtol=4e-16)
    kept = stage("balance_mosaic", highlights="keep").run(mosaic, white, 1.0, line, line, ["R", "G", "B"])[
        "mosaic_linear"
    ]
    assert kept.max() == pytest.approx(2.5, rel=1e-15)
    with pytest.raises(ValueError, match="vanishing"):
        stage("balance_mosaic").run(mosaic, np.array([0.3, 0.5, 0.0]), 1.0, line, line, ["R", "G", "B"])


def test_a_raw_file_has_the_white_of_its_own_numbers_and_not_that_of_the_balanced_mosaic(tmp_path):
    sensor = (
        "irradiance",
        {"use": "pixel", "rows": 32, "columns": 32},
        "mosaic",
        "exposure",
        "shot_noise",
        "adc",
        "linearise",
    )
    wanted = ["adc.raw", "white.white", "balance_mosaic.white", "colour_matrix"]
    run(EDGE, *sensor, "white", "balance_mosaic", "colour_fit", wanted=wanted, archive=tmp_path / "raw")
    shelf = Shelf(tmp_path / "raw")
    frame = next(f for f in shelf.frames("raw"))
    assert_array_equal(raw_frame(shelf, frame).camera_white, shelf.beside(frame, "white", "white balance"))
    assert np.ptp(raw_frame(shelf, frame).camera_white) > 0.01
    assert np.ptp(shelf.beside(frame, "white")) == 0


def test_full_planes_follow_the_balance():
    """Plane by plane, bit for bit what the mosaic has at the sites of each."""
    tree = run(
        EDGE,
        "irradiance",
        {"use": "pixel", "rows": 32, "columns": 32},
        "mosaic",
        "ideal_mosaic",
        "white",
        "balance_mosaic",
        "no_mask",
        {"use": "ideal_mosaic", "name": "every", "clip": False},
        {"use": "balance_mosaic", "name": "planes", "from": {"white": "white"}},
        wanted=["planes.mosaic_linear", "balance_mosaic.mosaic_linear"],
    )
    planes, mosaic = values(tree, "planes.mosaic_linear"), values(tree, "balance_mosaic.mosaic_linear")
    assert planes.shape == (3, 32, 32)
    assert_array_equal(planes[0, ::2, ::2], mosaic[::2, ::2])  # RGGB
    assert_array_equal(planes[1, ::2, 1::2], mosaic[::2, 1::2])
    assert_array_equal(planes[2, 1::2, 1::2], mosaic[1::2, 1::2])


# -- the white as the camera finds it -------------------------------------------------------------------------


def estimate(white, mosaic, **parameters):
    rows, columns = (np.arange(float(n)) for n in mosaic.shape)
    return stage("white_estimate", **parameters).run(mosaic, white, rows, columns)


@pytest.mark.parametrize(("method", "degrees"), [("grey_world", 0.5), ("shades_of_grey", 0.5), ("white_patch", 1.5)])
def test_on_a_grey_picture_every_method_finds_the_illuminants_white(method, degrees):
    """To the noise of 256 cells' mean; the quantile of cells of 4 to 8 pixels a channel takes their own noise with
    it.
    """
    sensor = (
        "irradiance",
        {"use": "pixel", "rows": 64, "columns": 64},
        "mosaic",
        "exposure",
        "shot_noise",
        "full_well",
        "read_noise",
        "adc",
    )
    tree = run(
        EDGE,
        *sensor,
        "linearise",
        "white",
        {"use": "white_estimate", "method": method},
        wanted=["white_estimate"],
        pixel_pitch=2.8,
    )
    assert values(tree, "white_estimate.white_error") < degrees
    assert values(tree, "white_estimate.white_used") > 0.4


def test_the_true_white_passes_unchanged_and_a_preset_is_the_inverse_of_its_gains():
    white, mosaic = np.array([0.3, 0.5, 0.2]), np.full((8, 8), 0.1)
    true = estimate(white, mosaic, method="illuminant")
    assert_array_equal(true["white"], white)
    assert true["white_error"] == 0
    preset = estimate(white, mosaic, method="preset", gains=(2.0, 1.0, 4.0))
    assert_allclose(
        preset["white"] * [2.0, 1.0, 4.0], np.full(3, 1 / 1.75), rtol=1e-15
    )  # the sum of the true white is 1
    own = estimate(white, mosaic, method="preset", gains=tuple(1 / white))
    assert own["white_error"] < 1e-13
    assert_allclose(own["white"], white, rtol=1e-14)


def test_the_error_of_a_white_is_its_angle_to_the_true_one_whatever_the_exposure():
    grey = np.full(
        (16, 16), 0.4
    )  # equal in all channels: under a coloured white this is a wrong guess of a known angle
    white = np.array([0.6, 0.6, 0.3])
    angle = np.degrees(np.arccos(1.5 / np.sqrt(3 * 0.81)))
    for level in (0.05, 1.0, 2.0):
        found = estimate(white, grey * level, method="grey_world")
        assert found["white_error"] == pytest.approx(angle, rel=1e-12)
        assert_allclose(found["white"], np.full(3, 0.5), rtol=1e-14)


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_a_frame_that_is_black_or_clipped_shows_no_white_and_says_so(level):
    with pytest.raises(ValueError, match="none of the 16 cells"):
        estimate(np.array([0.3, 0.5, 0.2]), np.full((16, 16), level))
    assert estimate(np.array([0.3, 0.5, 0.2]), np.full((16, 16), level), method="illuminant")["white_error"] == 0


def test_a_dead_channel_is_refused_or_floored_and_counted():
    mosaic = np.full((16, 16), 0.4)
    mosaic[1::2, 1::2] = 0.0  # blue
    with pytest.raises(ValueError, match="vanishing"):
        estimate(np.array([0.3, 0.5, 0.2]), mosaic)
    lifted = estimate(np.array([0.3, 0.5, 0.2]), mosaic, floor=0.1)
    assert lifted["channels_floored"] == 1
    assert lifted["white"][2] == pytest.approx(0.1 * lifted["white"][1], rel=1e-12)


def test_gains_and_method_go_together():
    for wrong, text in (
        ({"method": "preset"}, "give gains with"),
        ({"gains": (1.0, 1.0, 1.0)}, "give gains with"),
        ({"method": "preset", "gains": (1.0, 2.0)}, "3 channels"),
    ):
        with pytest.raises(ValueError, match=text):
            stage("white_estimate", **wrong)


def test_a_cone_without_light_is_refused_or_floored_and_counted():
    xyz, red = np.full((3, 4, 4), 0.2), np.array([0.85, 1.0, 1e-12])  # no light for the short cones
    d65 = np.array([0.95047, 1.0, 1.08883])
    with pytest.raises(ValueError, match="three cones"):
        stage("balance", floor=0.0).run(xyz, red, d65)
    floored = stage("balance", floor=0.01).run(xyz, red, d65)
    assert floored["cones_floored"] == 1
    assert np.isfinite(floored["xyz_scene"]).all()
    ordinary = stage("balance", floor=0.01).run(xyz, np.array([1.1, 1.0, 0.35]), d65)
    assert ordinary["cones_floored"] == 0
    assert_array_equal(ordinary["xyz_scene"], stage("balance").run(xyz, np.array([1.1, 1.0, 0.35]), d65)["xyz_scene"])


# -- shading --------------------------------------------------------------------------------------------------

WIDE = {"focal_length": "5 mm", "pixel_pitch": 70.0, "aperture_fraction": 0.9, "f_number": 2.8}
RIM = {"rim_radius": 1.3, "rim_distance": 1.5}
OPTICS = (
    "irradiance",
    {"use": "falloff", "model": "disc"},
    {"use": "vignetting", **RIM},
    {"use": "angular_response", "power": 1.5},
)
SENSOR = ({"use": "pixel", "rows": 60, "columns": 80}, "mosaic", "ideal_mosaic")


def test_even_light_behind_fall_off_rim_and_angular_response_is_even_again():
    """Pixels are 70 um wide and see the mean of a curve: 6e-4 of it in the corner, where the rim makes it steep;
    1e-4 inside.
    """
    known = {"use": "lens_shading", "model": "disc", "power": 1.5, **RIM}
    tree = run(FLAT, *OPTICS, *SENSOR, known, wanted=["ideal_mosaic.mosaic_linear", "lens_shading"], **WIDE)
    before, after = values(tree, "ideal_mosaic.mosaic_linear"), values(tree, "lens_shading.mosaic_linear")
    for row, column in ((0, 0), (0, 1), (1, 1)):
        dark, flat = before[row::2, column::2], after[row::2, column::2]
        assert dark.min() < 0.3 * dark.max()
        assert np.abs(flat / flat[15, 20] - 1).max() < 1e-3


def test_a_table_from_a_flat_field_of_the_camera_itself_corrects_it_as_well(tmp_path):
    """What a maker does: a frame of even light gives the table, and the next frames are flat by it."""
    flat = run(FLAT, *OPTICS, *SENSOR, wanted=["ideal_mosaic.mosaic_linear"], **WIDE)[
        "ideal_mosaic"
    ].mosaic_linear.squeeze()
    y, x = 0.07 * (np.arange(60) - 29.5), 0.07 * (np.arange(80) - 39.5)
    shading.write_gains(tmp_path / "gains.csv", shading.calibrated(np.asarray(flat), cfa.parse("RGGB"), y, x))
    known = {"use": "lens_shading", "map": "table", "table": str(tmp_path / "gains.csv")}
    after = values(run(FLAT, *OPTICS, *SENSOR, known, wanted=["lens_shading"], **WIDE), "lens_shading.mosaic_linear")
    for row, column in ((0, 0), (0, 1), (1, 1)):
        plane = after[row::2, column::2]
        assert np.abs(plane / plane[15, 20] - 1).max() < 0.01  # where the rim begins to cut, the curve has a kink


def test_a_correction_of_no_strength_is_left_out_and_changes_no_bit():
    tree = run(
        FLAT,
        *OPTICS,
        *SENSOR,
        {"use": "lens_shading", "strength": 0.0},
        wanted=["ideal_mosaic.mosaic_linear", "lens_shading"],
        **WIDE,
    )
    assert_array_equal(tree["lens_shading"].mosaic_linear, tree["ideal_mosaic"].mosaic_linear)
    ledger = tree["ledger"].to_dataset()
    assert "left_out" in {
        str(s) for s in np.asarray(ledger["status"].values[ledger["stage"].values == "lens_shading"]).tolist()
    }


def test_the_plan_says_what_the_correction_costs_and_where_it_ends():
    def notes(**values):
        stages = [
            FLAT,
            *({"use": s} if isinstance(s, str) else s for s in (*OPTICS, *SENSOR)),
            {"use": "lens_shading", **values},
        ]
        document = {"name": "raw", "camera": {**CAMERA, **WIDE}, "stages": stages}
        return [
            n for n in make_plan(from_document(document), installed_stages()).warnings if n.startswith("lens_shading")
        ]

    assert any("noise grows by the same factor" in n for n in notes())
    assert any("gains are limited to largest_gain = 1.5" in n for n in notes(largest_gain=1.5))
    assert notes(strength=0.0) == []


def test_black_is_left_alone_and_a_table_needs_the_patterns_channels(tmp_path):
    line = np.arange(8.0)
    um = 500.0 * (line - 3.5)
    black = stage("lens_shading", focal_length=3.0).run(np.zeros((8, 8)), 1.0, line, line, um, um)["mosaic_linear"]
    assert_array_equal(black, np.zeros((8, 8)))
    (tmp_path / "g.csv").write_text("height_mm,R,G,W\n0,1,1,1\n3,2,2,2\n")
    with pytest.raises(ValueError, match="one column per channel"):
        stage("lens_shading", map="table", table=str(tmp_path / "g.csv")).run(np.zeros((8, 8)), 1.0, line, line, um, um)
    with pytest.raises(ValueError, match="give a table with"):
        stage("lens_shading", map="table")


# -- defects --------------------------------------------------------------------------------------------------


def sensor_with(*corrections, hot=0.004, dead=0.003, stuck=0.002, wanted):
    grey = {**FLAT, "width": 700, "height": 700, "spacing": 7.0}
    defective = {"use": "defects", "hot": hot, "dead": dead, "hot_rate": 3e6}
    reading = (
        "shot_noise",
        "full_well",
        "read_noise",
        "adc",
        {"use": "stuck_pixels", "stuck": stuck},
        "linearise",
        "join_defect_maps",
    )
    return run(
        grey,
        "irradiance",
        {"use": "pixel", "rows": 96, "columns": 96},
        "mosaic",
        defective,
        {"use": "exposure", **QUIET},
        *reading,
        *corrections,
        wanted=["linearise.mosaic_linear", "join_defect_maps.defect_map", *wanted],
        pixel_pitch=7.0,
    )


@pytest.mark.parametrize("by", ["map", "detection", "both"])
def test_a_flat_field_with_defects_is_as_even_as_its_noise_and_the_figures_are_true(by):
    tree = sensor_with({"use": "correct_defects", "by": by}, wanted=["correct_defects"])
    before, after = values(tree, "linearise.mosaic_linear"), values(tree, "correct_defects.mosaic_linear")
    known = values(tree, "join_defect_maps.defect_map") > 0
    figures = {
        n: float(values(tree, f"correct_defects.{n}"))
        for n in ("defects_corrected", "defects_left", "defects_missed", "false_alarms")
    }
    changed = before != after
    assert figures["defects_corrected"] + figures["defects_left"] >= np.count_nonzero(
        changed
    )  # a replacement may equal what it replaces
    assert (
        figures["defects_corrected"] + figures["defects_left"]
        == known.sum() - figures["defects_missed"] + figures["false_alarms"]
    )
    assert figures["defects_left"] == 0
    assert figures["defects_missed"] == 0 if by != "detection" else figures["defects_missed"] < 0.3 * known.sum()
    assert figures["false_alarms"] <= (0 if by == "map" else 3)
    red, sound = np.s_[0::2, 0::2], ~known[0::2, 0::2]
    noise = before[red][sound].std()
    assert before[red].std() > 2 * noise
    assert after[red].std() < 1.1 * noise


def test_without_a_map_defects_are_found_all_the_same_and_nobody_knows_what_is_missed():
    tree = sensor_with(
        "correct_found_defects",
        {"use": "correct_defects", "by": "detection", "from": {"mosaic_linear": "linearise"}},
        wanted=["correct_found_defects", "correct_defects"],
    )
    assert_array_equal(
        values(tree, "correct_found_defects.mosaic_linear"), values(tree, "correct_defects.mosaic_linear")
    )
    assert np.isnan(values(tree, "correct_found_defects.defects_missed"))
    assert np.isnan(values(tree, "correct_found_defects.false_alarms"))


def test_a_sensor_without_defects_keeps_every_bit():
    tree = sensor_with(
        {"use": "correct_defects", "by": "map"}, hot=0.0, dead=0.0, stuck=0.0, wanted=["correct_defects"]
    )
    assert values(tree, "correct_defects.defects_corrected") == 0
    assert_array_equal(tree["correct_defects"].mosaic_linear, tree["linearise"].mosaic_linear)


def test_a_rim_that_the_correction_does_not_know_is_noted():
    from etendue_camera.mosaic.stages.shading import LensShading

    rim, without = {"tube": installed_stages().load("vignetting")}, {"falloff": installed_stages().load("falloff")}
    assert "rim (stage tube)" in LensShading().warn_among(rim | without)[0]
    assert not LensShading(rim_radius=3.0).warn_among(rim) and not LensShading().warn_among(without)
    assert not LensShading(strength=0.0).warn_among(rim)
