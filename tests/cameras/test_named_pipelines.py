"""Bodies and lenses by name in a pipeline: values, axes, stand-ins, archives without the database."""

import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

import etendue
from etendue.cli.program import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.plan.planner import make_plan
from etendue_camera.cameras import bodies
from tests.cameras import database

PIPELINE = """
name = "named"
tolerance = 1e-2
[camera]
body = "sony ilce-7rm2"
lens = "acme 20-40mm"
f_number = 2.8
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "1000 cd m-2"
width = "0.1 mm"
height = "0.1 mm"
centre_x = "15 mm"
spacing = "5 um"
wavelength_from = "500 nm"
wavelength_to = "600 nm"
bin_width = "50 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "distortion"
[[stages]]
use = "falloff"
[[stages]]
use = "pixel"
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    own = tmp_path / "own"
    own.mkdir()
    (own / "acme.xml").write_text(database.text())
    monkeypatch.setenv("ETENDUE_CAMERAS", str(own))
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))
    bodies.levels.cache_clear()
    (tmp_path / "named.toml").write_text(PIPELINE)
    return tmp_path


def plan(folder, **overrides):
    return make_plan(
        etendue.read_pipeline(folder / "named.toml", {k.replace("__", "."): v for k, v in overrides.items()}),
        installed_stages(),
    )


def test_a_body_and_a_lens_give_their_values(folder):
    shared = plan(folder).shared
    assert shared["sensitivity"] == "Sony ILCE-7RM2" and shared["sensitivity_per"] == "energy"
    assert shared["pixel_pitch"] == 4.51 and shared["mount"] == "Alpha" and shared["focal_length"] == 20
    assert plan(folder, camera__focal_length="30 mm").shared["focal_length"] == 30


def test_every_body_gives_the_same_quantities_each_with_a_source():
    wanted = set(bodies.body("Sony ILCE-7RM2").camera)
    for name in bodies.packaged():
        own = bodies.body(name)
        assert set(own.camera) == wanted and all(one.source for one in own.camera.values())
        licensed = [one for one in own.camera.values() if "rawtoaces" in one.source or "libcamera" in one.source]
        assert all(one.licence for one in licensed)


def test_stand_ins_are_named_in_the_plan_and_refused_on_demand(folder):
    notes = [text for text in plan(folder).warnings if "typical values are used" in text]
    assert len(notes) == 2 and "peak_qe" in notes[0] and "body Sony ILCE-7RM2" in notes[0]
    assert "focal_length of the lens Acme 20-40mm f/2.8" in notes[1]
    with pytest.raises(RequestError, match="stand_ins: no source gives .*peak_qe.*not allowed"):
        plan(folder, stand_ins=False)
    given = CliRunner().invoke(main, ["plan", str(folder / "named.toml"), "--no-stand-ins"])
    assert given.exit_code == 2


def test_bodies_and_lenses_are_axes_whose_cells_are_those_of_each_alone(folder):
    names = {"sweep__body": ["Sony ILCE-7RM2", "ILCE-6400"], "sweep__lens": ["Acme 50mm f/1.8", "acme 20-40mm"]}
    whole = plan(folder, **names)
    assert [axis.key for axis in whole.axes] == ["body", "lens"]
    alone = plan(folder, camera__body="ILCE-6400", camera__lens="Acme 50mm f/1.8")
    keys = {cell.key for (stage, *_), cell in whole.cells.items() if stage == "pixel"}
    assert next(cell.key for (stage, *_), cell in alone.cells.items() if stage == "pixel") in keys and len(keys) == 4


def test_what_does_not_fit_is_said(folder):
    with pytest.raises(RequestError, match="body Beta; choose another lens, or set adapter = true"):
        plan(folder, camera__body="Nikon D810")
    plan(folder, camera__body="Nikon D810", camera__adapter=True)
    with pytest.raises(RequestError, match="its projection is fisheye"):
        plan(folder, camera__lens="acme 8mm")
    with pytest.raises(RequestError, match="sensor and body both give"):
        plan(folder, camera__sensor="sony-imx174")
    with pytest.raises(RequestError, match="unknown body 'Sonny ILCE-7RM2'; did you mean"):
        plan(folder, camera__body="Sonny ILCE-7RM2")


def test_without_a_database_a_lens_is_refused_with_the_command_that_installs_one(folder, monkeypatch):
    monkeypatch.setenv("ETENDUE_CAMERAS", "none")
    with pytest.raises(RequestError, match="apt install liblensfun-data-v1, or pip install lensfunpy"):
        plan(folder)


def test_an_archive_is_reproduced_without_the_database_and_says_where_its_values_are_from(folder, monkeypatch):
    archive = folder / "archive"
    sweep = ["--sweep", "body=Sony ILCE-7RM2,ilce-6400", "--sweep", "lens=Acme 50mm f/1.8,acme 20-40mm"]
    run = CliRunner().invoke(main, ["run", str(folder / "named.toml"), "--archive", str(archive), *sweep])
    assert run.exit_code == 0, run.output
    record = json.loads((archive / "runs" / "0001.json").read_text())
    stated = record["stated"]["body"]["Sony ILCE-7RM2"]
    assert stated["sensitivity"]["licence"] == "Apache-2.0" and stated["peak_qe"]["source"] == "typical"
    assert record["stated"]["lens"]["Acme 50mm f/1.8"]["lens_profile"]["licence"] == "CC BY-SA 3.0"
    assert str(folder) not in "".join(one.read_text() for one in (archive / "inputs").glob("*.toml"))
    monkeypatch.setenv("ETENDUE_CAMERAS", "none")
    monkeypatch.setenv("ETENDUE_CACHE", str(folder / "another"))
    for command in ("verify", "reproduce"):
        again = CliRunner().invoke(main, [command, str(archive)])
        assert again.exit_code == 0, again.output


def test_a_record_names_no_file_outside_its_archive(folder):
    archive = folder / "archive"
    CliRunner().invoke(main, ["run", str(folder / "named.toml"), "--archive", str(archive)])
    written = archive / "runs" / "0001.toml"
    name = next(line for line in written.read_text().splitlines() if line.startswith("body = ")).split('"')[1]
    copy = (written.parent / name).resolve()
    elsewhere = folder / "elsewhere.toml"
    copy.rename(elsewhere)
    copy.symlink_to(elsewhere)
    with pytest.raises(RequestError, match="is not in the archive's inputs/"):
        make_plan(etendue.read_pipeline(written), installed_stages())


def test_cameras_are_listed_shown_and_searched(folder):
    def said(*words):
        found = CliRunner().invoke(main, ["cameras", *words, "--json"])
        assert found.exit_code == 0, found.output
        return json.loads(found.output)

    assert len(said()["bodies"]) >= 58
    shown = said("7rm2")
    assert shown["name"] == "Sony ILCE-7RM2" and shown["camera"]["peak_qe"]["stand_in"]
    assert said("acme 50mm")["facts"]["fall_off"]["value"] == "none"
    found = said("--search", "acme")
    assert [one["name"] for one in found["refused"]] == ["Acme 8mm Fisheye", "Acme 85mm"] and found["bodies"]
    wrong = CliRunner().invoke(main, ["cameras", "nothing like it"])
    assert wrong.exit_code == 2


def test_a_body_in_a_file_is_a_body_like_any_other(folder):
    mine = folder / "mine.toml"
    CliRunner().invoke(main, ["cameras", "Nikon D810", "-o", str(mine)])
    assert mine.is_file()
    mine.write_text(mine.read_text().replace("Nikon D810", "Mine", 1))
    given = plan(folder, camera__body="./mine.toml", camera__adapter=True)
    assert given.shared["sensitivity"] == "Nikon D810" and Path(os.fspath(mine)).exists()
