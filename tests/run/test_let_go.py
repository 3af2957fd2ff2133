"""What nobody holds any more is let go, by itself and at little cost: trees of earlier runs, arrays that nobody
asked for.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import tracemalloc
import weakref
from pathlib import Path

import pytest

import etendue
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.run.memory import LEAST, MOST, TREES
from etendue.session import Options, collect, load

PROGRAM = Path(__file__).parents[2] / "benchmarks" / "many_runs.py"
LIGHT = """
name = "light"
[[stages]]
use = "uniform"
white_luminance = "1000 cd m-2"
width = "256 um"
height = "256 um"
spacing = "1 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "50 nm"
[[stages]]
use = "irradiance"
[[stages]]
use = "falloff"
"""
BESIDE = 256 << 10  # bytes of tables, plans and what Python remembers


@pytest.fixture
def collections():
    """The generations of the collections that Python does meanwhile."""
    seen = []

    def note(phase, said):
        if phase == "start":
            seen.append(said["generation"])

    gc.callbacks.append(note)
    yield seen
    gc.callbacks.remove(note)


def test_few_trees_wait_that_nobody_holds_and_few_collections_look_at_everything(collections):
    """A tree is a circle that only the collector finds, which would come after some hundred of them."""
    trees, most, runs = [], 0, 25
    for number in range(runs):
        tree = etendue.simulate(LIGHT, scheduler="serial", f_number=2 + number / 1000)
        size = tree.nbytes
        trees.append(weakref.ref(tree))
        del tree
        most = max(most, sum(one() is not None for one in trees))
    assert TREES * size > LEAST  # so that bytes are what is counted
    assert most <= min(TREES * size, MOST) // size + 1
    assert collections.count(2) <= runs // 10


def test_trees_that_somebody_holds_are_there_and_not_looked_through_again_and_again(collections):
    held = [etendue.simulate(LIGHT, scheduler="serial", f_number=2 + number / 1000) for number in range(20)]
    assert len({id(tree) for tree in held}) == 20 and all(tree["falloff/irradiance"].size for tree in held)
    assert collections.count(2) <= 4  # at twice as many each time


@pytest.mark.parametrize(
    "asked",
    [{}, {"keep": ["white_irradiance"]}, {"keep": ["irradiance"]}, {"want": ["white_irradiance"], "keep": []}],
    ids=str,
)
def test_behind_a_run_nothing_is_held_but_what_was_asked_for(asked):
    """Bytes of all arrays, as numpy tells them to Python."""
    etendue.simulate(LIGHT, scheduler="serial", **asked)  # imports, and tables that later runs use
    tracemalloc.start()
    try:
        tree = etendue.simulate(LIGHT, scheduler="serial", **asked)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < tree.nbytes + BESIDE


def test_so_it_is_behind_a_study():
    plan = make_plan(load(LIGHT, {"sweep.camera.f_number": [2, 2.8, 4, 5.6]}), installed_stages())
    wanted = {ref: ("irradiance",) for ref in plan.cells if ref[0] == "falloff"}
    collect(plan, wanted, Options("serial"))
    tracemalloc.start()
    try:
        found = collect(plan, wanted, Options("serial"))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    asked = [array.nbytes for own in found.arrays.values() for array in own.values()]
    assert len(asked) == 4
    assert held < sum(asked) + BESIDE


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_memory_after_two_thousand_runs_is_that_after_a_hundred():
    done = subprocess.run(
        [sys.executable, PROGRAM, "memory", "--runs", "2000"],
        capture_output=True,
        text=True,
        timeout=3500,
        check=True,
    )
    curve = {int(runs): float(size) for runs, size in (line.split() for line in done.stdout.splitlines()[1:-1])}
    assert curve[2000] <= 1.1 * curve[100], curve
