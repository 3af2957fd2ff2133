"""Verdicts on recomputed archives and words about errors, from what was found alone: no archive is read."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from etendue.archive.checks import left_out
from etendue.archive.read.comparing import Compared
from etendue.archive.read.differing import between
from etendue.archive.records.manifest import DATA
from etendue.contract.ports import CellReport
from etendue.present.terminal.answer_texts import notes, plus_minus
from etendue.present.terminal.global_error import not_held
from etendue.trust import sayings
from etendue.trust.verdict import judged, judged_cell

ONE = np.linspace(0, 1, 100)


def test_a_value_that_is_undefined_in_one_of_both_is_beyond_any_stated_error():
    for elsewhere, allowed in ((False, None), (True, None), (True, math.inf)):
        found = judged("s", "s", Compared.of("v", between(ONE, np.where(ONE < 0.5, ONE, np.nan))), allowed, elsewhere)
        assert found.found == "beyond" and "undefined in only one of the arrays" in found.why


def test_the_whole_of_the_stated_error_may_be_used():
    compared = Compared.of("v", between(ONE, ONE + 1e-3))
    off = compared.difference.relative
    for allowed, verdict in ((off, "within"), (np.nextafter(off, 0), "beyond"), (np.nextafter(off, 1), "within")):
        assert judged("s", "s", compared, float(allowed), True).found == verdict


def test_a_damaged_cell_is_damaged_whatever_its_recomputation_gives():
    same = CellReport("s", (), "done", written=(Compared.of("v", between(ONE, ONE)),))
    for report in (None, same):
        (found,) = judged_cell(None, ("s", ()), "s", report, "its file is too short", False)
        assert (found.found, found.why) == ("damaged", "its file is too short")
    for report in (None, CellReport("s", (), "failed"), CellReport("s", (), "skipped")):
        (found,) = judged_cell(None, ("s", ()), "s", report, "", False)
        assert found.found == "failed"


@pytest.mark.parametrize(
    ("data", "key"),
    [
        (b'{"a": 1, "b": 2, "a": 3}', "a"),
        (b'{"a": {"c": 1, "c": 1}}', "c"),
        (b'[{"a": 1}, {"a": 2}]', None),
        (b"{", None),
        (None, None),
    ],
    ids=str,
)
def test_a_key_that_one_object_has_twice_is_named(data, key):
    assert sayings.named_twice(data) == key


@pytest.mark.parametrize(
    ("there", "missing"),
    [((1, 2, 3), []), ((1, 3), [2]), ((2, 3), [1]), ((1, 4), [2]), ((3,), [1]), ((), [])],
    ids=str,
)
def test_runs_are_numbered_from_one_without_gaps(there, missing, tmp_path):
    """As many numbers as there are runs are looked at: the first gap is among them."""
    (tmp_path / "runs").mkdir()
    for number in there:
        (tmp_path / "runs" / f"{number:04}.json").write_text("{}")
    found = list(sayings._of_runs(SimpleNamespace(folder=tmp_path)))
    assert [one.file for one in found] == [f"runs/{number:04}.json" for number in missing]


def error(parts, **more):
    known = {"variable": "v", "unit": "dB", "rms": 0.1, "max": 0.1, "parts": parts, "open": {}, "fixed": {}}
    return known | {"points": 1, "scaled": 1.0, "noise": None} | more


def part(rms, basis="refined"):
    return {"rms": rms, "max": rms, "basis": basis}


def test_parts_below_a_fiftieth_of_the_error_are_not_listed():
    said = plus_minus(error({"bins": part(0.1), "spacing": part(0.0021), "margin": part(0.0019)}), "dB")
    assert said == "\u00b10.1 dB (bins 0.1, spacing 0.0021)"


def test_an_error_of_omissions_alone_says_nothing_while_others_are_not_measured_and_noise_is_no_part():
    unknown = {"open": {"bins": "costs about 3 s"}}
    assert plus_minus(error({"omissions": part(0.1)}, **unknown)) == ""
    assert plus_minus(error({"spacing": part(0.1)}, **unknown)) != ""
    noise = error({"omissions": part(0.1)}, open={"noise": "one draw"})
    assert plus_minus(noise) == "\u00b10.1 (omissions 0.1)"


@pytest.mark.parametrize(
    ("points", "factor", "said"),
    [
        (1, 1.0, "measured without noise"),
        (1, 2.0, "at 1 point of"),
        (3, 1.0, "at 3 points of"),
        (3, 2.0, "at 3 points of"),
    ],
)
def test_where_errors_were_measured_is_said_unless_it_was_everywhere(points, factor, said):
    found = {"errors": {"v": error({"bins": part(0.1)}, scaled=factor)}, "points": points, "remembered": False}
    first, *_ = notes(found | {"seconds": 1.0, "dear": None})
    assert said in first
    assert (f"for all points, {factor:g} times the measured errors are stated" in first) == (factor > 1)


@pytest.mark.parametrize(("norm", "times"), [("rms", "3 times"), ("max", "5 times")])
def test_what_is_not_held_is_told_in_the_norm_that_was_asked_for(norm, times):
    hold = {"missed": ["v"], "norm": norm, "limits": {"v": 0.01}, "blame": {"bins": 0.5}}
    first, blame = not_held(hold, {"v": {"rms": 0.03, "max": 0.05, "how": "measured"}})
    assert times in first and blame == "caused by: bins (0.5)"


@pytest.mark.parametrize(("count", "right"), [(-1, False), (0, True), (3, True), (4, False)])
@pytest.mark.parametrize("what", ["planned", "todo"])
def test_a_run_counts_no_more_cells_than_there_are_and_none_below_nothing(what, count, right):
    plan = SimpleNamespace(nodes=[SimpleNamespace(name="pixel")], of=lambda stage: [0, 1, 2])
    run = SimpleNamespace(**({"planned": {}, "todo": {}} | {what: {"pixel": count}}))
    journal = SimpleNamespace(axes={}, blocks={}, arrays={}, run=run)
    stored = SimpleNamespace(journal=journal, manifest=SimpleNamespace(metadata={}))
    found = list(sayings._of_lines(stored, SimpleNamespace(plan=plan), {}))
    assert [one.says for one in found] == ([] if right else [str(count)])


@pytest.mark.parametrize(
    ("there", "said"), [([3], ""), (None, ""), ([5], "/a/v has 3 values along y, not [5]")], ids=str
)
def test_what_is_left_out_has_the_shape_of_the_array_that_has_its_values(there, said, tmp_path):
    def wrote(place, **document):
        (tmp_path / DATA / place).mkdir(parents=True)
        (tmp_path / DATA / place / "zarr.json").write_text(json.dumps(document))

    wrote("a/v", dimension_names=["f_number", "y", "x"])
    wrote("g/x", shape=[4])
    if there:
        wrote("g/y", shape=there)
    archive = SimpleNamespace(form=lambda *_: SimpleNamespace(shape=(3, 4)))
    stored = SimpleNamespace(folder=tmp_path, archive=archive, journal=SimpleNamespace(axes={"a": {"f_number": [2]}}))
    one = SimpleNamespace(path="/a/v", source="a", group="g", variable="v")
    assert left_out._other_shape(stored, one) == said


@pytest.mark.parametrize("why", ["", "it has another shape"])
def test_a_cell_whose_values_no_cell_of_equal_key_has_is_named_and_another_is_not(why, monkeypatch):
    for name, does in {
        "_named_otherwise": lambda stored: (),
        "fault_of": lambda *_: why,
        "_other_shape": lambda *_: "",
        "_cells": lambda *_: ("lost", "there"),
    }.items():
        monkeypatch.setattr(left_out, name, does)
    one = SimpleNamespace(group="g", variable="v", path="/a/v", cells={0: (SimpleNamespace(name="there"), None)})
    stored = SimpleNamespace(archive=SimpleNamespace(followed=[one]), journal=None)
    found = list(left_out.left_out_damage(stored))
    assert [damage.cell for damage in found if "no cell with an equal key" in damage.what] == ["lost"]
    assert len(found) == 1 + bool(why)
