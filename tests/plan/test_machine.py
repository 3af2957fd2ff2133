"""A plan that does not fit is refused with what makes it smaller: cells where one alone is too large, the sweep
where many are.
"""

from pathlib import Path

import pytest
from click.testing import CliRunner

from etendue.cli.program import main
from etendue.contract.registry import installed_stages
from etendue.errors import MachineError
from etendue.pipeline.file import read_pipeline
from etendue.plan import machine
from etendue.plan.planner import make_plan
from etendue.run import machine as fitting
from etendue.run.peak_memory import peak_memory

PIPELINE = Path(__file__).parents[2] / "pipelines" / "smallest.toml"
CELL, SWEEP = (
    "a coarser spacing or wider bands in the first stage, a smaller window",
    "20 values; shorten 'keep' or the sweep",
)


def plan_of(**overrides):
    return make_plan(
        read_pipeline(PIPELINE, {key.replace("__", "."): value for key, value in overrides.items()}), installed_stages()
    )


@pytest.fixture
def small_plans_too(monkeypatch):
    monkeypatch.setattr(fitting, "_at_most", lambda plan, workers: 1 << 62)


@pytest.mark.usefixtures("small_plans_too")
@pytest.mark.parametrize(("values", "part", "said"), [(1, 0.2, CELL), (20, 0.2, CELL), (20, 0.95, SWEEP)])
def test_what_is_to_be_shortened_is_what_is_too_large(monkeypatch, values, part, said):
    """Where there is room for a part of what one cell takes, or for more than one and not for all."""
    plan = plan_of(**({"sweep__f_number": [2 + 0.1 * n for n in range(values)]} if values > 1 else {}))
    need = peak_memory(plan, 1, in_memory=True)
    room = int(part * (need.bytes if said == SWEEP else need.alone))
    monkeypatch.setattr(machine, "available_memory", lambda: room)
    with pytest.raises(MachineError, match=said):
        fitting.check_machine(plan, None)


@pytest.mark.usefixtures("small_plans_too")
def test_a_plan_says_what_a_run_refuses_in_the_same_words(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(machine, "available_memory", lambda: 1000)
    words = [str(PIPELINE), "--workers", "1", "--json"]
    planned, run = (CliRunner().invoke(main, [name, *words]) for name in ("plan", "run"))
    assert planned.exit_code == run.exit_code == 5
    assert planned.stderr == run.stderr != ""
    assert "would be held at once, most of it by '" in run.stderr
    assert "at f_number = 2" in run.stderr  # the cell is named with its axis values
    assert not list(tmp_path.rglob("*.zarr"))


def test_a_plan_that_is_refused_with_two_workers_says_so_where_one_would_do(monkeypatch):
    plan = plan_of()
    one, two = (peak_memory(plan, workers).bytes for workers in (1, 2))
    assert one < two
    monkeypatch.setattr(machine, "available_memory", lambda: (one + two) // 2)
    monkeypatch.setattr(fitting, "_at_most", lambda plan, workers: 1 << 62)
    fitting.check_machine(plan, Path("nowhere"), 1)
    with pytest.raises(MachineError, match="--workers 1"):
        fitting.check_machine(plan, Path("nowhere"), 2)


def test_what_is_taken_to_be_small_is():
    """The bound that lets small plans through without going through their jobs is one."""
    for overrides in ({}, {"precision": "float64"}, {"scene__bin_width": "10 nm"}):
        for workers in (1, 2):
            plan = plan_of(**overrides)
            assert peak_memory(plan, workers).bytes < fitting._at_most(plan, workers)
