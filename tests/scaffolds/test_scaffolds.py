"""What is written to begin with works as it stands: it installs, keeps the laws, gives the bits of what it begins
as.
"""

import importlib
import inspect
import sys
from importlib.metadata import EntryPoint

import pytest
from click.testing import CliRunner

from etendue.cli.program import main
from etendue.contract.registry import installed_stages
from etendue.contract.stage import arguments_of, parameters_of, reads_of, writes_of
from etendue.errors import RequestError
from etendue.pipeline.beginning import text_of
from etendue.pipeline.distribution import beginning, files
from etendue.pipeline.file import parse_pipeline
from etendue.pipeline.presets import preset_names
from etendue.plan.planner import make_plan
from etendue.testing import StageConformance, check_stage
from etendue.testing.cases import ordinary

ROLES = list(dict.fromkeys(installed_stages().load(name).role for name in installed_stages().names()))
QUICK = ("demosaicing", "read noise", "lens", "pixel", "figures")


def written(tmp_path, monkeypatch, role, like=None, name="begun"):
    """The class of a new distribution, imported from its files."""
    one = beginning(installed_stages(), name, role, like)
    for path, text in files(one).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path / "src"))
    for module in [m for m in sys.modules if m.split(".")[0] == one.module]:
        del sys.modules[module]
    importlib.invalidate_caches()
    brought = importlib.import_module(f"{one.module}.manifest").etendue_stages()
    return one, EntryPoint(one.stage, brought[one.stage], "").load()


@pytest.mark.parametrize("role", ROLES)
def test_a_stage_of_every_role_begins_with_the_declaration_of_its_model(tmp_path, monkeypatch, role):
    one, kind = written(tmp_path, monkeypatch, role)
    assert kind.role == role and issubclass(kind, one.kind)
    assert (reads_of(kind), writes_of(kind)) == (reads_of(one.kind), writes_of(one.kind))
    assert parameters_of(kind).keys() == parameters_of(one.kind).keys()


@pytest.mark.parametrize(
    "role", [pytest.param(role, marks=[] if role in QUICK else pytest.mark.long) for role in ROLES]
)
def test_a_stage_of_every_role_keeps_every_law_as_it_is_written(tmp_path, monkeypatch, role):
    _, kind = written(tmp_path, monkeypatch, role)
    assert check_stage(kind(**ordinary(kind))) == []


DEMOSAICERS = [name for name in installed_stages().names() if installed_stages().load(name).role == "demosaicing"]


@pytest.mark.parametrize("like", DEMOSAICERS)
def test_a_demosaicer_begins_knowing_where_its_window_stands(tmp_path, monkeypatch, like):
    """As it is written; without its rows and columns it is found out."""
    one, kind = written(tmp_path, monkeypatch, "demosaicing", like)
    law = "test_a_window_of_the_whole_is_read_where_it_stands"
    conformance = type("Conformance", (StageConformance,), {"stage": kind(**ordinary(kind))})()
    getattr(conformance, law)()
    if {"y", "x"} <= set(arguments_of(kind)):

        class Blind(kind):
            def run(self, **given):
                return one.kind.run(self, **given | {"y": given["y"] - given["y"][0], "x": given["x"] - given["x"][0]})

            run.__signature__ = inspect.signature(kind.run)

        with pytest.raises(AssertionError, match="row 1, column 0"):
            getattr(type("Conformance", (StageConformance,), {"stage": Blind(**ordinary(kind))})(), law)()


@pytest.mark.parametrize("sensor", preset_names())
def test_a_new_pipeline_plans_without_a_fault_or_a_note(sensor):
    plan = make_plan(parse_pipeline(text_of("mine", sensor)), installed_stages())
    assert plan.pipeline.name == "mine" and plan.nodes
    assert not plan.warnings


def test_the_commands_write_once_and_never_over_what_is_there(tmp_path):
    runner = CliRunner()
    for words in (["new", "mine"], ["new-plugin", "mine", "--role", "demosaicing"]):
        done = runner.invoke(main, [*words, "-o", str(tmp_path)])
        assert done.exit_code == 0, done.output
        assert "next: " in done.output
        before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        again = runner.invoke(main, [*words, "-o", str(tmp_path)])
        assert again.exit_code == 2 and "is not overwritten" in again.output
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["etendue-mine", "mine.toml"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("Über", "demosaicing", None), "is not a stage name"),
        (("class", "demosaicing", None), "is not a stage name"),
        (("sharpen", "sharpening", None), "is already installed, from etendue"),
        (("mine", "demosaicking", None), "did you mean 'demosaicing'?"),
        (("mine", None, None), "missing: give one of scene, "),
        (("mine", None, "sharpne"), "did you mean 'sharpen'?"),
        (("mine", "lens", "sharpen"), "sharpen has the role 'sharpening', not 'lens'"),
    ],
)
def test_a_wrong_name_role_or_model_is_said_and_nothing_written(words, said):
    with pytest.raises(RequestError, match=said.replace("?", r"\?")):
        beginning(installed_stages(), *words)


@pytest.mark.parametrize("name", ["a/b", 'a"b', ".a", "a\nb", "a\\b", ""])
def test_a_wrong_name_of_a_pipeline_is_said(name):
    with pytest.raises(RequestError, match="is not a valid pipeline name"):
        text_of(name, "sony-imx363")


@pytest.mark.parametrize("like", ["sharpen", "lens_shading", "demosaic_bilinear"])
def test_the_parameter_that_is_proposed_is_none_that_is_inherited(like):
    """`sharpen` and `lens_shading` have a `strength`: one of one's own would stand in its place."""
    import re

    one = beginning(installed_stages(), "begun", None, like)
    (name,) = re.findall(r"#     (\w+): float = param", files(one)["src/etendue_begun/stages.py"])
    assert name not in parameters_of(one.kind) and not hasattr(one.kind, name)


def test_a_name_with_its_suffix_gives_the_same_file(tmp_path):
    for name, folder in (("mine", "short"), ("mine.toml", "long")):
        assert CliRunner().invoke(main, ["new", name, "-o", str(tmp_path / folder)]).exit_code == 0
    assert (tmp_path / "short" / "mine.toml").read_bytes() == (tmp_path / "long" / "mine.toml").read_bytes()
