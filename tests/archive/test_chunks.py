"""What is appended chunk by chunk is what zarr's own API writes: every chunk byte for byte, and a shard as a whole."""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from math import prod

import numpy as np
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from zarr.codecs import BloscCodec, Crc32cCodec

from etendue.archive.records import disk
from etendue.archive.sharding.chunks import CODEC, LEVEL, RAW, CellFiles, Chunk, decode, encode
from etendue.archive.sharding.partition import pieces_of
from etendue.archive.sharding.segments import GATHERED, PARTS, ShardSegment
from etendue.archive.sharding.shards import (
    MOST,
    ChunkPlace,
    block_of,
    index_bytes,
    index_size,
    part_path,
    put_shard,
    read_index,
)
from etendue.errors import ArchiveError, ArchiveInUse
from tests.archive.tiny import index_of
from tests.run.small import assert_same_bits

DTYPES = ("float32", "float64", "uint16", "uint8")
SHAPES = ((), (1,), (7,), (32, 32), (3, 17, 19), (5, 64, 64))
CODECS = (CODEC, RAW)


def values(dtype, shape, kind):
    rng = np.random.default_rng(5)
    if kind == "zeros":
        return np.zeros(shape, dtype)
    if kind == "noise":
        return (rng.uniform(0, 200, shape)).astype(dtype)
    return (
        np.broadcast_to(np.arange(shape[-1] if shape else 1, dtype=dtype)[: shape[-1] if shape else 1], shape).copy()
        if shape
        else np.array(3, dtype)
    )


def codecs(kind):
    return [*([] if kind == RAW else [BloscCodec(cname=CODEC, clevel=LEVEL, shuffle="bitshuffle")]), Crc32cCodec()]


def by_zarr(folder, array, codec, chunks=None):
    """The bytes zarr writes for an array in one file: a chunk, or a shard of such chunks."""
    group = zarr.open_group(str(folder), mode="w", zarr_format=3)
    whole = tuple(max(n, 1) for n in array.shape)
    stored = group.create_array(
        "a",
        shape=array.shape,
        chunks=chunks or whole,
        shards=whole if chunks else None,
        dtype=array.dtype,
        compressors=codecs(codec),
        fill_value=0,
        config={"write_empty_chunks": True},
        chunk_key_encoding={"name": "default", "separator": "."},
    )
    stored[...] = array
    return (folder / "a" / ".".join(["c", *["0"] * array.ndim])).read_bytes()


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("kind", ["zeros", "ramp", "noise"])
def test_a_chunk_has_the_bytes_that_zarr_would_write(tmp_path, dtype, shape, kind, codec):
    array = values(dtype, shape, kind)
    data = encode(array, codec)
    assert data == by_zarr(tmp_path / "z", array, codec)
    assert_same_bits(decode(data, dtype, shape, codec), array)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("order", ["F", "reversed", "big-endian"])
def test_memory_order_and_byte_order_do_not_reach_the_disk(order, codec):
    plain = np.random.default_rng(1).uniform(size=(8, 9))
    other = {"F": np.asfortranarray(plain), "reversed": plain[::-1].copy()[::-1], "big-endian": plain.astype(">f8")}[
        order
    ]
    assert encode(other, codec) == encode(plain, codec)


def test_nan_and_infinity_survive():
    array = np.array([np.nan, np.inf, -np.inf, -0.0])
    for codec in CODECS:
        assert_same_bits(decode(encode(array, codec), "float64", (4,), codec), array)


@given(st.integers(0, 10**6), st.integers(0, 7), st.sampled_from(CODECS))
def test_one_flipped_bit_is_found_wherever_it_is(position, bit, codec):
    data = bytearray(encode(np.random.default_rng(2).uniform(size=(12, 12)).astype("float32"), codec))
    data[position % len(data)] ^= 1 << bit
    with pytest.raises(ArchiveError, match="checksum"):
        decode(bytes(data), "float32", (12, 12), codec)


@given(st.integers(0, 400), st.sampled_from(CODECS))
def test_a_cut_off_chunk_is_found(length, codec):
    data = encode(np.random.default_rng(2).uniform(size=(12, 12)), codec)
    with pytest.raises(ArchiveError):
        decode(data[: min(length, len(data) - 1)], "float64", (12, 12), codec)


