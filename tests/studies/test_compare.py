"""Alternatives compared: what is measured is true of the pictures, and one bad alternative does not spoil the
others.
"""

import csv
import json
import math
import re
import shlex
from dataclasses import replace
from decimal import Decimal
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from etendue.cli import main
from etendue.cli.options import number
from etendue.pipeline.file import parse_pipeline
from etendue.present.pictures.crops import Strip, _of_several, sized, strip, where_most
from etendue.present.terminal.work_precision import Point, work_precision
from etendue.session import Options
from etendue_camera.colour import difference
from etendue_camera.colour.stages.tristimulus import CameraToXyz
from etendue_camera.field.psf_bank import PsfBank
from etendue_lab.compare import ranking
from etendue_lab.compare.axis import AxisRequest, candidates, labels_of, parse_axis
from etendue_lab.compare.branches import nodes_of
from etendue_lab.compare.compared import FIGURES, ComparedRow
from etendue_lab.compare.figures import colour_figures
from etendue_lab.compare.ranking import UNITS, document, print_comparison
from etendue_lab.compare.study import Comparison, compare, ranked
from tests.studies import alternatives

SMALL = """
name = "small"
precision = "float64"
[camera]
peak_qe = [0.36, 0.44, 0.40]
f_number = 4
pixel_pitch = "4 um"
integration_time = "4 ms"
full_well_density = "2000 electron um-2"
{camera}
[[stages]]
use = "{scene}"
name = "scene"
white_luminance = "1000 cd m-2"
width = "224 um"
height = "224 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "60 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "lens_gaussian"
name = "lens"
sigma = "1.2 um"
[[stages]]
use = "pixel"
rows = 52
columns = 48
[[stages]]
use = "mosaic"
{wandering}
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "full_well"
[[stages]]
use = "read_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "white"
{before}
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
[[stages]]
use = "sharpen"
strength = 0.05
[[stages]]
use = "colour_fit"
[[stages]]
use = "camera_to_xyz"
[[stages]]
use = "balance"
[[stages]]
use = "display"
[[stages]]
use = "encode"
{after}
"""
SERIAL = Options("serial")
PLAIN_LENS = 'use = "lens_gaussian"\nname = "lens"\nsigma = "1.2 um"'


def written(text=SMALL, scene="composite", camera="", wandering="", before="", after=""):
    return text.format(scene=scene, camera=camera, wandering=wandering, before=before, after=after)


def pipeline(*replaced, **changes):
    """The small pipeline with words of it replaced, pair by pair."""
    text = SMALL
    for old, new in replaced:
        assert old in text
        text = text.replace(old, new)
    return parse_pipeline(written(text, **changes))


def rows_of(axis, found=None, expected=False, edges=False, **changes):
    result = compare(found or pipeline(**changes), parse_axis(axis, number), 1, expected, SERIAL, edges=edges)
    return {row.label: row for row in result.rows}, result


@pytest.fixture
def registry(monkeypatch):
    """The installed stages, and a third party's."""
    mine = alternatives.registry()
    monkeypatch.setattr("etendue_lab.compare.study.installed_stages", lambda: mine)
    return mine


# -- what is measured -------------------------------------------------------------------------------------------


def test_the_reference_compared_with_itself_is_perfect(registry):
    rows, _ = rows_of('demosaic.use=demosaic_bilinear,{ use = "perfect", label = "itself" }', edges=True)
    itself = rows["itself"]
    assert (itself.psnr, itself.rmse, itself.psnr_encoded) == (math.inf, 0.0, math.inf)
    assert (itself.delta_e, itself.zipper, itself.false_colour) == (0.0, 0.0, 0.0)
    assert itself.ssim == pytest.approx(1.0, abs=1e-12)  # sums under a window
    assert itself.mtf50 == itself.mtf50_reference
    assert rows["demosaic_bilinear"].psnr < 60


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera": 'crosstalk = "through_filter"', "wandering": '[[stages]]\nuse = "crosstalk"'},
        {"before": '[[stages]]\nuse = "balance_mosaic"\nhighlights = "keep"'},
        {"before": '[[stages]]\nuse = "lens_shading"\nstrength = 1.0\nfull_field = "40 deg"\ngeometry = "paper"'},
    ],
)
def test_of_a_uniform_scene_without_noise_every_interpolation_is_the_reference(changes):
    rows, result = rows_of("demosaic.use=demosaic_bilinear,demosaic_nearest", scene="uniform", expected=True, **changes)
    floor = (
        200 if "lens_shading" not in changes.get("before", "") else 45
    )  # rounding; gains that change from pixel to pixel
    assert min(row.psnr for row in rows.values()) > floor
    assert not any("omits" in note for note in result.notes)


