"""What a plan says of omissions, coarser settings, assumptions and bounds is what it decided; no cell is computed."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from etendue import telling
from etendue.contract.arrays.facts import Content, Facts
from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.contract.values import bounds
from etendue.plan import cost, marks, omissions
from etendue.plan.agreement import taken_differently
from etendue.plan.expansion import leave_out
from etendue.plan.expansion.approximate import _allowed, open_knobs
from etendue.plan.model import Approximated, LeftOut
from etendue.present.terminal.terminal import omission_lines
from tests.plan.test_rates import TEXT, plan_of


def left(**words):
    known = {"cells": 1, "of": 1, "bound": 0.1, "at_stage": 0.1, "why": "so", "seconds_saved": None, "copies": 0}
    return known | words


def knob(value, **words):
    known = {"knob": "nodes", "value": value, "reference": 512, "bound": 0.1, "at_stage": 0.1, "cells": 1}
    return known | {"seconds_saved": 0.0} | words


@pytest.mark.parametrize("bound", [0.0, 1e-12, 1e-3, 0.5])
def test_only_what_changes_nothing_is_left_out_exactly(bound):
    (said,) = omission_lines("blur", left(bound=bound, at_stage=bound), None)
    assert ("exactly" in said) == (bound == 0)


@pytest.mark.parametrize(
    ("seconds", "said"), [(None, ""), (0.0, ""), (0.9e-3, ""), (1e-3, "0.001"), (2.5, "2.5")], ids=str
)
def test_a_saving_is_told_from_a_millisecond_on_and_where_it_is_known(seconds, said):
    for (text,) in (
        omission_lines("blur", left(seconds_saved=seconds), None),
        omission_lines("blur", None, [knob(64, seconds_saved=seconds)]),
    ):
        assert text.partition("saves about ")[2].partition(" s")[0] == said


def test_a_saving_of_several_settings_is_known_where_that_of_each_is():
    for second, said in ((1.0, True), (None, False)):
        (text,) = omission_lines("blur", None, [knob(64, seconds_saved=2.0), knob(128, seconds_saved=second)])
        assert ("saves about 3 s" in text) == ("saves" in text) == said


def test_the_bound_of_a_coarser_knob_is_that_of_its_worst_setting():
    settings = [knob(64, at_stage=0.01, bound=0.02), knob(32, at_stage=0.03, bound=0.09)]
    for every in (settings, settings[::-1]):
        (text,) = omission_lines("blur", None, every)
        assert "at most 0.03 of full scale at this stage, 0.09 in the results" in text


def test_a_bound_is_told_at_the_stage_and_in_the_results_where_they_differ():
    plan = plan_of(TEXT)
    node, (cell,) = plan.node("diffraction"), plan.of("diffraction")
    for growth in (1.0, 3.0):
        out = cell.changed(left_out=LeftOut(0.01, "so"), growth=growth)
        found = omissions.left_out(node, [cell, out], plan.precision)
        assert (found["cells"], found["of"], found["at_stage"]) == (1, 2, 0.01)
        assert found["bound"] == pytest.approx(0.01 * growth)
        (said,) = omission_lines("diffraction", found, None)
        assert ("0.03 in the results" in said) == ("results" in said) == (growth > 1)
        coarse = cell.changed(approximated=(Approximated("obstruction", 0.1, 0.0, 0.01),), growth=growth)
        (one,) = omissions.approximated(node, [coarse], plan.precision)
        assert (one["at_stage"], one["bound"]) == (0.01, pytest.approx(0.01 * growth))


def test_a_stage_is_held_against_the_last_before_it_that_assumes_something():
    def cell(name, value, *before):
        stage = SimpleNamespace(assumes=lambda: {"x": value})
        return SimpleNamespace(node=name, ref=(name, ()), stage=stage, inputs=[("", (one, ()), "") for one in before])

    cells = {"a": cell("a", 1.5), "b": cell("b", 2.5, "a"), "c": cell("c", 1.5, "b"), "d": cell("d", 1.5, "c")}
    nodes = [
        SimpleNamespace(name=name, inputs=[[(port, source, v) for port, (source, _), v in one.inputs]])
        for name, one in cells.items()
    ]
    assert taken_differently(nodes, cells) == [
        "b: x is 2.5 here, but 1.5 in 'a', earlier on its path",
        "c: x is 1.5 here, but 2.5 in 'b', earlier on its path",
    ]


def test_a_document_may_be_as_deep_and_a_number_as_long_as_the_bound():
    def nested(depth):
        return {"x": nested(depth - 1)} if depth else {}

    assert bounds.document_fault(nested(bounds.MOST_NESTED)) is None
    assert "nested" in bounds.document_fault(nested(bounds.MOST_NESTED + 1)).message
    assert bounds.document_fault({"x": 2**bounds.LONGEST_NUMBER - 1}) is None
    assert "digits" in bounds.document_fault({"x": 2**bounds.LONGEST_NUMBER}).message


def test_a_value_between_two_settings_costs_what_the_finer_one_does():
    plan = plan_of(TEXT)
    (cell,) = plan.of("diffraction")
    parameter = SimpleNamespace(settings=(1, 2, 4), costs=(1.0, 3.0, 9.0))
    falling = SimpleNamespace(settings=(4.0, 2.0, 1.0), costs=(1.0, 3.0, 9.0))
    counts = SimpleNamespace(settings=(16, 64, 0), costs=(1.0, 3.0, 9.0))  # 0 stands for all
    assert [cost._cost(parameter, value) for value in (1, 1.5, 2, 3, 4)] == [1, 3, 3, 9, 9]
    assert [cost._cost(falling, value) for value in (4.0, 3.0, 2.0, 1.5, 1.0)] == [1, 3, 3, 9, 9]
    assert [cost._cost(counts, value) for value in (16, 20, 64, 100, 0)] == [1, 3, 3, 9, 9]
    assert cost.knobs_cost(cell.stage) == 1


def test_seconds_are_those_of_the_nearest_size_that_was_measured():
    plan = plan_of(TEXT)
    (cell,) = plan.of("diffraction")
    rates = cost.Rates()
    near, far = cost._size(1e-3), cost._size(1e3)
    rates.__dict__["known"] = {cost._place(cell.stage, "float32"): {str(near): 2.0, str(far): 5.0}}
    assert rates.seconds(cell, 2e-3, "float32") == pytest.approx(2 * 2e-3)
    assert rates.seconds(cell, 2e2, "float32") == pytest.approx(5 * 2e2)
    assert rates.seconds(cell, 1.0, "float64") is None
    out = cell.changed(left_out=LeftOut(0.1, "so"))  # which takes the engine's time alone, known everywhere
    assert cost.seconds_of(plan.node("diffraction"), [(out, 1)], "float32", cost.Rates())[1]


@pytest.mark.parametrize(("full", "why"), [(0.0, "there is no light"), (1.0, "the scene is uniform")])
def test_blur_of_a_dark_scene_and_of_a_uniform_one_is_left_out_for_its_own_reason(full, why):
    (cell,) = plan_of(TEXT).of("diffraction")
    content = Content(full, (0.0, 1.0), ((0.0,),), ((0.0,),), (full,), (full,), (full,))
    grid = Grid.of({"wavelength": Bands((500.0, 600.0)), "y": Line(4, 0.0, 1.0), "x": Line(4, 0.0, 1.0)})
    found = leave_out._of_the_content(cell.stage, Facts(content=content), grid)
    assert found.bound == 0 and found.why.startswith(why)


@pytest.mark.parametrize("norm", ["rms", "max"])
def test_a_plan_bounds_what_it_leaves_out_in_the_norm_of_its_own(norm, monkeypatch):
    content = Content(1.0, (0.0, 1.0), ((0.0,),), ((0.0,),), (0.0,), (0.5,), (1.0,))
    (cell,) = plan_of(TEXT).of("diffraction")
    asked = []
    monkeypatch.setattr(leave_out, "through", lambda *_: "irradiance")
    monkeypatch.setattr(leave_out, "_of_the_stage", lambda stage, facts, grid: asked.append(facts.content.norm))
    facts, grids = {"irradiance": Facts(content=content)}, {"irradiance": SimpleNamespace(banded="")}
    leave_out.decide(leave_out.LeaveOutRule(0.1, norm), cell.stage, facts, grids, {}, list)
    assert asked == [norm]


def test_noise_above_that_of_photons_in_the_dark_is_never_left_out():
    """At low light its variance is above one per count, however little that is of the brightest pixel's."""
    noise = SimpleNamespace(variance=lambda level: 50.0)
    photons = SimpleNamespace(variance=lambda level: level)
    for low, out in ((10.0, False), (1e5, True)):
        found = leave_out._of_the_noise(noise, Facts(low=low, high=1e6), lambda: [noise, photons], 0.9)
        assert (found is not None) == out


