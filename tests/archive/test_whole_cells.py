"""Cells looked at together are judged as each is alone; a shard read as a column holds what its cells hold."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from etendue.archive.journaling.journal import NAME
from etendue.archive.read.reading import open_archive
from etendue.archive.read.shard_columns import shard_column
from etendue.archive.sharding.shards import ShardFiles
from etendue.archive.structure.naming import Names
from etendue.archive.write.store import ArchiveWriter
from etendue.archive.write.whole_cells import WholeCells
from etendue.present.page import figures
from etendue.present.page.opened import Opened
from tests.designs.given import plan_of


def edited(archive, shard, change):
    path = archive / "data.zarr" / shard
    data = bytearray(path.read_bytes())
    change(data)
    path.write_bytes(data)


def flip(at):
    def change(data):
        data[at] ^= 1

    return change


def without_lines(archive, number):
    lines = (archive / NAME).read_bytes().splitlines(keepends=True)
    own = [line for line in lines if b'"event":"done"' in line]
    (archive / NAME).write_bytes(b"".join(line for line in lines if line != own[number]))


def not_closed(archive):
    lines = (archive / NAME).read_bytes().splitlines(keepends=True)
    (archive / NAME).write_bytes(b"".join(line for line in lines if json.loads(line)["event"] != "closed"))


HARM = {
    "nothing": lambda archive: None,
    "the index of a shard": lambda archive: edited(archive, "lens_numbers/airy_diameter/c.0", flip(-9)),
    "a shard is cut": lambda archive: edited(archive, "lens_numbers/airy_diameter/c.0", lambda data: data.pop()),
    "bytes of a shard": lambda archive: edited(archive, "lens_numbers/airy_diameter/c.0", flip(2)),
    "no shard": lambda archive: next((archive / "data.zarr" / "irradiance").rglob("c.*")).unlink(),
    "a line is lost": lambda archive: without_lines(archive, 3),
    "the run has not ended": not_closed,
}


def judged(archive, plan, together):
    """Which cells are finished, and what is known of their chunks."""
    with ArchiveWriter(archive) as store:
        store.use(plan)
        there = WholeCells(store, together).there.tolist()
        finished = [one or store.finished(ref) for ref, one in zip(plan.cells, there, strict=True)]
        return finished, {path: dict(own) for path, own in store.blocks.wanted.items() if own}, sum(there)


@pytest.fixture
def archive(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "copy")
    return tmp_path / "copy"


@pytest.mark.parametrize("harm", HARM.values(), ids=HARM)
def test_cells_looked_at_together_are_judged_as_each_is_alone(archive, plan, harm):
    harm(archive)
    finished, chunks, together = judged(archive, plan, True)
    assert (finished, chunks, 0) == judged(archive, plan, False)
    unseen = (HARM["nothing"], HARM["bytes of a shard"])  # bytes are read when they are needed
    assert together == len(plan.cells) if harm in unseen else together < len(plan.cells)


def test_names_come_in_the_order_of_the_cells(plan):
    for one in (plan, plan_of({"design.points": 8})):
        names = Names(one)
        assert list(names.in_order()) == [names[ref] for ref in one.cells]
        assert len(set(names.in_order())) == len(names) > 8


def test_a_cell_with_another_key_is_not_there(archive, plan):
    cells = {ref: cell.changed(key=f"{number:032x}") for number, (ref, cell) in enumerate(plan.cells.items())}
    finished, chunks, _ = judged(archive, replace(plan, cells=cells), True)
    assert not any(finished) and not chunks


@pytest.mark.parametrize("harm", [name for name in HARM if name not in ("no shard", "a line is lost")])
def test_a_shard_read_as_a_column_holds_what_its_cells_hold(archive, harm):
    HARM[harm](archive)
    opened, columns = open_archive(archive), 0
    with ShardFiles(archive) as files:
        for path, numbers in opened.by_shard.items():
            column = shard_column(opened, path, files)
            if column is None:
                continue
            columns += 1
            chunks = [opened.chunk(opened.journal.said.files[number]) for number in numbers]
            alone = np.array([opened._array(chunk) for chunk in chunks])
            assert column.dtype == alone.dtype and column.tobytes() == alone.tobytes()
        assert columns > 5
        spoilt = shard_column(opened, "data.zarr/lens_numbers/airy_diameter/c.0", files) is None
        assert spoilt == (harm not in ("nothing", "the run has not ended"))


@pytest.mark.parametrize("harm", ["nothing", "bytes of a shard"])
def test_the_metrics_of_a_report_are_those_of_its_cells(archive, harm, monkeypatch):
    HARM[harm](archive)
    together, alone = Opened(archive), Opened(archive)
    monkeypatch.setattr(alone, "column", lambda group, name: None)
    found, one_by_one = (
        [(f.stage, f.variable, f.values.tobytes()) for f in figures.figures(o)[0]] for o in (together, alone)
    )
    assert sorted(found) == sorted(one_by_one)
    assert together.damaged == alone.damaged
    assert bool(alone.damaged) == (harm != "nothing")
