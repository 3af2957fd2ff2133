"""An archive written anew: the same bits in every array, axes sorted, fresh shards; also of one with a file for
every cell.
"""

from __future__ import annotations

import json
import shutil
from contextlib import suppress

import numpy as np
import pytest
import xarray

import etendue
from etendue.archive.checks.verify import verify
from etendue.archive.journaling.journal import summed
from etendue.archive.read.reading import open_archive
from etendue.archive.records.manifest import write_manifest
from etendue.archive.sharding.chunks import encode
from etendue.archive.write import in_place
from etendue.archive.write.compact import compact
from etendue.archive.write.in_place import compact_in_place
from etendue.archive.write.store import ArchiveWriter
from etendue.cli import main
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.session import Options, execute
from tests.archive.dying import Died, dying
from tests.archive.tiny import store_of, tiny_file, tiny_plan

pytestmark = pytest.mark.long


def run(plan, archive, **options):
    return execute(plan, archive, Options("serial", **options))


def state(folder):
    return {p.relative_to(folder): (p.stat().st_mtime_ns, p.read_bytes()) for p in folder.rglob("*") if p.is_file()}


def shards(archive):
    return {
        p.relative_to(archive).as_posix(): p.stat().st_size
        for p in (archive / "data.zarr").rglob("c.*")
        if "c" not in p.parts
    }


GROWN = {"sweep.f_number": [2, 3, 4]}


@pytest.fixture(scope="module")
def grown(whole, place):
    """Two f-numbers, then a third between them."""
    shutil.copytree(whole, place / "grown")
    outcome = run(tiny_plan(place, GROWN), place / "grown")
    assert outcome.computed
    assert not outcome.moved["copied"]  # what is stored stays where it is
    return place / "grown"


def test_it_has_the_arrays_and_shards_of_a_fresh_sweep(grown, place, tmp_path):
    before = state(grown)
    plan = tiny_plan(place, GROWN)
    run(plan, tmp_path / "fresh")
    done = compact(grown, tmp_path / "new")
    assert done.sorted["irradiance"] == ["f_number"]
    assert shards(tmp_path / "new") == shards(tmp_path / "fresh") != shards(grown)
    mine, fresh = store_of(tmp_path / "new"), store_of(tmp_path / "fresh")
    tables = ("ledger", "summary", "frames", "zarr.json")
    assert {k: v for k, v in mine.items() if not k.startswith(tables)} == {
        k: v for k, v in fresh.items() if not k.startswith(tables)
    }
    assert not list(open_archive(tmp_path / "new").check())
    with xarray.open_datatree(tmp_path / "new/data.zarr", engine="zarr", chunks=None) as tree:
        assert tree["irradiance/f_number"].values.tolist() == [2, 3, 4]
    assert state(grown) == before
    assert run(plan, tmp_path / "new").computed == 0
    again = state(tmp_path / "new")
    assert run(plan, tmp_path / "new").computed == 0
    assert state(tmp_path / "new") == again


def labelled(archive):
    """Every array of the store by label, tables and pictures aside."""
    tree = etendue.open_archive(archive)
    groups = {
        path: tree[path].to_dataset() for path in ("scene", "irradiance", "pixel/4x4", "pixel/5x4", "lens_numbers")
    }
    return {
        path: data.sortby([dim for dim in ("f_number",) if dim in data.dims]).load() for path, data in groups.items()
    }


def assert_same_cells(one, other):
    for path, data in one.items():
        xarray.testing.assert_equal(data, other[path])


def test_in_place_it_is_what_it_is_elsewhere_and_what_is_right_is_not_written(grown, tmp_path):
    archive = tmp_path / "a"
    shutil.copytree(grown, archive)
    before, held = labelled(archive), (archive / "data.zarr/scene/radiance/c.0.0.0").stat().st_ino
    done = compact_in_place(archive)
    compact(grown, tmp_path / "elsewhere")
    mine, other = ({k: v for k, v in store_of(folder).items()} for folder in (archive, tmp_path / "elsewhere"))
    assert mine == other
    assert done.sorted["irradiance"] == ["f_number"]
    assert (archive / "data.zarr/scene/radiance/c.0.0.0").stat().st_ino == held  # no axis of it has grown
    assert 0 < done.written < sum(p.stat().st_size for p in archive.rglob("*") if p.is_file())
    assert done.amplification == done.written / done.bytes
    assert verify(archive).whole
    assert_same_cells(before, labelled(archive))
    after = state(archive)
    again = compact_in_place(archive)
    assert (again.written, again.cells, again.sorted) == (0, done.cells, {})
    assert state(archive) == after
    assert {p.name for p in tmp_path.iterdir()} == {"a", "elsewhere"}