# -- shards --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("axes", [(3,), (2, 3), (2, 1, 4)], ids=str)
def test_a_shard_holds_what_zarr_would_put_into_it(tmp_path, axes, codec):
    """Every chunk byte for byte; their order is that in which they were written, where zarr's is Morton's."""
    array = np.random.default_rng(3).integers(0, 99, (*axes, 5, 7)).astype("uint16")
    theirs = by_zarr(tmp_path / "z", array, codec, chunks=(*(1 for _ in axes), 5, 7))
    slots = prod(axes)
    write(tmp_path / "a", array, codec, axes, np.random.default_rng(1).permutation(slots))
    ours = (tmp_path / "a" / PATH).read_bytes()
    assert len(ours) == len(theirs)
    mine, wanted = index_of(ours, slots), index_of(theirs, slots)
    assert {s: ours[at : at + n] for s, (at, n) in mine.items()} == {
        s: theirs[at : at + n] for s, (at, n) in wanted.items()
    }
    (tmp_path / "z/a" / PATH.rpartition("/")[2]).write_bytes(ours)
    assert_same_bits(zarr.open_array(str(tmp_path / "z/a"), mode="r")[...], array)


PATH = "data.zarr/g/v/c.0.0.0"


def target_of(folder, chunks, **more):
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "run.id").exists():
        (folder / "run.id").write_text("mine")
    return CellFiles(str(folder), "mine", chunks, **more)


def write(folder, array, codec, axes, order):
    """Cells in some order, then their shard."""
    flat, slots, found = array.reshape(-1, *array.shape[len(axes) :]), prod(axes), {}
    for slot in order:
        chunk = Chunk("v", PATH, int(slot), slots, str(array.dtype), array.shape[len(axes) :], codec)
        target = target_of(folder, (chunk,))
        (written,) = target.write({"v": flat[slot]})
        target.settle()
        found[int(slot)] = written, ChunkPlace(part_path(written), written.offset, written.size, written.digest)
    PARTS.close(str(folder))
    return put_shard(folder, PATH, slots, found)


def test_a_shard_of_some_cells_reads_as_missing_elsewhere(tmp_path):
    array = np.arange(4 * 6, dtype="float32").reshape(4, 2, 3)
    by_zarr(tmp_path / "z", array, RAW, chunks=(1, 2, 3))
    write(tmp_path / "a", array, RAW, (4,), [3, 1])
    (tmp_path / "z/a/c.0.0.0").write_bytes((tmp_path / "a" / PATH).read_bytes())
    found = zarr.open_array(str(tmp_path / "z/a"), mode="r")[...]
    np.testing.assert_array_equal(found[[1, 3]], array[[1, 3]])
    assert not found[[0, 2]].any()  # the fill value of this array


@given(st.lists(st.integers(1, 300), max_size=4), st.integers(1, 1 << 28), st.integers(1, 40))
@settings(max_examples=200)
def test_every_cell_has_one_slot_and_no_shard_too_many(sizes, cell_bytes, pieces):
    block = block_of(tuple(sizes), cell_bytes, pieces, 64 << 20)
    assert all(1 <= own <= size for own, size in zip(block, sizes, strict=True))
    assert prod(block) * pieces <= max(MOST, pieces)
    assert prod(block) * cell_bytes <= max(64 << 20, cell_bytes)
    cut = [own < size for own, size in zip(block, sizes, strict=True)]
    whole = sum(cut) and max(n for n, one in enumerate(cut) if one)
    assert all(own == 1 for own in block[:whole])  # innermost axes first
    assert pieces_of(tuple(sizes), block) * prod(block) >= prod(sizes)


@given(st.dictionaries(st.integers(0, 9), st.tuples(st.integers(0, 1 << 40), st.integers(0, 1 << 32))))
def test_an_index_says_where_chunks_lie_and_a_flipped_bit_of_it_is_found(tmp_path_factory, places):
    path = tmp_path_factory.getbasetemp() / "index"
    data = index_bytes(10, places)
    path.write_bytes(b"chunks" + data)
    assert len(data) == index_size(10)
    assert read_index(path, 10) == (6 + len(data), places)
    flipped = bytearray(data)
    flipped[sum(map(sum, places.values())) % len(data)] ^= 1
    path.write_bytes(b"chunks" + flipped)
    assert read_index(path, 10) == (6 + len(data), None)


