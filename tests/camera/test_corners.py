"""The ends of every range: a camera quantity there is computed with, or refused by the plan; it breaks nothing."""

import importlib.util
from pathlib import Path

import pytest

from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.plan.wiring.parameters import LARGEST, SMALLEST

DRIVER = Path(__file__).parents[2] / "benchmarks" / "faults" / "corners.py"


def driver():
    spec = importlib.util.spec_from_file_location("corners", DRIVER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.long
def test_every_camera_quantity_may_stand_at_the_ends_of_its_range():
    """One at a time, in a whole camera of 16 x 16 pixels; warnings are errors."""
    corners = driver()
    asked = [
        (name, document)
        for name, document in corners.cases(["camera"])
        if name.rpartition(" = ")[2][-1:] in tuple("0123456789f]")
    ]
    ended = {name: corners.outcome(document) for name, document in asked}
    assert {name: found for name, found in ended.items() if found[0] not in ("ran", "refused")} == {}
    assert sum(what == "ran" for what, _ in ended.values()) > 60


def test_every_stage_has_ranges_that_a_value_can_have():
    for use in installed_stages().names():
        for name, (parameter, _, default) in parameters_of(installed_stages().load(use)).items():
            ends = [end for end in (parameter.above, parameter.at_least, parameter.below, parameter.at_most) if end]
            assert all(SMALLEST <= abs(end) <= LARGEST for end in ends), (use, name)
            for value in default if isinstance(default, tuple) else (default,):
                number = isinstance(value, float | int) and not isinstance(value, bool)
                assert not number or parameter.infinite or parameter.allows(value), (use, name)
