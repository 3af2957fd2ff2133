"""Archives on an object store: the same archive as on disk, whatever breaks off, wherever it goes on.

Most of it on a store in memory, which keeps conditions as S3 does; S3 itself in ``test_s3.py``.
"""

from __future__ import annotations

import json
import shutil
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import xarray

import etendue
from etendue.archive import fetching, mirror, places
from etendue.archive.checks.describe import describe_archive
from etendue.archive.checks.verify import verify
from etendue.archive.read.differences import differences
from etendue.archive.remote import lease
from etendue.errors import ArchiveError, ArchiveInUse, RequestError, StoreLost
from etendue.session import Options, execute
from etendue.trust.repairing import repair
from tests.archive.tiny import store_of, tiny_plan

pytestmark = pytest.mark.long

obstore = pytest.importorskip("obstore", reason="object stores need obstore: pip install 'etendue[objects]'")

from etendue.archive.remote import objects  # noqa: E402

SHARD = "data.zarr/pixel/4x4/photon_rate/c.0.0.0.0.0.0"


@pytest.fixture(autouse=True)
def machine(tmp_path, monkeypatch):
    """Every test has a machine of its own: a place for working folders, and nobody else's store."""
    monkeypatch.setenv("ETENDUE_WORK", str(tmp_path / "work"))
    monkeypatch.setattr(objects, "_memory", {})
    monkeypatch.setattr(mirror, "LOOK", 0.01)
    return tmp_path


def elsewhere(machine, monkeypatch, name="elsewhere"):
    """Another machine: nothing of the first is there."""
    monkeypatch.setenv("ETENDUE_WORK", str(machine / name))


def run(plan, url, **more):
    return execute(plan, url, Options("serial", **more))


def stored(url) -> dict[str, bytes]:
    """Every object, by path."""
    door = objects.Objects(url)
    return {path: door.get(path)[0] for path in door.list()}


def downloaded(url, folder: Path) -> Path:
    """An archive as any other program would copy it."""
    for path, data in stored(url).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(data)
    return folder


@pytest.fixture
def asked(monkeypatch):
    """Requests by kind and path, of everybody."""
    found: Counter = Counter()
    for kind in ("get", "part", "pieces", "put"):
        real = getattr(objects.Objects, kind)

        def told(self, path, *rest, real=real, kind=kind):
            found[kind, path] += 1
            return real(self, path, *rest)

        monkeypatch.setattr(objects.Objects, kind, told)
    return found


def test_an_archive_on_an_object_store_is_the_archive_on_disk(plan, whole, machine):
    url = "memory:///sweeps/tiny"
    outcome = run(plan, url)
    assert str(outcome.archive) == url and not outcome.failed
    copy = downloaded(url, machine / "copy")
    assert store_of(copy) == store_of(whole)
    assert verify(copy).whole
    with places.reading(url, exact=True) as folder:
        assert verify(folder).whole
        assert all(one.equal for one in differences(whole, folder))
        assert describe_archive(folder)["finished"] == len(plan.cells)
    tree, there = etendue.open_archive(url), etendue.open_archive(whole)
    assert tree.groups == there.groups
    for node in there.subtree:
        own = node.to_dataset().drop_vars("seconds", errors="ignore")
        xarray.testing.assert_identical(
            tree[node.path].to_dataset().drop_vars("seconds", errors="ignore").compute(), own.compute()
        )


def test_a_run_that_has_nothing_to_compute_puts_nothing(plan, machine, monkeypatch, asked):
    url = "memory:///tiny"
    run(plan, url)
    for number, place in enumerate(("work", "elsewhere", "elsewhere")):
        elsewhere(machine, monkeypatch, place)
        before = stored(url)
        asked.clear()
        assert run(plan, url).computed == 0
        requests = set(asked)
        assert not [path for kind, path in requests if kind == "put"]
        assert len(requests) <= (1, 8, 1)[number], "owner, table, journal, small documents in one; what is larger"
        assert stored(url) == before
    assert requests == {("get", "owner.json")}, "a machine that knows the archive fetches nothing of it again"


def lost_at(monkeypatch, number):
    """The network is gone at the put with this number, and stays away."""
    real, puts, lock = objects.Objects.put, [0], threading.Lock()

    def put(self, path, data, if_tag=None):
        with lock:
            puts[0] += 1
            if puts[0] >= number:
                raise StoreLost(f"{self.url}: the store cannot be reached")
        return real(self, path, data, if_tag)

    monkeypatch.setattr(objects.Objects, "put", put)
    return puts