def test_what_corrects_the_mosaic_by_another_picture_of_it_is_none_of_the_reference_and_what_needs_none_is():
    by_map = {"wandering": '[[stages]]\nuse = "defects"', "before": '[[stages]]\nuse = "correct_defects"'}
    _, result = rows_of("demosaic.use=demosaic_bilinear", **by_map)
    assert any("omits correct_defects, which reads defect_map" in note for note in result.notes)
    _, result = rows_of("demosaic.use=demosaic_bilinear", before='[[stages]]\nuse = "correct_found_defects"')
    assert not any("omits" in note for note in result.notes)


@pytest.mark.parametrize("use", ["sharpen_mosaic", "correct_found_defects"])
def test_what_betters_the_mosaic_is_compared_with_a_picture_that_did_not_need_it(use):
    name, values = ("strength", "0,0.3") if use == "sharpen_mosaic" else ("threshold", "3,6")
    _, result = rows_of(f"{use}.{name}={values}", before=f'[[stages]]\nuse = "{use}"')
    assert (result.without, result.own_reference) == (use, False)


def test_alternatives_are_given_the_same_mosaic_and_a_row_does_not_depend_on_its_company():
    together, _ = rows_of("demosaic.use=demosaic_nearest,demosaic_bilinear,demosaic_any")
    alone, _ = rows_of("demosaic.use=demosaic_any")
    figures = ("psnr", "psnr_encoded", "ssim", "delta_e", "zipper", "false_colour", "mtf50")
    assert [getattr(alone["demosaic_any"], f) for f in figures] == [
        getattr(together["demosaic_any"], f) for f in figures
    ]
    for name in figures[:4]:  # on Bayer, demosaic_any is the bilinear one up to rounding
        assert getattr(together["demosaic_any"], name) == pytest.approx(
            getattr(together["demosaic_bilinear"], name), rel=1e-9
        )


def test_noise_costs_quality_and_expected_values_have_none():
    noisy, _ = rows_of("demosaic.use=demosaic_bilinear", edges=True)
    quiet, result = rows_of("demosaic.use=demosaic_bilinear", expected=True, edges=True)
    assert quiet["demosaic_bilinear"].psnr > noisy["demosaic_bilinear"].psnr
    assert quiet["demosaic_bilinear"].mtf50 == noisy["demosaic_bilinear"].mtf50  # which is noise-free either way
    assert "expected values" in result.noise


def test_mtf50_of_the_reference_is_that_of_lens_and_pixel():
    rows, _ = rows_of("demosaic.use=demosaic_bilinear", edges=True)
    sigma, width, tilt = 1.2 / 4, 0.741, math.radians(5)

    def half(f):
        square = np.sinc(width * f * math.cos(tilt)) * np.sinc(width * f * math.sin(tilt))
        return math.exp(-2 * (math.pi * sigma * f) ** 2) * square - 0.5

    # the frame is 100 x 76 pixels after its border: a few parts in a thousand
    assert rows["demosaic_bilinear"].mtf50_reference == pytest.approx(brentq(half, 0.1, 0.9), rel=0.004)


def test_a_sharpening_is_held_against_the_picture_that_did_not_need_it(registry):
    ideal = pipeline(('use = "demosaic_bilinear"', 'use = "perfect"'))
    rows, result = rows_of("sharpen.strength=0,0.3", ideal, edges=True)
    assert result.without == "sharpen"
    assert rows["0"].psnr == math.inf
    assert rows["0.3"].psnr < 60
    assert rows["0.3"].mtf50 > rows["0"].mtf50


def test_a_camera_quantity_as_axis_reaches_the_reference_too():
    rows, result = rows_of("pixel_pitch=3,4", edges=True)
    per_um = [rows[f"{pitch} um"].mtf50_reference / pitch for pitch in (3, 4)]
    assert per_um[0] > per_um[1]  # smaller pixels resolve more of the same light
    assert rows["3 um"].mtf50_reference < rows["4 um"].mtf50_reference  # but of their own grid less
    assert rows["3 um"].seconds is None
    assert result.without == ""