def test_a_plan_sets_no_knob_that_studies_alone_vary_and_none_finer_than_its_default_where_that_is_dear():
    from etendue.contract.registry import installed_stages
    from etendue.contract.stage import parameters_of

    studied = 0
    for name in installed_stages().names():
        kind = installed_stages().load(name)
        for key, (parameter, _, default) in parameters_of(kind).items():
            assert not (parameter.studied and key in open_knobs(kind, ()))
            studied += parameter.studied
            if parameter.dear and default in parameter.settings:
                assert _allowed(parameter, default)[-1] == default
    assert studied
    first = SimpleNamespace(settings=(1, 2, 4), dear=True)
    assert [_allowed(first, default) for default in (1, 2, 4)] == [(1,), (1, 2), (1, 2, 4)]


@given(st.floats(0, 1e6))
@example(119.7)
@example(59.999)
@example(0.99999)
def test_a_duration_reads_back_to_its_last_digit_and_has_no_minute_of_sixty_seconds(seconds):
    said = telling.human_seconds(seconds)
    words = said.split()
    scale = {"ms": 1e-3, "s": 1.0, "min": 60.0}
    parts = [(float(number), unit) for number, unit in zip(words[::2], words[1::2], strict=True)]
    last = {"ms": 0.1e-3, "s": 1.0 if len(parts) == 2 else 0.01}[parts[-1][1]]
    assert math.isclose(sum(n * scale[unit] for n, unit in parts), seconds, abs_tol=0.5001 * last)
    assert parts[-1][0] < {"ms": 1000, "s": 60}[parts[-1][1]]


