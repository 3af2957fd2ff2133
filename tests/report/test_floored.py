"""The end of a run says in words what was lifted to a floor."""

import json

import pytest
from click.testing import CliRunner

from etendue.cli import main

CAMERA = """
name = "tiny"
[camera]
integration_time = "8 ms"
peak_qe = [0.36, 0.44, 0.40]
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "1000 cd m-2"
width = "60 um"
height = "60 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "pixel"
rows = 8
columns = 8
[[stages]]
use = "mosaic"
[[stages]]
use = "ideal_mosaic"
[[stages]]
use = "white"
[[stages]]
use = "white_estimate"
method = "preset"
gains = [1, 1, 1e4]
floor = 1e-6
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(CAMERA)
    want = ("--want", "white_estimate.white")  # the count itself is not asked for
    return lambda *words: CliRunner().invoke(
        main, ["run", "tiny.toml", "--quiet", "--scheduler", "serial", *want, *words]
    )


SENTENCE = "white_estimate has channels of the white raised to the floor: in 1 of 2 cells, at most 1 of them in a cell"


def test_a_channel_that_was_lifted_is_said_in_words_also_when_the_cells_are_reused(run):
    for _ in range(2):
        result = run("--sweep", "white_estimate.floor=1e-6,0.1")
        assert result.exit_code == 0, result.output
        assert f"floored: {SENTENCE}" in result.output
    assert "0 cells computed" in result.output
    assert json.loads(run("--sweep", "white_estimate.floor=1e-6,0.1", "--json").stdout)["floored"] == [SENTENCE]


def test_nothing_is_said_where_nothing_was_lifted(run):
    result = run()
    assert result.exit_code == 0 and "floored:" not in result.output


def test_a_white_that_no_pixel_can_reach_is_said_in_words(run):
    told = (
        "overexposed: white has channels in which a white diffuser exceeds saturation: in 1 of 2 cells, at most "
        "3 of them in a cell"
    )
    for _ in range(2):  # also when the cells are reused
        result = run("--sweep", "integration_time=0.0008,80")
        assert result.exit_code == 0 and told in result.output, result.output
    assert "overexposed" not in run("--set", "camera.integration_time=0.0008").output
