"""A camera quantity has two names, ``f_number`` and ``camera.f_number``: wherever one of them works the other does,
and means the same.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import etendue
from etendue import stages as s
from etendue.cli import main
from etendue.contract.registry import installed_stages
from etendue.errors import RequestError
from etendue.pipeline.file import from_document, overridden, parse_pipeline, read_pipeline
from etendue.plan.planner import make_plan
from etendue_lab.compare.axis import check_axis, parse_axis

HEAD = """
name = "grey"
[[stages]]
use = "uniform"
name = "scene"
white_luminance = "100 cd m-2"
width = "24 um"
height = "16 um"
bin_width = "100 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "falloff"
name = "light"
[[stages]]
use = "lens_numbers"
"""
SWEPT = HEAD + "[sweep]\nf_number = [2, 4]\n"
PAIRS = [
    ({"camera.f_number": 8}, {"f_number": 8}),
    ({"sweep.f_number": [2, 8]}, {"sweep.camera.f_number": [2, 8]}),
    ({"camera.sensor": "sony-imx250"}, {"sensor": "sony-imx250"}),
    ({"sweep.sensor": ["sony-imx250"]}, {"sweep.camera.sensor": ["sony-imx250"]}),
]


@pytest.fixture
def inside(capsys, tmp_path, monkeypatch):
    """Run a command in this process, beside grey.toml: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "grey.toml").write_text(SWEPT)

    def call(*words):
        with pytest.raises(SystemExit) as stopped:
            main(words, prog_name="etendue")
        captured = capsys.readouterr()
        return stopped.value.code or 0, captured.out, captured.err

    return call


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("words") / "grey"
    etendue.simulate(SWEPT, archive=folder)
    return folder


def keys(pipeline):
    return {ref: cell.key for ref, cell in make_plan(pipeline, installed_stages()).cells.items()}


@pytest.mark.parametrize("text", [HEAD, SWEPT], ids=["one value", "swept"])
@pytest.mark.parametrize(("one", "other"), PAIRS, ids=str)
def test_both_names_of_an_override_give_one_pipeline(text, one, other):
    assert parse_pipeline(text, overrides=one) == parse_pipeline(text, overrides=other)
    assert overridden(parse_pipeline(text), one) == overridden(parse_pipeline(text), other)


def test_of_two_overrides_that_mean_one_thing_the_last_counts():
    assert parse_pipeline(HEAD, overrides={"f_number": 2, "camera.f_number": 4}).shared == {"f_number": 4}
    assert parse_pipeline(HEAD, overrides={"camera.f_number": 2, "f_number": 4}).shared == {"f_number": 4}


@pytest.mark.parametrize(
    "axis", ["camera.f_number = [2, 4]", '"camera.f_number" = [2, 4]', "camera = { f_number = [2, 4] }"]
)
def test_an_axis_of_a_file_has_both_names(axis):
    written = parse_pipeline(f"{HEAD}[sweep]\n{axis}\n")
    assert (dict(written.sweep), keys(written)) == ({"f_number": [2, 4]}, keys(parse_pipeline(SWEPT)))
    assert dict(parse_pipeline(f"{HEAD}[sweep]\n{axis}\n", overrides={"sweep.f_number": [8]}).sweep) == {
        "f_number": [8]
    }
    assert dict(parse_pipeline(f"{HEAD}[sweep]\n{axis}\n", overrides={"f_number": 8}).sweep) == {}


def test_an_axis_under_both_names_is_refused_with_its_line():
    text = SWEPT + "camera.f_number = [8]\n"
    with pytest.raises(RequestError) as refused:
        make_plan(parse_pipeline(text, "grey.toml"), installed_stages())
    assert f"grey.toml:{text.count(chr(10))}" in str(refused.value) and "are the same axis" in str(refused.value)


def test_a_stage_that_is_called_camera_keeps_its_parameters_and_the_camera_its_quantities():
    text = HEAD.replace('name = "scene"', 'name = "camera"')
    swept = parse_pipeline(text, overrides={"sweep.camera.width": ["8 um", "16 um"], "sweep.camera.f_number": [2, 4]})
    assert list(swept.sweep) == ["camera.width", "f_number"]
    assert [axis.dim for axis in make_plan(swept, installed_stages()).axes] == ["camera_width", "f_number"]


def test_the_command_line_takes_both_names_in_both_places(inside):
    for option, value in (("--set", "f_number=8"), ("--sweep", "f_number=4,8")):
        shown = [inside("plan", "grey.toml", "--json", option, front + value) for front in ("", "camera.")]
        assert [code for code, _, _ in shown] == [0, 0], shown
        one, other = (json.loads(out) | {"scene_seconds": None} for _, out, _ in shown)  # the first looks at the scene
        assert one == other
    code, out, err = inside("run", "grey.toml", "--json", "--quiet", "--set", "f_number=8", "--archive", "one")
    assert code == 0, out + err
    with open("one/runs/0001.json") as file:
        assert json.load(file)["overrides"] == {"camera.f_number": "8"}
    assert inside("quantities", "camera.f_number") == inside("quantities", "f_number")


