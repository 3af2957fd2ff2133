"""What a reader finds while somebody writes, or was broken off writing: under way, not damaged."""

from __future__ import annotations

import fcntl
import os
import shutil
from types import SimpleNamespace

import pytest

from etendue.archive import places
from etendue.archive.checks.describe import describe_archive
from etendue.archive.checks.verify import verify
from etendue.archive.records.names import aside_of
from etendue.archive.write import in_place
from etendue.archive.write.in_place import compact_in_place
from etendue.contract.registry import installed_stages
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.pipeline.file import read_pipeline
from etendue.plan.planner import make_plan
from etendue.present.terminal.looking import next_commands
from etendue.session import Options, execute
from etendue.trust import reproducing
from etendue.trust.reproducing import reproduce
from tests.archive.tiny import store_of, tiny_file, tiny_plan

SERIAL = Options("serial")


@pytest.fixture
def archive(whole, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    return tmp_path / "a"


def replaced(archive, tmp_path):
    """Another run replaces cells, and is done with it at once."""
    execute(tiny_plan(tmp_path, {"camera.peak_qe": [0.3, 0.4, 0.4]}), archive, SERIAL)


def test_cells_that_a_run_replaces_meanwhile_are_not_damaged(archive, tmp_path, monkeypatch):
    real = reproducing.execute
    monkeypatch.setattr(reproducing, "execute", lambda *given: (replaced(archive, tmp_path), real(*given))[1])
    with pytest.raises(ArchiveInUse, match="has started writing"):
        reproduce(archive, SERIAL)
    seen = []
    with pytest.raises(ArchiveInUse, match="being written"):
        verify(
            archive,
            lambda done, total: seen.append(done) or len(seen) != 3 or execute(plan_of(tmp_path), archive, SERIAL),
        )
    assert verify(archive).whole


def plan_of(tmp_path):
    return make_plan(read_pipeline(tiny_file(tmp_path), {"camera.peak_qe": [0.1, 0.2, 0.3]}), installed_stages())


def test_what_a_reader_misses_while_a_run_writes_is_being_written(archive):
    with pytest.raises(ArchiveError, match="^lost"), places.reading(archive):
        raise ArchiveError("lost")
    lock = os.open(archive / "lock", os.O_RDWR)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(ArchiveInUse, match="being written by a run"), places.reading(archive):
            raise ArchiveError("a chunk is missing")
    finally:
        os.close(lock)


@pytest.mark.parametrize("where", ["_clear", "_sync", "exchange"])
def test_a_compact_that_is_interrupted_leaves_nothing_beside_the_archive(archive, tmp_path, monkeypatch, where):
    execute(tiny_plan(tmp_path, {"sweep.f_number": [3, 2, 4]}), archive, SERIAL)
    before, real = store_of(archive), getattr(in_place, where)

    def interrupted(*given):
        real(*given)
        raise KeyboardInterrupt

    monkeypatch.setattr(in_place, where, interrupted)
    with pytest.raises(KeyboardInterrupt):
        compact_in_place(archive)
    assert not aside_of(archive).exists()
    assert verify(archive).whole
    assert (store_of(archive) == before) == (where != "exchange")


def test_what_a_killed_compact_has_left_is_named_and_removed_by_the_next(archive):
    aside_of(archive).mkdir()
    (aside_of(archive) / "lock").touch()
    found = verify(archive)
    assert found.whole and found.partial == describe_archive(archive)["partial"] == str(aside_of(archive))
    compact_in_place(archive)
    assert not aside_of(archive).exists() and not verify(archive).partial


def test_the_hint_behind_a_run_names_the_address_of_an_object_store(tmp_path):
    plan = tiny_plan(tmp_path)
    assert "etendue plot s3://bucket/a " in next_commands(SimpleNamespace(archive="s3://bucket/a", plan=plan))[0]
