"""A sensor is calibrated from frames: what a simulated sensor was given comes back, and its file makes the same one."""

import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.session import load
from etendue_lab.calibrate import checking, pattern_fit
from etendue_lab.calibrate.calibration import calibrate
from etendue_lab.calibrate.drawing import photon_transfer
from etendue_lab.emva.study import of_pipeline
from etendue_lab.frames.patterns import Pattern
from etendue_lab.frames.reading import open_frames
from tests.studies.desk import SIGMAS, TRUE, beyond, measurement

NAMES = ("gain", "quantum_efficiency", "read_noise", "dsnu", "prnu", "dark_current", "black_level")


def calibrated(folder, **own):
    np.savez(folder / "frames.npz", **measurement(**own))
    return calibrate(open_frames(folder / "frames.npz"))


@pytest.mark.parametrize("seed", range(3))
def test_parameters_of_a_linear_sensor_come_back_without_a_bend(tmp_path, seed):
    model = calibrated(tmp_path, seed=seed, size=96)
    assert beyond(model, {name: TRUE[name] for name in NAMES}) == {}
    assert "bend" not in model.values
    assert "row_noise" not in model.values
    assert model.dark.waves == []


@pytest.mark.parametrize(("bend", "order"), [(0.01, 1.0), (0.03, 2.0), (0.02, 3.0)])
def test_a_bend_is_found_with_its_order(tmp_path, bend, order):
    model = calibrated(tmp_path, seed=5, size=96, levels=24, bend=bend, order=order)
    assert model.response.order == order
    assert beyond(model, {"bend": bend, "gain": TRUE["gain"], "quantum_efficiency": 0.5}) == {}


def test_row_and_column_parts_are_told_from_white_noise(tmp_path):
    own = {"row_noise": 4.0, "column_pattern": 5.0, "row_pattern": 6.0}
    model = calibrated(tmp_path, seed=2, size=96, stack=32, **own)
    assert beyond(model, {**own, "read_noise": TRUE["read_noise"]}) == {}
    assert "column_noise" not in model.values


def test_waves_outliers_and_shading_are_told_apart():
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:128, :128]
    truth = rng.standard_normal((128, 128)) + 1.5 * np.cos(2 * np.pi * (0.2013 * y - 0.04 * x + 0.1))
    truth[5, 7], truth[90, 31] = 40.0, -30.0
    shading = 0.5 * (y / 64 - 1) ** 2
    groups = truth + shading + 0.3 * rng.standard_normal((8, 128, 128))
    found = pattern_fit.fit(Pattern(groups - groups.mean(axis=(1, 2), keepdims=True), 8), shaded=True)
    assert len(found.waves) == 1
    wave = found.waves[0]
    sign = math.copysign(1.0, wave.along_y)
    # standard errors of a wave in white noise: sqrt(2/n) of the amplitude, sqrt(24/n) / (2 pi A N) of the frequency
    assert wave.amplitude == pytest.approx(1.5, abs=5 * math.sqrt(2) / 128)
    assert (sign * wave.along_y, sign * wave.along_x) == pytest.approx((0.2013, -0.04), abs=5 * 2e-5)
    assert found.outliers == 2
    assert found.white.low < 1.0 < found.white.high
    assert found.shading == pytest.approx(shading.std(), rel=0.1)  # of 1/128 of the white noise's power


def test_the_fitted_sensor_predicts_its_own_frames(tmp_path):
    np.savez(tmp_path / "frames.npz", **measurement(seed=1, size=96, bend=0.02, order=1.0, levels=24))
    frames = open_frames(tmp_path / "frames.npz")
    found = checking.check(frames, calibrate(frames))
    statistical = math.sqrt(2 / 96**2)  # of the variance of a pair
    assert found["variance_rms"] < 1.6 * statistical
    assert found["mean_worst"] < 0.005
    assert abs(found["spatial_at_stack"]) < 0.1


def test_the_check_is_drawn_with_its_saturated_levels(tmp_path):
    np.savez(tmp_path / "frames.npz", **measurement(seed=1, size=64))
    asked = ["calibrate", str(tmp_path / "frames.npz"), "--figure", str(tmp_path / "transfer.svg"), "--json"]
    done = CliRunner().invoke(main, asked)
    assert done.exit_code == 0, done.output
    (found,) = json.loads(done.output)["checks"]
    assert any(row["variance_predicted"] is None for row in found["levels"])  # saturated: the model says nothing
    drawn = (tmp_path / "transfer.svg").read_text()
    assert "predicted, unscaled" in drawn
    assert photon_transfer([found], "as JSON").figure is not None


