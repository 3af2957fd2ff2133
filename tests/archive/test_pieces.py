"""Large cells in row bands: together they are the cell, each is what zarr would write, and a window costs those
under it.
"""

from __future__ import annotations

from math import prod

import numpy as np
import pytest
import zarr
from hypothesis import given
from hypothesis import strategies as st
from zarr.codecs import BloscCodec, Crc32cCodec

import etendue
from etendue.archive.read.vouched.verified_store import VouchedStore
from etendue.archive.sharding.chunks import CODEC, RAW, CellFiles, Chunk, encode
from etendue.archive.sharding.partition import Cutter, joined, pieces_of, windows_of
from etendue.archive.sharding.segments import PARTS
from etendue.archive.structure import cutting
from etendue.archive.structure.cutting import BANDS, chunk_of, chunk_shapes
from etendue.archive.structure.metadata import array_node, document
from tests.archive.tiny import index_of

SIZES = st.integers(1, 23)


@given(st.lists(SIZES, min_size=2, max_size=4), st.data())
def test_the_parts_of_a_cell_are_disjoint_and_together_the_cell(shape, data):
    shape = tuple(shape)
    chunk = tuple(data.draw(st.integers(1, n), label="chunk") for n in shape)
    array = np.arange(prod(shape), dtype="float32").reshape(shape)
    windows = windows_of(shape, chunk)
    assert len(windows) == pieces_of(shape, chunk) == prod(chunk_shapes(shape, (), chunk)[1]) // prod(chunk)
    cutter = Cutter(array)
    assert sum(cutter.part(window).size for window in windows) == array.size
    parts = [(window, cutter.chunk(window, shape if window is None else chunk)) for window in windows]
    assert all(part.shape == chunk or len(parts) == 1 for _, part in parts)
    np.testing.assert_array_equal(joined(parts, windows), array)


@given(rows=st.integers(1, 5000), columns=st.integers(1, 300), channels=st.integers(1, 3))
def test_a_band_holds_a_quarter_of_the_largest_chunk_or_is_a_row(rows, columns, channels):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cutting, "LARGEST_CHUNK", 40_000)
        shape = (channels, rows, columns)
        chunk = chunk_of(("channel", "y", "x"), shape, 4)
    if 4 * prod(shape) <= 40_000:
        assert chunk == shape
    else:
        assert chunk[1] == 1 or 4 * prod(chunk) <= 40_000 / BANDS + 4 * columns * channels
        assert chunk_shapes(shape, (), chunk)[1][1] - rows < chunk[1]


@pytest.mark.parametrize("codec", [CODEC, RAW])
@pytest.mark.parametrize(
    ("shape", "chunk"), [((3, 8, 5), (3, 4, 5)), ((3, 7, 5), (3, 3, 5)), ((2, 7, 5), (1, 3, 5))], ids=str
)
def test_every_band_and_the_metadata_are_zarrs(tmp_path, shape, chunk, codec):
    """Also of rows that do not come out even: the last band goes on in fill values."""
    array = np.random.default_rng(5).uniform(size=(2, *shape)).astype("float32")
    chunks, shards = chunk_shapes(shape, (2,), chunk)
    packed = (
        [Crc32cCodec()] if codec == RAW else [BloscCodec(cname="lz4", clevel=5, shuffle="bitshuffle"), Crc32cCodec()]
    )
    group = zarr.open_group(str(tmp_path / "z"), mode="w", zarr_format=3)
    theirs = group.create_array(
        "a",
        shape=array.shape,
        dtype="float32",
        chunks=chunks,
        shards=shards,
        compressors=packed,
        fill_value=np.nan,
        dimension_names=("f_number", "channel", "y", "x"),
        chunk_key_encoding={"name": "default", "separator": "."},
    )
    theirs[...] = array
    node = array_node("float32", array.shape, chunks, shards, codec, ("f_number", "channel", "y", "x"), ".", {})
    assert document(node) == (tmp_path / "z/a/zarr.json").read_bytes()
    data = (tmp_path / "z/a/c.0.0.0.0").read_bytes()
    windows, cells = windows_of(shape, chunk), [Cutter(cell) for cell in array]
    index = index_of(data, 2 * len(windows))
    assert len(index) == 2 * len(windows)
    for slot, (at, size) in index.items():
        window = windows[slot % len(windows)]
        assert data[at : at + size] == encode(cells[slot // len(windows)].chunk(window, chunk), codec)


def test_light_made_by_wavelength_is_asked_for_each_plane_once(tmp_path):
    whole, asked = np.random.default_rng(0).uniform(size=(3, 7, 4)).astype("float32"), []

    class Light:
        def __getitem__(self, band):
            asked.append(band)
            return whole[band]

    (tmp_path / "run.id").write_text("mine")
    windows = windows_of(whole.shape, (1, 3, 4))
    chunks = tuple(
        Chunk("s", "data.zarr/g/s/c.0.0.0", n, 9, "float32", (1, 3, 4), RAW, window) for n, window in enumerate(windows)
    )
    target = CellFiles(str(tmp_path), "mine", chunks)
    assert len(target.write({"s": Light()})) == 9
    assert asked == [0, 1, 2]
    np.testing.assert_array_equal(target.read("s"), whole)
    np.testing.assert_array_equal(target.read_band("s", 1), whole[1])
    PARTS.close(str(tmp_path))


def test_who_reads_a_window_reads_the_bands_under_it(whole, monkeypatch):
    read, chunk_of_cell = [], VouchedStore.chunk
    monkeypatch.setattr(
        VouchedStore, "chunk", lambda self, chunk, files: read.append(chunk.window) or chunk_of_cell(self, chunk, files)
    )
    everything = etendue.open_archive(whole)["scene/radiance"].values
    radiance = etendue.open_archive(whole)["scene/radiance"]  # which has read nothing yet
    bands = len(read)
    assert bands > 2
    read.clear()
    y = radiance.dims.index("y")
    size = radiance.sizes["y"] // bands
    np.testing.assert_array_equal(radiance.isel(y=slice(0, size)).values, np.take(everything, range(size), axis=y))
    assert [window[y] for window in read] == [(0, size)]
