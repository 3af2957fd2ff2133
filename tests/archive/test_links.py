"""Nothing outside an archive is ever written, cut or removed, whatever stands in it."""

from __future__ import annotations

import os
import shutil
import time

import pytest

from etendue.archive.records import disk
from etendue.archive.sharding.chunks import CellFiles, Chunk
from etendue.archive.sharding.segments import PARTS
from etendue.cli import main
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.session import Options, execute
from tests.archive.tiny import store_of, tiny_file

pytestmark = pytest.mark.long


def state(folder):
    """Every file and link of a folder, with what is in it."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        found[name] = os.readlink(path) if path.is_symlink() else path.read_bytes() if path.is_file() else None
    return found


PLACES = (
    "data.zarr",
    "data.zarr/scene",
    "data.zarr/pixel/4x4",
    "data.zarr/irradiance/irradiance",
    "data.zarr/irradiance/f_number/c",
    "data.zarr/irradiance/irradiance/c.0.0.0.0",
    "data.zarr/zarr.json",
    "data.zarr/ledger",
    "data.zarr/frames/preview/zarr.json",
    "inputs",
    "runs",
    "runs/0001.json",
    "run.id",
    "lock",
    "journal.jsonl",
    "manifest.json",
    "ro-crate-metadata.json",
    "contact_sheet.png",
)


CASES = [(place, "") for place in PLACES] + [
    (place, how) for how in ("recompute", "prune") for place in PLACES if place.count("/") < 2
]


@pytest.mark.parametrize(("linked", "how"), CASES)
def test_a_link_is_refused_before_anything_is_touched(whole, plan, tmp_path, linked, how):
    options = {how: True} if how else {}
    archive, outside = tmp_path / "a", tmp_path / "outside"
    shutil.copytree(whole, archive)
    outside.mkdir()
    shutil.move(archive / linked, outside / "moved")
    (archive / linked).symlink_to(outside / "moved")
    before = state(tmp_path)
    with pytest.raises(ArchiveError, match="is a link") as refused:
        execute(plan, archive, Options("serial", **options))
    assert str(archive / linked) in str(refused.value)
    assert "moved" in str(refused.value)
    assert state(tmp_path) == before


def test_show_says_where_a_link_is(whole, tmp_path, capsys):
    shutil.copytree(whole, tmp_path / "a")
    shutil.move(tmp_path / "a/data.zarr/scene", tmp_path / "scene")
    (tmp_path / "a/data.zarr/scene").symlink_to(tmp_path / "scene")
    with pytest.raises(SystemExit) as stopped:
        main(["show", str(tmp_path / "a")], prog_name="etendue")
    said = capsys.readouterr().err
    assert stopped.value.code == 2
    assert len(said.splitlines()) == 1
    assert "data.zarr/scene is a link" in said


def test_the_archive_itself_may_be_named_by_a_link(whole, plan, tmp_path):
    shutil.copytree(whole, tmp_path / "a")
    (tmp_path / "named").symlink_to("a")
    assert execute(plan, tmp_path / "named", Options("serial")).computed == 0
    assert (tmp_path / "named").is_symlink()
    assert store_of(tmp_path / "a") == store_of(whole)
    (tmp_path / "round").symlink_to("round")
    with pytest.raises(ArchiveError, match="cannot be resolved"):
        execute(plan, tmp_path / "round", Options("serial"))


def test_a_second_name_of_a_file_outside_keeps_its_bytes(whole, plan, tmp_path):
    """A copy of hard links, as backups make them: all that a run writes is written aside and renamed."""
    shutil.copytree(whole, tmp_path / "backup")
    shutil.copytree(whole, tmp_path / "a", copy_function=os.link)
    before = state(whole)
    with pytest.raises(ArchiveError, match=r"journal\.jsonl has a second name"):
        execute(plan, tmp_path / "a", Options("serial", recompute=True))
    shutil.copy2(tmp_path / "a/journal.jsonl", tmp_path / "own")
    os.replace(tmp_path / "own", tmp_path / "a/journal.jsonl")
    execute(plan, tmp_path / "a", Options("serial", recompute=True))
    assert state(whole) == before
    assert store_of(tmp_path / "a") == store_of(whole)


@pytest.mark.parametrize("where", ["data.zarr", "data.zarr/g", "data.zarr/g/a"])
def test_a_link_put_there_in_the_middle_of_a_run_is_not_followed(tmp_path, where):
    """The worker's side: it knows paths, and asks nobody."""
    (tmp_path / "a/data.zarr/g/a").mkdir(parents=True)
    (tmp_path / "a/run.id").write_text("mine")
    import numpy as np

    files = CellFiles(str(tmp_path / "a"), "mine", (Chunk("v", "data.zarr/g/a/c.0", 0, 1, "float64", (2,)),))
    files.write({"v": np.zeros(2)})
    files.settle()
    PARTS.close(files.root)  # what is open already leads where it led
    shutil.move(tmp_path / "a" / where, tmp_path / "outside")
    (tmp_path / "a" / where).symlink_to(tmp_path / "outside")
    before = state(tmp_path / "outside")
    with pytest.raises(ArchiveError, match="is a link"):
        files.write({"v": np.ones(2)})
    with pytest.raises(ArchiveError, match="is a link"):
        disk.remove(tmp_path / "a", "data.zarr/g/a/c.0")
    assert state(tmp_path / "outside") == before


