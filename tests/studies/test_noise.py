"""Noise behind every stage: what is predicted is what frames of noise show."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.session import load
from etendue_camera.electronics.stages.read_out import Linearise, LinePattern, ReadNoise
from etendue_lab.information.study import information
from etendue_lab.losses.study import losses
from etendue_lab.noise.flat_field import FlatField
from etendue_lab.noise.study import noise

CAMERA = """
name = "small"
seed = 3
[camera]
pixel_pitch = "4 um"
integration_time = "10 ms"
peak_qe = [0.4]
{camera}
[[stages]]
use = "slanted_edge"
white_luminance = "500 cd m-2"
width = "{side} um"
height = "{side} um"
spacing = "4 um"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
sampling = "paper"
[[stages]]
use = "mosaic"
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
use = "{demosaic}"
name = "demosaic"
[[stages]]
use = "sharpen"
[[stages]]
use = "white"
[[stages]]
use = "colour_fit"
[[stages]]
use = "camera_to_xyz"
[[stages]]
use = "display"
[[stages]]
use = "encode"
"""


def camera(demosaic="demosaic_bilinear", camera="", side=480):
    return load(CAMERA.format(demosaic=demosaic, camera=camera, side=side))


def measured(*arguments, **options):
    return noise(camera(*arguments), installed_stages(), **options)


@pytest.mark.parametrize("demosaic", ["demosaic_bilinear", "demosaic_colour_difference", "demosaic_nearest"])
def test_linear_stages_carry_noise_as_predicted(demosaic):
    """Four standard errors (88 x 88 pixels, 2 frames: about 1.3 % each) and the correlations to 0.05."""
    report = measured(demosaic, frames=2)
    for expected, found, error in report.mosaic.values():
        assert abs(found - expected) < 4 * error + 0.003 * expected
    assert [row.stage for row in report.rows] == ["demosaic", "sharpen", "camera_to_xyz", "display", "encode"]
    for row in report.rows:
        np.testing.assert_allclose(row.found, row.predicted, rtol=0.06)
        for expected, found in [*row.between.values(), *row.neighbours]:
            assert abs(found - expected) < 0.05


def test_bilinear_keeps_nine_sixteenths_of_reds_variance_and_no_channel_takes_from_another():
    (row, *_), mosaic = (report := measured(frames=1)).rows, report.mosaic
    np.testing.assert_allclose(
        row.predicted[0] / mosaic["R"][0], 0.75, rtol=5e-3
    )  # the light about a few places against that of the window
    np.testing.assert_allclose(row.predicted[1] / mosaic["G"][0], 0.625**0.5, rtol=5e-3)
    assert all(abs(expected) < 1e-9 for expected, _ in row.between.values())


def test_patterns_of_the_sensor_are_part_of_the_noise_of_a_frame():
    """With no read noise and a strong offset pattern the mosaic's noise is shot noise and pattern."""
    report = measured("demosaic_bilinear", "dsnu = 200\nread_noise = 0", frames=3)
    for expected, found, error in report.mosaic.values():
        assert abs(found - expected) < 4 * error + 0.003 * expected


@pytest.mark.parametrize(
    ("settings", "prnu"),
    [("read_noise = 0\ndsnu = 0", 0.05), ("read_noise = 0\ndsnu = 0\nbits = 7\nblack_level = 4", 0.0)],
    ids=["sensitivity pattern", "rounding"],
)
def test_each_source_of_noise_is_counted(settings, prnu):
    """Sources that are many times shot noise: 5 % of 900 electrons against 30; steps of 94 electrons, rms 27."""
    pipeline = camera(camera=settings)
    stages = tuple(replace(e, values={"prnu": prnu}) if e.use == "exposure" else e for e in pipeline.stages)
    report = noise(replace(pipeline, stages=stages), installed_stages(), frames=2)
    for expected, found, error in report.mosaic.values():
        assert abs(found - expected) < 4 * error + 0.01 * expected


@pytest.mark.parametrize(("row_noise", "remarks"), [(0.0, 0), (2.0, 1)])
def test_noise_of_whole_lines_is_remarked_on_once_and_only_where_there_is_any(row_noise, remarks):
    noisy = {"read_noise": ReadNoise(read_noise=3.0), "line_pattern": LinePattern(row_noise=row_noise)}
    field = SimpleNamespace(first=SimpleNamespace(name="linearise"), before={"linearise": Linearise()}, notes=[])
    field.noisy, field.unsaid = (lambda: noisy), (lambda: "")
    for _ in range(2):
        variance = FlatField.model(field, {"green": 100.0})["green"] * Linearise().electrons() ** 2
        assert variance == pytest.approx(9.0 + ReadNoise().dsnu ** 2 + row_noise**2)
    assert sum("rows and columns" in note for note in field.notes) == len(field.notes) == remarks