# -- parts ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def target(tmp_path):
    chunks = (
        Chunk("a", "data.zarr/g/a/c.0.0.0", 0, 3, "float64", (4, 5)),
        Chunk("n", "data.zarr/g/n/c", 0, 0, "uint16", ()),
    )
    yield target_of(tmp_path / "t", chunks)
    PARTS.close(str(tmp_path / "t"))


ARRAYS = {"a": np.arange(20.0).reshape(4, 5), "n": np.array(7, "uint16")}


def test_what_is_written_is_read_and_described(target):
    written = target.write(ARRAYS)
    target.settle()
    for name, array in ARRAYS.items():
        assert_same_bits(target.read(name), array)
    for one, name in zip(written, ARRAYS, strict=True):
        with open(f"{target.root}/{part_path(one)}", "rb") as file:
            file.seek(one.offset)
            assert file.read(one.size) == encode(ARRAYS[name])


def test_a_damaged_chunk_is_named_when_it_is_read(target):
    (one, _) = target.write(ARRAYS)
    target.settle()
    with open(f"{target.root}/{part_path(one)}", "r+b") as file:
        file.seek(one.offset + 30)
        file.write(b"\x01\x02")
    with pytest.raises(ArchiveError, match=r"g/a/c\.0.*checksum"):
        target.read("a")


@pytest.mark.parametrize("owner", ["another", None])
def test_a_worker_stops_when_the_archive_has_another_owner(target, tmp_path, owner):
    run_id = tmp_path / "t/run.id"
    run_id.unlink()
    if owner is not None:
        run_id.write_text(owner)
    with pytest.raises(ArchiveInUse, match="another run"):
        target.write(ARRAYS)
    assert not (tmp_path / "t/data.zarr").exists()


def test_a_worker_whose_archive_is_taken_over_in_the_middle_reports_nothing(target, tmp_path):
    target.write(ARRAYS)
    (tmp_path / "t/run.id").write_text("another")
    with pytest.raises(ArchiveInUse, match="another run"):
        target.settle()


def test_a_variable_stored_by_band_is_put_together_again(target):
    bands = tuple(
        Chunk("s", "data.zarr/g/s/c.0.0.0", b, 3, "float32", (1, 4, 4), RAW, ((b, b + 1), (0, 4), (0, 4)))
        for b in range(3)
    )
    whole = np.random.default_rng(0).uniform(size=(3, 4, 4)).astype("float32")
    by_band = replace(target, chunks=bands)
    assert len(by_band.write({"s": whole})) == 3
    assert_same_bits(by_band.read("s"), whole)


def test_durable_writes_the_same(target):
    durable = replace(target, durable=True)
    assert [(w.size, w.digest) for w in durable.write(ARRAYS)] == [(w.size, w.digest) for w in target.write(ARRAYS)]


