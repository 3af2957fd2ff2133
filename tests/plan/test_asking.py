"""A stage that breaks off or answers nonsense while it is planned is a fault of the file that names it; never an
exception of its own.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import pytest

from etendue.api import Bands, Bounded, Facts, Grid, Line, Noisy, Source, Stage, hookimpl, param, quantity
from etendue.contract.class_checks import check_class
from etendue.contract.registry import Registry
from etendue.contract.values.late_bound import LateValue
from etendue.errors import PluginError, RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.plan import stage_calls
from etendue.plan.expansion.approximate import choose
from etendue.plan.planner import make_plan
from etendue.plugins.discovery import Discovery
from tests.distributions import distribution

LIGHT = "wavelength y x [W m-2 nm-1]"
GRID = Grid.of({"wavelength": Bands((400.0, 700.0)), "y": Line(8), "x": Line(9)})


@dataclass(frozen=True, kw_only=True)
class Lamp(Source):
    writes: ClassVar = {"irradiance": LIGHT}

    def describe(self) -> Any:
        return Facts(uniform=True, low=0.0, high=1.0, contrast=2.0), {"irradiance": GRID}

    def run(self, out_x: Any) -> Any:
        return {}


@dataclass(frozen=True, kw_only=True)
class Filter(Bounded):
    reads: ClassVar = {"irradiance": LIGHT}
    writes: ClassVar = {"irradiance": LIGHT}
    strength: float = param(1.0)

    def run(self, irradiance: Any, rng: Any) -> Any:
        return {}

    def negligible(self, facts: Any, grid: Any) -> Any:
        return None


class Point:
    """An entry point of bad-light 1.0, whose manifest has these stages."""

    name, value, dist = "bad-light", "bad_light", distribution("bad-light")

    def __init__(self, stages: dict[str, Any]) -> None:
        self.manifest = ModuleType("bad_light")
        self.manifest.etendue_stages = hookimpl(lambda: stages)

    def load(self) -> ModuleType:
        return self.manifest


def given(**stages: Any) -> Registry:
    """A registry of these stages, as if installed."""
    return Registry(Discovery([Point(stages)]))


def faults(lamp: type[Stage], filter_: type[Stage]) -> str:
    text = '[[stages]]\nuse = "lamp"\n[[stages]]\nuse = "filter"\n'
    with pytest.raises(RequestError) as caught:
        make_plan(parse_pipeline(text), given(lamp=lamp, filter=filter_))
    assert len(caught.value.faults) == 1
    return str(caught.value)


def spoilt(kind: type[Stage], method: str, does: Any) -> type[Stage]:
    made = type(f"Bad{kind.__name__}", (kind,), {method: does})
    return dataclass(frozen=True, kw_only=True)(made) if method == "__post_init__" else made


def raising(error: BaseException) -> Any:
    def does(self: Any, *_: Any) -> Any:
        raise error

    return does


ASKED = ("grid", "carry", "negligible", "error", "warn", "warn_among", "__post_init__")
RAISED = {
    "KeyError": KeyError("wavelength"),
    "SystemExit": SystemExit(0),
    "PermissionError": PermissionError(13, "Permission denied", "/root/secret/table.csv"),
    "AttributeError": AttributeError("no such thing"),
    "RecursionError": RecursionError("too deep"),
    "GeneratorExit": GeneratorExit(),
}


@pytest.mark.parametrize("method", ASKED)
@pytest.mark.parametrize("name", RAISED)
def test_what_a_method_raises_is_a_fault_that_names_stage_distribution_and_method(method, name):
    text = faults(Lamp, spoilt(Filter, method, raising(RAISED[name])))
    for words in ("stages[2] filter", "filter", f"BadFilter.{method} failed", name, "test_asking.py:"):
        assert words in text
    assert "bad-light 1.0" in text or method.startswith("warn")
    assert "secret" not in text
    assert "\n" not in text


@pytest.mark.parametrize("name", RAISED)
def test_a_source_that_cannot_describe_itself_is_a_fault(name):
    text = faults(spoilt(Lamp, "describe", raising(RAISED[name])), Filter)
    assert "stages[1] lamp" in text and "lamp of bad-light 1.0: BadLamp.describe failed" in text


def test_a_value_error_is_how_a_stage_refuses_and_stays_in_its_own_words():
    text = faults(Lamp, spoilt(Filter, "grid", raising(ValueError("the frame is\x1b[2J too small"))))
    assert text.endswith("stages[2] filter: the frame is[2J too small")


@pytest.mark.parametrize(("contrast", "precision"), [(2.0, "float32"), (1e9, "float64"), (None, "float64")])
def test_light_whose_contrast_is_large_or_unknown_is_computed_in_double_precision(contrast, precision):
    dim = spoilt(Lamp, "describe", lambda lamp: (Facts(contrast=contrast), {"irradiance": GRID}))
    text = '[[stages]]\nuse = "lamp"\n[[stages]]\nuse = "filter"\n'
    assert make_plan(parse_pipeline(text), given(lamp=dim, filter=Filter)).precision == precision


NONSENSE = {
    "grid": ([], {"irradiance": 3}, {"irradiance": [GRID]}, None, "irradiance", {"other": GRID}),
    "carry": (None, {}, "uniform", Facts(high="bright"), Facts(contrast=math.nan), Facts(uniform="yes")),
    "negligible": (
        math.nan,
        "nothing",
        (math.nan, "why"),
        ("0", "why"),
        (-1.0, "why"),
        (0.0, None),
        (0.0,),
        [0.0, "why"],
    ),
    "error": (
        "1e-6",
        1e-6,
        (math.nan, "proved"),
        ("1e-6", "proved"),
        (1e-6, "guessed"),
        (-1.0, "proved"),
        (1e-6,),
        None,
        (True, "proved"),
    ),
    "warn": ("dark", [1], None, 3, [None]),
    "warn_among": ("dark", [b"dark"], None),
    "common_draws": (None, ["yes"], 1),
}


@pytest.mark.parametrize(
    ("method", "answer"), [(method, answer) for method, answers in NONSENSE.items() for answer in answers]
)
def test_nonsense_is_a_fault_that_says_what_was_expected(method, answer):
    does = property(lambda self: answer) if method == "common_draws" else lambda self, *_: answer
    text = faults(Lamp, spoilt(Filter, method, does))
    assert f"BadFilter.{method}" in text
    assert "expected" in text or "does not write" in text


@pytest.mark.parametrize(
    "answer", [None, Facts(), (Facts(), None), (None, {}), (Facts(), {"irradiance": GRID, "more": GRID})]
)
def test_nonsense_about_a_source_is_a_fault_too(answer):
    assert "BadLamp.describe" in faults(spoilt(Lamp, "describe", lambda self: answer), Filter)


def test_an_instance_that_is_no_value_or_no_stage_is_a_fault():
    assert "is not hashable" in faults(Lamp, spoilt(Filter, "__hash__", None))
    assert "returned int" in faults(Lamp, spoilt(Filter, "__new__", lambda cls, **_: 3))


def test_a_dim_that_nobody_knows_is_said_with_what_to_write():
    @dataclass(frozen=True, kw_only=True)
    class Split(Filter):
        writes: ClassVar = {"parts": "channel y x [1]"}

    text = faults(Lamp, Split)
    for words in (
        "Split writes parts with the dim 'channel'",
        "which none of its inputs has",
        "creates = {'channel': RGB}",
        "grid(self",
    ):
        assert words in text


@pytest.mark.parametrize(
    "own",
    [
        {"gain": "large"},
        {"gain": math.nan},
        {"gain": -1.0},
        {"nan": "shrug"},
        {"negative": property(lambda self: 1 / 0)},
        {"libraries": "scipy"},
        {"libraries": (3,)},
        {"creates": {"channel": ("R", "G")}},
        {"creates": ["channel"]},
        {"run": 3},
        {"grid": GRID},
        {"nanoseconds": "many"},
    ],
)
def test_a_class_that_says_nonsense_of_itself_is_no_stage(own):
    check_class(Filter)
    with pytest.raises(TypeError, match=next(iter(own))):
        check_class(type("Bad", (Filter,), own))


def test_what_a_hook_raises_is_the_fault_of_its_distribution(monkeypatch):
    def raises(name: str) -> None:
        raise KeyboardInterrupt  # by the plugin: no signal has come

    module = ModuleType("bad_light")
    module.__getattr__ = raises
    monkeypatch.setitem(sys.modules, "bad_light", module)
    registry = given(filter="bad_light:Filter")
    monkeypatch.setattr("etendue.plugins.discovery.is_ours", lambda error: False)
    with pytest.raises(PluginError, match=r"'filter' of bad-light 1.0 cannot be loaded: KeyboardInterrupt"):
        registry.load("filter")


@dataclass(frozen=True, kw_only=True)
class Hiss(Noisy):
    """Noise whose variance, and a knob whose value, hang on a quantity that a run may find."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    integration_time: float = quantity("integration_time")
    terms: int = param(8, at_least=1, fidelity=True, reference="8", settings=(1, 8))

    def __post_init__(self) -> None:
        if self.integration_time > 100:
            raise ValueError("too long")

    def variance(self, charge: float) -> Any:
        return 2.0 * self.integration_time

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return 1e-3 / self.terms, "fitted"

    def run(self, charge: Any, rng: Any) -> Any:
        return {}


