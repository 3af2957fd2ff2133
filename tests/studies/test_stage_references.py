"""Stored references of built-in stages: complete, and noticed when a result changes."""

import json
from pathlib import Path

import numpy as np
import pytest

from etendue.contract.registry import installed_stages
from etendue.testing.cases import cases
from etendue_lab.stability import references

HOME = Path(__file__).parents[2]


def test_every_case_with_a_reference_exists_and_most_stages_have_some():
    names = set(installed_stages().names())
    assert set(references.stored()[0]) <= names
    for name, several in references.stored()[0].items():
        assert set(several) <= {case.name for case in cases(installed_stages().load(name))}, name


@pytest.mark.parametrize("name", ["adc", "falloff", "encode"])
def test_a_stage_gives_its_references(name):
    every = list(cases(installed_stages().load(name)))
    rows = [row for case in every for row in references.row_of(name, case)]
    assert rows
    assert [row for row in rows if not row.ok] == []


def test_a_change_of_one_value_by_a_millionth_is_noticed():
    values = np.linspace(0.1, 1.0, 108)
    other = values.copy()
    other[40] *= 1 + 1e-6
    assert references.apart(references.summary(values), references.summary(other), "charge") > references.BOUND
    assert references.apart(references.summary(values), references.summary(values * (1 + 1e-14)), "charge") < 1e-12


def test_every_slip_has_its_text_once_in_its_file_and_names_stages():
    slips = json.loads((HOME / "benchmarks" / "stage_mutants.json").read_text(encoding="utf-8"))
    assert len(slips) >= 40
    for slip in slips:
        assert (HOME / slip["file"]).read_text(encoding="utf-8").count(slip["old"]) == 1, slip["name"]
        assert slip["old"] != slip["new"]
        assert set(slip["stages"].split()) <= set(installed_stages().names()), slip["name"]
