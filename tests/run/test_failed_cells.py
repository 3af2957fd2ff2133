"""A stage that raises at one value of an axis: recorded, what depends on it skipped, everything else done."""

from __future__ import annotations

import json
import shlex
import shutil

import numpy as np
import pytest
import xarray

from tests.run.small import BARE, assert_same_archives, command

MODULE = '''
import os
from dataclasses import dataclass
from typing import ClassVar

from etendue.api import Stage, hookimpl, quantity


@dataclass(frozen=True, kw_only=True)
class Picky(Stage):
    """Passes light on, but not at f/5.6 while it is told so."""

    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"photocurrent": "y x [electron/s]"}
    negative: ClassVar = "keep"
    f_number: float = quantity("f_number")

    def run(self, photocurrent):
        if self.f_number == 5.6 and os.environ.get("PICKY"):
            raise ArithmeticError("f/5.6 is beyond me")
        return {"photocurrent": photocurrent + photocurrent.dtype.type(0)}


@hookimpl
def etendue_stages():
    return {"picky": Picky}
'''

PIPELINE = (
    BARE.replace('[[stages]]\nuse = "exposure"\n', '[[stages]]\nuse = "picky"\n[[stages]]\nuse = "exposure"\n')
    + """
[sweep]
f_number = [2, 5.6]
integration_time = ["2 ms", "8 ms"]
pixel_pitch = ["2.0 um", "2.6 um"]
"""
)

