"""What is written to begin with works as it stands: it installs, keeps the laws, gives the bits of what it begins as."""

import importlib
import sys
from importlib.metadata import EntryPoint

import pytest
from click.testing import CliRunner

from etendue.cli.program import main
from etendue.errors import RequestError
from etendue.plan.planner import make_plan
from etendue.registry import installed_stages
from etendue.scaffolds.beginning import text_of
from etendue.scaffolds.distribution import beginning, files
from etendue.spec.pipeline import parse_pipeline
from etendue.spec.presets import preset_names
from etendue.spec.stage import parameters_of, reads_of, writes_of
from etendue.testing import check_stage
from etendue.testing.cases import ordinary

ROLES = list(dict.fromkeys(installed_stages().load(name).role for name in installed_stages().names()))
QUICK = ("demosaicing", "read noise", "lens", "pixel", "figures")


def written(tmp_path, monkeypatch, role, name="begun"):
    """The class of a new distribution, imported from its files."""
    one = beginning(installed_stages(), name, role, None)
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


@pytest.mark.parametrize("role", [pytest.param(role, marks=[] if role in QUICK else pytest.mark.long) for role in ROLES])
def test_a_stage_of_every_role_keeps_every_law_as_it_is_written(tmp_path, monkeypatch, role):
    _, kind = written(tmp_path, monkeypatch, role)
    assert not [finding for finding in check_stage(kind(**ordinary(kind))) if not finding.ok]


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
        assert again.exit_code == 2 and "nothing is written over" in again.output
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["etendue-mine", "mine.toml"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("Über", "demosaicing", None), "is no name for a stage"),
        (("class", "demosaicing", None), "is no name for a stage"),
        (("sharpen", "sharpening", None), "is installed already, from etendue"),
        (("mine", "demosaicking", None), "did you mean 'demosaicing'?"),
        (("mine", None, None), "say what it is for: scene, "),
        (("mine", None, "sharpne"), "did you mean 'sharpen'?"),
        (("mine", "lens", "sharpen"), "sharpen has the role 'sharpening', not 'lens'"),
    ],
)
def test_a_wrong_name_role_or_model_is_said_and_nothing_written(words, said):
    with pytest.raises(RequestError, match=said.replace("?", r"\?")):
        beginning(installed_stages(), *words)


@pytest.mark.parametrize("name", ["a/b", 'a"b', ".a", "a\nb", "a\\b", ""])
def test_a_wrong_name_of_a_pipeline_is_said(name):
    with pytest.raises(RequestError, match="is no name for a pipeline"):
        text_of(name, "sony-imx363")