@pytest.mark.parametrize("name", RAISED)
def test_a_variance_that_breaks_off_or_is_no_number_names_itself(name):
    with pytest.raises(PluginError, match=f"variance failed.*{name}"):
        stage_calls.variance_of(spoilt(Hiss, "variance", raising(RAISED[name]))(integration_time=1.0), 10.0)
    with pytest.raises(PluginError, match="a number of at least 0"):
        stage_calls.variance_of(spoilt(Hiss, "variance", lambda self, charge: "loud")(integration_time=1.0), 10.0)


def test_what_a_run_finds_is_not_known_to_variance_and_stands_in_the_way_of_no_knob():
    stage = stage_calls.made(Hiss, {"integration_time": LateValue("integration_time", 1e-3, 1.0), "terms": 8})
    assert stage_calls.variance_of(stage, 10.0) is None
    chosen, (one,) = choose(stage, ("terms",), 1e-2, lambda s: s.error(None, None, "float64"))
    assert (chosen.terms, one.value, one.reference) == (1, 1, 8)


def test_a_shared_quantity_may_not_have_the_name_of_a_preset():
    """Else what a pipeline writes for it would be looked up among the presets."""

    @dataclass(frozen=True, kw_only=True)
    class Glass(Filter):
        lens: str = param("plain", shared=True)

    assert "stages.filter: takes a shared quantity 'lens', which names a preset" in faults(Lamp, Glass)