def test_of_a_sweep_the_cameras_own_values_hold_else_the_first_and_both_are_named(capsys):
    sweep = (
        '[sweep]\nf_number = [8, 2]\n"sharpen.strength" = { from = 0.2, to = 1, steps = 3 }\n"demosaic.use" = '
        '["demosaic_nearest"]'
    )
    swept = pipeline(("strength = 0.05", ""), after=sweep)
    rows, result = rows_of("pixel_pitch=4", swept)
    plain, _ = rows_of("pixel_pitch=4", pipeline(("strength = 0.05", "strength = 0.2")))
    assert {k: v if k.endswith("use") else float(v) for k, v in result.at.items()} == {
        "f_number": 4.0,
        "sharpen.strength": 0.2,
        "demosaic.use": "demosaic_bilinear",
    }
    assert result.first == ("sharpen.strength",)
    assert rows["4 um"].psnr == plain["4 um"].psnr
    print_comparison(result, [])
    said = capsys.readouterr().out
    assert "f_number = 4, demosaic.use = demosaic_bilinear: from the file" in said
    assert "sharpen.strength = 0.2: the first value of the file's sweep" in said
    assert document(result)["first_of_sweep"] == ["sharpen.strength"]


def test_colours_are_seen_by_an_eye_that_is_adapted_to_their_white(registry, monkeypatch):
    seen = []

    def spy(picture, reference, white):
        seen.append(difference.lab(np.asarray(reference, np.float64), white))
        return colour_figures(picture, reference, white)

    monkeypatch.setattr("etendue_lab.compare.study.colour_figures", spy)
    ideal = ('use = "demosaic_bilinear"', 'use = "perfect"')
    rows_of("balance.target=D65,A", pipeline(ideal, scene="uniform"))
    unbalanced = pipeline(ideal, ('[[stages]]\nuse = "balance"\n', ""), scene="uniform", camera='illuminant = "A"')
    rows_of("demosaic.use", unbalanced)
    assert len(seen) >= 3
    for (
        lab
    ) in seen:  # a grey surface looks grey, up to what the matrix makes of it; beside another white it is 10 to 90 off
        assert np.hypot(*lab[1:]).max() < 3


IDEAL = ('use = "demosaic_bilinear"', 'use = "perfect"')


@pytest.mark.parametrize(
    "axis",
    [
        "display.display=sRGB,Display P3",
        "balance.target=D65,A",
        "encode.encoding=sRGB,power",
        'display.use={use="display",label="a"}',
    ],
)
def test_an_axis_behind_the_demosaicer_reaches_the_reference_so_that_the_ideal_camera_is_perfect_at_every_value(
    axis, registry
):
    rows, result = rows_of(axis, pipeline(IDEAL))
    assert result.own_reference
    for row in rows.values():
        assert (row.status, row.psnr, row.psnr_encoded, row.delta_e) == ("done", math.inf, math.inf, 0.0)


def test_a_correction_of_the_mosaic_as_axis_reaches_its_counterpart_for_planes():
    shading = '[[stages]]\nuse = "lens_shading"\nstrength = 1.0\nfull_field = "40 deg"\ngeometry = "paper"'
    rows, result = rows_of("lens_shading.strength=0,1", scene="uniform", expected=True, before=shading)
    assert min(row.psnr for row in rows.values()) > 45  # as at the one value of the file
    assert result.own_reference


def test_values_with_references_of_their_own_are_ranked_by_what_can_be_held_side_by_side(capsys):
    for found, by in ((pipeline(), "psnr_encoded"), (_camera_values_only(), "psnr_white")):
        rows, result = rows_of("f_number=8,2", found)
        assert result.rank_by == by
        assert rows["8"].psnr > rows["2"].psnr  # little light has little to lose on a scale that both share
        assert [row.label for row in result.rows] == ["2", "8"]
        assert document(result)["rank_by"] == by
    print_comparison(result, [])
    said = capsys.readouterr().out
    assert "relative to the brightest value of each reference" in said
    assert "each value has its own" in said


def _camera_values_only():
    text = written()
    return parse_pipeline(text[: text.index('[[stages]]\nuse = "colour_fit"')])


def test_nothing_depends_on_the_order_of_values():
    there, back = (rows_of(f"integration_time={values}", edges=True)[1] for values in ("2ms,40ms", "40ms,2ms"))
    assert [row.label for row in there.rows] == [row.label for row in back.rows]
    for one, other in zip(there.rows, back.rows, strict=True):
        assert {**vars(one), "position": 0} == {**vars(other), "position": 0}
        assert 0.2 < one.mtf50 < 0.9
    assert there.notes == back.notes
    assert any("at 40 ms are clipped" in note for note in there.notes)
    assert (there.size, there.rank_by) == (back.size, back.rank_by)


