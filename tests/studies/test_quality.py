"""A camera against the ideal camera of the same scene: ``etendue quality``."""

import itertools
import json

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose

from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline
from etendue_camera.colour import matrices
from etendue_camera.colour.stages.display import Display
from etendue_camera.colour.stages.display_white import white_of
from etendue_camera.quality import fidelity as measures
from etendue_lab.quality import study
from etendue_lab.quality.figures import FLAT_SIZES, Shot, figures, flat_region, without_slope
from etendue_lab.quality.ideal import ideal_of
from etendue_lab.quality.study import evenly, quality
from tests.studies import alternatives

HEAD = """
name = "tiny"
seed = 3
[camera]
f_number = 4
focal_length = "6.93 mm"
pixel_pitch = "5 um"
integration_time = "8 ms"
full_well_density = "2000 electron um-2"
peak_qe = [0.36, 0.44, 0.40]
[[stages]]
use = "SCENE"
name = "scene"
white_luminance = "1000 cd m-2"
width = "240 um"
height = "240 um"
spacing = "2.5 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "100 nm"
"""
PLAIN = [
    "irradiance",
    "falloff",
    "lens_gaussian lens",
    "diffusion",
    "pixel",
    "mosaic",
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "adc",
    "linearise",
    "demosaic_bilinear demosaic",
    "sharpen",
    "white",
    "colour_fit",
    "camera_to_xyz",
    "balance",
    "display",
    "encode",
]
EXTRA = {"pixel": "rows = 40\ncolumns = 40\n", "lens_gaussian lens": 'sigma = "3 um"\n'}


def text(stages=PLAIN, scene="composite", **extra):
    given = EXTRA | extra
    tables = []
    for stage in stages:
        use, _, name = stage.partition(" ")
        tables.append(f'[[stages]]\nuse = "{use}"\n' + (f'name = "{name}"\n' if name else "") + given.get(stage, ""))
    return HEAD.replace("SCENE", scene) + "".join(tables)


def read(stages=PLAIN, scene="composite", overrides=None, **extra):
    return parse_pipeline(text(stages, scene, **extra), overrides=overrides)


def swapped(*pairs, without=()):
    return [dict(pairs).get(stage, stage) for stage in PLAIN if stage not in without]


def measured(*args, **kwargs):
    return quality(read(*args, **kwargs), alternatives.registry())


PERFECT = swapped(("demosaic_bilinear demosaic", "perfect demosaic"), without=("sharpen",))


def test_the_ideal_camera_is_its_own_ideal():
    stages = [stage for stage in PERFECT if stage != "lens_gaussian lens"]
    (row,) = measured(stages).rows
    assert row["psnr_linear"] == row["psnr_encoded"] == np.inf
    assert_allclose(row["ssim"], 1, rtol=1e-14)
    assert [row[name] for name in ("de_mean", "de_p95", "scielab_mean", "false_colour")] == [0, 0, 0, 0]


def test_a_wider_blur_is_farther_from_ideal_by_every_figure():
    rows = measured(PERFECT, overrides={"sweep.lens.sigma": ["0.5 um", "2 um", "5 um"]}).rows
    assert [row["lens.sigma"] for row in rows] == [0.5, 2, 5]
    for name, sign in (
        ("psnr_linear", -1),
        ("psnr_encoded", -1),
        ("ssim", -1),
        ("de_mean", 1),
        ("de_p95", 1),
        ("scielab_mean", 1),
    ):
        assert np.all(sign * np.diff([row[name] for row in rows]) > 0), name


def test_more_light_brings_a_noisy_camera_nearer_to_ideal():
    # a uniform scene: no blur, no mosaic, nothing but noise lies between the two
    grey = {"scene.reflectance": 0.4, "exposure.prnu": 0, "sweep.integration_time": ["0.5 ms", "2 ms", "8 ms"]}
    rows = measured(scene="uniform", overrides=grey).rows
    assert np.all(np.diff([row["visible_noise"] for row in rows]) < 0)
    assert rows[0]["flat"]["size"] == 32
    # between shot noise (twice for four times the light) and read noise (four times); +-10 % from 1024 correlated
    # pixels
    steps = [after["snr_flat"] / before["snr_flat"] for before, after in itertools.pairwise(rows)]
    assert all(1.8 < step < 4.4 for step in steps)


def test_a_camera_of_a_uniform_scene_is_right_on_average():
    # PSNR is noise alone: as large as the variance around the mean says, to the error of that mean
    (row,) = measured(scene="uniform").rows
    assert 25 < row["psnr_linear"] < 60
    assert row["scielab_mean"] < 0.7 * row["de_mean"]  # the eye averages over pixels