@given(st.floats(0, 1e14))
@example(999_960.0)
@example(999.7)
def test_a_number_of_bytes_has_at_most_three_digits_before_the_point(count):
    number, unit = telling.human_bytes(count).split()
    assert float(number) < 1000
    scale = 1000.0 ** ("B", "kB", "MB", "GB", "TB").index(unit)
    assert math.isclose(float(number) * scale, count, abs_tol=0.5001 * scale * (1.0 if unit == "B" else 0.1))


def test_the_last_line_of_a_long_error_is_kept_and_marks_of_direction_are_not():
    text = "\n".join(f"line {number}" for number in range(100))
    lines = telling.plain(text).split("\n")
    assert len(lines) == telling.MOST_LINES and lines[0] == "line 0" and lines[-1] == "line 99"
    assert lines[-2] == f"... ({100 - telling.MOST_LINES + 1} more lines)"
    assert telling.plain("\n".join(["x" * 1000] * 100 + ["the cause"])).endswith("\nthe cause")
    assert telling.printable("a\u202eb\u2066c\x1bd\n") == "abcd\n"


@pytest.mark.parametrize(
    ("bounds_of_cells", "named"), [((0.0, 0.0), ()), ((0.0, None), ("sharpen",)), ((0.0, 0.1), ("sharpen",))], ids=str
)
def test_a_stage_that_does_nothing_in_any_cell_is_not_named_beside_a_figure(bounds_of_cells, named):
    cells = [SimpleNamespace(left_out=None if b is None else LeftOut(b, "so")) for b in bounds_of_cells]
    kind, probe = SimpleNamespace(role="sharpening"), SimpleNamespace(unseen={"v": ("sharpening",)})
    other = SimpleNamespace(name="sharpen", alternatives=[SimpleNamespace(kind=kind)], is_probe=False, writes={})
    node = SimpleNamespace(name="figure", alternatives=[SimpleNamespace(kind=probe)], looks_at=())
    plan = SimpleNamespace(nodes=[other], of=lambda name: cells)
    assert marks.not_in_it(plan, node, "v") == named