def test_where_the_scene_is_the_axis_it_is_said_that_no_edge_can_take_its_place():
    rows, result = rows_of("scene.use", edges=True)
    assert rows["composite"].status == "done"
    assert [note for note in result.notes if "MTF50" in note] == [
        "no MTF50: the scene is the axis, so it cannot be replaced by an edge"
    ]


def test_a_time_that_is_metered_serves_the_reference_too():
    found = pipeline(('integration_time = "4 ms"\n', ""), scene="uniform", wandering='[[stages]]\nuse = "meter"')
    rows, _ = rows_of("demosaic.use=demosaic_bilinear", found, expected=True)
    assert rows["demosaic_bilinear"].psnr > 200


def test_what_is_beyond_clipping_is_said():
    _, result = rows_of("demosaic.use=demosaic_bilinear", camera="iso = 0\nanalogue_gain = 8")
    assert any("are clipped, which no alternative restores" in note for note in result.notes)


@pytest.mark.parametrize(
    ("values", "units", "labels"),
    [
        ((Decimal("2.8000001"), Decimal("2.8000004")), "1", ["2.8000001", "2.8000004"]),
        (("2ms", "40 ms", "1e-3 s", "5"), "s", ["2 ms", "40 ms", "1e-3 s", "5 s"]),
        ((3, 4.0, 0.1 + 0.2), "um", ["3 um", "4 um", "0.3 um"]),
        ((2.8000001, 2.8000004), "1", ["2.8000001", "2.8000004"]),
        ((True, "D65", "Display P3"), "", ["true", "D65", "Display P3"]),
        (("2 ms", "2ms"), "s", ["2 ms", "2 ms (2)"]),
    ],
)
def test_labels_carry_the_unit_and_no_two_are_alike(values, units, labels):
    assert labels_of(values, units) == labels


def test_values_that_nearly_agree_are_rows_and_pictures_of_their_own():
    rows, result = rows_of("f_number=2.8000001,2.8000004")
    assert set(rows) == {"2.8000001", "2.8000004"}
    assert len(result.pictures) == 2


def test_a_stage_that_is_swept_under_the_name_of_its_variable_is_compared():
    rows, _ = rows_of('white.use=white,{ use = "white", label = "again" }')
    assert rows["white"].status == rows["again"].status == "done"
    assert rows["white"].psnr == rows["again"].psnr


# -- alternatives -----------------------------------------------------------------------------------------------


def test_every_installed_stage_that_fits_is_taken_plugins_included(registry):
    rows, result = rows_of("demosaic.use")
    assert {"demosaic_nearest", "demosaic_bilinear", "demosaic_colour_difference", "demosaic_any", "grey"} <= set(rows)
    assert not {"reads_more", "perfect", "no_demosaicing", "sharpen"} & set(rows)
    assert any("skipped: " in note and "cannot_load" in note for note in result.notes)


@pytest.mark.parametrize(
    ("stage", "use", "among", "not_among"),
    [
        (
            "sharpen",
            "sharpen",
            {"unsharp", "wiener", "richardson_lucy", "softer"},
            {"paper_exposure", "denoise", "grey"},
        ),
        ("demosaic", "demosaic_nearest", {"demosaic_bilinear", "grey"}, {"softer", "sharpen"}),
        ("lens", "diffraction", {"lens_gaussian", "wavefront"}, {"diffusion", "glare", "birefringent"}),
        ("lens", "falloff", set(), {"vignetting", "distortion", "angular_response"}),
        ("read_noise", "read_noise", set(), {"line_pattern", "full_well"}),
    ],
)
def test_candidates_are_what_somebody_would_swap_and_who_says_nothing_is_found(registry, stage, use, among, not_among):
    found = pipeline()
    entries = tuple(replace(e, use=use, values={}) if e.name == stage else e for e in found.stages)
    node = next(n for n in nodes_of(replace(found, stages=entries), registry) if n.name == stage)
    chosen = set(candidates(node, registry)[0])
    assert among | {use} <= chosen
    assert not not_among & chosen


def test_a_stage_without_optional_outputs_is_an_alternative_named_or_not(registry):
    """The rule is that of a sweep: `sharpen` writes gains where somebody asks, `softer` has none."""
    rows, _ = rows_of("sharpen.use=sharpen,softer")
    assert {name: row.status for name, row in rows.items()} == {"sharpen": "done", "softer": "done"}
    assert rows["softer"].psnr == rows_of("sharpen.use")[0]["softer"].psnr


