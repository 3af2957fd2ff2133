"""Requests beyond bounds are refused in words, at once and in little memory; a lacking plugin is named once."""

import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import pytest

import etendue
from etendue.contract.registry import installed_stages
from etendue.errors import Fault, RequestError, escaped
from etendue.pipeline.file import from_document, parse_pipeline
from etendue.plan.planner import make_plan
from etendue.plan.wiring import missing

PIPELINES = Path(__file__).parents[2] / "pipelines"
LINE = '[[stages]]\nuse = "lens_numbers"\n'
LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000, 2_000_000_000))
resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
from etendue.cli import main
main(sys.argv[1:], prog_name="etendue")
"""


def refused(text):
    with pytest.raises(RequestError) as error:
        make_plan(parse_pipeline(text, "file.toml"), installed_stages())
    return str(error.value)


HUGE = {
    "keys in a table": "".join(f"k{n} = 1\n" for n in range(60_000)),
    "stages": '[[stages]]\nuse = "nobody"\n' * 30_000,
    "a dotted key": ".".join(["a"] * 20_000) + " = 1\n",
    "a dotted key in a table": "[camera]\n" + ".".join(["a"] * 20_000) + " = 1\n",
    "a dotted header": "[" + ".".join(["a"] * 20_000) + "]\n",
    "a quoted dotted key": ".".join(['"a b"'] * 20_000) + " = 1\n",
    "one long key": "k" * 1_000_000 + " = 1\n",
    "one long text": f'name = "{"n" * 1_000_000}"\n',
    "many quotes": "'" * 1_000_000,
    "a number of a million digits": "seed = 0x" + "f" * 1_000_000 + "\n",
    "more than a file": "#" * 1_100_000,
    "nested": "a = " + "[" * 20_000 + "]" * 20_000,
    "inline tables": "a = " + "{ a = " * 300 + "1" + " }" * 300,
    "an axis": "[sweep]\nf_number = [" + ", ".join(str(1 + n / 1e5) for n in range(20_000)) + "]\n",
}


@pytest.mark.parametrize("what", HUGE)
def test_a_huge_file_is_refused_in_few_lines_little_memory_and_time(what, tmp_path):
    (tmp_path / "huge.toml").write_text(HUGE[what] + (LINE if what == "an axis" else ""))
    if what == "an axis":  # 20,000 cells are fine, but not of a million
        (tmp_path / "huge.toml").write_text("most_cells = 1000\n" + LINE + HUGE[what])
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, "plan", str(tmp_path / "huge.toml")], capture_output=True, text=True
    )
    assert done.returncode == 2, done.stderr[-500:]
    assert "Traceback" not in done.stderr
    assert len(done.stderr) < 30_000 and len(done.stderr.splitlines()) <= 21


def test_a_device_without_an_end_is_no_pipeline():
    with pytest.raises(RequestError, match="not a plain file"):
        etendue.simulate("/dev/zero")


def test_a_document_from_python_is_held_against_the_same_bounds():
    deep: dict = {}
    inner = deep
    for _ in range(50_000):
        inner["a"] = {}
        inner = inner["a"]
    with pytest.raises(RequestError, match="nested more than 16 deep"):
        etendue.simulate({"camera": deep, "stages": [{"use": "lens_numbers"}]}, f_number=2)
    with pytest.raises(RequestError, match="cells, more than the 1000000"):
        etendue.simulate(
            {
                "stages": [{"use": "lens_numbers"}],
                "sweep": {
                    "f_number": {"from": 1, "to": 9, "steps": 2000},
                    "transmittance": {"from": 0.1, "to": 1, "steps": 2000},
                },
            }
        )


def test_more_cells_are_planned_where_the_file_says_so():
    document = {"stages": [{"use": "lens_numbers"}], "sweep": {"f_number": [1, 2, 3]}, "most_cells": 3}
    assert len(make_plan(from_document(document), installed_stages()).cells) == 3
    with pytest.raises(RequestError, match="set most_cells = 3"):
        make_plan(from_document({**document, "most_cells": 2}), installed_stages())


def test_planning_tells_how_far_it_is():
    told = []
    document = {"stages": [{"use": "lens_numbers"}], "sweep": {"f_number": {"from": 1, "to": 9, "steps": 2000}}}
    make_plan(from_document(document), installed_stages(), True, lambda done, total: told.append((done, total)))
    assert told == [(500, 2000), (1000, 2000), (1500, 2000), (2000, 2000)]


def test_what_a_terminal_obeys_is_written_out_in_messages():
    assert str(Fault("a\x1b[31m", "b\nc\x00\u202e")) == "a\\x1b[31m: b\\nc\\x00\\u202e"
    for text in ("plain µm é 光 \u00a0", "emoji \U0001f600\u200d"):
        assert escaped(text) == text


def test_many_faults_are_shown_in_part_and_kept_whole():
    error = RequestError([Fault("place", f"fault {n}") for n in range(100)], "file.toml")
    assert len(str(error).splitlines()) == 16
    assert str(error).endswith("file.toml: and 85 more faults")
    assert len(error.faults) == 100


def test_a_lacking_plugin_is_named_once_with_the_command_that_installs_it(monkeypatch, tmp_path):
    """By its stages where they are known, by `requires` where they are not; both ways name it once."""
    known = {"lens_of_theirs": "etendue-theirs", "numbers_of_theirs": "etendue-theirs"}
    monkeypatch.setattr(missing, "known_plugins", lambda: known)
    text = '[camera]\ntheir_quantity = 1\n[[stages]]\nuse = "lens_of_theirs"\n[[stages]]\nuse = "numbers_of_theirs"\n'
    assert refused(text).splitlines() == [
        "file.toml:3: stages[1] lens_of_theirs: etendue-theirs, which provides lens_of_theirs, numbers_of_theirs, is "
        "not installed: "
        "pip install etendue-theirs"
    ]
    folder = tmp_path / "plugins" / "etendue-theirs"
    folder.mkdir(parents=True)
    (folder / "pyproject.toml").touch()
    (tmp_path / "pipelines").mkdir()
    monkeypatch.chdir(tmp_path)
    made = parse_pipeline('requires = ["etendue-theirs"]\n' + text, "file.toml", tmp_path / "pipelines")
    with pytest.raises(RequestError) as error:
        make_plan(made, installed_stages())
    assert len(error.value.faults) == 1
    assert str(error.value).endswith("pip install plugins/etendue-theirs")


def test_the_plugins_of_this_repository_are_known_by_all_their_stages():
    import runpy

    written = {}
    for file in PIPELINES.parent.glob("plugins/*/src/*/manifest.py"):
        written |= dict.fromkeys(runpy.run_path(str(file))["etendue_stages"](), file.parents[2].name)
    assert missing.known_plugins() == written


def test_a_distribution_that_is_installed_is_not_lacking():
    document = {"stages": [{"use": "lens_numbers"}], "requires": ["etendue", "numpy"]}
    assert missing.lacking(from_document(document), installed_stages()) == []


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), Decimal("1e999999"), 10**400, True, "x" * 10**6, None, object()]
)
def test_any_value_from_python_is_planned_or_refused(value):
    tables = {"camera": {"f_number": value}}, {"sweep": {"f_number": [value]}}
    for document in (*tables, {"seed": value}, {"tolerance": value}, {"name": value}):
        with pytest.raises(RequestError):
            make_plan(from_document({"stages": [{"use": "lens_numbers"}], **document}), installed_stages())
