"""Whatever is wrong with a pipeline file, it is planned or refused in lines that a person can act on."""

import importlib.util
from pathlib import Path

DRIVER = Path(__file__).parents[2] / "benchmarks" / "faults" / "mutated_pipelines.py"


def test_shipped_pipelines_with_mistakes_are_planned_or_refused():
    """120 of what the driver makes by thousands: no traceback, no warning, no message that a terminal obeys."""
    spec = importlib.util.spec_from_file_location("mutated_pipelines", DRIVER)
    driver = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(driver)
    ended = [(driver.outcome(text), text) for text in driver.mutants(120, 7)]
    assert [(what, said, text) for (what, said), text in ended if what not in ("planned", "refused")] == []
    assert {what for (what, _), _ in ended} == {"planned", "refused"}
