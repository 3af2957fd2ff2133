"""The direct chunk writer is the fast path; zarr's own API is the reference: byte-equal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st

from etendue.archive import chunks
from etendue.archive.chunks import CellFiles, ChunkFile, decode, encode
from etendue.archive.tree import codecs
from etendue.errors import ArchiveError, ArchiveInUse
from tests.run.small import assert_same_bits

DTYPES = ("float32", "float64", "uint16", "uint8")
SHAPES = ((), (1,), (7,), (32, 32), (3, 17, 19), (5, 64, 64))


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


def by_zarr(folder, array):
    """The bytes zarr writes for an array of one chunk."""
    group = zarr.open_group(str(folder), mode="w", zarr_format=3)
    stored = group.create_array(
        "a", shape=array.shape, chunks=tuple(max(n, 1) for n in array.shape), dtype=array.dtype, compressors=codecs(),
        fill_value=0, config={"write_empty_chunks": True}, chunk_key_encoding={"name": "default", "separator": "."},
    )  # fmt: skip
    stored[...] = array
    return (folder / "a" / ".".join(["c", *["0"] * array.ndim])).read_bytes()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("kind", ["zeros", "ramp", "noise"])
def test_a_chunk_has_the_bytes_that_zarr_would_write(tmp_path, dtype, shape, kind):
    array = values(dtype, shape, kind)
    data = encode(array)
    assert data == by_zarr(tmp_path / "z", array)
    assert_same_bits(decode(data, dtype, shape), array)


@pytest.mark.parametrize("order", ["F", "reversed", "big-endian"])
def test_memory_order_and_byte_order_do_not_reach_the_disk(order):
    plain = np.random.default_rng(1).uniform(size=(8, 9))
    other = {"F": np.asfortranarray(plain), "reversed": plain[::-1].copy()[::-1], "big-endian": plain.astype(">f8")}[order]
    assert encode(other) == encode(plain)


def test_nan_and_infinity_survive():
    array = np.array([np.nan, np.inf, -np.inf, -0.0])
    assert_same_bits(decode(encode(array), "float64", (4,)), array)


@given(st.integers(0, 10**6), st.integers(0, 7))
def test_one_flipped_bit_is_found_wherever_it_is(position, bit):
    data = bytearray(encode(np.random.default_rng(2).uniform(size=(12, 12)).astype("float32")))
    data[position % len(data)] ^= 1 << bit
    with pytest.raises(ArchiveError, match="checksum"):
        decode(bytes(data), "float32", (12, 12))


@given(st.integers(0, 400))
def test_a_cut_off_chunk_is_found(length):
    data = encode(np.random.default_rng(2).uniform(size=(12, 12)))
    with pytest.raises(ArchiveError):
        decode(data[: min(length, len(data) - 1)], "float64", (12, 12))


@pytest.fixture
def target(tmp_path):
    (tmp_path / "run.id").write_text("mine")
    return CellFiles(
        str(tmp_path), "mine", (ChunkFile("a", "data.zarr/g/a/c.0", "float64", (4, 5)), ChunkFile("n", "data.zarr/g/n/c", "uint16", ()))
    )


ARRAYS = {"a": np.arange(20.0).reshape(4, 5), "n": np.array(7, "uint16")}


def test_what_is_written_is_read_and_described(target, tmp_path):
    written = target.write(ARRAYS)
    for name, array in ARRAYS.items():
        assert_same_bits(target.read(name), array)
    for one in written:
        data = (tmp_path / one.path).read_bytes()
        assert (len(data), chunks.digest_of(data)) == (one.size, one.digest)
    assert not list(tmp_path.rglob("*.partial"))


def test_a_damaged_file_is_named_when_it_is_read(target, tmp_path):
    target.write(ARRAYS)
    path = tmp_path / "data.zarr/g/a/c.0"
    data = bytearray(path.read_bytes())
    data[30] ^= 4
    path.write_bytes(data)
    with pytest.raises(ArchiveError, match=r"g/a/c\.0"):
        target.read("a")


@pytest.mark.parametrize("owner", ["another", None])
def test_a_worker_stops_when_the_archive_has_another_owner(target, tmp_path, owner):
    if owner is None:
        (tmp_path / "run.id").unlink()
    else:
        (tmp_path / "run.id").write_text(owner)
    with pytest.raises(ArchiveInUse, match="another run"):
        target.write(ARRAYS)
    assert not (tmp_path / "data.zarr").exists()


def test_a_variable_stored_by_band_is_put_together_again(target):
    bands = tuple(ChunkFile("s", f"data.zarr/g/s/c.{b}.0.0", "float32", (4, 4), b) for b in range(3))
    whole = np.random.default_rng(0).uniform(size=(3, 4, 4)).astype("float32")
    by_band = replace(target, chunks=bands)
    assert len(by_band.write({"s": whole})) == 3
    assert_same_bits(by_band.read("s"), whole)


def test_durable_writes_the_same(target):
    durable = replace(target, durable=True)
    assert durable.write(ARRAYS) == target.write(ARRAYS)
