"""Metadata written here is, byte for byte, what zarr's own API writes of the same arrays and groups."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, ZstdCodec

from etendue.archive.structure.metadata import text_chunk


def compressors(codecs):
    made = {
        "blosc": lambda c: BloscCodec(cname=c["cname"], clevel=c["clevel"], shuffle=c["shuffle"]),
        "zstd": lambda c: ZstdCodec(**c),
        "crc32c": lambda c: Crc32cCodec(),
    }
    return [made[one["name"]](one.get("configuration")) for one in codecs if one["name"] in made]


def test_metadata_of_every_array_and_group_is_zarrs(whole, tmp_path):
    root = zarr.open_group(str(tmp_path / "z"), mode="w", zarr_format=3)
    seen = {"array": 0, "group": 0, "sharded": 0, "text": 0}
    for path in sorted((whole / "data.zarr").rglob("zarr.json")):
        document = json.loads(path.read_text())
        seen[document["node_type"]] += 1
        if document["node_type"] == "group":
            document.pop("consolidated_metadata", None)
            made = root.create_group(f"g{seen['group']}", attributes=document["attributes"])
            if path.parent.name != "data.zarr":
                assert (tmp_path / "z" / made.path / "zarr.json").read_bytes() == path.read_bytes()
            continue
        outer, codecs = tuple(document["chunk_grid"]["configuration"]["chunk_shape"]), document["codecs"]
        sharding = codecs[0]["configuration"] if codecs[0]["name"] == "sharding_indexed" else None
        text = document["data_type"] == "string"
        seen["sharded"] += sharding is not None
        seen["text"] += text
        fill = document["fill_value"]
        root.create_array(
            "a",
            shape=document["shape"],
            chunks=tuple(sharding["chunk_shape"]) if sharding else outer,
            shards=outer if sharding else None,
            dtype=str if text else document["data_type"],
            fill_value=np.nan if fill == "NaN" else fill,
            compressors=compressors(sharding["codecs"] if sharding else codecs),
            dimension_names=document.get("dimension_names", ()),
            attributes=document["attributes"],
            chunk_key_encoding=document["chunk_key_encoding"]["configuration"] | {"name": "default"},
            overwrite=True,
        )
        assert (tmp_path / "z/a/zarr.json").read_bytes() == path.read_bytes(), path
    assert min(seen.values()) > 5


@pytest.mark.filterwarnings("ignore:.*[Cc]onsolidated metadata.*")
def test_consolidated_metadata_is_zarrs(whole, tmp_path):
    shutil.copytree(whole / "data.zarr", tmp_path / "z")
    document = json.loads((tmp_path / "z/zarr.json").read_text())
    del document["consolidated_metadata"]
    (tmp_path / "z/zarr.json").write_text(json.dumps(document))
    zarr.consolidate_metadata(str(tmp_path / "z"))
    assert (tmp_path / "z/zarr.json").read_bytes() == (whole / "data.zarr/zarr.json").read_bytes()


@pytest.mark.parametrize(
    "texts", [["one"], ["", ""], ["äöü", "x" * 3000, "日本"], [f"cell {n}" for n in range(500)]], ids=len
)
def test_texts_are_encoded_as_zarr_does_and_a_flipped_bit_is_found(tmp_path, texts):
    stored = zarr.create_array(
        str(tmp_path / "z"),
        shape=(len(texts),),
        chunks=(len(texts),),
        dtype=str,
        compressors=[ZstdCodec(level=0), Crc32cCodec()],
        config={"write_empty_chunks": True},
    )
    stored[...] = np.array(texts, dtype=object)
    assert (tmp_path / "z/c/0").read_bytes() == text_chunk(texts)
    data = bytearray(text_chunk(texts))
    data[len(data) // 2] ^= 1
    (tmp_path / "z/c/0").write_bytes(data)
    with pytest.raises(ValueError, match="checksum"):
        stored[...]