def test_axes_that_end_at_the_mosaic_share_one_ideal_camera():
    found = measured(
        overrides={
            "sweep.demosaic.use": ["demosaic_bilinear", "demosaic_nearest"],
            "sweep.f_number": [2, 4],
            "sweep.sharpen.strength": [0, 0.2],
        }
    )
    assert len(found.rows) == 8
    assert {(row["demosaic.use"], row["f_number"]) for row in found.rows} == {
        (d, f) for d in ("demosaic_bilinear", "demosaic_nearest") for f in (2, 4)
    }
    assert list(found.ideal.pipeline.sweep) == ["f_number"]
    best = {
        use: max(row["psnr_linear"] for row in found.rows if row["demosaic.use"] == use)
        for use in ("demosaic_bilinear", "demosaic_nearest")
    }
    assert best["demosaic_bilinear"] > best["demosaic_nearest"]


# -- what is ideal ------------------------------------------------------------------------------------------------


def ideal(stages=PLAIN, **options):
    return ideal_of(read(stages), installed_stages(), **options)


def test_lens_and_sharpening_go_while_light_and_sensor_stay():
    stages = [
        "irradiance",
        "falloff",
        "vignetting",
        "distortion",
        "glare",
        "birefringent",
        "lens_psf_field",
        *PLAIN[2:],
    ]
    found = ideal(stages)
    assert set(found.left_out) == {"distortion", "glare", "birefringent", "lens_psf_field", "lens", "sharpen"}
    assert found.replaced == {"demosaic": "no_demosaicing"}
    assert [entry.name for entry in found.pipeline.stages][:6] == [
        "scene",
        "irradiance",
        "falloff",
        "vignetting",
        "diffusion",
        "pixel",
    ]
    assert any("distortion moves the picture" in note for note in found.notes)


def test_what_belongs_to_the_lens_can_be_said():
    assert "diffusion" in ideal(without=["diffusion"]).left_out
    assert "lens" not in ideal(keep=["lens"]).left_out
    with pytest.raises(RequestError, match="--keep lense: unknown stage; did you mean 'lens'"):
        ideal(keep=["lense"])


def test_the_ideal_camera_knows_its_white_and_has_no_shading_to_correct():
    stages = [
        "irradiance",
        "falloff",
        "lens_gaussian lens",
        "diffusion",
        "pixel",
        "mosaic",
        "exposure",
        "shot_noise",
        "adc",
        "linearise",
        "lens_shading",
        "white",
        "white_estimate",
        "balance_mosaic",
        "demosaic_bilinear demosaic",
    ]
    found = ideal(stages)
    assert {"falloff", "white_estimate", "balance_mosaic"} <= set(found.left_out)
    assert "white" not in found.left_out
    assert any("corrects shading" in note for note in found.notes)


def test_metering_and_crosstalk_have_their_own_full_planes():
    stages = [
        "irradiance",
        "pixel",
        "mosaic",
        "crosstalk",
        "meter",
        "exposure",
        "shot_noise",
        "adc",
        "linearise",
        "demosaic_bilinear d",
    ]
    found = ideal(stages)
    assert found.replaced == {"d": "no_demosaicing", "crosstalk": "crosstalk_planes"}
    assert any("meters its own, sharper light" in note for note in found.notes)


def test_a_stage_that_reads_from_the_lens_then_reads_what_the_lens_read():
    pipeline = read(
        **{"diffusion": 'from = { irradiance = "lens" }\n', "lens_gaussian lens": 'from = { irradiance = "falloff" }\n'}
    )
    by_name = {entry.name: entry for entry in ideal_of(pipeline, installed_stages()).pipeline.stages}
    assert by_name["diffusion"].origin == {"irradiance": "falloff"}


def test_a_balance_on_the_mosaic_does_not_change_how_near_the_camera_is():
    # one bilinear demosaicer on a uniform scene commutes with gains by channel; the noise of the codes stays the same
    balanced = PLAIN[:12] + ["white", "balance_mosaic"] + [stage for stage in PLAIN[12:] if stage != "white"]
    one, other = (measured(stages, scene="uniform").rows[0] for stages in (PLAIN, balanced))
    assert_allclose(other["psnr_linear"], one["psnr_linear"], atol=0.01)  # float32 gains; nothing clips
    assert_allclose(other["de_mean"], one["de_mean"], rtol=1e-3)


WHITE = [*PLAIN[:12], "white", "white_estimate"]
BEHIND = [stage for stage in PLAIN[12:] if stage != "white"]


