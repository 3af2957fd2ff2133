"""What is found out once for cells that are alike never serves one that is not."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from etendue.api import Stage, param
from etendue.compute.cell import compute
from etendue.compute.form import form_of
from etendue.compute.job import Job
from etendue.compute.ownership import undisturbed
from etendue.contract.arrays.grid import Grid, Line
from etendue.contract.arrays.variables import parse_declaration


@dataclass(frozen=True, kw_only=True)
class Ramp(Stage):
    writes: ClassVar = {"out": "y x [1]"}
    factor: float = param(1.0)

    def prepare(self, coordinates):
        return self.factor * coordinates["out_y"]

    def run(self, out_y, out_x, prepared):
        return {"out": prepared[:, None] + out_x}


@dataclass(frozen=True, kw_only=True)
class Table(Ramp):
    file: str = param(file=True)

    def prepare(self, coordinates):
        with open(self.file) as file:
            return float(file.read()) * coordinates["out_y"]


@dataclass(frozen=True, kw_only=True)
class Overflowing(Ramp):
    def run(self, out_y, out_x):
        np.log(np.zeros(1)), np.exp(np.full(1, 1e4)), np.exp(np.full(1, -1e4))
        return {"out": out_y[:, None] + out_x}


def job_of(stage, rows=2, columns=3, start=0.0, precision="float64"):
    grid = Grid.of({"y": Line(rows, start), "x": Line(columns, start)})
    return Job(
        ref=("one", ()),
        task="compute",
        stage=stage,
        writes={"out": parse_declaration("out", "y x [1]")},
        grids={"out": grid},
        input_grids={},
        inputs=(),
        left_out=False,
        seed=b"",
        pattern_of=b"",
        precision=precision,
        store=(),
        deliver=("out",),
        target=None,
        seconds=0.0,
    )


@given(
    st.lists(
        st.tuples(
            st.integers(1, 3),
            st.integers(1, 3),
            st.sampled_from([0.0, 5.0]),
            st.sampled_from([1.0, 2.0]),
            st.sampled_from(["float32", "float64"]),
        ),
        min_size=2,
        max_size=12,
    )
)
def test_cells_of_one_name_in_any_order_each_have_their_own_grid_precision_and_tables(cells):
    for rows, columns, start, factor, precision in cells:
        result, report = compute(job_of(Ramp(factor=factor), rows, columns, start, precision), {})
        assert report.status == "done", report.message
        expected = factor * (start + np.arange(rows))[:, None] + start + np.arange(columns)
        assert result.arrays["out"].dtype == precision
        np.testing.assert_array_equal(result.arrays["out"], expected)  # small whole numbers: exact in both precisions


def test_a_table_is_prepared_anew_when_its_file_has_changed(tmp_path):
    path = tmp_path / "table"
    stage = Table(file=str(path))
    for number, text in enumerate(("1", "2", "3")):
        path.write_text(text)
        os.utime(path, ns=(number, number))  # clocks of file systems may be coarser than this loop
        result, report = compute(job_of(stage), {})
        assert report.status == "done", report.message
        assert result.arrays["out"][1, 0] == float(text)


def test_what_is_asked_of_a_stage_without_files_is_hashed_once():
    stage = Ramp(factor=3.0)
    first, again = (form_of(job_of(stage)).key_of_prepared(stage) for _ in range(2))
    assert first is again
    assert form_of(job_of(stage)).key_of_prepared(Ramp(factor=4.0)) != first


def test_how_its_caller_handles_errors_of_numpy_changes_no_cell_and_no_cell_changes_it():
    with np.errstate(all="raise"):
        before = np.geterr()
        assert compute(job_of(Overflowing()), {})[1].status == "done"
        undisturbed(np.seterr, all="print")
        assert np.geterr() == before
