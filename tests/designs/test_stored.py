"""What a study finds is stored as groups of an archive: open to plain xarray, whole for commands, told when old."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest
import xarray

from etendue.archive.checks.verify import verify
from etendue.archive.read.studies import stored_studies
from etendue.archive.write.compact import compact
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.opening import opened
from etendue_lab.designs.samples import samples_of
from etendue_lab.designs.sensitivity import sensitivity, subjects_of
from etendue_lab.designs.stored import store
from tests.designs.given import ran
from tests.run.small import command

OVER = {"design.method": "saltelli", "design.points": 8}
METRICS = ("airy_diameter", "cutoff_frequency")


def studied(folder, *metrics):
    document = sensitivity(samples_of(folder), metrics)
    return document, store(folder, folder, document)


@pytest.fixture
def archive(tmp_path):
    ran(tmp_path / "a", OVER)
    return tmp_path / "a"


def test_groups_are_read_by_plain_xarray_and_the_archive_stays_whole(archive, tmp_path):
    document, stored = studied(archive, *METRICS)
    assert stored["groups"] == ["sensitivity/lens_numbers.airy_diameter", "sensitivity/lens_numbers.cutoff_frequency"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with xarray.open_datatree(archive / "data.zarr", engine="zarr") as tree:
            own = tree["sensitivity"]["lens_numbers.airy_diameter"].to_dataset().load()
    for row, name in zip(document["metrics"][0]["factors"], own["factor"].values, strict=True):
        assert row["factor"] == name and row["total"]["value"] == own["total"].sel(factor=name)
        assert row["total"]["high"] == own["total_interval"].sel(factor=name, end="high")
    assert len(own["cell_key"]) == 3  # levels of the f-number
    assert verify(archive).whole
    assert not any(one.name.startswith("sensitivity") for one in Holdings(opened(archive)))
    assert [one.stale for one in stored_studies(archive)] == ["", ""]
    before = {path: path.stat().st_mtime_ns for path in archive.rglob("*")}
    studied(archive, *METRICS)
    assert before == {path: path.stat().st_mtime_ns for path in archive.rglob("*")}  # the same is not written again
    compact(archive, tmp_path / "c")
    assert verify(tmp_path / "c").whole and len(list(stored_studies(tmp_path / "c"))) == 2
    assert ran(tmp_path / "c", OVER).computed == 0
    assert len(list(stored_studies(tmp_path / "c"))) == 2


def test_a_run_keeps_what_is_stored_and_it_is_told_that_it_is_old(archive):
    studied(archive, "airy_diameter")
    ran(archive, {**OVER, "design.points": 16})
    assert verify(archive).whole
    assert [one.stale for one in stored_studies(archive)] == [""]  # the levels of the f-number are those of before
    over = {**OVER, "design.factors.f_number": {"from": 2, "to": 8}}
    ran(archive.parent / "b", over)
    studied(archive.parent / "b", "airy_diameter")
    ran(archive.parent / "b", {**over, "design.points": 16})
    (old,) = stored_studies(archive.parent / "b")
    assert old.since == 16 and "16 cells were finished since" in old.stale
    studied(archive.parent / "b", "airy_diameter")
    assert [one.stale for one in stored_studies(archive.parent / "b")] == [""]


def test_commands_say_it_and_reproduce_passes(archive):
    said = json.loads(command("sensitivity", archive, "airy_diameter", "--json").stdout)
    assert said["stored"] == {"groups": ["sensitivity/lens_numbers.airy_diameter"], "why": ""}
    assert "study sensitivity/lens_numbers.airy_diameter, of 3 cells" in command("show", archive).stdout
    done = command("reproduce", archive)
    assert done.returncode == 0, done.stdout + done.stderr


def test_what_cannot_be_stored_says_why(archive):
    (archive / "manifest.json").unlink()
    _, stored = studied(archive, "airy_diameter")
    assert not stored["groups"] and "incomplete or damaged" in stored["why"]


def test_sums_by_subject_and_a_closed_index_only_where_the_design_holds_the_group():
    def row(factor, subject, first, total):
        own = [{"value": v, "low": v - 0.1, "high": v + 0.1} for v in (first, total)]
        return {"factor": factor, "subject": subject, "first": own[0], "total": own[1], "main_effect": first}

    rows = [row("a", "lens", 0.3, 0.4), row("b", "lens", 0.2, 0.3), row("c", "pixel", 0.4, 0.4)]
    lens, pixel = subjects_of(rows)
    assert lens["sum"] == pytest.approx(0.5) and pixel["sum"] == pytest.approx(0.4)
    np.testing.assert_allclose([lens["closed"][w] for w in ("value", "low", "high")], [0.6, 0.5, 0.7])
    assert pixel["closed"]["value"] == 0.4  # of one factor alone: its first-order index
    more = subjects_of([*rows, row("d", "pixel", 0.0, 0.1)])
    assert [one["closed"] for one in more] == [None, None]