def test_what_breaks_off_or_refuses_is_a_row_with_the_reason_and_the_others_are_measured(registry):
    rows, result = rows_of("demosaic.use")
    assert {
        name: rows[name].status for name in ("breaks_off", "writes_nan", "for_xtrans", "needs_a_number", "grey")
    } == {
        "breaks_off": "failed",
        "writes_nan": "failed",
        "for_xtrans": "refused",
        "needs_a_number": "refused",
        "grey": "done",
    }
    for name, words in (
        ("breaks_off", "too many pixels"),
        ("writes_nan", "NaN"),
        ("for_xtrans", "X-Trans only"),
        ("needs_a_number", "how steep"),
    ):
        assert words in rows[name].reason
        assert rows[name].psnr is None
    assert result.failed
    assert [row.psnr is None for row in result.rows] == sorted(row.psnr is None for row in result.rows)
    assert rows["demosaic_bilinear"].psnr > rows["grey"].psnr


@pytest.mark.parametrize(
    ("values", "code", "left"),
    [
        ("RGGB,X-Trans,mono", 3, "the other alternatives are refused"),
        ("RGGB,BGGR,mono", 3, ""),
        ("RGGB,BGGR", 0, ""),
        ("RGGB", 0, "it is the only alternative"),
    ],
)
def test_the_command_says_what_of_the_values_that_were_named_is_not_compared(run, values, code, left):
    result = run("--axis", f"pattern={values}")
    assert result.exit_code == code, result.output
    assert ("nothing to compare with" in result.output) == bool(left) and left in result.output


def test_a_camera_quantity_is_an_axis_under_both_its_names(run):
    tables = [json.loads(run("--axis", f"{front}f_number=2,4", "--json").stdout) for front in ("", "camera.")]
    assert [table["axis"] for table in tables] == ["f_number"] * 2
    quality = [
        [{key: value for key, value in row.items() if "second" not in key} for row in table["rows"]] for table in tables
    ]
    assert quality[0] == quality[1] and len(quality[0]) == 2
    assert "did you mean 'f_number'" in run("--axis", "f_numbr").output


def test_a_table_gives_an_alternative_its_parameters(registry):
    rows, _ = rows_of(
        'demosaic.use=grey,{ use = "grey", offset = 0.5, label = "lifted" }, { use = "reads_more" }', expected=True
    )
    assert rows["lifted"].psnr < rows["grey"].psnr - 3
    assert rows["reads_more"].psnr == rows["grey"].psnr


def dead(self, rgb_camera, white, clipping_level, colour_matrix):
    raise ValueError("there is a dead channel")


def test_what_fails_for_all_alike_is_said_once(monkeypatch):
    monkeypatch.setattr(CameraToXyz, "run", dead)
    rows, result = rows_of("demosaic.use=demosaic_bilinear,demosaic_nearest", pipeline())
    assert rows["demosaic_bilinear"].psnr > rows["demosaic_nearest"].psnr
    assert rows["demosaic_bilinear"].delta_e is None
    assert len([note for note in result.notes if "failed" in note and "dead channel" in note]) == 1


# -- ranking ----------------------------------------------------------------------------------------------------


def test_the_front_holds_what_nothing_beats_in_both():
    rng = np.random.default_rng(5)
    rows = [
        ComparedRow(i, str(i), psnr=float(p), seconds_per_mpixel=float(t))
        for i, (p, t) in enumerate(rng.uniform(1, 2, (40, 2)))
    ]
    for row in ranked([*rows, ComparedRow("x", "x", status="failed")]):
        better = [
            r
            for r in rows
            if row.psnr is not None and r.psnr > row.psnr and r.seconds_per_mpixel <= row.seconds_per_mpixel
        ]
        assert row.pareto == (row.psnr is not None and not better)
    assert ranked(rows)[0].psnr == max(r.psnr for r in rows)


# -- files and pictures -----------------------------------------------------------------------------------------


def picture_of(data):
    from PIL import Image

    return Image.open(BytesIO(data))