def puts_of_a_run(plan, monkeypatch) -> int:
    with monkeypatch.context() as patch:
        puts = lost_at(patch, 10**9)
        run(plan, "memory:///counted")
    return puts[0]


def broken_off_and_finished(plan, whole, machine, monkeypatch, number, same, url):
    """Lose the store at one put; the same command again, here or elsewhere, ends with the archive of an
    uninterrupted run.
    """
    with monkeypatch.context() as patch:
        puts, said = lost_at(patch, number), ""
        try:
            run(plan, url)
        except StoreLost as error:
            said = str(error)
    lost = puts[0] >= number  # how often the journal goes up depends on the clock
    assert ("cannot be reached" in said and said.endswith("run again to continue") and "\n" not in said) == lost
    if not same:
        elsewhere(machine, monkeypatch, f"elsewhere {number}")
        monkeypatch.setattr(lease, "LEASE", 0.0)  # the right of the run that is gone has ended
    assert not run(plan, url).failed
    copy = downloaded(url, machine / f"copy {number} {same}")
    assert store_of(copy) == store_of(whole)
    assert verify(copy).whole
    assert json.loads((copy / "owner.json").read_text())["state"] == "closed"


@pytest.mark.parametrize("same", [True, False], ids=["here", "elsewhere"])
def test_a_run_that_loses_the_store_goes_on(plan, whole, machine, monkeypatch, same):
    puts = puts_of_a_run(plan, monkeypatch)
    for number in (2, 2 * puts // 3):
        broken_off_and_finished(plan, whole, machine, monkeypatch, number, same, f"memory:///lost/{number}")


@pytest.mark.long
def test_a_run_that_loses_the_store_at_any_put_goes_on(plan, whole, machine, monkeypatch):
    puts = puts_of_a_run(plan, monkeypatch)
    for number in range(2, puts + 1, 5):
        with monkeypatch.context() as patch:
            broken_off_and_finished(plan, whole, machine, patch, number, number % 2 == 0, f"memory:///lost/{number}")
        shutil.rmtree(machine, ignore_errors=True)


def test_what_is_sealed_counts_elsewhere_and_only_what_is_needed_is_fetched(place, plan, machine, monkeypatch, asked):
    """An axis that grows: shards of earlier values are neither fetched nor put; the archive is the one that grew on
    disk.
    """
    grown = tiny_plan(place, {"sweep.f_number": [2, 4, 8]})
    execute(plan, machine / "disk", Options("serial"))
    execute(grown, machine / "disk", Options("serial"))
    url = "memory:///tiny"
    run(plan, url)
    before = {path for path in stored(url) if path.rpartition("/")[2].startswith("c.") and path != SHARD}
    elsewhere(machine, monkeypatch)
    asked.clear()
    outcome = run(grown, url)
    assert (outcome.computed, len(outcome.reused)) == (len(grown.cells) - len(plan.cells), len(plan.cells))
    again = {path for kind, path in asked if path in before and kind in ("pieces", "put")}
    assert not {
        path for path in again if not path.startswith(("data.zarr/frames", "data.zarr/ledger", "data.zarr/summary"))
    }
    assert store_of(downloaded(url, machine / "copy")) == store_of(machine / "disk")


@pytest.mark.parametrize("put", [0, *(pytest.param(n, marks=pytest.mark.long) for n in range(2, 60, 4))])
def test_cells_that_get_another_group_are_neither_lost_nor_computed_again(place, plan, machine, monkeypatch, put):
    """A second shape comes, on a machine that has nothing of the first; the store is lost at one of the puts."""
    first, url = tiny_plan(place, {"sweep.pixel.rows": [4]}), "memory:///tiny"
    for where in (machine / "disk", url):
        execute(first, where, Options("serial"))
        elsewhere(machine, monkeypatch)
        if put and where == url:
            with monkeypatch.context() as patch:
                lost_at(patch, put)
                with suppress(StoreLost):
                    run(plan, url)
            if put % 8 == 2:
                elsewhere(machine, monkeypatch, "a third")
                monkeypatch.setattr(lease, "LEASE", 0.0)
        outcome = execute(plan, where, Options("serial"))
        new = len(plan.cells) - len(first.cells)
        assert outcome.computed <= new if put and where == url else outcome.computed == new
    copy = downloaded(url, machine / "copy")
    assert store_of(copy) == store_of(machine / "disk")
    assert verify(copy).whole


def test_other_parameters_replace_what_is_there(place, plan, machine, monkeypatch):
    """Also where the store is lost in the middle: what a machine then finds there is not what was packed when all
    was in order.
    """
    brighter = tiny_plan(place, {"camera.peak_qe": [0.3, 0.4, 0.4]})
    for where in (machine / "disk", "memory:///tiny"):
        run(plan, where)
        if where != machine / "disk":
            elsewhere(machine, monkeypatch)
            with monkeypatch.context() as patch:
                lost_at(patch, 14)
                with pytest.raises(StoreLost):
                    run(brighter, where)
            elsewhere(machine, monkeypatch, "a third")
            monkeypatch.setattr(lease, "LEASE", 0.0)
        run(brighter, where)
    copy = downloaded("memory:///tiny", machine / "copy")
    assert store_of(copy) == store_of(machine / "disk")
    assert verify(copy).whole


def flip(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


CHANGES = {
    "bytes": lambda data: flip(data, 8),
    "index": lambda data: flip(data, len(data) - 6),
    "cut": lambda data: data[: len(data) // 2],
    "gone": None,
}


@pytest.mark.parametrize(
    "kind", ["index", *(pytest.param(kind, marks=pytest.mark.long) for kind in CHANGES if kind != "index")]
)
def test_a_damaged_object_is_found_named_and_mended(plan, whole, machine, monkeypatch, kind):
    change = CHANGES[kind]
    url = "memory:///tiny"
    run(plan, url)
    door = objects.Objects(url)
    for path in (SHARD, "data.zarr/pixel/4x4/f_number/c/0", "journal.jsonl") if kind != "index" else (SHARD,):
        data, _ = door.get(path)
        door.put(path, change(data)) if change else door.delete([path])
        with places.reading(url, exact=True) as folder:
            found = verify(folder)
        assert path in {damage.path for damage in found.damages}, path
        elsewhere(machine, monkeypatch, f"{kind} {path.replace('/', ' ')}")
        with places.writing(url, exact=True) as folder:
            assert repair(folder, [], Options("serial")).after.whole
        with places.reading(url, exact=True) as folder:
            assert verify(folder).whole
    copy = downloaded(url, machine / "copy")
    assert {
        path: data for path, data in store_of(copy).items() if not path.startswith(("frames", "ledger", "summary"))
    } == {path: data for path, data in store_of(whole).items() if not path.startswith(("frames", "ledger", "summary"))}


def test_one_run_at_a_time(plan, machine, monkeypatch):
    """A second machine is refused while the right of the first holds; a run that has lost its right stops, and puts
    nothing more.
    """
    url = "memory:///tiny"
    real = mirror.Mirror.begun
    monkeypatch.setattr(lease.Lease, "renew", lambda self: None)  # a machine that sleeps

    def begun(self):
        real(self)
        with monkeypatch.context() as patch:
            elsewhere(machine, patch)
            with pytest.raises(
                ArchiveInUse, match=r"in use by another run; if that run was killed, its lease ends in \d+ s"
            ):
                run(plan, url)
            monkeypatch.setattr(lease, "LEASE", 0.0)  # from now on
            patch.setattr(mirror.Mirror, "begun", real)
            assert not run(plan, url).failed
        taken.update(stored(url))

    taken: dict[str, bytes] = {}
    monkeypatch.setattr(mirror.Mirror, "begun", begun)
    with pytest.raises(ArchiveInUse, match="now belongs to another run; this run stops"):
        run(plan, url)
    assert {path: data for path, data in stored(url).items()} == taken


def test_a_reader_sees_no_data_that_nothing_vouches_for(place, plan, machine, monkeypatch):
    """While a run replaces and adds cells: what ``status`` calls done reads as that run computes it, or is refused;
    never otherwise.
    """
    url = "memory:///tiny"
    run(plan, url)
    brighter = tiny_plan(place, {"camera.peak_qe": [0.3, 0.4, 0.4], "sweep.f_number": [2, 4, 8]})
    execute(brighter, machine / "new", Options("serial"))
    new = {
        n.path: n.to_dataset().compute()
        for n in etendue.open_archive(machine / "new").subtree
        if "status" in n.variables
    }
    real, puts, looked = objects.Objects.put, [0], Counter()

    def put(self, path, data, if_tag=None):
        tag = real(self, path, data, if_tag)
        puts[0] += 1
        if puts[0] % 25 == 0 and threading.current_thread() is threading.main_thread():
            try:
                tree = xarray.open_datatree(objects.zarr_store(url), engine="zarr", consolidated=False)
                there = tree["pixel/4x4"].to_dataset().compute()
            except (ValueError, KeyError):  # the axis is growing: its values are there, or its arrays
                return tag
            if there.sizes["f_number"] == 3:
                right = new["/pixel/4x4"]
                done = there.status == 0
                assert np.array_equal(there.photon_rate.where(done, 0), right.photon_rate.where(done, 0))
                looked[int(done.sum())] += 1
        return tag

    with monkeypatch.context() as patch:
        patch.setattr(objects.Objects, "put", put)
        patch.setattr(mirror, "at_once", lambda do, paths, threads=1: [do(path) for path in paths])
        run(brighter, url)
    assert looked


def test_an_archive_that_another_program_has_copied_there_is_one(plan, whole, machine):
    url = "memory:///copied"
    door = objects.Objects(url)
    for path in whole.rglob("*"):
        if path.is_file():
            door.put(path.relative_to(whole).as_posix(), path.read_bytes())
    with places.reading(url, exact=True) as folder:
        assert verify(folder).whole
    assert run(plan, url).computed == 0


def test_an_interrupted_run_leaves_the_archive_to_whoever_comes(plan, whole, machine, monkeypatch):
    url = "memory:///tiny"
    with monkeypatch.context() as patch:
        patch.setattr(mirror.Mirror, "sealed", lambda self, paths: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run(plan, url)
    assert lease.look(objects.Objects(url)).state == "left"
    elsewhere(machine, monkeypatch)
    run(plan, url)
    assert store_of(downloaded(url, machine / "copy")) == store_of(whole)


def test_stand_ins_hold_no_bytes_and_give_no_zeros(plan, machine, monkeypatch):
    """What lies on the store is fetched when it is asked for; a program that overlooks that gets an error, no zeros."""
    url = "memory:///tiny"
    run(plan, url)
    elsewhere(machine, monkeypatch)
    with places.reading(url, exact=True) as folder:
        assert (folder / SHARD).stat().st_size == len(stored(url)[SHARD])
        assert not any((folder / SHARD).read_bytes()[:64])
        with pytest.raises(Exception, match="checksum|crc32c|corrupt"):
            xarray.open_datatree(folder / "data.zarr", engine="zarr")["pixel/4x4"].photon_rate.compute()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("ftp://somewhere/x", "archives are kept in folders or at s3://bucket/prefix/name"),
        ("s3://bucket", "name an archive below a bucket"),
        ("s3://key:secret@bucket/x", "a URL must not contain keys"),
        ("memory:///a/../b", "name an archive"),
    ],
)
def test_a_url_that_is_none_is_refused_in_one_line(plan, url, words):
    with pytest.raises(RequestError, match=words) as found:
        run(plan, url)
    assert "\n" not in str(found.value) and "secret@" not in str(found.value)


def test_what_is_missing_is_said_in_one_line(plan, machine, monkeypatch):
    with (
        pytest.raises(ArchiveError, match="memory:///none is not an archive of etendue"),
        places.reading("memory:///none"),
    ):
        pass
    objects.Objects("memory:///full").put("holiday.jpg", b"x")
    with pytest.raises(ArchiveError, match="holds objects but no archive"):
        run(plan, "memory:///full")
    monkeypatch.delenv("ETENDUE_WORK")
    with pytest.raises(
        RequestError, match="workers of a cluster store results in a folder that all of them can access"
    ):
        execute(plan, "memory:///tiny", Options("tcp://127.0.0.1:1"))
    elsewhere(machine, monkeypatch)
    for name in (*objects.ROLES, "AWS_SKIP_SIGNATURE", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://127.0.0.1:9")
    with (
        pytest.raises(ArchiveError, match="no credentials found; set AWS_ACCESS_KEY_ID"),
        places.reading("s3://bucket/x"),
    ):
        pass
    monkeypatch.setitem(__import__("sys").modules, "obstore", None)
    with (
        pytest.raises(ArchiveError, match=r"need the package obstore: pip install 'etendue\[objects\]'"),
        places.reading("memory:///tiny"),
    ):
        pass


def test_the_record_is_read_while_uploads_add_to_it(tmp_path, monkeypatch):
    here = fetching.Here(tmp_path, "memory://uploads")
    here.folder.mkdir()
    here.there = {f"data.zarr/{number}": ("tag", 1, 1, 1) for number in range(3)}
    seen = []

    def state(_, path):
        """An upload ends between two looks at files."""
        here.there[f"data.zarr/{len(here.there)}"] = ("tag", 1, 1, 1)
        seen.append(path)

    monkeypatch.setattr(fetching.Here, "state", state)
    assert here.gone() == seen == ["data.zarr/0", "data.zarr/1", "data.zarr/2"]
    assert len(here.there) == 6
