"""A record runs as it stands: the same keys, the same bits, wherever the archive is."""

from __future__ import annotations

import json
import math
import os
import shutil
import tomllib
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from etendue.archive.records import inputs
from etendue.archive.records.inputs import copy_inputs, resolve_pipeline
from etendue.archive.structure.naming import cell_name
from etendue.builder.simulating import simulate
from etendue.cli import main
from etendue.cli.options import Given
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline import toml
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from tests.archive.tiny import store_of, tiny_file, tiny_plan

PIPELINES = Path(__file__).parents[2] / "pipelines"

# -- TOML ----------------------------------------------------------------------------------------------------------

texts = st.text(st.characters(exclude_categories=("Cs",)), max_size=12)
numbers = st.integers(-(10**18), 10**18) | st.decimals(allow_nan=False) | st.floats(allow_nan=False)
values = st.recursive(
    texts | numbers | st.booleans(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
tables = st.dictionaries(texts, values, max_size=4)


@given(plain=tables, table=tables, many=st.lists(tables, min_size=1, max_size=3))
def test_what_is_written_as_toml_reads_back(plain, table, many):
    document = {f"_{name}": value for name, value in plain.items() if not isinstance(value, dict)} | {
        "t": table,
        "many": many,
    }
    document = {
        k: v for k, v in document.items() if k == "many" or not (isinstance(v, list) and v and isinstance(v[0], dict))
    }
    assert tomllib.loads(toml.dumps(document), parse_float=Decimal) == exact(document)


def exact(value):
    """As ``tomllib`` reads it: floats by their shortest text."""
    if isinstance(value, dict):
        return {name: exact(one) for name, one in value.items()}
    if isinstance(value, list):
        return [exact(one) for one in value]
    return Decimal(repr(value)) if isinstance(value, float) else value


def test_a_value_that_toml_has_not_is_refused():
    assert toml.value(np.float64(0.1)) == "0.1"
    assert [toml.value(v) for v in (math.inf, -math.inf, Decimal("Infinity"))] == ["inf", "-inf", "inf"]
    with pytest.raises(TypeError):
        toml.value(None)


@given(st.floats(allow_nan=False))
def test_a_number_is_written_as_it_is_once_it_has_been_read(number):
    text = toml.value(number)
    read = tomllib.loads(f"v = {text}", parse_float=Decimal)["v"]
    assert toml.value(read) == text and float(read) == number


# -- the same keys -------------------------------------------------------------------------------------------------

ASKED = {
    "smallest.toml": [
        (),
        ("--set", "camera.f_number=4", "--sweep", "sharpen.strength=0,0.2,0.4"),
        ("--want", "rgb_display", "--tolerance", "0"),
        ("--set", "camera.focal_length=6 mm", "--sweep", "focus_distance=inf,500 mm"),
        ("--nothing-left-out",),
    ],
    "paper.toml": [(), ("--sweep", "f_number=2,2.8", "--set", "seed=7")],
    "paper_order.toml": [()],
    "sensors.toml": [
        ("--set", "camera.sensor=sony-imx363"),
        ("--set", "camera.sensor=sony-imx174", "--sweep", "pixel_pitch=3 um,4 um"),
    ],
    "sweep_die.toml": [("--sweep", "f_number={ from = 2, to = 8, steps = 3, spacing = 'log' }")],
    "colour.toml": [()],
    "raw_corrections.toml": [("--set", 'keep=["raw"]')],
    "resolution.toml": [
        ("--sweep", 'demosaic.use=["demosaic_bilinear", { use = "demosaic_nearest", label = "mine" }]')
    ],
}


def plan_from(path, words):
    """As the command line makes it."""
    options = {"--set": [], "--sweep": [], "--want": [], "--tolerance": [], "--nothing-left-out": []}
    name = ""
    for word in words:
        if word.startswith("--"):
            name = word
            options[name] += [word] if word == "--nothing-left-out" else []
        else:
            options[name].append(word)
    given = Given(
        path,
        tuple(options["--set"]),
        tuple(options["--sweep"]),
        want=tuple(options["--want"]),
        tolerance=next(iter(options["--tolerance"]), None),
    )
    return make_plan(given.pipeline(), installed_stages(), not options["--nothing-left-out"])


def assert_same_plan(first, second):
    one, other = (
        {cell_name(plan, ref): (cell.key, cell.seed) for ref, cell in plan.cells.items()} for plan in (first, second)
    )
    assert one == other
    assert (first.kept, first.wanted, first.precision, first.shared.keys()) == (
        second.kept,
        second.wanted,
        second.precision,
        second.shared.keys(),
    )
    assert [(a.key, a.values) for a in first.axes] == [(a.key, a.values) for a in second.axes]


def recorded(plan, archive):
    """The record of a plan, and its inputs, as a run would leave them."""
    resolved = resolve_pipeline(plan)
    (archive / "runs").mkdir(parents=True)
    (archive / "runs/0001.toml").write_text(resolved.text)
    copy_inputs(archive, resolved.inputs)
    return archive / "runs/0001.toml"


@pytest.mark.long
@pytest.mark.parametrize(("name", "words"), [(name, words) for name, many in ASKED.items() for words in many], ids=str)
def test_a_record_has_the_keys_of_its_run(tmp_path, name, words):
    if "demosaic_nearest" not in installed_stages() and "mine" in str(words):
        pytest.skip("not installed")
    plan = plan_from(PIPELINES / name, words)
    assert_same_plan(make_plan(read_pipeline(recorded(plan, tmp_path / "a")), installed_stages()), plan)
    assert str(PIPELINES) not in (tmp_path / "a/runs/0001.toml").read_text()
    assert "package:" not in (tmp_path / "a/runs/0001.toml").read_text()


# -- the same bits -------------------------------------------------------------------------------------------------


def test_a_record_gives_the_same_archive_again(tmp_path, monkeypatch, capsys):
    """Overrides, a file from the command line, and the archive moved elsewhere."""
    file = tiny_file(tmp_path)
    shutil.copy(tmp_path / "camera.csv", tmp_path / "mine.csv")
    monkeypatch.chdir(tmp_path)

    def etendue(*words):
        with pytest.raises(SystemExit) as stopped:
            main(["run", *words, "--quiet", "--json"], prog_name="etendue")
        out = capsys.readouterr()
        assert stopped.value.code == 0, out.err
        return json.loads(out.out)

    etendue(
        str(file),
        "--archive",
        "a",
        "--set",
        f"camera.sensitivity={tmp_path}/mine.csv",
        "--set",
        "camera.transmittance=0.5",
        "--sweep",
        "f_number=2,8",
        "--nothing-left-out",
    )
    record = json.loads(Path("a/runs/0001.json").read_text())
    assert record["resolved"] == Path("a/runs/0001.toml").read_text()
    assert record["overrides"]["sweep.f_number"] == "[2, 8]"
    assert "Decimal" not in json.dumps(record)
    for path in ("a/runs/0001.json", "a/runs/0001.toml"):
        assert str(tmp_path) not in Path(path).read_text()
    (tmp_path / "elsewhere").mkdir()
    shutil.move("a", "elsewhere/b")
    for name in ("tiny.toml", "camera.csv", "mine.csv"):
        Path(name).unlink()
    again = etendue("elsewhere/b/runs/0001.toml", "--archive", "new")
    assert again["computed"] == 13
    old, new = store_of(tmp_path / "elsewhere/b"), store_of(tmp_path / "new")
    assert old == new


def test_what_python_asked_for_is_recorded_too(tmp_path):
    file = tiny_file(tmp_path)
    simulate(
        file,
        archive=tmp_path / "a",
        f_number=np.array([2.0, 4.0]),
        pixel__rows=[4],
        transmittance=np.float64(0.25),
        leave_out=False,
    )
    made = make_plan(read_pipeline(tmp_path / "a/runs/0001.toml"), installed_stages())
    assert made.shared["transmittance"] == 0.25
    assert not made.leaves_out
    assert [axis.values for axis in made.axes] == [(2.0, 4.0), ("absorbing", "reflecting"), (4,)]


# -- inputs --------------------------------------------------------------------------------------------------------

CUBE = """
name = "cube"
[camera]
peak_qe = 0.4
[[stages]]
use = "cube"
name = "scene"
file = "FOLDER"
variable = "scene/radiance"
[[stages]]
use = "irradiance"
"""


@pytest.fixture
def cube(tmp_path):
    """A pipeline whose scene is the store of another archive."""
    execute(tiny_plan(tmp_path, {"wanted": ["scene.radiance"]}), tmp_path / "first", Options("serial"))
    shutil.copytree(tmp_path / "first/data.zarr", tmp_path / "light.zarr")
    name = next(n for n in installed_stages().names() if installed_stages().load(n).__name__ == "RadianceCube")
    (tmp_path / "cube.toml").write_text(
        CUBE.replace("FOLDER", "light.zarr").replace('"cube"\nname = "scene"', f'"{name}"\nname = "scene"')
    )
    return tmp_path / "cube.toml"


def test_a_scene_that_is_a_folder_is_copied_and_runs_again(cube, tmp_path):
    plan = make_plan(read_pipeline(cube), installed_stages())
    execute(plan, tmp_path / "a", Options("serial"))
    (copied,) = (tmp_path / "a/inputs").iterdir()
    assert copied.is_dir()
    assert copied.suffix == ".zarr"
    assert f"../inputs/{copied.name}" in (tmp_path / "a/runs/0001.toml").read_text()
    shutil.rmtree(tmp_path / "light.zarr")
    again = make_plan(read_pipeline(tmp_path / "a/runs/0001.toml"), installed_stages())
    execute(again, tmp_path / "b", Options("serial"))
    assert store_of(tmp_path / "a") == store_of(tmp_path / "b")


def test_a_folder_with_a_link_out_of_it_is_refused(cube, tmp_path):
    (tmp_path / "secret").write_text("words")
    (tmp_path / "light.zarr/secret").symlink_to(tmp_path / "secret")
    with pytest.raises(RequestError, match="contains a link, secret"):
        make_plan(read_pipeline(cube), installed_stages())


def test_a_very_large_input_is_described(tmp_path, monkeypatch):
    monkeypatch.setattr(inputs, "LARGEST_COPY", 100)
    execute(tiny_plan(tmp_path), tmp_path / "a", Options("serial"))
    (told,) = (tmp_path / "a/inputs").iterdir()
    found = json.loads(told.read_text())
    assert (found["name"], found["copied"]) == ("camera.csv", False)
    assert found["bytes"] == os.path.getsize(tmp_path / "camera.csv")
