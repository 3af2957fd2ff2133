"""What a stage can do is said by its methods: names of parameters are free, and never read as a claim."""

import ast
import dataclasses
from pathlib import Path

import pytest

import etendue
from etendue.api import Stage, param, quantity
from etendue.contract.capabilities import Noisy, ends_in_sum, is_source, is_transfer
from etendue.contract.class_checks import CAPABILITIES, check_class
from etendue.contract.stage import WORDS, arguments_of, parameters_of
from etendue_camera.roles import Displaying, Scaled

METHODS = sorted(CAPABILITIES)


def with_parameter(name, default):
    """A stage that has a parameter of this name, and nothing else."""
    return dataclasses.make_dataclass(
        "Own", [(name, type(default), param(default))], bases=(Stage,), frozen=True, kw_only=True
    )


@pytest.mark.parametrize("default", ["source", 0.5, print], ids=["text", "number", "callable"])
@pytest.mark.parametrize("name", METHODS)
def test_a_parameter_is_no_capability_whatever_its_name(name, default):
    kind = with_parameter(name, default)
    assert name in parameters_of(kind)
    assert not any(issubclass(kind, base) for base in CAPABILITIES.values())
    assert not (is_source(kind) or is_transfer(kind) or ends_in_sum(kind))


@pytest.mark.parametrize("name", METHODS)
def test_a_method_of_a_capability_without_its_base_is_refused_with_the_base(name):
    able = type("Able", (Stage,), {name: lambda self, *given: None, "run": lambda self: {}})
    with pytest.raises(
        TypeError, match=rf"Able defines {name}.*derive it from etendue\.api\.{CAPABILITIES[name].__name__}"
    ):
        check_class(able)


OWED = [name for name in METHODS if getattr(getattr(CAPABILITIES[name], name), "__isabstractmethod__", False)]


@pytest.mark.parametrize("name", OWED)
def test_a_capability_without_its_method_is_refused_by_name(name):
    with pytest.raises(TypeError, match=f"Lame lacks .*{name}"):
        check_class(type("Lame", (CAPABILITIES[name],), {"run": lambda self: {}}))


@pytest.mark.parametrize("name", sorted(WORDS))
def test_a_parameter_with_the_name_of_a_word_that_every_stage_has_is_refused(name):
    with pytest.raises(TypeError, match=f"{name} has the name of an attribute of Stage"):
        parameters_of(with_parameter(name, 1.0))


def test_a_stage_with_patterns_says_of_which_sensor():
    """Else every sensor would have the same."""

    class Patterned(Stage):
        writes = {"charge": "y x [electron]"}

        def run(self, rng_sensor):
            return {"charge": rng_sensor.normal("its own")}

    serial = ("sensor_serial", str, quantity("sensor_serial"))
    of_a_sensor = dataclasses.make_dataclass("OfASensor", [serial], bases=(Patterned,), frozen=True, kw_only=True)
    with pytest.raises(
        TypeError, match=r'Patterned\.run asks for rng_sensor.*sensor_serial: str = quantity\("sensor_serial"\)'
    ):
        arguments_of(Patterned)
    assert arguments_of(of_a_sensor) == ("rng_sensor",)


def test_no_room_asks_for_a_method_of_a_stage_by_its_bare_name():
    asked = []
    for path in Path(etendue.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Name)
                and node.func.id in ("hasattr", "getattr")
            ):
                name = node.args[1]
                if isinstance(name, ast.Constant) and name.value in {*METHODS, *WORDS}:
                    asked.append(f"{path.name}:{node.lineno} {name.value}")
    assert not asked


@pytest.mark.parametrize(("base", "method"), [(Noisy, "variance"), (Scaled, "electrons"), (Displaying, "to_xyz")])
def test_what_a_study_asks_of_a_stage_is_asked_for_when_it_is_loaded(base, method):
    with pytest.raises(TypeError, match=f"Mute lacks {method}, required by its base classes"):
        check_class(type("Mute", (base,), {"run": lambda self: {}}))
    check_class(type("Able", (base,), {"run": lambda self: {}, method: lambda self, *given: 1.0}))