@pytest.mark.parametrize("size", [8, GATHERED // 8 + 1], ids=["gathered", "at once"])
def test_threads_that_share_a_part_lose_nothing(tmp_path, size):
    """Sixteen threads, forty cells each, one shard."""
    arrays = np.random.default_rng(0).uniform(size=(640, size))
    found = {}

    target_of(tmp_path, ())

    def work(first):
        for slot in range(first, 640, 16):
            target = target_of(tmp_path, (Chunk("v", PATH, slot, 640, "float64", (size,), RAW),))
            (one,) = target.write({"v": arrays[slot]})
            if slot % 5 == 0:
                target.settle()
            found[slot] = one, ChunkPlace(part_path(one), one.offset, one.size, one.digest)
        target.settle()

    threads = [threading.Thread(target=work, args=(n,)) for n in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({place.file for _, place in found.values()}) == 1
    PARTS.close(str(tmp_path))
    put = put_shard(tmp_path, PATH, 640, found)
    assert put.copied == 0
    data = (tmp_path / PATH).read_bytes()
    for slot, (at, length) in index_of(data, 640).items():
        assert_same_bits(decode(data[at : at + length], "float64", (size,), RAW), arrays[slot])


def test_a_thread_has_settled_when_its_chunks_stand_in_the_file_whoever_settles_them(tmp_path, monkeypatch):
    """Two threads append to one part; while one settles it the other may not tell of its cell: a shard would be made
    without it.
    """
    first, second = (target_of(tmp_path, (Chunk("v", PATH, slot, 2, "float64", (3,), RAW),)) for slot in (0, 1))
    for target in (first, second):
        target.write({"v": np.arange(3.0)})
    under_way, go, put = threading.Event(), threading.Event(), ShardSegment._put

    def held(part, pieces, size):
        under_way.set()
        assert go.wait(60)
        put(part, pieces, size)

    monkeypatch.setattr(ShardSegment, "_put", held)
    one, other = threading.Thread(target=first.settle), threading.Thread(target=second.settle)
    one.start()
    assert under_way.wait(60)
    other.start()
    other.join(0.1)
    assert other.is_alive()
    go.set()
    one.join()
    other.join()
    (part,) = (tmp_path / PATH).parent.glob("*.part")
    assert part.stat().st_size == 2 * (3 * 8 + 4)
    PARTS.close(str(tmp_path))


def test_parts_of_several_processes_become_one_shard(tmp_path):
    """What a second and third process have written is appended to the largest part."""
    array, found = np.random.default_rng(0).uniform(size=(9, 600)), {}
    for slot in range(9):
        target = target_of(tmp_path, (Chunk("v", PATH, slot, 9, "float64", (600,), RAW),))
        (one,) = target.write({"v": array[slot]})
        target.settle()
        found[slot] = one, ChunkPlace(part_path(one), one.offset, one.size, one.digest)
        if slot in (1, 6):
            PARTS.close(str(tmp_path))  # as another process, which begins a part of its own
    PARTS.close(str(tmp_path))
    put = put_shard(tmp_path, PATH, 9, found)
    assert put.copied == 4 * 4804
    for slot, (one, _) in found.items():
        at = put.shard.at(one)
        assert (at, one.size) == put.places[slot]
        assert_same_bits(
            decode((tmp_path / PATH).read_bytes()[at : at + one.size], "float64", (600,), RAW), array[slot]
        )


def test_a_part_that_has_become_a_shard_is_left_alone(tmp_path):
    """A worker that was left behind computes a cell again: the shard keeps its bytes."""
    write(tmp_path, np.arange(6.0).reshape(2, 3), RAW, (2,), [0])
    target = target_of(tmp_path, (Chunk("v", PATH, 1, 2, "float64", (3,), RAW),))
    (first,) = target.write({"v": np.arange(3.0)})
    target.settle()
    put_shard(tmp_path, PATH, 2, {1: (first, ChunkPlace(part_path(first), first.offset, first.size, first.digest))})
    before = (tmp_path / PATH).read_bytes()
    (again,) = target.write({"v": np.arange(3.0)})
    target.settle()
    assert again.part != first.part
    assert (tmp_path / PATH).read_bytes() == before
    PARTS.close(str(tmp_path))


def test_a_part_with_a_second_name_is_copied(tmp_path):
    """A backup of hard links keeps its bytes."""
    target = target_of(tmp_path, (Chunk("v", PATH, 0, 1, "float64", (3,), RAW),))
    (one,) = target.write({"v": np.arange(3.0)})
    target.settle()
    PARTS.close(str(tmp_path))
    os.link(tmp_path / part_path(one), tmp_path / "backup")
    before = (tmp_path / "backup").read_bytes()
    put_shard(tmp_path, PATH, 1, {0: (one, ChunkPlace(part_path(one), one.offset, one.size, one.digest))})
    assert (tmp_path / "backup").read_bytes() == before
    assert index_of((tmp_path / PATH).read_bytes(), 1) == {0: (0, one.size)}


def test_a_full_disk_leaves_what_was_written(tmp_path, monkeypatch):
    target = target_of(tmp_path, (Chunk("v", PATH, 0, 2, "float64", (GATHERED,), RAW),))
    (one,) = target.write({"v": np.zeros(GATHERED)})
    whole = disk.write_at

    def full(handle, pieces, offset):
        whole(handle, [bytes(100)], offset)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(disk, "write_at", full)
    with pytest.raises(OSError, match="No space"):
        target.write({"v": np.ones(GATHERED)})
    monkeypatch.undo()
    assert os.stat(tmp_path / part_path(one)).st_size == one.size
    (two,) = target.write({"v": np.ones(GATHERED)})
    assert (two.part, two.offset) == (one.part, one.size)
    PARTS.close(str(tmp_path))
