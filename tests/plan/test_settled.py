"""Cells of a plan share what is settled about them, and find the rest when they are asked: nothing of it may show."""

from __future__ import annotations

import pickle
import tracemalloc

import pytest

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import parse_pipeline
from etendue.plan.expansion.approximate import WatchedFacts
from etendue.plan.planner import make_plan
from tests.designs.given import DESIGN, STAGES

PITCHES, TIMES, NOISES = ["2 um", "3 um", "4 um"], ["1 ms", "20 ms", "2 s"], [0.0, 0.5, 4.0]
WELL = "".join(f'[[stages]]\nuse = "{use}"\n' for use in ("full_well", "read_noise", "adc", "linearise"))
PICTURE = "".join(f'[[stages]]\nuse = "{use}"\n' for use in ("white", "balance_mosaic", "demosaic_bilinear"))
PICTURE += 'name = "demosaic"\n'
TEXT = STAGES.replace('[[stages]]\nuse = "read_noise"\n', WELL) + PICTURE
SWEEPS = {
    "of everything": {"sweep.pixel_pitch": PITCHES, "sweep.integration_time": TIMES, "sweep.read_noise": NOISES},
    "of stages": {"sweep.demosaic.use": ["demosaic_bilinear", "demosaic_directional"], "sweep.integration_time": TIMES},
    "that light is blurred along": {"sweep.f_number": [1.4, 22.0], "sweep.pixel_pitch": PITCHES},
}


def plan_of(over, text=TEXT, **ways):
    return make_plan(parse_pipeline(text, overrides=over), installed_stages(), **ways)


def said(cell):
    """All that a plan says of a cell but its place."""
    form = (cell.stage, cell.use, cell.input_grids, cell.grids, cell.mapped, cell.digits, cell.versions)
    return form, cell.facts, cell.left_out, cell.approximated, cell.error, cell.key, cell.seed


@pytest.mark.parametrize("digits", [False, True], ids=["", "rounded"])
@pytest.mark.parametrize("over", SWEEPS.values(), ids=SWEEPS)
def test_a_cell_of_a_sweep_is_planned_as_it_is_alone(over, digits):
    more = {"tolerance": 1e-3} | ({"archive.digits": "stated"} if digits else {})
    plan = plan_of(over | more)
    for place in ({axis.dim: 0 for axis in plan.axes}, {axis.dim: len(axis.values) - 1 for axis in plan.axes}):
        at = {axis.key: list(over.values())[n][place[axis.dim]] for n, axis in enumerate(plan.axes)}
        alone = plan_of({f"sweep.{key}": [value] for key, value in at.items()} | more)
        for node in plan.nodes:
            cell = plan.cells[node.name, tuple(place[dim] for dim in node.axes)]
            assert said(cell) == said(alone.of(node.name)[0])


@pytest.mark.parametrize("over", SWEEPS.values(), ids=SWEEPS)
def test_a_plan_that_is_sent_says_the_same(over):
    """Nothing of its cells was asked for before."""
    sent = pickle.loads(pickle.dumps(plan_of(over)))
    assert sent.cells == plan_of(over).cells


def test_a_row_of_a_design_is_planned_as_it_is_alone():
    plan = plan_of({}, STAGES + DESIGN)
    for row in (0, 5):
        alone = plan_of({"design.rows": [row]}, STAGES + DESIGN)
        for node in plan.nodes:
            at = plan.everywhere({plan.axes[0].dim: row})
            cell = plan.cells[node.name, tuple(at[dim] for dim in node.axes)]
            assert said(cell) == said(alone.of(node.name)[0])


def test_keys_and_seeds_are_the_same_in_whatever_order_they_are_asked_for():
    first, other = plan_of(SWEEPS["of everything"]), plan_of(SWEEPS["of everything"])
    backwards = {ref: (cell.seed, cell.key) for ref, cell in reversed(other.cells.items())}
    assert {ref: (cell.seed, cell.key) for ref, cell in first.cells.items()} == backwards


def test_keys_are_of_the_files_that_were_planned(tmp_path):
    table = tmp_path / "qe.csv"
    table.write_text("wavelength_nm,R,G,B\n400,0.2,0.5,1\n550,0.5,1,0.5\n720,1,0.5,0.2\n")
    over = {"camera.sensitivity": str(table), "sweep.integration_time": TIMES}
    before, same = plan_of(over), plan_of(over)
    keys = [(cell.key, cell.seed) for cell in before.cells.values()]
    table.write_text("wavelength_nm,R,G,B\n400,0.3,0.5,1\n550,0.5,1,0.5\n720,1,0.5,0.2\n")
    assert [(cell.key, cell.seed) for cell in same.cells.values()] == keys
    assert [cell.key for cell in plan_of(over).cells.values()] != [key for key, _ in keys]


def test_a_changed_cell_keeps_what_is_not_changed():
    plan = plan_of(SWEEPS["of everything"])
    cell = plan.of("demosaic")[-1]
    other = plan_of(SWEEPS["of everything"]).of("demosaic")[-1].changed(growth=3.0)
    assert other != cell and other.changed(growth=cell.growth) == cell
    moved = plan_of(SWEEPS["of everything"]).of("shot_noise")[-1]
    moved = moved.changed(ref=("shot_noise", (0, 0, 0)))  # its key stays that of the cell it was
    assert said(moved) == said(plan.of("shot_noise")[-1])


def test_a_plan_takes_at_most_500_bytes_a_cell_even_while_it_is_made():
    def traced(count):
        times = {"from": "1 ms", "to": "20 ms", "steps": count}
        lenses = {"from": 1.4, "to": 22, "steps": 20}
        tracemalloc.start()
        plan = plan_of({"sweep.f_number": lenses, "sweep.integration_time": times}, TEXT.replace(PICTURE, ""))
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return len(plan.cells), most

    traced(4)
    few, many = traced(10), traced(80)
    assert (many[1] - few[1]) / (many[0] - few[0]) < 500


LOOKS = {
    "dict": dict,
    "unpacked": lambda facts: {**facts},
    "joined": lambda facts: facts | {},
    "joined to": lambda facts: {} | facts,
    "copied": lambda facts: facts.copy(),
    "by port": lambda facts: facts["port"],
    "if it is there": lambda facts: facts.get("port"),
    "all": lambda facts: list(facts.values()),
}


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
def test_whatever_reads_facts_is_seen(look):
    facts = WatchedFacts(port=1.0)
    assert not facts.looked
    look(facts)
    assert facts.looked