def test_the_file_is_a_sensor_of_a_pipeline_and_of_an_axis(tmp_path):
    np.savez(tmp_path / "frames.npz", **measurement(seed=1, size=96))
    target = tmp_path / "mine.toml"
    done = CliRunner().invoke(
        main, ["calibrate", str(tmp_path / "frames.npz"), "-o", str(target), "--json", "--pitch", "4"]
    )
    assert done.exit_code == 0, done.output
    parameters = {one["name"]: one for one in json.loads(done.output)["channels"][0]["parameters"]}
    written = tomllib.loads(target.read_text())
    assert written["camera"]["conversion_gain"]["value"] == pytest.approx(parameters["gain"]["value"], rel=1e-6)
    assert any("SHA-256" in one.get("note", "") for one in written["facts"].values())
    text = """
name = "used"
seed = 3
[camera]
sensor = "./mine.toml"
f_number = 8
illuminant = "550 nm"
integration_time = "10 ms"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "600 cd m-2"
width = "700 um"
height = "540 um"
wavelength_from = "545 nm"
wavelength_to = "555 nm"
bin_width = "10 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 64
columns = 64
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
"""
    (tmp_path / "used.toml").write_text(text)
    (channel,) = of_pipeline(load(tmp_path / "used.toml"), installed_stages(), 96).channels
    for name in ("gain", "read_noise", "prnu"):
        one, given = getattr(channel.measurement, name), parameters[name]["value"]
        assert abs(one.value - given) < SIGMAS * max(one.high - one.value, one.value - one.low), name
    swept = CliRunner().invoke(  # an axis
        main,
        ["run", str(tmp_path / "used.toml"),
         "--sweep", "sensor=./mine.toml,sony-imx174", "--archive", str(tmp_path / "a"),
         "--no-errors", "--want", "raw"],
    )  # fmt: skip
    assert swept.exit_code == 0, swept.output
    again = CliRunner().invoke(main, ["verify", str(tmp_path / "a")])
    assert again.exit_code == 0, again.output


def test_the_pipeline_of_the_page_takes_a_monochrome_sensor_and_one_with_filters(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "desk.md").read_text()
    (block,) = re.findall(r"^```toml\n(.*?)^```", page, flags=re.S | re.M)
    (tmp_path / "desk.toml").write_text(block)
    np.savez(tmp_path / "frames.npz", **measurement(seed=1, size=64, row_noise=3.0))
    asked = [
        ["calibrate", str(tmp_path / "frames.npz"), "-o", str(tmp_path / "mine.toml"), "--pitch", "4"],
        ["run", str(tmp_path / "desk.toml"), "--sweep", "sensor=./mine.toml,sony-imx174", "--no-errors", "--archive",
         str(tmp_path / "a"), "--want", "edge_mtf50_cycles,raw"],
    ]  # fmt: skip
    for one in asked:
        done = CliRunner().invoke(main, one)
        assert done.exit_code == 0, done.output


def test_a_missing_or_faulty_sensor_file_is_told(tmp_path):
    document = {"name": "a", "camera": {"sensor": "./none.toml"}, "stages": [{"use": "uniform"}]}
    assert "none.toml" in str(load(document).faults)
    (tmp_path / "bad.toml").write_text("title = 3\n")
    from etendue.pipeline.presets import preset_at

    with pytest.raises(RequestError, match="is missing; expected title"):
        preset_at("bad.toml", None, tmp_path)


def test_an_output_that_is_no_sensor_file_is_refused(tmp_path):
    np.savez(tmp_path / "frames.npz", **measurement())
    done = CliRunner().invoke(main, ["calibrate", str(tmp_path / "frames.npz"), "-o", str(tmp_path / "mine.txt")])
    assert done.exit_code == 2
    assert "ends in .toml" in " ".join(done.output.split())


def test_the_page_of_real_frames_is_drawn_from_the_committed_figures():
    from runpy import run_path

    root = Path(__file__).parents[2]
    made = run_path(str(root / "benchmarks" / "reality.py"))
    found = json.loads((root / "benchmarks" / "reality.json").read_text())
    assert made["page"](found) == (root / "docs" / "reality.md").read_text()
    assert all("CC BY-SA 3.0" in made["SETS"][name]["notice"] for name in found if name == "emva_001")
