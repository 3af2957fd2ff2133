"""Examples in docstrings run as they stand: pasted into a fresh interpreter, in a folder with the shipped pipelines."""

from __future__ import annotations

import ast
import doctest

import pytest

from tests.documents.pages import ROOT

SOURCE = ROOT / "src"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)


def examples():
    """Every docstring that shows an example, with where it stands."""
    for path in sorted(SOURCE.rglob("*.py")):
        text = path.read_text()
        if ">>> " in text:
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, DOCUMENTED) and ">>> " in (ast.get_docstring(node) or ""):
                    name = f"{path.relative_to(SOURCE)}:{getattr(node, 'name', '')}"
                    yield pytest.param(ast.get_docstring(node), getattr(node, "lineno", 1), path, id=name)


FOUND = list(examples())


@pytest.mark.parametrize(("text", "line", "path"), FOUND)
def test_an_example_gives_what_it_shows(text, line, path, tmp_path, monkeypatch):
    """With nothing imported that it does not import itself."""
    (tmp_path / "pipelines").symlink_to(ROOT / "pipelines")
    monkeypatch.chdir(tmp_path)
    test = doctest.DocTestParser().get_doctest(text, {}, path.name, str(path), line)
    said: list[str] = []
    outcome = doctest.DocTestRunner(optionflags=FLAGS).run(test, out=said.append)
    assert outcome.attempted and not outcome.failed, "".join(said)


def test_no_example_is_left_out():
    """An example that nobody runs is a promise that nobody keeps."""
    assert len(FOUND) > 20
    assert [one.id for one in FOUND if "+SKIP" in one.values[0]] == []
