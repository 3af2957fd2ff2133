"""Stability as a user meets it: naive formulas are caught and named, their sound twins pass, and everything that is
installed holds.
"""

import itertools
import json
import math
import os
from collections import Counter
from pathlib import Path

import pytest

from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.errors import RequestError
from etendue.testing.cases import CORNER, END, FAR, INSIDE, MIXED, ORDINARY, cases, ordinary
from etendue_lab.stability import cameras, kernels, study
from etendue_lab.stability.rows import LawCase, counts, document, groups
from tests.fresh import process

SITE = Path(__file__).parents[1] / "plugins" / "naive"
FAULTS = {  # every fault of a naive stage, and the law that names it
    "naive_diffusion": [
        ("mean kept, bounded", "overflow, or zero divided by zero"),
        ("digits", "cancellation: even double precision loses digits"),
        ("computes or refuses", "NaN or infinite"),
    ],
    "naive_softwell": [("digits", "cancellation: even double precision loses digits")],
    "naive_gamma": [("negative input", "returns NaN for negative rgb_linear")],
    "naive_variance": [("digits", "cancellation: even double precision loses digits")],
    "naive_shade": [("unit of light", "a hidden constant")],
    "naive_veil": [("digits", "as if rounded to 32 bits")],
    "naive_scatter": [("variance", "variance states 5 electron2")],
}


def etendue(folder, *arguments, site=SITE):
    return process(*arguments, cwd=folder, env={**os.environ, "PYTHONPATH": str(site), "COLUMNS": "120"})


@pytest.fixture(scope="module")
def naive(tmp_path_factory):
    """Naive stages and their twins, tried by the command."""
    names = [name.replace("naive", kind) for name in FAULTS for kind in ("naive", "sound")]
    return etendue(tmp_path_factory.mktemp("naive"), "stability", *names, "--workers", "1", "--json")


@pytest.mark.long
def test_a_naive_plugin_is_caught_in_each_of_its_faults_by_name(naive):
    assert naive.returncode == 1
    rows = json.loads(naive.stdout)["cases"]
    for stage, faults in FAULTS.items():
        broken = {(row["law"], row["why"]) for row in rows if row["stage"] == stage and row["ok"] is False}
        for law, words in faults:
            assert any(law == own and words in why for own, why in broken), (stage, law, broken)


@pytest.mark.long
def test_the_sound_twins_of_naive_stages_pass(naive):
    rows = [row for row in json.loads(naive.stdout)["cases"] if row["stage"].startswith("sound_")]
    assert {row["stage"] for row in rows} == {name.replace("naive", "sound") for name in FAULTS}
    assert [row for row in rows if row["ok"] is not True] == []
    laws = {stage: {row["law"] for row in rows if row["stage"] == stage} for stage in {row["stage"] for row in rows}}
    for naive_stage, faults in FAULTS.items():  # the laws that catch the one have been told of the other
        assert {law for law, _ in faults} <= laws[naive_stage.replace("naive", "sound")]


def test_a_case_has_the_words_that_scripts_ask_for(naive):
    for row in json.loads(naive.stdout)["cases"]:
        assert {"stage", "case", "law", "error", "bound", "condition", "ok", "why"} == set(row)
        assert row["ok"] is not False or row["why"]
        assert all(
            row[word] is None or isinstance(row[word], int | float | str) for word in ("error", "bound", "condition")
        )


def test_an_unknown_stage_is_a_wrong_request_with_the_nearest_name(tmp_path):
    found = etendue(tmp_path, "stability", "diffraktion", "--json")
    assert found.returncode == 2
    (fault,) = json.loads(found.stdout)["faults"]
    assert "diffraction" in fault["message"]
    with pytest.raises(RequestError, match="diffusion"):
        study.parts(["difusion"])


@pytest.mark.long
def test_processes_change_nothing_but_the_time():
    names = ["full_well", "encode", "pixel_numbers"]
    alone = study.stability(names, workers=1)
    assert study.stability(list(reversed(names)), workers=2) == alone
    assert {row.stage for row in alone} == set(names)
    assert all(row.ok for row in alone)


