"""What is settled once for the cells of a stage in a batch changes no bit, no message and no other cell."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from etendue.api import param
from etendue.compute.cell import compute
from etendue.compute.given import Alike, is_ordinary
from etendue.plugins import guests
from etendue.run.batches import run_batch
from tests.run.test_form import Ramp, Table, job_of

WAYS = ("as declared", "fails", "ends", "nan", "overflow", "shape", "whole numbers", "not a dict", "kept", "narrow")


@dataclass(frozen=True, kw_only=True)
class Wild(Ramp):
    held: ClassVar[list[np.ndarray]] = []
    way: str = param(WAYS[0])

    def run(self, out_y, out_x, prepared, rng):
        out = prepared[:, None] + out_x + rng.random((out_y.size, out_x.size))
        if self.way == "fails":
            raise ValueError("no such light")
        if self.way == "ends":
            raise SystemExit(3)
        if self.way in ("nan", "overflow"):
            out[-1, -1] = np.nan if self.way == "nan" else 1e308 * 1e308
        if self.way == "kept":  # and changed by the next one
            for other in self.held:
                other[...] = -1
            self.held[:] = [out]
        forms = {"shape": out[:1], "whole numbers": out.astype(int), "narrow": out.astype("float32")}
        return [out] if self.way == "not a dict" else {"out": forms.get(self.way, out)}


CELL = st.tuples(
    st.sampled_from(WAYS), st.integers(1, 3), st.sampled_from([1.0, 2.0]), st.sampled_from(["float32", "float64"])
)


def _jobs(cells):
    for number, (way, rows, factor, precision) in enumerate(cells):
        job = job_of(Wild(way=way, factor=factor), rows, precision=precision)
        yield replace(job, ref=("one", (number,)), seed=b"%d" % number)


def _told(result, report):
    arrays = {name: (array.dtype, array.shape, array.tobytes()) for name, array in result.arrays.items()}
    message = [line for line in report.message.split("\n") if "src/etendue/" not in line]  # the engine's own lines
    return report.status, message, arrays


@given(st.lists(CELL, min_size=1, max_size=16), st.randoms(use_true_random=False))
@settings(max_examples=40, deadline=None)
def test_each_cell_of_a_batch_is_as_if_alone(cells, random):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guests, "is_guest", lambda kind: False)  # the stages of a test are somebody else's
        alone = {job.ref: _told(*compute(job, {})) for job in _jobs(cells)}
        jobs = list(_jobs(cells))
        random.shuffle(jobs)
        assert all(is_ordinary(job) and Alike(job).ordinary for job in jobs)
        refs = dict.fromkeys(job.ref for job in jobs)
        found = run_batch(tuple(jobs), refs, (), frozenset())
    for report in found.reports:
        ref = report.stage, report.index
        assert _told(found.results[ref], report) == alone[ref]


def test_a_changed_file_is_read_again_within_a_batch(tmp_path):
    path = tmp_path / "table"
    stage, seen = Table(file=str(path)), []
    jobs = [replace(job_of(stage), ref=("one", (number,))) for number in range(3)]

    def change(number):
        path.write_text(str(number + 1))
        os.utime(path, ns=(number, number))  # clocks of file systems may be coarser than this loop

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guests, "is_guest", lambda kind: False)
        found = run_batch(tuple(jobs), dict.fromkeys(job.ref for job in jobs), (), frozenset(), at=change)
    seen = [float(found.results[job.ref].arrays["out"][1, 0]) for job in jobs]
    assert seen == [1.0, 2.0, 3.0]
