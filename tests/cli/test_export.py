"""``etendue export``: pictures of an archive as files that other programs open, and what is refused before any is
written.
"""

import json
import os

import numpy as np
import pytest
import tifffile
import xarray
from click.testing import CliRunner

import etendue
from etendue.cli import main

PIPELINE = """
name = "chart"
seed = 1
[camera]
peak_qe = [0.36, 0.44, 0.40]
focal_length = "6.93 mm"
integration_time = "8 ms"
full_well_density = "2000 electron um-2"
iso = 200
base_iso = 100
[[stages]]
use = "colorchecker"
name = "scene"
white_luminance = "1000 cd m-2"
width = "300 um"
height = "200 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "50 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "falloff"
[[stages]]
use = "pixel"
sensor_height = "0.192 mm"
sensor_width = "0.288 mm"
[[stages]]
use = "mosaic"
[[stages]]
use = "exposure"
[[stages]]
use = "shot_noise"
[[stages]]
use = "adc"
[[stages]]
use = "linearise"
[[stages]]
use = "demosaic_bilinear"
name = "demosaic"
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
[sweep]
f_number = [2.8, 4]
pixel_pitch = ["3 um", "4 um"]
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    etendue.simulate(PIPELINE, archive=folder / "chart")
    return folder / "chart"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """The command in a folder of its own: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        done = CliRunner().invoke(main, ["export", *map(str, words)], standalone_mode=True)
        return done.exit_code, done.stdout, done.stderr

    return call


def stored(archive, path, **at):
    with xarray.open_datatree(archive / "data.zarr", engine="zarr") as tree:
        return tree[path].sel(at).to_numpy()


def test_every_cell_of_a_sweep_becomes_a_file_that_says_where_it_stands(archive, run, tmp_path):
    code, out, err = run(archive, "--dng")
    assert (code, err) == (0, "")
    names = sorted(os.listdir(tmp_path / "chart-export"))
    assert names == sorted(f"chart_f_number-{n}_pixel_pitch-{p}.dng" for n in ("2.8", "4") for p in ("3", "4"))
    assert len(out.splitlines()) == 4


