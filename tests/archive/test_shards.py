"""Shards of runs that are killed, interrupted, short of disk, or done by several processes: nothing is lost, and
nothing is left over.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
import xarray

from etendue.archive.journaling.journal import Journal
from etendue.archive.read.reading import open_archive
from etendue.archive.records import disk
from etendue.errors import EtendueError
from etendue.session import Options, execute
from tests.archive.tiny import index_of, slots_of, store_of, tiny_file
from tests.run.small import assert_same_archives, environment

DIES = """
import os, sys
from etendue.archive.structure import cutting
from etendue.archive.write.store import ArchiveWriter
from tests.archive.tiny import LARGEST, SMALL
cutting.LARGEST_CHUNK, cutting.SMALL = LARGEST, SMALL
left, reported = [int(os.environ["DIE_AFTER"])], ArchiveWriter.reported

def die(self, reports):
    reports = list(reports)
    reported(self, reports)
    left[0] -= len(reports)
    if left[0] <= 0:
        os._exit(9)

ArchiveWriter.reported = die
from etendue import session
whole = session.partition
session.partition = lambda jobs, seconds: whole(jobs, 0.0)
from etendue.cli import main
sys.argv = ["etendue", *sys.argv[1:]]
main()
"""


def run(plan, archive, scheduler="serial", **options):
    return execute(plan, archive, Options(scheduler, **options))


def parts(archive):
    return [p.name for p in archive.rglob(".*") if p.name.endswith((disk.PART, disk.PARTIAL))]


def killed(place, archive, after, scheduler="serial"):
    """A run that is ended by the system behind the journal line of so many cells."""
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            DIES,
            "run",
            str(tiny_file(place)),
            "--archive",
            str(archive),
            "--quiet",
            "--scheduler",
            scheduler,
        ],
        env=environment(DIE_AFTER=str(after)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 9, done.stderr


def test_what_a_killed_run_has_finished_is_seen_and_never_computed_again(whole, plan, place, tmp_path):
    archive = tmp_path / "a"
    killed(place, archive, 7)
    assert parts(archive)
    found, sound = open_archive(archive), open_archive(whole)
    assert len(found.cells) == 7
    for name, cell in found.cells.items():
        for chunk in cell.chunks:
            np.testing.assert_array_equal(
                found.read(cell, chunk.variable), sound.read(sound.cells[name], chunk.variable)
            )
    assert not list(found.check())
    assert run(plan, archive).computed == len(plan.cells) - 7
    assert store_of(archive) == store_of(whole)
    assert not parts(archive)


@pytest.mark.long
def test_killed_again_and_again_it_still_ends_with_every_cell_computed_once(whole, plan, place, tmp_path):
    """Each run takes over the parts of all before it."""
    archive = tmp_path / "a"
    for _ in range(3):
        killed(place, archive, 3)
    assert run(plan, archive).computed == len(plan.cells) - 9
    assert store_of(archive) == store_of(whole)
    assert not parts(archive)


def test_a_part_that_lost_bytes_costs_the_cells_in_them(whole, plan, place, tmp_path):
    """Since the last run that ended in order nothing is trusted unread."""
    archive = tmp_path / "a"
    killed(place, archive, len(plan.cells) - 1)
    cell = open_archive(archive).cells["pixel f_number=2.0 back='absorbing' pixel_rows=4"]
    (chunk,) = (chunk for chunk in cell.chunks if chunk.variable == "photon_rate")
    at = open_archive(archive).place(chunk)
    with (archive / at.file).open("r+b") as file:
        file.seek(at.offset + 5)
        file.write(b"????")
    (damage,) = open_archive(archive).check()
    assert (damage.cell, damage.variable) == (cell.name, "photon_rate")
    assert run(plan, archive).computed == 2
    assert store_of(archive) == store_of(whole)


@pytest.mark.parametrize("scheduler", ["threads", pytest.param("processes", marks=pytest.mark.long)])
def test_whoever_computes_the_shards_hold_the_same(whole, plan, tmp_path, scheduler):
    run(plan, tmp_path / "a", scheduler, workers=2, batch_seconds=0.0, durable=True)
    assert store_of(tmp_path / "a") == store_of(whole)
    assert not parts(tmp_path / "a")


def test_more_shards_than_files_may_be_open(whole, plan, tmp_path, monkeypatch):
    from etendue.archive.sharding import segments as rooms

    monkeypatch.setattr(rooms, "HANDLES", 2)
    run(plan, tmp_path / "a")
    assert store_of(tmp_path / "a") == store_of(whole)


def forget(folder, cells):
    """Say of cells that they may be overwritten, as a repair does of damaged ones; gives how many were called done."""
    journal = Journal(folder)
    done = [(cell, one.key) for cell in cells if (one := journal.entries.get(cell)) and one.event == "done"]
    journal.open()
    journal.start(done)
    journal.close()
    return len(done)


def test_what_is_forgotten_is_computed_again_and_nothing_else(whole, plan, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    assert forget(tmp_path / "a", ["irradiance f_number=2.0", "irradiance f_number=3.0"]) == 1
    assert [(r.stage, r.index) for r in run(plan, tmp_path / "a").reports.values() if r.status == "done"] == [
        ("irradiance", (0,))
    ]
    assert store_of(tmp_path / "a") == store_of(whole)


def test_a_cell_that_is_computed_again_moves_its_shard_and_says_so(whole, plan, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    journal = tmp_path / "a/journal.jsonl"
    cell = "irradiance f_number=2.0"
    with journal.open("a") as handle:
        handle.write(json.dumps({"event": "start", "cell": cell, "key": "1" * 32}) + "\n")
    before = {
        name: (tmp_path / "a/data.zarr" / name).stat().st_ino
        for name in ("irradiance/irradiance/c.0.0.0.0", "scene/radiance/c.0.0.0")
    }
    outcome = run(plan, tmp_path / "a")
    assert outcome.computed == 1
    sizes = [chunk.written.size for chunk in open_archive(tmp_path / "a").cells["irradiance f_number=4.0"].chunks]
    assert outcome.moved["copied"] == sum(sizes)  # of the other cell in each of its shards
    assert outcome.moved["computed"] == sum(
        chunk.written.size for chunk in open_archive(tmp_path / "a").cells[cell].chunks
    )
    assert store_of(tmp_path / "a") == store_of(whole)
    after = {name: (tmp_path / "a/data.zarr" / name).stat().st_ino for name in before}
    assert [after[name] == before[name] for name in before] == [
        False,
        True,
    ]  # nothing that stands in its place is written to


def test_a_failed_cell_has_no_chunk_in_its_shard(plan, tmp_path, monkeypatch):
    from etendue.compute import cell as cells
    from etendue_camera.scene.stages import charts  # noqa: F401  # loaded, so that the class can be found

    made = cells._made

    def fails(job, results, clipped):
        if job.ref[0] == "irradiance" and job.ref[1] == (1,):
            raise ValueError("no light")
        return made(job, results, clipped)

    monkeypatch.setattr(cells, "_made", fails)
    assert len(run(plan, tmp_path / "a").failed) == 1
    shard = (tmp_path / "a/data.zarr/irradiance/irradiance/c.0.0.0.0").read_bytes()
    slots = slots_of(json.loads((tmp_path / "a/data.zarr/irradiance/irradiance/zarr.json").read_text()))
    assert slots > 2  # it is cut in bands
    assert set(index_of(shard, slots)) == set(range(slots // 2))
    with xarray.open_datatree(tmp_path / "a/data.zarr", engine="zarr", chunks=None) as tree:
        assert tree["irradiance/status"].values.tolist() == [0, 2]
        assert np.isnan(tree["irradiance/irradiance"].values[1]).all()
    monkeypatch.undo()
    run(plan, tmp_path / "a")
    run(plan, tmp_path / "b")
    assert_same_archives(tmp_path / "a", tmp_path / "b")


OPERATIONS = ("pwritev", "open", "replace", "ftruncate", "mkdir", "write")


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO], ids=["full", "broken"])
def test_a_disk_that_fails_once_ends_the_run_in_words_and_the_next_goes_on(whole, plan, tmp_path, monkeypatch, code):
    """At some of the operations on files; at every one: benchmarks/faults/file_operations.py."""

    class Failing:
        """The module ``os`` for the door to the disk: one operation fails."""

        def __init__(self, at):
            self.left = at

        def __getattr__(self, name):
            own = getattr(os, name)
            if name not in OPERATIONS:
                return own

            def attempt(*arguments, **more):
                self.left -= 1
                if self.left == 0:
                    raise OSError(code, os.strerror(code))
                return own(*arguments, **more)

            return attempt

    counting = Failing(0)
    monkeypatch.setattr(disk, "os", counting)
    run(plan, tmp_path / "counted")
    total = -counting.left
    assert total > 300
    for number in range(1, 8):
        archive = tmp_path / f"{number}"
        failing = Failing(total * number // 8)
        monkeypatch.setattr(disk, "os", failing)
        with pytest.raises((EtendueError, OSError)):
            run(plan, archive)
        monkeypatch.undo()
        run(plan, archive)
        assert store_of(archive) == store_of(whole)
        assert not parts(archive)


def test_what_a_run_leaves_that_is_killed_while_it_takes_its_folder_is_an_archive(whole, plan, tmp_path):
    """Killed at its first write there is nothing that tells an archive but the names: at every operation,
    benchmarks/faults.
    """
    archive = tmp_path / "a"
    (archive / "data.zarr").mkdir(parents=True)
    for name in ("lock", "journal.jsonl", ".run.id.4321.140157846580096.partial"):
        (archive / name).touch()
    run(plan, archive)
    assert store_of(archive) == store_of(whole)
    assert not list(archive.glob(".*"))
