"""The tables of an archive hold what the reports of its cells say, each number in its own column and unit."""

import numpy as np
import pytest

from etendue.contract.ports import CellReport
from etendue.plan.reports import Reports
from etendue.present.terminal.tables import ledger, stage_rows
from tests.plan.given import chain, plan_of

SAID = {"clipped": 0.25, "clipped_flux": 0.01, "seconds": 3.0, "message": "words", "platform": "elsewhere"}


@pytest.fixture(scope="module")
def swept():
    return plan_of(chain(sweep='"sharpen.strength" = [0.1, 0.2]\nbits = [8, 12]'))


def test_every_column_of_the_ledger_holds_what_its_report_says(swept):
    reports, cell = Reports(swept), swept.of("sharpen")[-1]
    reports.take([CellReport(*cell.ref, "done", floored=7.0, **SAID)])
    arrays = ledger(swept, reports)["arrays"]
    row = list(swept.cells).index(cell.ref)
    for name, value in SAID.items():
        dims, column, _ = arrays[name]
        assert dims == ("cell",) and np.asarray(column)[row] == value, name


def test_columns_of_time_are_in_seconds_and_those_of_errors_are_ratios(swept):
    arrays = ledger(swept, Reports(swept))["arrays"]
    units = {name: attrs.get("units") for name, (_, _, attrs) in arrays.items()}
    assert {name for name, unit in units.items() if unit == "s"} == {"seconds", "seconds_saved"}
    assert {units[name] for name in ("error", "bound", "clipped", "clipped_flux")} == {"1"}


def test_the_error_of_a_row_is_that_of_its_worst_cell(swept):
    """Fewer bits round more."""
    (row,) = [row for row in stage_rows(swept, Reports(swept)) if row["name"] == "adc"]
    errors = [cell.error[0] for cell in swept.of("adc")]
    assert row["error"] == max(errors) > min(errors)


def test_the_cell_that_lost_most_light_is_named_and_not_the_one_with_most_places(swept):
    """Undershoot of much light in few places takes more than that of little light in many."""
    reports, (one, other) = Reports(swept), swept.of("adc")[:2]
    reports.take([CellReport(*one.ref, "done", clipped=0.5, clipped_flux=1e-6)])
    reports.take([CellReport(*other.ref, "done", clipped=0.01, clipped_flux=1e-3)])
    assert reports.most_clipped().index == other.ref[1]