@pytest.mark.parametrize(("pitch", "shape"), [(3.0, "64x96"), (4.0, "48x72")])
def test_libraw_reads_the_archives_numbers_levels_white_and_exposure(pitch, shape, archive, run, tmp_path):
    """Shapes differ with the pitch: each cell is found in the group of its shape."""
    rawpy = pytest.importorskip("rawpy")
    code, out, err = run(
        archive,
        "--dng",
        "--at",
        "f_number=4",
        "--at",
        f"pixel_pitch={pitch * 1000} nm",
        "--output",
        "one.dng",
        "--json",
    )
    assert code == 0, err
    assert json.loads(out) == {"files": ["one.dng"], "skipped": []}
    at = {"f_number": 4.0, "pixel_pitch": pitch}
    white = stored(archive, "white/white", **at)
    with rawpy.imread(str(tmp_path / "one.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image, stored(archive, f"adc/{shape}/raw", **at))
        assert raw.black_level_per_channel == [64] * 4
        assert raw.white_level == 4095
        assert raw.raw_pattern.tolist() == [[0, 1], [3, 2]]
        np.testing.assert_allclose(raw.camera_whitebalance[:3], white.max() / white, rtol=1e-6)
        assert raw.other.shutter_speed == pytest.approx(0.008)
        assert raw.other.aperture == pytest.approx(4)
        assert raw.other.focal_length == pytest.approx(6.93)
        assert raw.other.iso_speed == 200


@pytest.mark.parametrize(
    ("well_stage", "level"), [('[[stages]]\nuse = "full_well"\n', 64 + 2 * 0.1 * 2000 * (3 * 0.741) ** 2), ("", 4095)]
)
def test_the_white_level_is_the_full_well_where_it_ends_below_the_top_code(well_stage, level, run, tmp_path):
    text = PIPELINE.partition("[sweep]")[0].replace("iso = 200", "iso = 200\nconversion_gain = 0.1\npixel_pitch = 3")
    etendue.simulate(
        text.replace('[[stages]]\nuse = "adc"', well_stage + '[[stages]]\nuse = "adc"'), archive=tmp_path / "low"
    )
    code, _, err = run(tmp_path / "low", "--dng", "--output", "one.dng")
    assert code == 0, err
    with tifffile.TiffFile(tmp_path / "one.dng") as file:
        assert file.pages[0].tags[50717].value == round(level)


def test_libraw_develops_grey_patches_grey_and_colours_in_their_hue(archive, run, tmp_path):
    rawpy = pytest.importorskip("rawpy")
    assert run(archive, "--dng", "--at", "f_number=4", "--at", "pixel_pitch=3", "--output", "one.dng")[0] == 0
    with rawpy.imread(str(tmp_path / "one.dng")) as raw:
        rgb = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=16, gamma=(1, 1)).astype(float)
    patch, noise = {}, {}
    for number in range(24):
        row, column = divmod(number, 6)
        y, x = 8 + 16 * row, 8 + 16 * column
        pixels = rgb[y - 3 : y + 4, x - 3 : x + 4]
        patch[number] = pixels.mean(axis=(0, 1))
        noise[number] = pixels.std(axis=(0, 1)).max() / np.sqrt(
            49 / 4
        )  # of red and blue every fourth pixel is measured
    for number in (19, 20, 21, 22):  # neutral 8 to 3.5; the white one is next to clipping
        # patches that are not quite grey, and the largest of three differences of noise, each of sqrt(2) times one
        # channel's
        assert np.ptp(patch[number]) < 0.03 * patch[number].mean() + 3 * np.sqrt(2) * noise[number], number
    assert patch[14].argmax() == 0  # red
    assert patch[13].argmax() == 1  # green
    assert patch[12].argmax() == 2  # blue


def test_the_file_says_where_it_comes_from(archive, run, tmp_path):
    assert run(archive, "--dng", "--at", "f_number=4", "--at", "pixel_pitch=3", "--output", "one.dng")[0] == 0
    with tifffile.TiffFile(tmp_path / "one.dng") as file:
        told = json.loads(file.pages[0].description)
        assert file.pages[0].tags[50708].value == "etendue chart"
    assert told["pipeline"] == "chart"
    assert told["stage"] == "adc"
    assert told["at"] == "f_number=4, pixel_pitch=3"
    assert told["cell"] in (archive / "journal.jsonl").read_text()


def test_two_exports_are_the_same_files(archive, run, tmp_path):
    for folder in ("a", "b"):
        assert run(archive, "--dng", "--tiff", "--variable", "rgb_display", "--output", folder)[0] == 0
    names = os.listdir(tmp_path / "a")
    assert len(names) == 8
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert not [name for name in names if "partial" in name]


def test_tiff_holds_raw_numbers_and_pictures(archive, run, tmp_path):
    code, _, err = run(
        archive,
        "--tiff",
        "--variable",
        "raw",
        "--variable",
        "rgb_display",
        "--at",
        "f_number=4",
        "--at",
        "pixel_pitch=4",
        "--output",
        "t",
    )
    assert code == 0, err
    at = {"f_number": 4.0, "pixel_pitch": 4.0}
    raw = tifffile.imread(tmp_path / "t" / "chart_f_number-4_pixel_pitch-4.tif")
    np.testing.assert_array_equal(raw, stored(archive, "adc/48x72/raw", **at))
    with tifffile.TiffFile(tmp_path / "t" / "chart_rgb_display_f_number-4_pixel_pitch-4.tif") as file:
        rgb = np.moveaxis(file.pages[0].asarray(), -1, 0)
        assert 34675 in file.pages[0].tags
    np.testing.assert_allclose(rgb / 65535, stored(archive, "encode/48x72/rgb_display", **at), atol=0.5001 / 65535)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "--dng, --tiff, --png"),
        (["--dng", "--at", "fnumber=4"], "did you mean 'f_number'"),
        (["--dng", "--at", "f_number=5"], "f_number is 2.8, 4"),
        (["--dng", "--at", "f_number"], "expected axis=value"),
        (["--dng", "--stage", "mosaic"], "wrote no 'raw'"),
        (["--dng", "--variable", "rgb_display"], "--variable is for --tiff"),
        (["--tiff", "--variable", "rgb_dislpay"], "did you mean 'rgb_display'"),
        (["--tiff", "--variable", "radiance"], "it is not a picture"),
        (["--dng", "--output", "one.dng"], "4 would be written"),
        (["--dng", "--at", "f_number=4", "--at", "pixel_pitch=4", "--output", "one.tif"], "must end in .dng"),
    ],
)
def test_a_request_that_cannot_be_met_writes_nothing_and_says_what_to_do(words, says, archive, run, tmp_path):
    code, out, err = run(archive, *words)
    assert code == 2
    assert says in err
    assert out == ""
    assert os.listdir(tmp_path) == []


