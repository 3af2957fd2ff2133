"""Sensors with colour filters: every site of the mosaic has its own gain and black level, read from DNG files."""

import json
import tomllib

import numpy as np
import pytest
from click.testing import CliRunner

from etendue.cli import main
from etendue_camera.export import dng
from etendue_lab.frames.reading import open_frames

SIDE, LEVELS, TOP = 96, 12, 4095
GAINS = {"R": 0.20, "Gr": 0.25, "Gb": 0.26, "B": 0.32}  # DN/electron
BLACKS = {"R": 100.0, "Gr": 104.0, "Gb": 98.0, "B": 110.0}  # DN
RATES = {"R": 0.6, "Gr": 1.0, "Gb": 1.0, "B": 0.5}  # electrons, relative
PLACES = {"R": (0, 0), "Gr": (0, 1), "Gb": (1, 0), "B": (1, 1)}
TIMES = np.linspace(0.002, 0.024, LEVELS)


def frame(rng, time, light):
    codes = np.zeros((SIDE, SIDE), np.uint16)
    for name, (row, column) in PLACES.items():
        shape = (SIDE // 2, SIDE // 2)
        charge = rng.poisson(RATES[name] * light * 12000 * time / TIMES[-1], shape) + 6 * rng.standard_normal(shape)
        codes[row::2, column::2] = np.clip(np.rint(charge * GAINS[name] + BLACKS[name]), 0, TOP)
    return codes


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """DNG files as a camera names them: frames without light in a folder of their own."""
    found = tmp_path_factory.mktemp("raws")
    (found / "darks").mkdir()
    rng = np.random.default_rng(7)
    for i, time in enumerate(TIMES):
        for again in range(2):
            for where, light in ((found / "darks", 0.0), (found, 1.0)):
                raw = dng.RawFrame(
                    frame(rng, time, light), ("RG", "GB"), 100.0, TOP, np.ones(3), np.eye(3), exposure=float(time)
                )
                dng.write(where / f"IMG_{2 * i + again:04d}.dng", raw)
    return found


def test_times_and_filters_come_from_the_files(folder):
    pytest.importorskip("rawpy")
    frames = open_frames(folder)
    assert frames.pattern == "RGGB"
    levels = frames.levels()
    # EXIF times are ratios of integers: within 1e-8
    assert [one.time for one in levels if not one.dark] == pytest.approx(TIMES, rel=1e-7)
    assert [one.time for one in levels if one.dark] == pytest.approx(TIMES, rel=1e-7)
    assert all(len(one.frames) == 2 for one in levels)


def test_every_channel_has_its_own_gain_and_black_level(folder, tmp_path):
    pytest.importorskip("rawpy")
    target = tmp_path / "mine.toml"
    done = CliRunner().invoke(main, ["calibrate", str(folder), "--json", "-o", str(target), "--pitch", "2"])
    assert done.exit_code == 0, done.output
    channels = {one["channel"]: one for one in json.loads(done.output)["channels"]}
    assert set(channels) == set(GAINS)
    written = tomllib.loads(target.read_text())
    assert written["camera"]["pattern"]["value"] == "RGGB"
    for name, channel in channels.items():
        found = {one["name"]: one for one in channel["parameters"]}
        for key, true in (("gain", GAINS[name]), ("black_level", BLACKS[name])):
            one = found[key]
            # 2.2 half intervals: 4.3 standard errors
            assert abs(one["value"] - true) < 2.2 * (one["high"] - one["value"]), (name, key)
            assert written["facts"][f"{key}_{name.lower()}"]["value"] == pytest.approx(one["value"], rel=1e-5)
