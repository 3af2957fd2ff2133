"""Whatever is wrong with a pipeline file, it is planned or refused in lines that a person can act on."""

import importlib.util
from pathlib import Path

import pytest

DRIVER = Path(__file__).parents[2] / "benchmarks" / "faults" / "mutated_pipelines.py"
COUNT, PARTS = 120, 6  # of what the driver makes by thousands; the workers share the parts


@pytest.fixture(scope="module")
def driver():
    spec = importlib.util.spec_from_file_location("mutated_pipelines", DRIVER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def mutants(driver):
    return list(driver.mutants(COUNT, 7))


@pytest.mark.parametrize("part", range(PARTS))
def test_shipped_pipelines_with_mistakes_are_planned_or_refused(driver, mutants, part):
    """No traceback, no warning, no message that a terminal obeys."""
    ended = [(driver.outcome(text), text) for text in mutants[part::PARTS]]
    assert len(ended) == COUNT / PARTS
    assert [(what, said, text) for (what, said), text in ended if what not in ("planned", "refused")] == []


def test_some_of_the_mistakes_are_refused_and_some_are_planned(driver, mutants):
    outcomes = (driver.outcome(text)[0] for text in reversed(mutants))
    assert "planned" in outcomes and "refused" in outcomes