def believed(method, *more):
    return measured(
        [*WHITE, *more, *BEHIND], scene="uniform", overrides={"scene.reflectance": 0.2}, white_estimate=method
    ).rows[0]


def test_a_white_that_was_only_believed_does_not_change_camera_primaries():
    truth = believed('method = "illuminant"\n')
    for method in ('method = "preset"\ngains = [1, 1, 1]\n', 'method = "grey_world"\n'):
        assert believed(method)["psnr_linear"] == truth["psnr_linear"]
    balanced = believed('method = "preset"\ngains = [2, 1, 1.5]\n', "balance_mosaic")
    assert_allclose(balanced["psnr_linear"], truth["psnr_linear"], atol=0.01)  # float32 gains, undone


def shots(*args, **kwargs):
    found = []

    def show(number, at, one, ideal, shown):
        found.append((one, ideal))
        return str(number), b""

    quality(read(*args, **kwargs), installed_stages(), show=show)
    return found


def test_the_time_that_was_metered_is_known_of_both_cameras():
    stages = [own for stage in PLAIN for own in (["meter", stage] if stage == "exposure" else [stage])]
    ((one, ideal),) = shots(stages)
    assert 0 < one.time < 1 and 0 < ideal.time < 1
    ((one, ideal),) = shots()
    assert one.time is None and ideal.time is None


@pytest.mark.parametrize(
    ("display", "red", "green", "blue", "white"),
    [
        ("Display P3", (0.680, 0.320), (0.265, 0.690), (0.150, 0.060), (0.3127, 0.3290)),  # SMPTE EG 432-1
        ("Adobe RGB (1998)", (0.64, 0.33), (0.21, 0.71), (0.15, 0.06), (0.3127, 0.3290)),  # Adobe, 2005
        ("sRGB", (0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290)),  # IEC 61966-2-1
        ("Typical CRT Brainard 1997", None, None, None, None),
    ],
)
def test_light_is_that_of_the_display_which_the_pipeline_names(display, red, green, blue, white):
    (one, _), (other, _) = shots(overrides={"sweep.display.display": [display, "Apple Studio Display"]})
    assert_allclose(one.to_xyz[1].sum(), 1, rtol=1e-12)
    if red:
        assert_allclose(
            one.to_xyz, matrices.rgb_to_xyz_matrix([red, green, blue], white), atol=2e-4
        )  # printed to four digits
    assert_allclose(other.to_xyz.sum(axis=1), white_of("Apple Studio Display"), rtol=1e-12)
    assert np.abs(one.to_xyz - other.to_xyz).max() > 0.01


def test_a_picture_that_was_decoded_again_is_meant_for_the_same_display():
    ((one, _),) = shots([*PLAIN, "decode"], overrides={"display.display": "Display P3"})
    assert_allclose(
        one.to_xyz,
        matrices.rgb_to_xyz_matrix([(0.680, 0.320), (0.265, 0.690), (0.150, 0.060)], (0.3127, 0.3290)),
        atol=2e-4,
    )


def test_pipelines_without_a_picture_are_refused():
    with pytest.raises(RequestError, match="no demosaicer"):
        ideal(PLAIN[:12])
    with pytest.raises(RequestError, match="no stage that writes photon_rate"):
        ideal(["irradiance"])


# -- figures ------------------------------------------------------------------------------------------------------


def shot(rgb, **applied):
    return Shot(rgb, rgb_linear=rgb, rgb_display=rgb, to_xyz=matrices.RGB_TO_XYZ_SRGB, **applied)


def test_a_flat_region_is_the_largest_and_of_these_the_one_nearest_grey():
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0.1, 0.9, (3, 90, 90))
    xyz[:, 5:43, 5:43] = 0.7
    xyz[:, 45:83, 45:83] = 0.2
    assert flat_region(xyz) == (48, 48, 32)
    xyz[:, 45:83, 45:83] = 0.001  # too dark to be a patch
    assert flat_region(xyz) == (8, 8, 32)
    assert flat_region(rng.uniform(0.1, 0.9, (3, 90, 90))) is None
    assert flat_region(np.full((3, FLAT_SIZES[-1], FLAT_SIZES[-1]), 0.2)) is None  # no room for the margin


def test_slow_shading_is_taken_out_of_a_patch_and_its_mean_stays():
    y, x = np.mgrid[:12, :9]
    ramp = np.stack([2 + 0.1 * y, 1 - 0.2 * x, 0.3 * y + 0.4 * x])
    assert_allclose(without_slope(ramp), np.broadcast_to(ramp.mean(axis=(1, 2), keepdims=True), ramp.shape), rtol=1e-13)