@pytest.mark.parametrize("use", ["diffusion", "full_well", "white_estimate", "merge_frames", "denoise"])
def test_cases_stand_in_the_declared_ranges_and_at_their_ends(use):
    kind = installed_stages().load(use)
    every = list(cases(kind))
    assert [case.where for case in every[:1]] == [ORDINARY]
    assert {case.where for case in every} == {ORDINARY, END, CORNER, FAR, INSIDE, MIXED}
    assert [case.name for case in every] == [case.name for case in cases(kind)]  # the same in every run
    for case in every:
        for name, (parameter, form, _) in parameters_of(kind).items() if case.stage else ():
            value = getattr(case.stage, name)
            if form is float:
                assert parameter.allows(value) or (parameter.infinite and value == math.inf), (case.name, name)
                within = parameter.held is None or parameter.held[0] <= value <= parameter.held[1] or value == math.inf
                assert within or value == ordinary(kind)[name], (case.name, name)
    for name, (parameter, form, default) in parameters_of(kind).items():
        if (
            form is float
            and parameter.at_least is not None
            and parameter.held is None
            and default != parameter.at_least
        ):
            assert parameter.fidelity or any(
                case.stage and getattr(case.stage, name) == parameter.at_least for case in every
            ), name


def test_every_closed_form_serves_a_stage_and_holds():
    rows = list(kernels.rows_of_forms(frozenset()))
    assert len(rows) > 400
    assert {row.stage for row in rows} <= set(installed_stages().names())
    assert [row for row in rows if not row.ok] == []
    assert {row.law.split()[2].rstrip(",") for row in rows} == set(kernels.FORMS)


def test_a_kernel_that_loses_digits_is_told_by_its_closed_form():
    naive = kernels.ClosedForm(lambda linear: linear**0.45 * (1 + 1e-12))
    told = kernels.judged("encode", naive, "closed form", "v = 0.5", [0.5], 0.5**0.45, 1.0, kernels.DOUBLE)
    assert not told.ok
    assert told.error == pytest.approx(1e-12, rel=1e-2)  # a few roundings of 1e-16 beside it


def test_a_camera_that_cannot_be_is_refused_once_in_words():
    (row,) = cameras.rows_of_camera("1 bit", dict(cameras.cameras())["bits = 1"])
    assert row.ok
    assert "it must be from 0 to below the top code 1" in row.why


def test_a_group_shows_what_broke_also_beside_what_was_not_tried_whatever_their_order():
    rows = [
        LawCase("a", "x", "untried", None, why="no example"),
        LawCase("a", "x", "broken", False, why="so"),
        LawCase("a", "x", "near", True, 0.9, 1.0),
    ]
    for order in itertools.permutations(rows):
        (group,) = groups(order)
        assert (group.worst.case, group.cases, group.failed, group.untried) == ("broken", 3, 1, 1)


def test_a_group_shows_what_broke_before_what_came_near():
    rows = [
        LawCase("a", "x", "near", True, 0.9, 1.0, 5.0),
        LawCase("a", "x", "broken", False, why="so"),
        LawCase("a", "x", "far", True, 0.1, 1.0, 7.0),
        LawCase("b", "x", "untried", None, why="no example"),
    ]
    first, second = groups(rows)
    assert (first.worst.case, first.cases, first.failed, first.condition) == ("broken", 3, 1, 7.0)
    assert (second.worst.case, second.untried) == ("untried", 1)
    assert counts(rows) == {"cases": 4, "stages": 2, "held": 2, "failed": 1, "untried": 1}
    assert [case["ok"] for case in document(rows)["cases"]] == [True, False, True, None]


EXTREME = (
    "ordinary",
    "f_number = 1e+06",
    "pixel_pitch = 0.1",
    "white of 1 electron",
    "black scene",
    "1 x 1 pixels",
    "scene of 1e8 : 1",
)


@pytest.mark.long
def test_everything_that_is_installed_holds():
    rows = study.stability([])
    assert [row for row in rows if row.ok is not True] == []
    assert len(rows) >= 600
    assert {row.stage for row in rows} == {*installed_stages().names(), cameras.STAGE}
    tried = Counter(row.case for row in rows if row.stage == cameras.STAGE)
    assert {tried[name] for name in EXTREME} == {6}  # all laws of a camera; those that are refused have one row