@pytest.mark.parametrize("count", [2, pytest.param(8, marks=pytest.mark.long)])
def test_killed_at_any_operation_no_cell_is_lost_and_the_same_command_ends_right(grown, place, tmp_path, count):
    archive, before = tmp_path / "a", labelled(grown)
    shutil.copytree(grown, archive)
    with dying(tmp_path) as operations:
        compact_in_place(archive)
    sound = store_of(archive)
    numbers = np.unique(np.linspace(1, len(operations), count + 2, dtype=int)[1:-1])
    assert len(operations) > 200
    for number in numbers:
        shutil.rmtree(archive)
        shutil.copytree(grown, archive)
        for died in (int(number), int(number) // 2 + 1):  # and once more on the way
            with dying(tmp_path, died), suppress(Died):
                compact_in_place(archive)
        assert verify(archive).whole
        assert_same_cells(before, labelled(archive))
        compact_in_place(archive)
        assert store_of(archive) == sound
        assert [p.name for p in tmp_path.iterdir()] == ["a"]
    assert verify(archive).whole
    assert run(tiny_plan(place, GROWN), archive).computed == 0


def test_what_was_written_before_it_was_killed_is_not_written_again(grown, tmp_path):
    archive = tmp_path / "a"
    shutil.copytree(grown, archive)
    with dying(tmp_path) as operations:
        whole = compact_in_place(archive).written
    first = operations.names.index("link") + 40  # some shards are there
    shutil.rmtree(archive)
    shutil.copytree(grown, archive)
    with dying(tmp_path, first), pytest.raises(Died):
        compact_in_place(archive)
    assert compact_in_place(archive).written < whole


def test_in_place_it_is_refused_where_it_cannot_be_done(grown, tmp_path, monkeypatch):
    archive = tmp_path / "a"
    shutil.copytree(grown, archive)
    before = state(archive)
    with ArchiveWriter(archive), pytest.raises(ArchiveInUse):
        compact_in_place(archive)
    monkeypatch.setattr(in_place, "EXCHANGE", 1 << 20)  # which no system knows
    with pytest.raises(ArchiveError, match=r"cannot exchange two folders .* compact .* NEW"):
        compact_in_place(archive)
    assert {p: data for p, (_, data) in state(archive).items()} == {p: data for p, (_, data) in before.items()}
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_the_same_bytes_whenever_it_is_written(grown, tmp_path):
    compact(grown, tmp_path / "one")
    compact(tmp_path / "one", tmp_path / "two")
    first, second = (
        {p.relative_to(f): p.read_bytes() for p in (f / "data.zarr").rglob("*") if p.is_file()}
        for f in (tmp_path / "one", tmp_path / "two")
    )
    assert first == second


def with_files_for_cells(archive, old):
    """The form of earlier versions: a file for every chunk, no shards, and a journal that names files."""
    shutil.copytree(archive, old)
    stored, lines, root = open_archive(archive), [], json.loads((archive / "data.zarr/zarr.json").read_text())
    for path in shards(archive):
        (old / path).unlink()
    for line in map(json.loads, (archive / "journal.jsonl").read_text().splitlines()):
        line.pop("sum")
        if line["event"] in ("blocks", "shard", "closed"):
            continue
        if line["event"] == "done":
            cell = stored.cells[line["cell"]]
            files = []
            for chunk in {chunk.variable: chunk for chunk in cell.chunks}.values():
                folder = chunk.written.path.rpartition("/")[0]
                where = ".".join(["c", *map(str, chunk.position), *("0" for _ in chunk.form.shape)])
                data = encode(stored.read(cell, chunk.variable))
                (old / folder / where).write_bytes(data)
                files.append([f"{folder}/{where}", len(data), "00" * 16])
                node = json.loads((archive / folder / "zarr.json").read_text())
                if node["codecs"][0]["name"] == "sharding_indexed":
                    inner = node["codecs"][0]["configuration"]
                    size = np.dtype(chunk.form.dtype).itemsize
                    blosc = {"typesize": size, "cname": "lz4", "clevel": 5, "shuffle": "bitshuffle", "blocksize": 0}
                    node["chunk_grid"]["configuration"]["chunk_shape"] = [1] * len(chunk.form.block) + list(
                        chunk.form.shape
                    )
                    node["codecs"] = [inner["codecs"][0], {"name": "blosc", "configuration": blosc}, {"name": "crc32c"}]
                    (old / folder / "zarr.json").write_text(json.dumps(node, indent=2))
                    root["consolidated_metadata"]["metadata"][folder.removeprefix("data.zarr/")] = node
            line["files"] = files
        lines.append(summed(json.dumps(line, separators=(",", ":")).encode()))
    (old / "journal.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    root["attributes"]["etendue"]["format"] = 1
    (old / "data.zarr/zarr.json").write_text(json.dumps(root, indent=2))
    known = json.loads((archive / "manifest.json").read_text())["metadata"]
    write_manifest(old, {path: (old / path).read_bytes() for path in known})


def test_an_archive_with_a_file_for_every_cell_is_read_refused_with_the_way_out_and_written_anew(
    whole, plan, place, tmp_path, capsys
):
    with_files_for_cells(whole, tmp_path / "old")
    archive = open_archive(tmp_path / "old")
    assert len(archive.cells) == len(plan.cells)
    assert not list(archive.check())
    main(["show", str(tmp_path / "old")], prog_name="etendue", standalone_mode=False)
    assert f"{len(plan.cells)} of {len(plan.cells)}" in capsys.readouterr().out
    before = state(tmp_path / "old")
    with pytest.raises(SystemExit) as stopped:
        main(["run", str(tiny_file(place)), "--archive", str(tmp_path / "old"), "--quiet"], prog_name="etendue")
    assert stopped.value.code == 2
    assert f"etendue compact {tmp_path / 'old'} old-2" in capsys.readouterr().err
    assert state(tmp_path / "old") == before
    main(
        ["compact", str(tmp_path / "old"), str(tmp_path / "new"), "--json"], prog_name="etendue", standalone_mode=False
    )
    assert json.loads(capsys.readouterr().out)["cells"] == len(plan.cells)
    with (
        xarray.open_datatree(whole / "data.zarr", engine="zarr", chunks=None) as one,
        xarray.open_datatree(tmp_path / "new/data.zarr", engine="zarr", chunks=None) as other,
    ):
        for group in ("scene", "irradiance", "pixel/4x4", "pixel/5x4", "lens_numbers"):
            xarray.testing.assert_identical(one[group].to_dataset(), other[group].to_dataset())
    assert run(plan, tmp_path / "new").computed == 0
    assert not list(open_archive(tmp_path / "new").check())


def test_what_is_damaged_unfinished_or_in_the_way_is_refused(whole, tmp_path):
    (tmp_path / "there").mkdir()
    with pytest.raises(ArchiveError, match="exists"):
        compact(whole, tmp_path / "there")
    with pytest.raises(ArchiveError, match="not an archive"):
        compact(tmp_path / "there", tmp_path / "new")
    shutil.copytree(whole, tmp_path / "unfinished")
    (tmp_path / "unfinished/manifest.json").unlink()
    with pytest.raises(ArchiveError, match=r"manifest\.json is missing"):
        compact(tmp_path / "unfinished", tmp_path / "new")
    shutil.copytree(whole, tmp_path / "flipped")
    path = next((tmp_path / "flipped/data.zarr/pixel/4x4/photon_rate").glob("c.*"))
    data = bytearray(path.read_bytes())
    data[20] ^= 1
    path.write_bytes(data)
    with pytest.raises(ArchiveError, match="photon_rate of pixel f_number"):
        compact(tmp_path / "flipped", tmp_path / "new")
    assert {p.name for p in tmp_path.iterdir()} == {"there", "unfinished", "flipped"}


def test_the_command_says_what_it_has_written(grown, tmp_path, capsys):
    shutil.copytree(grown, tmp_path / "a")
    main(["compact", str(tmp_path / "a"), "--json"], prog_name="etendue", standalone_mode=False)
    said = json.loads(capsys.readouterr().out)
    assert said["amplification"] == said["written"] / said["bytes"] > 0
    assert said["sorted"]["irradiance"] == ["f_number"]
    main(["compact", str(tmp_path / "a")], prog_name="etendue", standalone_mode=False)
    assert "nothing to do" in capsys.readouterr().out