def test_the_crop_is_where_pictures_differ():
    pictures = [np.zeros((3, 90, 120)) for _ in range(3)]
    pictures[1][:, 50:55, 70:75] = 1.0
    row, column = where_most(pictures, 20)
    assert row <= 50
    assert row + 20 >= 55
    assert column <= 70
    assert column + 20 >= 75
    assert picture_of(strip([Strip(str(i), p) for i, p in enumerate(pictures)], True, "t")).size[0] > 3 * 200


def test_crops_of_pictures_of_several_sizes_show_the_same_place_with_its_size():
    steps, um = (1.4, 5.86, 5.4), 600.0
    found = []
    for step in steps:
        n = round(um / step)
        at = step * (np.arange(n) - (n - 1) / 2)
        spot = np.exp(-((at[:, None] - 90) ** 2 + (at[None] + 60) ** 2) / (2 * 40**2))
        found.append(Strip(f"{step}", np.stack([spot] * 3), ((at[0], step), (at[0], step))))
    reference = Strip("reference", np.zeros_like(found[0].picture), found[0].plane)
    windows, said = _of_several([reference, *found])
    assert windows[0] == windows[1] and "um of the image plane" in said
    for (top, left, high, wide), one in zip(windows[1:], found, strict=True):
        (y, dy), (x, dx) = one.plane
        middle = y + dy * (top + (high - 1) / 2), x + dx * (left + (wide - 1) / 2)
        np.testing.assert_allclose(middle, (90, -60), atol=0.5 * steps[0] + dy)  # within a pixel of its own
        np.testing.assert_allclose((high * dy, wide * dx), 28 * 5.86, atol=0.5 * dy)
        assert (
            sized((high, wide), one.plane)
            == f"{wide} x {high} pixels of {dx:.4g} um: {wide * dx:.4g} x {high * dy:.4g} um"
        )
    assert picture_of(strip([reference, *found], True, "t")).size[0] > 3 * 200


@pytest.mark.parametrize("shape", [(3, 4, 5), (1, 60, 60), (4, 70, 20)])
def test_pictures_of_any_size_and_number_of_channels_are_cut(shape):
    found = [np.random.default_rng(i).uniform(0, 1, shape) for i in range(2)]
    assert picture_of(strip([Strip("a", found[0]), Strip("b", found[1])], False, "t")).format == "PNG"


def test_the_plot_takes_one_point_or_many_at_the_same_place():
    assert picture_of(work_precision([Point("one", 0.01, 0.1, True)], "t", "e")).format == "PNG"
    assert (
        picture_of(work_precision([Point(f"a long name {i}", 0.01, 0.1, i == 0) for i in range(12)], "t", "e")).format
        == "PNG"
    )


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(written())
    quick = ["--scheduler", "serial", "--repeat", "1", "--no-mtf50"]
    return lambda *words: CliRunner().invoke(main, ["compare", "small.toml", *words, *quick])


