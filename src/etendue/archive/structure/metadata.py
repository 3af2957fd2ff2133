"""Metadata of groups and arrays exactly as zarr writes it, without a store and its event loop.

In:  attributes, shapes, dims, codecs.
Out: the text of ``zarr.json``; chunks of texts. Tests check that they equal the output of zarr's own API.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping, Sequence
from typing import TypeVar

import google_crc32c
import numpy as np

from etendue.archive.records.indented import indented
from etendue.archive.sharding.chunks import LEVEL, RAW
from etendue.archive.sharding.unfolding import refuse_unfolding
from etendue.errors import ArchiveError
from etendue.types.documents import Document, DocumentView

CRC = {"name": "crc32c"}
TEXT = "text"
T = TypeVar("T")


def document(node: DocumentView) -> bytes:
    """Return a node as zarr writes it."""
    return indented(node, 2)


def array_node(
    dtype: str,
    shape: Sequence[int],
    chunks: Sequence[int],
    shards: Sequence[int] | None,
    codec: str,
    dims: Sequence[str],
    separator: str,
    attrs: DocumentView,
) -> Document:
    """Return an array whose chunks, or shards of chunks, are checksummed; ``dtype`` is a numpy dtype or ``text``."""
    text = dtype == TEXT
    kind = np.dtype("u1" if text else dtype)
    inner = _text_codecs() if text else _codecs(kind, codec)
    if shards is not None:
        little = {"name": "bytes", "configuration": {"endian": "little"}}
        sharding = {
            "chunk_shape": list(chunks),
            "codecs": inner,
            "index_codecs": [little, CRC],
            "index_location": "end",
        }
        inner = [{"name": "sharding_indexed", "configuration": sharding}]
    return {
        "shape": list(shape),
        "data_type": "string" if text else kind.name,
        "chunk_grid": {
            "name": "regular",
            "configuration": {"chunk_shape": list(shards if shards is not None else chunks)},
        },
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": separator}},
        "fill_value": "" if text else "NaN" if kind.kind == "f" else 0,
        "codecs": inner,
        "attributes": dict(attrs),
        **({"dimension_names": list(dims)} if dims else {}),
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }


def _codecs(kind: np.dtype[np.generic], codec: str) -> list[Document]:
    first: Document = (
        {"name": "bytes"} if kind.itemsize == 1 else {"name": "bytes", "configuration": {"endian": "little"}}
    )
    if codec == RAW:
        return [first, CRC]
    blosc = {"typesize": kind.itemsize, "cname": codec, "clevel": LEVEL, "shuffle": "bitshuffle", "blocksize": 0}
    return [first, {"name": "blosc", "configuration": blosc}, CRC]


def _text_codecs() -> list[Document]:
    return [
        {"name": "vlen-utf8", "configuration": {}},
        {"name": "zstd", "configuration": {"level": 0, "checksum": False}},
        CRC,
    ]


def text_chunk(texts: Sequence[str]) -> bytes:
    """Return the single chunk of an array of texts, in C order."""
    from numcodecs import VLenUTF8, Zstd

    body = Zstd(level=0).encode(VLenUTF8().encode(np.array([*texts, None], dtype=object)[:-1]))
    return bytes(body) + int(google_crc32c.value(bytes(body))).to_bytes(4, "little")


def texts_of(data: bytes) -> list[str]:
    """Return the texts in a chunk of texts.

    Raises
    ------
    ArchiveError
        The chunk does not hold texts.
    """
    from numcodecs import VLenUTF8, Zstd

    body, checksum = data[:-4], data[-4:]
    if int(google_crc32c.value(body)).to_bytes(4, "little") != checksum:
        raise ArchiveError("the stored bytes do not match their checksum")
    refuse_unfolding(body)
    try:
        texts = Zstd().decode(body)
        if 4 * int.from_bytes(bytes(texts[:4]), "little") > len(texts):  # each begins with its length
            raise ValueError("the chunk states more strings than its bytes can hold")
        return list(map(str, VLenUTF8().decode(texts)))
    except (RuntimeError, ValueError, TypeError) as error:
        raise ArchiveError(f"the stored bytes cannot be decoded as strings: {error}") from None


def consolidated(nodes: Mapping[str, DocumentView]) -> Document:
    """Return the root with the metadata of all nodes, by path; '' is the root itself."""
    found = {}
    for path, node in in_order(nodes).items():
        if path:
            found[path] = dict(node)
            if found[path]["node_type"] == "group":
                found[path] = _with(found[path], {})
    return _with(nodes[""], found)


def in_order(nodes: Mapping[str, T]) -> dict[str, T]:
    """Return nodes by path in the order in which zarr writes them."""
    order = sorted(nodes, key=lambda path: (path.count("/"), unicodedata.normalize("NFKC", path).casefold()))
    return {path: nodes[path] for path in order}


def _with(group: DocumentView, members: DocumentView) -> Document:
    inline = {"kind": "inline", "must_understand": False, "metadata": members}
    return {"attributes": group["attributes"], "zarr_format": 3, "consolidated_metadata": inline, "node_type": "group"}