def test_gains_and_time_that_were_applied_are_undone_in_camera_primaries():
    rgb = np.random.default_rng(0).uniform(0.1, 0.9, (3, 20, 20))
    gains = np.array([2.0, 1.0, 0.5])
    scaled = rgb * gains[:, None, None] * 3
    found, _, _ = figures(shot(scaled, gains=gains, time=0.03), shot(rgb, time=0.01), 30)
    assert found["psnr_linear"] > 300  # a rounding, if any
    found, _, _ = figures(shot(rgb), shot(scaled, gains=gains * 3), 30)
    assert found["psnr_linear"] > 280  # of a picture three times as bright
    one_knows = figures(shot(rgb, time=0.03), shot(rgb), 30)[0]  # there is no ratio to undo
    assert one_knows["psnr_linear"] == np.inf


def test_structure_is_compared_in_luma():
    rng = np.random.default_rng(0)
    reference = rng.uniform(0.1, 0.9, (3, 20, 20))
    picture = reference.copy()
    picture[2] = rng.uniform(0.1, 0.9, (20, 20))  # blue, which luma has little of
    luma = [np.tensordot([0.2126, 0.7152, 0.0722], one, 1)[None] for one in (picture, reference)]  # ITU-R BT.709
    found, _, _ = figures(shot(picture), shot(reference), 30)
    assert_allclose(found["ssim"], measures.ssim(*luma), atol=2e-4)  # printed to four digits
    assert abs(found["ssim"] - measures.ssim(picture.mean(0, keepdims=True), reference.mean(0, keepdims=True))) > 0.1


def test_what_the_display_cannot_show_is_no_difference():
    rgb = np.random.default_rng(0).uniform(0.1, 0.9, (3, 20, 20))
    beyond = rgb.copy()
    rgb[0, :5], rgb[2, 5:9] = 1.0, 0.0
    beyond[0, :5], beyond[2, 5:9] = 1.7, -0.4
    found, _, _ = figures(shot(beyond), shot(rgb), 30)
    assert [found[name] for name in ("de_mean", "de_p95", "scielab_mean", "false_colour")] == [0, 0, 0, 0]
    assert found["psnr_linear"] < 20


def test_small_pictures_and_those_without_a_display_have_unknown_figures():
    rgb = np.random.default_rng(0).uniform(0.1, 0.9, (3, 8, 8))
    found, shown, flat = figures(shot(rgb), shot(rgb), 30)
    assert np.isnan(found["ssim"]) and found["de_mean"] == 0 and flat is None
    found, shown, flat = figures(Shot(rgb), Shot(rgb), 30)
    assert found["psnr_linear"] == np.inf and np.isnan(found["de_mean"]) and shown is None
    with pytest.raises(ValueError, match="but the picture of the ideal camera has shape"):
        figures(Shot(rgb), Shot(rgb[:, :4]), 30)


# -- the command --------------------------------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(text())
    return lambda *words: CliRunner().invoke(main, ["quality", "tiny.toml", *words])


def test_the_command_prints_a_table_and_writes_files(run, tmp_path):
    from PIL import Image

    result = run("--sweep", "f_number=2,8", "-o", "out", "--pictures", "1")
    assert result.exit_code == 0, result.output
    assert "no_demosaicing in place of demosaic" in result.output and "PSNR" in result.output
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "quality.csv",
        "quality.json",
        "quality_000.png",
    ]
    lines = (tmp_path / "out/quality.csv").read_text().splitlines()
    assert len(lines) == 3 and lines[0].startswith("f_number [1],psnr_linear [dB],")
    assert Image.open(tmp_path / "out/quality_000.png").size[0] > 3 * 480  # three panels of 12 screen pixels a pixel


def test_its_json_has_no_nan(run):
    result = run("--json")
    document = json.loads(result.stdout, parse_constant=pytest.fail)
    assert document["ideal"] == {"left_out": ["lens", "sharpen"], "replaced": {"demosaic": "no_demosaicing"}}
    (row,) = document["rows"]
    assert row["mean_snr"] is None and row["psnr_linear"] > 0
    assert set(document["figures"]) <= set(row)
    assert any("exposure_report" in note for note in document["notes"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--set", "camera.f_numbr=2"), "did you mean 'f_number'"),
        (("--without", "lans"), "did you mean 'lens'"),
        (("--samples-per-degree", "0"), "must be greater than 0"),
    ],
)
def test_wrong_requests_are_named(run, words, message):
    result = run(*words)
    assert result.exit_code == 2
    assert message in result.output