def test_the_command_prints_a_table_and_writes_its_files(run, tmp_path):
    done = run("--axis", "demosaic.use=demosaic_nearest,demosaic_bilinear")
    assert done.exit_code == 0, done.output
    for text in ("demosaic_bilinear", "etendue ", "dE00", "reference", "1 frame", "Mpixel/s"):
        assert text in done.output
    folder = tmp_path / "small-compare-demosaic"
    assert {p.name for p in folder.iterdir()} == {"compare.csv", "compare.json", "error_against_time.png", "crops.png"}
    with (folder / "compare.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["demosaic.use"] for row in rows] == ["demosaic_bilinear", "demosaic_nearest"]
    assert float(rows[0]["psnr"]) > float(rows[1]["psnr"])
    kept = json.loads((folder / "compare.json").read_text(), parse_constant=pytest.fail)
    assert kept["rows"][0]["psnr"] == float(rows[0]["psnr"])


def test_every_figure_of_the_table_has_its_unit_and_a_time_per_size_is_the_inverse_of_a_speed():
    assert set(FIGURES) <= set(UNITS)
    assert "/".join(reversed(UNITS["mpixel_per_second"].split("/"))) == UNITS["seconds_per_mpixel"]
    assert UNITS["seconds_per_mpixel"].split("/")[0] == UNITS["seconds"]


def test_its_json_keeps_its_fields_and_has_no_nan(run, registry):
    done = run("--axis", "demosaic.use=demosaic_bilinear,breaks_off", "--json", "-o", "out")
    assert done.exit_code == 3
    found = json.loads(done.stdout, parse_constant=pytest.fail)
    for row in found["rows"]:
        assert {"demosaic.use", "label", "psnr", "delta_e", "mtf50", "seconds", "distribution", "version"} <= set(row)
    assert [row["psnr"] is None for row in found["rows"]] == [False, True]
    assert found["rows"][1]["reason"].endswith("too many pixels")
    assert found["files"] == [
        f"out/{name}" for name in ("compare.csv", "compare.json", "error_against_time.png", "crops.png")
    ]


def test_pictures_of_an_earlier_comparison_do_not_stay_beside_another(run, tmp_path):
    run("--axis", "demosaic.use=demosaic_bilinear,demosaic_nearest", "-o", "out")
    run("--axis", "pixel_pitch=3,4", "-o", "out")  # a quantity has no time of its own: no plot
    assert not (tmp_path / "out" / "error_against_time.png").exists()


def test_an_axis_that_changes_the_size_of_the_frame_has_all_its_files(run, tmp_path):
    run("--axis", "sharpen.strength=0,1", "-o", "out")
    before = (tmp_path / "out" / "crops.png").read_bytes()
    done = run("--axis", "pixel.rows=40,52", "-o", "out")
    assert done.exit_code == 0, done.output
    assert "differ in size (48 x 40, 48 x 52 pixels)" in done.output
    assert "crops.png shows pictures of one size" not in done.output  # each has its place on the image plane
    assert (tmp_path / "out" / "crops.png").read_bytes() != before
    assert len(list((tmp_path / "out").iterdir())) == 4


def test_nothing_is_written_where_a_picture_cannot_be_drawn(run, tmp_path, monkeypatch):
    def breaks(*words):
        raise ValueError("no ink")

    monkeypatch.setattr("etendue_lab.compare.ranking.strip", breaks)
    assert run("--axis", "sharpen.strength=0,1", "-o", "out").exit_code != 0
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("place", ["small.toml", "small.toml/inside"])
def test_a_folder_that_cannot_be_is_refused_before_anything_is_computed(run, monkeypatch, place):
    monkeypatch.setattr("etendue_lab.compare.study.execute", lambda *words: pytest.fail("was computed"))
    done = run("--axis", "demosaic.use=demosaic_nearest", "-o", place)
    assert done.exit_code == 2, done.output
    assert "folder" in done.output
    assert "Traceback" not in done.output


def test_a_wrong_request_leaves_no_folder(run, tmp_path):
    assert run("--axis", "demosaik.use").exit_code == 2
    assert not list(tmp_path.glob("small-compare*"))


WRONG = {
    "demosaik.use": "did you mean 'demosaic'",
    "demosaic": "demosaic.use",
    "demosaic_bilinear.use": "here demosaic_bilinear is named 'demosaic'",
    "demosaic.use=demosaic_bilinaer": "did you mean 'demosaic_bilinear'",
    'demosaic.use={use="demosaic_bilinear", strenght=3}': "no parameter 'strenght'",
    "demosaic.use={use=demosaic_bilinear}": "is not valid TOML",
    "demosaic.use=falloff,demosaic_bilinear": "alternatives must write the same variables",
    "demosaic.use=": "expected NAME",
    "sharpen.strength": "values are required",
    "sharpen.strenght=1": "did you mean 'strength'",
    "sharpen.strength=-1,2": "out of range",
    "sharpen.strength=1,1": "appears twice",
    "f_nummer=2": "did you mean 'f_number'",
    "f_number": "values are required",
    "colour_fit.use=white": "alternatives must write the same variables",
}


@pytest.mark.parametrize("axis", WRONG)
def test_a_wrong_request_names_what_is_meant(run, axis):
    done = run("--axis", axis)
    assert done.exit_code == 2, done.output
    assert WRONG[axis] in done.output
    assert "Traceback" not in done.output
    assert len(done.output.splitlines()) <= 2


def test_a_pipeline_without_pixels_is_refused_with_what_is_lacking(run, tmp_path):
    text = written().partition('[[stages]]\nuse = "mosaic"')[0]
    (tmp_path / "small.toml").write_text(text)
    done = run("--axis", "lens.use")
    assert done.exit_code == 2
    assert "rgb_camera" in done.output


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a.use", None),
        ("a.use=b", ("b",)),
        ("a.use=b, c", ("b", "c")),
        ('a.use={ use = "b", x = [1, 2] },c', ({"use": "b", "x": [1, 2]}, "c")),
        ('a.use=["b", "c"]', ("b", "c")),
        ("f={ from = 1, to = 4, steps = 3 }", {"from": 1, "to": 4, "steps": 3}),
        ("f=1,2", (1, 2)),
    ],
)
def test_an_axis_is_read_as_it_would_stand_in_a_file(text, values):
    assert parse_axis(text, number) == AxisRequest(text.partition("=")[0], values)