def test_a_misspelt_name_is_set_right_from_all_that_can_be_set(inside):
    for words in (("--set", "f_numbr=4"), ("--sweep", "camera.f_numbr=2,4")):
        code, _, err = inside("plan", "grey.toml", *words)
        assert code == 2 and "f_number" in err, err


def test_a_comparison_runs_along_an_axis_under_both_names():
    pipeline = parse_pipeline(SWEPT)
    for text in ("{}f_number=2,4", "{}sensor"):
        one, other = (check_axis(parse_axis(text.format(front), str), pipeline) for front in ("", "camera."))
        assert one == other and one.stage == ""
    with pytest.raises(RequestError, match="values are required: --axis f_number="):
        check_axis(parse_axis("camera.f_number", str), pipeline)


@pytest.mark.parametrize(
    "words",
    [
        ("plot", "show", "light.irradiance", "--at", "{}f_number=4"),
        ("plot", "curves", "airy_diameter", "--x", "{}f_number"),
        ("plot", "map", "airy_diameter", "--y", "{}f_number"),
        ("export", "--png", "--variable", "irradiance", "--at", "{}f_number=4"),
    ],
    ids=lambda words: words[1],
)
def test_values_along_an_axis_are_chosen_under_both_names(archive, inside, words):
    said = {}
    for front in ("", "camera."):
        command, *rest = (word.format(front) for word in words)
        said[front] = inside(command, str(archive), *rest, *(["--force"] if command == "export" else []))[:2]
    assert said[""] == said["camera."] and said[""][0] == 0, said


def test_a_value_along_an_axis_of_a_stage_is_chosen_by_its_parameter_in_python():
    show = etendue.simulate(HEAD, scene__white_luminance=[100, 200], f_number=2).etendue.show
    one, other = (
        show("light.irradiance", **{name: 200})._repr_png_()
        for name in ("scene_white_luminance", "scene__white_luminance")
    )
    assert one == other != show("light.irradiance", scene__white_luminance=100)._repr_png_()
    with pytest.raises(RequestError, match="given twice"):
        show("light.irradiance", scene_white_luminance=200, scene__white_luminance=100)


# -- in Python -----------------------------------------------------------------------------------------------------


def grey():
    scene = s.uniform(name="scene", white_luminance="100 cd m-2", width="24 um", height="16 um", bin_width="100 nm")
    return etendue.Pipeline(scene, s.irradiance(), s.falloff(name="light"), s.lens_numbers(), name="grey")


def test_pipelines_in_python_take_both_names():
    assert grey().sweep(camera__f_number=[2, 4]) == grey().sweep(f_number=[2, 4])
    for given in (grey().camera(camera__f_number=4), grey().set(f_number=4), grey().set(camera__f_number=4)):
        assert given == grey().camera(f_number=4)


@pytest.mark.parametrize("front", ["", "camera__"])
def test_whatever_a_pipeline_may_be_is_simulated_with_other_values(tmp_path, front):
    (tmp_path / "grey.toml").write_text(HEAD)
    file = tmp_path / "grey.toml"
    sources = [file, HEAD, grey().document(), grey(), read_pipeline(file), from_document(grey().document())]
    for number, source in enumerate(sources):
        tree = etendue.simulate(
            source, **{f"{front}f_number": [2, 4]}, scene__white_luminance=50, seed=3, want=["light.irradiance"]
        )
        assert tree["light/irradiance"].sizes["f_number"] == 2 and "lens_numbers" not in tree, source
        whole = etendue.simulate(source, **{f"{front}f_number": 4}, archive=tmp_path / f"{number}", scheduler="serial")
        half = tree["light/irradiance"].sel(f_number=4)
        np.testing.assert_allclose(half, whole["light/irradiance"] / 2, rtol=1e-6)  # float32
    assert grey() == sources[3]  # what was given is as it was


@pytest.mark.parametrize("name", ["smallest", "paper", "sensors", "burst"])
def test_a_pipeline_that_was_read_says_what_is_read_as_the_same(name):
    read = read_pipeline(Path(__file__).parents[2] / "pipelines" / f"{name}.toml")
    again = replace(from_document(read.document(), read.file), folder=read.folder, text=read.text, lines=read.lines)
    assert again == read
    assert overridden(read, {}) == read


def test_faults_of_a_pipeline_that_was_read_stay_with_it():
    read = parse_pipeline(HEAD.replace('name = "grey"', "seed = -1\ncolour = 2"))
    assert overridden(read, {"camera.f_number": 4}).faults == read.faults != ()
