"""A plan that does not fit is refused with what makes it smaller: cells where one alone is too large, the sweep where many are."""

from pathlib import Path

import pytest

from etendue.errors import MachineError
from etendue.plan import machine
from etendue.plan.planner import make_plan
from etendue.plan.strips import peak_memory
from etendue.registry import installed_stages
from etendue.spec.pipeline import read_pipeline

PIPELINE = Path(__file__).parents[2] / "pipelines" / "smallest.toml"
CELL, SWEEP = "a wider spacing of the scene, a wider bin_width, a smaller window", "20 values; shorten 'keep' or the sweep"


@pytest.mark.parametrize(("values", "part", "said"), [(1, 0.5, CELL), (20, 0.5, CELL), (20, 1.5, SWEEP)])
def test_what_is_to_be_shortened_is_what_is_too_large(monkeypatch, values, part, said):
    """Where there is room for a part of what one cell takes, or for more than one and not for all."""
    sweep = {"sweep.f_number": [2 + 0.1 * n for n in range(values)]} if values > 1 else {}
    plan = make_plan(read_pipeline(PIPELINE, sweep), installed_stages())
    monkeypatch.setattr(machine, "available_memory", lambda: int(part * peak_memory(plan, 1)))
    with pytest.raises(MachineError, match=said):
        machine.check_machine(plan, None)