def test_a_file_that_is_there_stays_unless_forced(archive, run, tmp_path):
    (tmp_path / "one.dng").write_text("mine")
    words = [archive, "--dng", "--at", "f_number=4", "--at", "pixel_pitch=4", "--output", "one.dng"]
    code, _, err = run(*words)
    assert (code, (tmp_path / "one.dng").read_text()) == (2, "mine")
    assert "--force" in err
    assert run(*words, "--force")[0] == 0
    assert (tmp_path / "one.dng").stat().st_size > 1000


def test_what_is_no_archive_is_said_to_be_none(run, tmp_path):
    code, _, err = run(tmp_path, "--dng")
    assert code == 2
    assert "is not an archive" in err


def test_more_than_a_handful_are_written_only_when_asked_for(archive, run, tmp_path, monkeypatch):
    monkeypatch.setattr("etendue_camera.export.command.MANY", 3)
    code, _, err = run(archive, "--dng")
    assert code == 2
    assert "4 files" in err and "--at f_number=2.8" in err and "--all" in err
    assert run(archive, "--dng", "--all")[0] == 0
    assert len(os.listdir(tmp_path / "chart-export")) == 4


def test_what_is_finished_of_a_run_that_goes_on_is_written_out(archive, run, tmp_path):
    import fcntl

    assert run(archive, "--dng", "--output", "before")[0] == 0
    with open(archive / "lock") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert run(archive, "--dng", "--output", "during")[0] == 0
    before, during = (
        {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("before", "during")
    )
    assert before == during and before


def test_colour_filters_without_a_white_are_refused_with_the_stage_that_gives_one(tmp_path, run):
    text = PIPELINE[: PIPELINE.index('[[stages]]\nuse = "white"')]
    etendue.simulate(text, archive=tmp_path / "bare")
    code, _, err = run("bare", "--dng")
    assert code == 2
    assert "'white'" in err and "'colour_fit'" in err and "--tiff" in err
    assert run("bare", "--tiff")[0] == 0


@pytest.mark.parametrize(
    ("pattern", "shape"), [("X-Trans", (6, 6)), ("quad-GRBG", (4, 4)), ("mono", None), ("RGBW", None)]
)
def test_other_masks_go_out_as_they_are_or_are_refused(pattern, shape, tmp_path, run):
    text = PIPELINE[: PIPELINE.index("[sweep]")].replace(
        "[camera]", f'[camera]\npattern = "{pattern}"\npixel_pitch = "4 um"'
    )
    if pattern in ("mono", "RGBW"):  # no colour from these
        text = text[: text.index('[[stages]]\nuse = "linearise"')].replace("[0.36, 0.44, 0.40]", "[0.6]")
        text = text.replace(
            "[camera]", '[camera]\nsensitivity_kind = "filter_transmittance"'
        )  # a clear pixel needs no column
    text = text.replace("demosaic_bilinear", "demosaic_any")
    etendue.simulate(text, archive=tmp_path / "mask")
    code, _, err = run("mask", "--dng", "--output", "one.dng")
    if pattern == "RGBW":
        assert code == 2
        assert "filters W" in err and "--tiff" in err
        return
    assert code == 0, err
    assert ("LibRaw" in err) == (shape == (4, 4))
    with tifffile.TiffFile(tmp_path / "one.dng") as file:
        tags = {tag.code: tag.value for tag in file.pages[0].tags}
        assert file.pages[0].photometric == (34892 if shape is None else 32803)
    assert tags.get(33421) == shape


def test_repeated_and_bracketed_frames_are_files_of_their_own(tmp_path, run):
    text = PIPELINE[: PIPELINE.index("[sweep]")].replace(
        'use = "exposure"', 'use = "bracket"\nrepeats = 1\nbrackets = [-1, 0]\n[[stages]]\nuse = "exposure"'
    )
    tail = text[text.index('[[stages]]\nuse = "white"') : text.index('[[stages]]\nuse = "camera_to_xyz"')]
    etendue.simulate(text[: text.index('[[stages]]\nuse = "linearise"')] + tail, archive=tmp_path / "series")
    assert run("series", "--dng")[0] == 0
    for frame, time in ((0, (1, 250)), (1, (1, 125))):
        with tifffile.TiffFile(tmp_path / "series-export" / f"series_frame-{frame}.dng") as file:
            assert file.pages[0].tags[34665].value["ExposureTime"] == time
            np.testing.assert_array_equal(file.pages[0].asarray(), stored(tmp_path / "series", "adc/raw", frame=frame))