@pytest.mark.long
def test_what_is_measured_in_a_small_window_is_not_too_little():
    """64 x 64 pixels: a quarter has 256, of which a trend of 15 terms takes 6 %. Sixty frames know a deviation to
    0.6 %.
    """
    report = measured("demosaic_bilinear", "", 256, frames=60)
    for expected, found, error in report.mosaic.values():
        assert abs(found / expected - 1) < 0.02 and error < 0.01 * found
    np.testing.assert_allclose(report.rows[0].found, report.rows[0].predicted, rtol=0.02)


def test_a_gain_that_differs_over_the_frame_is_followed_to_its_place():
    """Shading corrected by 1/cos^4 over 60 degrees: 30 % more noise at the edges of the window than in its middle."""
    lens = 'focal_length = "0.42 mm"\nf_number = 4'
    text = CAMERA.format(demosaic="demosaic_bilinear", camera=lens, side=640)
    text = text.replace('use = "irradiance"', 'use = "irradiance"\n[[stages]]\nuse = "falloff"', 1)
    text = text.replace('use = "linearise"', 'use = "linearise"\n[[stages]]\nuse = "lens_shading"', 1)
    report = noise(load(text), installed_stages(), frames=3)
    np.testing.assert_allclose(report.rows[0].found, report.rows[0].predicted, rtol=0.03)


def test_full_pixels_are_said_to_have_no_noise():
    bright = CAMERA.format(demosaic="demosaic_bilinear", camera="", side=480).replace('"10 ms"', '"1 s"')
    report = noise(load(bright), installed_stages(), reflectance=1.0, frames=1)
    assert any("saturate" in note for note in report.notes)


def test_a_camera_that_draws_no_noise_is_refused():
    noisy = ("exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
    text = CAMERA.format(demosaic="demosaic_bilinear", camera="", side=480)
    for use in noisy[1:]:
        text = text.replace(f'[[stages]]\nuse = "{use}"\n', "")
    text = text.replace('use = "exposure"', 'use = "ideal_mosaic"')
    with pytest.raises(RequestError, match="draws noise"):
        noise(load(text), installed_stages(), frames=1)


def test_any_array_is_followed_through_a_demosaicer_that_knows_it():
    report = measured("demosaic_any", 'pattern = "X-Trans"', 480, frames=2)
    np.testing.assert_allclose(report.rows[0].found, report.rows[0].predicted, rtol=0.06)
    for expected, found, error in report.mosaic.values():
        assert abs(found - expected) < 4 * error + 0.01 * expected


def test_a_camera_without_a_mosaic_a_small_picture_and_nonsense_are_refused():
    with pytest.raises(RequestError, match="at least 64 x 64"):
        measured("demosaic_bilinear", "", 200)
    with pytest.raises(RequestError, match="reflectance 0"):
        measured(reflectance=0.0)
    with pytest.raises(RequestError, match="frames 0"):
        measured(frames=0)
    bare = load(
        "name = 'x'\n[camera]\npeak_qe = [0.4]\n[[stages]]\nuse = 'uniform'\nwhite_luminance = 100\n[[stages]]\nuse = "
        "'irradiance'\n"
    )
    with pytest.raises(RequestError, match="no stage of the pipeline writes mosaic_linear"):
        noise(bare, installed_stages())


def test_a_grey_sensor_without_a_demosaicer_is_followed_up_to_its_mosaic():
    """By noise, information and losses alike; a note says where it ends."""
    text = CAMERA.format(demosaic="demosaic_bilinear", camera='pattern = "mono"\nsensitivity = "flat"', side=400)
    made = load(text)
    mono = replace(
        made, stages=made.stages[: 1 + next(n for n, stage in enumerate(made.stages) if stage.use == "linearise")]
    )
    found = noise(mono, installed_stages(), frames=1).document()
    (row,) = found["mosaic"]
    assert not found["rows"] and row["found"] == pytest.approx(row["predicted"], rel=0.1)
    detail = information(mono, installed_stages(), count=0).document()
    assert detail["rows"][0]["stage"] == "light" and detail["rows"][-1]["bits_per_pixel"] > 0.5
    shared = losses(mono, installed_stages(), runs=0).document()
    assert {one["what"] for one in shared["losses"]} == {"contrast", "SNR"}
    for study, what in ((found, "noise"), (detail, "detail"), (shared, "detail")):
        assert f"no stage makes a picture of mosaic_linear: {what} is followed up to linearise" in study["notes"]


def test_the_command_prints_tables_and_strict_json(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(CAMERA.format(demosaic="demosaic_bilinear", camera="", side=480))
    text = CliRunner().invoke(main, ["noise", str(file), "--frames", "1"])
    assert text.exit_code == 0 and "predicted" in text.output and "demosaic" in text.output
    document = json.loads(
        CliRunner().invoke(main, ["noise", str(file), "--frames", "1", "--json"]).output, parse_constant=pytest.fail
    )
    assert {row["stage"] for row in document["rows"]} >= {"demosaic", "sharpen", "display"}
    assert CliRunner().invoke(main, ["noise", str(file), "--reflectance", "2"]).exit_code == 2
