"""Seconds of a plan: what this machine has measured is told again, and what it has not is marked."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from etendue import cache
from etendue.plan import cost
from etendue.plan.planner import summary
from etendue.present.terminal.terminal import plan_columns
from etendue.session import Options, execute
from tests.plan.given import CAMERA, SCENE, SENSOR, plan_of

TEXT = CAMERA + SCENE.format(scene="siemens_star") + SENSOR


@pytest.fixture(autouse=True)
def _own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("ETENDUE_CACHE", str(tmp_path / "cache"))


def reports_of(plan, seconds):
    """Reports of all cells, as a run gives them."""
    return {cell.ref: SimpleNamespace(status="done", seconds=seconds(cell)) for cell in plan.cells.values()}


def test_a_plan_tells_what_was_measured_of_every_stage_and_of_writing():
    plan = plan_of(TEXT, {"tolerance": 1e-6})
    before = summary(plan)
    assert not before["seconds_known"]
    took = {node.name: 0.1 + 0.01 * number for number, node in enumerate(plan.nodes)}
    cost.remember(plan, reports_of(plan, lambda cell: took[cell.node]), (1 << 20, 0.5))
    after = summary(plan)
    assert after["seconds_known"]
    for stage in after["stages"]:
        computed = stage["left_out"] is None
        expected = (took[stage["name"]] if computed else 2e-5) + stage["bytes"] * 0.5 / (1 << 20)
        assert stage["seconds"] == pytest.approx(expected, rel=0.01)  # factors keep three digits


def test_a_size_that_never_ran_is_told_by_the_closest_one():
    small, large = plan_of(TEXT), plan_of(TEXT.replace('"48 um"', '"96 um"'))
    cost.remember(small, reports_of(small, lambda cell: 1.0), (0, 0.0))
    node, cell = large.node("diffraction"), large.of("diffraction")[0]
    told, known = cost.seconds_of(node, [(cell, 1)], large.precision, cost.Rates())
    other = small.of("diffraction")[0]
    ratio = cost.cell_seconds(node, cell, large.precision) / cost.cell_seconds(node, other, small.precision)
    assert known
    assert told == pytest.approx(ratio, rel=0.01)


def test_what_is_not_known_is_marked_in_the_table():
    _, _, tell = next(column for column in plan_columns(list) if column[0] == "time")
    plan = plan_of(TEXT)
    assert all(tell(stage).startswith("~") for stage in summary(plan)["stages"] if not stage["left_out"])
    execute(plan, None, Options("serial"))
    cost.remember(plan, reports_of(plan, lambda cell: 1.0), (1 << 20, 0.5))
    assert not any("~" in tell(stage) for stage in summary(plan)["stages"])


def test_what_a_left_out_stage_saves_includes_what_is_not_written():
    plan = plan_of(TEXT, {"tolerance": 0.5})
    out = next(s for s in summary(plan)["stages"] if s["left_out"] and s["name"] == "diffraction")
    (cell,) = plan.of("diffraction")
    written = cost.WRITING * cost.cell_bytes(plan.node("diffraction"), cell, plan.precision)
    alone = cost.seconds_of(plan.node("diffraction"), [(cell, 1)], plan.precision, cost.Rates())[0]
    assert out["left_out"]["seconds_saved"] > written > 0
    assert alone == pytest.approx(2e-5)


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b'{"a": 3}', b'{"writing": {"0": "x"}}', b'{"writing": {"0": -1}}'])
def test_a_damaged_cache_is_as_none(data):
    cache.write("rates", "stages", data)
    assert cost.Rates().per_byte is None
    assert not summary(plan_of(TEXT))["seconds_known"]