def test_a_link_in_the_place_of_a_half_written_file_is_not_followed(tmp_path):
    import threading

    (tmp_path / "precious").write_text("words")
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / f".x.{os.getpid()}.{threading.get_ident()}.partial").symlink_to(tmp_path / "precious")
    disk.write(tmp_path / "a", "x", b"bytes")
    assert (tmp_path / "precious").read_text() == "words"
    assert (tmp_path / "a" / "x").read_bytes() == b"bytes"


def test_looking_for_links_asks_no_file_for_its_state(tmp_path, monkeypatch):
    """1000 cells of 20 variables: kinds come with the names."""
    for variable in range(20):
        (tmp_path / f"data.zarr/g/{variable}").mkdir(parents=True)
        for cell in range(1000):
            (tmp_path / f"data.zarr/g/{variable}/c.{cell}").touch()
    asked = []
    for name, own in (("stat", os.stat), ("lstat", os.lstat)):
        monkeypatch.setattr(os, name, lambda *a, own=own, **k: asked.append(a) or own(*a, **k))
    began = time.perf_counter()
    listing = disk.Listing(tmp_path)
    print(f"{1e3 * (time.perf_counter() - began):.0f} ms for 20000 chunks")
    monkeypatch.undo()
    assert not asked
    assert sum(len(names) for names in listing.files.values()) == 20_000


# -- what is no archive -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given", [".", "file", "link to a file", "folder with a journal of somebody else", "home"])
def test_what_is_no_archive_is_refused_untouched(place, tmp_path, monkeypatch, capsys, given):
    (tmp_path / "words.txt").write_text("words")
    (tmp_path / "diary").mkdir()
    (tmp_path / "diary/journal.jsonl").write_text('{"event":"birthday"}\n')
    (tmp_path / "diary/data.zarr").mkdir()
    (tmp_path / "diary/runs").mkdir()
    (tmp_path / "diary/runs/0001.json").write_text('{"kilometres": 10}')
    (tmp_path / "link").symlink_to("words.txt")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    target = {".": ".", "file": "words.txt", "link to a file": "link", "home": str(tmp_path)}.get(given, "diary")
    before = state(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(["run", str(tiny_file(place)), "--archive", target, "--quiet"], prog_name="etendue")
    assert stopped.value.code == 2
    assert "is not an archive" in capsys.readouterr().err
    assert state(tmp_path) == before


def test_an_archive_may_be_the_folder_one_stands_in(whole, plan, tmp_path, monkeypatch):
    shutil.copytree(whole, tmp_path / "a")
    monkeypatch.chdir(tmp_path / "a")
    assert execute(plan, ".", Options("serial")).computed == 0
    assert store_of(tmp_path / "a") == store_of(whole)


def test_an_archive_in_use_is_not_looked_into(whole, plan, tmp_path):
    import fcntl

    shutil.copytree(whole, tmp_path / "a")
    handle = os.open(tmp_path / "a/lock", os.O_RDWR)
    fcntl.flock(handle, fcntl.LOCK_EX)
    before = state(tmp_path / "a")
    try:
        with pytest.raises(ArchiveInUse):
            execute(plan, tmp_path / "a", Options("serial", recompute=True, prune=True))
    finally:
        os.close(handle)
    assert state(tmp_path / "a") == before
