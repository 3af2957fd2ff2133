"""What a stage can do is said by its methods: names of parameters are free, and never read as a claim."""

import ast
import dataclasses
import re
from pathlib import Path

import pytest

import etendue
from etendue.api import Stage, param
from etendue.spec import stage as words
from etendue.spec.stage import WORDS, ends_in_sum, has_method, is_source, is_transfer, parameters_of, word_of

METHODS = sorted(set(re.findall(r"^    (\w+)\(self", words.__doc__, re.M)) | {"viewing_white", "sigma"})


def with_parameter(name, default):
    """A stage that has a parameter of this name, and nothing else."""
    return dataclasses.make_dataclass("Own", [(name, type(default), param(default))], bases=(Stage,), frozen=True, kw_only=True)


@pytest.mark.parametrize("default", ["source", 0.5, print], ids=["text", "number", "callable"])
@pytest.mark.parametrize("name", METHODS)
def test_a_parameter_is_no_method_whatever_its_name(name, default):
    kind = with_parameter(name, default)
    assert not has_method(kind, name)
    assert not (is_source(kind) or is_transfer(kind) or ends_in_sum(kind))
    assert has_method(type("Able", (Stage,), {name: lambda self: None}), name)


def test_the_methods_of_the_contract_are_all_there():
    assert {"describe", "grid", "prepare", "transfer", "weights", "by_band", "warn", "run", "negligible", "carry", "error"} <= set(METHODS)


def test_what_a_class_says_is_not_said_by_a_parameter():
    kind = with_parameter("nanoseconds", 5.0)
    assert word_of(kind, "nanoseconds", 30.0) == word_of(kind(), "nanoseconds", 30.0) == 30.0


@pytest.mark.parametrize("name", sorted(WORDS))
def test_a_parameter_with_the_name_of_a_word_that_every_stage_has_is_refused(name):
    with pytest.raises(TypeError, match=f"{name} has the name of a word"):
        parameters_of(with_parameter(name, 1.0))


def test_no_room_asks_for_a_method_of_a_stage_by_its_bare_name():
    asked = []
    for path in Path(etendue.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("hasattr", "getattr"):
                name = node.args[1]
                if isinstance(name, ast.Constant) and name.value in METHODS:
                    asked.append(f"{path.name}:{node.lineno} {name.value}")
    assert not asked