BEHIND = ("exposure", "shot_noise", "read_noise", "adc", "linearise", "demosaic", "sharpen", "exposure_report")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A directory with a pipeline and a plugin installed in it; a first run that failed at f/5.6."""
    place = tmp_path_factory.mktemp("failed")
    info = place / "site" / "picky-0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: picky\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[etendue]\npicky = picky_stage\n")
    (place / "site" / "picky_stage.py").write_text(MODULE)
    (place / "small.toml").write_text(PIPELINE)
    return place


def etendue(place, *arguments, picky="1"):
    return command(*arguments, PYTHONPATH=str(place / "site"), PICKY=picky)


@pytest.fixture(scope="module")
def first(place):
    done = etendue(place, "run", place / "small.toml", "--archive", place / "a", "--json")
    return done, json.loads(done.stdout)


@pytest.fixture(scope="module")
def fresh(place):
    """An archive of the same pipeline in which nothing failed."""
    done = etendue(place, "run", place / "small.toml", "--archive", place / "fresh", "--json", picky="")
    assert done.returncode == 0, done.stderr
    return place / "fresh"


def test_the_run_ends_with_exit_code_3_and_names_the_failed_cells(first):
    done, document = first
    assert done.returncode == 3, done.stderr
    assert document["failed"] == 2  # two pitches: the exposure does not reach the failing stage
    for failure in document["failures"]:
        assert failure["cell"][0] == "picky"
        assert failure["cell"][1]["f_number"] == 5.6
        assert "ArithmeticError: f/5.6 is beyond me" in failure["message"]


def test_dependants_are_skipped_and_the_rest_is_done(first, place):
    with xarray.open_datatree(place / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        for node in tree.subtree:
            if "status" not in node or node.path == "/ledger":
                continue
            stage, status = node.path.split("/")[1], node["status"]
            at = status.sel(f_number=5.6).values if "f_number" in status.dims else None
            if stage == "picky":
                assert (at == 2).all()
            elif stage in BEHIND:
                assert (at == 3).all(), stage
            elif at is not None:
                assert (at <= 1).all(), stage
            if "f_number" in status.dims:
                assert (status.sel(f_number=2).values <= 1).all(), stage
        ledger = tree["ledger"].dataset
        failed = [i for i, s in enumerate(ledger["status"].values) if s == "failed"]
        assert [ledger["stage"].values[i] for i in failed] == ["picky", "picky"]
        assert all("beyond me" in ledger["message"].values[i] for i in failed)


def test_arrays_of_cells_without_a_result_read_as_missing(first, place):
    with xarray.open_datatree(place / "a" / "data.zarr", engine="zarr", chunks=None) as tree:
        charge = tree["shot_noise/32x32/charge"]
        assert np.isnan(charge.sel(f_number=5.6).values).all()
        assert np.isfinite(charge.sel(f_number=2).values).all()
        assert (tree["adc/32x32/raw"].sel(f_number=5.6).values == 0).all()


@pytest.mark.long
def test_the_printed_command_repeats_the_failed_cell_alone(first, place):
    shutil.copytree(place / "a", place / "b")
    shown = etendue(place, "run", place / "small.toml", "--archive", place / "b", "--quiet")
    assert shown.returncode == 3
    line = next(line for line in shown.stdout.splitlines() if "rerun alone:" in line)
    assert line.split("rerun alone:")[1].strip() in {failure["again"] for failure in first[1]["failures"]}
    words = shlex.split(line.split("rerun alone:")[1].partition(" --archive ")[0])
    assert words[:2] == ["etendue", "run"]
    again = etendue(place, *words[1:], "--archive", place / "alone", "--json")
    assert again.returncode == 3, again.stderr + again.stdout
    document = json.loads(again.stdout)
    assert [failure["cell"][0] for failure in document["failures"]] == ["picky"]
    mended = etendue(place, *words[1:], "--archive", place / "alone", "--json", picky="")
    assert mended.returncode == 0


@pytest.mark.long
def test_the_next_run_computes_only_what_failed_or_was_skipped(first, fresh, place):
    again = etendue(place, "run", place / "small.toml", "--archive", place / "a", "--json")
    assert again.returncode == 3
    document = json.loads(again.stdout)
    assert (document["computed"], document["failed"]) == (0, 2)
    shutil.copytree(place / "a", place / "mended")
    mended = etendue(place, "run", place / "small.toml", "--archive", place / "mended", "--json", picky="")
    assert mended.returncode == 0, mended.stderr
    stages = {stage["name"]: stage["computed"] for stage in json.loads(mended.stdout)["stages"]}
    assert stages["picky"] == 2
    assert all(stages[name] == 4 for name in BEHIND)
    assert sum(stages.values()) == 2 + 4 * len(BEHIND)
    assert_same_archives(place / "mended", fresh)


def test_a_cell_that_fails_keeps_no_result_of_an_earlier_run(fresh, place):
    shutil.copytree(fresh, place / "c")
    failed = etendue(place, "run", place / "small.toml", "--archive", place / "c", "--recompute", "--json")
    assert failed.returncode == 3
    with xarray.open_datatree(place / "c" / "data.zarr", engine="zarr", chunks=None) as tree:
        assert np.isnan(tree["picky/32x32/photocurrent"].sel(f_number=5.6).values).all()
        assert np.isnan(tree["exposure/32x32/expected_charge"].sel(f_number=5.6).values).all()


@pytest.mark.parametrize(
    "scheduler", ["threads", *(pytest.param(name, marks=pytest.mark.long) for name in ("serial", "processes"))]
)
def test_every_scheduler_records_the_same_failures(first, place, scheduler):
    folder = place / scheduler
    done = etendue(
        place, "run", place / "small.toml", "--archive", folder, "--scheduler", scheduler, "--workers", 2, "--json"
    )
    assert done.returncode == 3, done.stderr
    assert_same_archives(folder, place / "a")


def test_an_archive_with_failed_cells_is_reproduced(first, place):
    done = etendue(place, "reproduce", place / "a", "--json")
    assert done.returncode == 0, done.stdout
    assert any(one["what"] == "messages of failed cells" for one in json.loads(done.stdout)["not_checked"])


def test_an_archive_in_which_a_stage_failed_everywhere_is_reproduced(place):
    every = ("run", place / "small.toml", "--archive", place / "every", "--sweep", "f_number=5.6", "--quiet")
    assert etendue(place, *every).returncode == 3
    done = etendue(place, "reproduce", place / "every", "--json")
    assert done.returncode == 0, done.stdout