def test_document_says_inf_where_there_is_no_end(registry):
    _, result = rows_of('demosaic.use={ use = "perfect", label = "itself" }')
    text = json.dumps(document(result), allow_nan=False)
    assert json.loads(text)["rows"][0]["psnr"] == "inf"
    assert_allclose(json.loads(text)["rows"][0]["rmse"], 0.0)


# -- the documentation ------------------------------------------------------------------------------------------


DOCS = Path(__file__).parents[2] / "docs" / "compare.md"


class Planned(Exception):
    """The request is right; nothing is computed."""


def planned():
    raise Planned


def written_axes():
    text = DOCS.read_text()
    lines = [
        words[words.index("--axis") + 1]
        for line in re.findall(r"^    etendue (.*)$", text, re.M)
        if (words := shlex.split(line))
    ]
    table = text[text.index("| `--axis` |") :].partition("\n\n")[0]
    return lines + [shlex.split(cell)[0] for cell in re.findall(r"^\| `(.*?)` \|", table, re.M)[1:]]


def test_the_documentation_has_examples():
    assert len(written_axes()) >= 6


@pytest.mark.parametrize("axis", written_axes())
def test_every_axis_of_the_documentation_can_be_asked_for(axis):
    with pytest.raises(Planned):
        compare(pipeline(), parse_axis(axis, number), options=SERIAL, ready=planned)


def test_the_python_of_the_documentation_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "pipelines").mkdir()
    (tmp_path / "pipelines" / "smallest.toml").write_text(written())
    monkeypatch.chdir(tmp_path)
    code = re.search(r"```python\n(.*?)```", DOCS.read_text(), re.S)[1]
    exec(compile(code, str(DOCS), "exec"), {})
    assert "demosaic_bilinear" in capsys.readouterr().out


def test_behind_a_lens_with_a_parameter_named_weights_the_edge_has_its_figures(tmp_path):
    """``weights`` of lens_psf_field says how its pictures are laid out; it does not make it the end of the sum over
    wavelength.
    """
    step = np.arange(-6, 7)
    spots = [np.exp(-0.5 * (step[:, None] ** 2 + step**2) / (1.2 * 1.2))] * 2
    PsfBank(np.array([0.0, 100.0]), np.array([0.55]), [[spot] for spot in spots], 1.0, "made for a test").save(
        tmp_path / "bank.npz"
    )
    own = f'use = "lens_psf_field"\nname = "lens"\nfile = "{tmp_path}/bank.npz"'
    rows, result = rows_of("demosaic.use=demosaic_bilinear", pipeline((PLAIN_LENS, own)), edges=True)
    there, plain = (
        rows["demosaic_bilinear"],
        rows_of("demosaic.use=demosaic_bilinear", edges=True)[0]["demosaic_bilinear"],
    )
    assert not any("MTF50" in note for note in result.notes)
    # the same Gaussian on either way; the bank's is sampled at 1 um and cut off at 5 sigma, and its blur errs by 1 % of
    # full scale
    assert there.mtf50 == pytest.approx(plain.mtf50, rel=0.02)
    assert there.mtf50_reference == pytest.approx(plain.mtf50_reference, rel=0.02)


def test_crops_and_plot_say_which_alternatives_they_do_not_show(tmp_path):
    rows = [
        ComparedRow(n, f"s{n}", psnr=40.0 - n, error=0.01, seconds_per_mpixel=1.0, position=n)
        for n in range(ranking.MOST_CROPS + 2)
    ]
    rows[0].psnr, rows[0].error = math.inf, 0.0
    picture = np.linspace(0, 1, 3 * 24 * 24).reshape(3, 24, 24)
    pictures = {row.position: picture * (1 - 0.01 * row.position) for row in rows}
    place = ("demosaic", "rgb_camera")
    found = Comparison(
        "p",
        "sharpen.strength",
        rows,
        place,
        place,
        "",
        "",
        (24, 24),
        {},
        [],
        pictures=pictures,
        reference_pictures=pictures,
    )
    ranking.write_files(found, tmp_path)
    beyond = f"the best {ranking.MOST_CROPS} of {len(rows)}"
    assert any(beyond in note and note.endswith("s9, s10") for note in found.notes)
    assert any("not shown: s0" in note for note in found.notes)