def test_an_rgb_space_as_display_has_every_figure(run):
    result = run("--set", "display.display=Display P3", "--json")
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)["rows"]
    assert row["de_mean"] > 0 and row["scielab_mean"] > 0


@pytest.mark.parametrize("folder", ["tiny.toml", "tiny.toml/inside", "o" * 300])
def test_a_folder_that_takes_no_files_is_refused_before_anything_is_computed(run, monkeypatch, folder):
    monkeypatch.setattr(study, "execute", lambda *_: pytest.fail("it ran"))
    result = run("-o", folder)
    assert result.exit_code == 2
    assert folder[:30] in result.output and "folder" in result.output and "archive" not in result.output


def test_a_request_with_faults_makes_no_folder(run, tmp_path):
    assert run("--set", "camera.f_numbr=2", "-o", "out").exit_code == 2
    assert not (tmp_path / "out").exists()


def test_pictures_of_an_earlier_comparison_do_not_stay_beside_a_new_table(run, tmp_path):
    assert run("--sweep", "f_number=2,8", "-o", "out").exit_code == 0
    (tmp_path / "out/quality_notes.png").write_bytes(b"mine")
    result = run("-o", "out", "--pictures", "1")
    assert [line.split()[1] for line in result.output.splitlines() if line.startswith("file")] == [
        "out/quality_000.png",
        "out/quality.json",
        "out/quality.csv",
    ]
    names = ["quality.csv", "quality.json", "quality_000.png", "quality_notes.png"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == names


@pytest.mark.parametrize("count", range(1, 40))
def test_pictures_are_spread_evenly_over_the_rows_the_first_and_the_last_among_them(count):
    rows = [3 * n for n in range(count)]  # those that have pictures
    for most in range(count + 3):
        chosen = sorted(evenly(rows, most))
        assert len(chosen) == min(most, count)
        if len(chosen) > 1:
            gaps = np.diff([rows.index(row) for row in chosen])
            assert (chosen[0], chosen[-1]) == (rows[0], rows[-1]) and np.ptp(gaps) <= 1


def test_every_row_has_its_picture_and_what_is_not_drawn_is_said(run, tmp_path):
    def drawn():
        return [path.name for path in sorted((tmp_path / "out").glob("*.png"))]

    all_of_them = run("--sweep", "f_number=2,4,8", "-o", "out")
    assert (
        drawn() == ["quality_000.png", "quality_001.png", "quality_002.png"]
        and "spread evenly over the sweep" not in all_of_them.output
    )
    some = run("--sweep", "f_number=2,4,8", "-o", "out", "--pictures", "2")
    assert drawn() == ["quality_000.png", "quality_002.png"]
    assert "drew 2 of 3 pictures" in some.output and "--pictures 3" in some.output


def test_channels_that_were_lifted_to_a_floor_are_a_note():
    lifting = 'method = "preset"\ngains = [1, 1, 1e4]\nfloor = 0.01\n'
    found = quality(read([*WHITE, *BEHIND], scene="uniform", white_estimate=lifting), installed_stages())
    assert any("white_estimate has channels of the white raised to the floor" in note for note in found.notes)


def dead(self, xyz_scene, prepared):
    raise ValueError("there is a dead channel")


def test_a_cell_that_breaks_is_a_row_with_its_reason(run, monkeypatch):
    monkeypatch.setattr(Display, "run", dead)
    result = run("--json")
    assert result.exit_code == 3
    (row,) = json.loads(result.stdout, parse_constant=pytest.fail)["rows"]
    assert row["status"] == "failed" and "dead channel" in row["reason"] and row["psnr_linear"] is None
    assert "dead channel" in run().output


def test_a_dark_picture_is_not_near_the_ideal_because_it_is_dark():
    """A hundredth of the light: absolute errors shrink, errors by the picture's own brightest value grow."""
    rows = measured(overrides={"sweep.integration_time": ["0.08 ms", "8 ms"]}).rows
    assert rows[0]["psnr_linear"] < rows[1]["psnr_linear"] - 3


def test_a_stage_cannot_be_kept_and_left_out():
    with pytest.raises(RequestError, match="--without lens and --keep lens"):
        quality(read(), installed_stages(), without=("lens",), keep=("lens",))


def test_what_the_plan_warns_of_stands_beside_the_figures():
    from etendue.plan.planner import make_plan

    warned = make_plan(read(overrides={"camera.pixel_pitch": "2 um"}), installed_stages()).warnings
    assert warned and set(warned) <= set(measured(overrides={"camera.pixel_pitch": "2 um"}).notes)
