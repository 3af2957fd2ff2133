"""What a Zarr store must be before its numbers count as light: whole, of the right dims and units, finite, nowhere
below 0.

In:  a store, an array in it, values that were read.
Out: nothing, or a ValueError that names the file, what it holds and what is allowed.

A chunk that is not there reads as the fill value without an error, so every chunk is looked for: one listing of the
array's folder (0.1 s for 10,000 chunks) and 16 bytes a chunk of every shard's index.
"""

from __future__ import annotations

import itertools
import math
import os
import stat
import struct
from pathlib import Path
from typing import Any

import numpy as np

from etendue import plain_files, require
from etendue.contract.bounds import MOST_POINTS, MOST_VALUES, beyond
from etendue.contract.units import UnitError, parse_unit
from etendue_camera.arrays import FloatArray

DIMS = ("wavelength", "y", "x")
MOST_CHUNKS = 1_000_000
MISSING = 2**64 - 1  # offset and length of a chunk that a shard does not hold


def refuse_links(path: str) -> None:
    """Links inside a store lead out of it: what is read would not be what is kept and hashed. Pipes are never read."""
    for folder, names, files in os.walk(path):
        for name in (*names, *files):
            kind = os.lstat(own := os.path.join(folder, name)).st_mode
            if stat.S_ISLNK(kind):
                raise ValueError(f"{path} holds a link, {os.path.relpath(own, path)}; copy what it points to there")
            if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):
                raise ValueError(f"{path} holds what is no plain file, {os.path.relpath(own, path)}; take it out")


def check_array(path: str, variable: str, array: Any, unit: str) -> None:
    """Dims, size, dtype, packing and, where one is given, unit."""
    shape = getattr(array, "shape", ())
    require.that(len(shape) == 3, f"{variable} in {path} must have the dims wavelength, y, x; it has the shape {shape}")
    attributes = dict(array.attrs)
    names = tuple(getattr(array.metadata, "dimension_names", None) or attributes.get("_ARRAY_DIMENSIONS") or DIMS)
    require.that(
        names == DIMS,
        f"{variable} in {path} must have the dims wavelength, y, x in this order; it has {', '.join(map(str, names))}",
    )
    for dim, size in zip(DIMS, shape, strict=True):
        text = beyond(size, f"points along {dim}", MOST_POINTS, "cut it") or ("" if size else f"no points along {dim}")
        require.that(not text, f"{variable} in {path} has {text}")
    too_many = beyond(math.prod(shape), "values", MOST_VALUES, "cut it")
    require.that(not too_many, f"{variable} in {path} has {too_many}")
    require.that(
        getattr(array.dtype, "kind", "?") in "fiu",
        f"{variable} in {path} holds {array.dtype}; allowed are floats and integers",
    )
    packed = [name for name in ("scale_factor", "add_offset") if name in attributes]
    require.that(
        not packed,
        f"{variable} in {path} is packed ({', '.join(packed)}), and its packed numbers would be read; store it as "
        f"floats",
    )
    _check_unit(variable, path, attributes, unit)


def _check_unit(name: str, path: str, attributes: Any, unit: str) -> None:
    written = attributes.get("units")
    if not unit or written is None:
        return
    try:
        same = parse_unit(str(written)) == parse_unit(unit)
    except UnitError:
        same = False
    require.that(same, f"{name} in {path} is in {str(written)!r}; allowed is {unit!r}: convert it")


def values_of(path: str, group: Any, name: str, shape: tuple[int, ...], unit: str) -> FloatArray:
    """A coordinate, whole and finite."""
    array = group[name]
    if getattr(array, "shape", None) != shape:
        raise ValueError(f"{name} has the shape {getattr(array, 'shape', ())}; its cube asks for {shape}")
    _check_unit(name, path, dict(array.attrs), unit)
    check_chunks(path, name, array)
    try:
        values = np.asarray(array[...], dtype=float)
    except Exception as error:
        raise ValueError(f"{name} cannot be read: {' '.join(str(error).split())[:150]}") from None
    if not np.isfinite(values).all():
        raise ValueError(f"{name} holds {int((~np.isfinite(values)).sum())} values that are NaN or infinite")
    return values


def check_chunks(path: str, variable: str, array: Any) -> None:
    """Refuse an array of which a chunk is not there."""
    outer = getattr(array, "shards", None) or array.chunks
    counts = [-(-size // chunk) for size, chunk in zip(array.shape, outer, strict=True)]
    inner = [-(-size // chunk) for size, chunk in zip(array.shape, array.chunks, strict=True)]
    too_many = beyond(math.prod(inner), "chunks", MOST_CHUNKS, "make them larger")
    require.that(not too_many, f"{variable} in {path} has {too_many}")
    there = _names(Path(path) / str(array.path))
    folder = str(array.path).strip("/")
    for place in itertools.product(*map(range, counts)):
        own = array.metadata.encode_chunk_key(place)
        key = f"{folder}/{own}".lstrip("/")
        if own not in there:
            raise ValueError(_missing(path, key, array))
        if not getattr(array, "shards", None):
            _check_size(Path(path) / key, math.prod(array.chunks) * array.dtype.itemsize)
        if getattr(array, "shards", None):
            lost = _lost_inside(Path(path) / key, array)
            if lost:
                raise ValueError(_missing(path, f"{key} (chunk {lost} of it)", array))


def _check_size(chunk: Path, size: int) -> None:
    """Refuse a chunk that says it unfolds to more than its numbers are."""
    said, length = plain_files.size_unfolded(chunk)
    if (said is not None and said > 2 * size + plain_files.SMALL) or length > 2 * size + plain_files.SMALL:
        raise ValueError(f"{chunk} unfolds to {said} bytes, from {length}; its numbers are {size}")


def _missing(path: str, key: str, array: Any) -> str:
    return (
        f"{path} lacks the chunk {key}, which would read as {array.fill_value}; restore it, or, if all of it has that "
        f"value, "
        "write the store with empty chunks (write_empty_chunks = True)"
    )


def _names(path: Path) -> set[str]:
    """Every file of an array, by its path inside."""
    return {
        os.path.relpath(os.path.join(folder, name), path).replace(os.sep, "/")
        for folder, _, files in os.walk(path)
        for name in files
    }


def _lost_inside(shard: Path, array: Any) -> str:
    """The first chunk that a shard's index says is not there and that lies inside the array's shape, or ''."""
    codec = next((c for c in array.metadata.codecs if type(c).__name__ == "ShardingCodec"), None)
    if codec is None or [type(c).__name__ for c in codec.index_codecs] != ["BytesCodec", "Crc32cCodec"]:
        return ""
    counts = [outer // chunk for outer, chunk in zip(array.shards, array.chunks, strict=True)]
    place = [int(part) for part in str(shard).replace(".", "/").split("/")[-3:] if part.isdigit()]
    length = 16 * math.prod(counts) + 4
    with shard.open("rb") as file:
        if getattr(codec.index_location, "value", codec.index_location) == "end":  # an enumeration, or its text
            file.seek(-length, os.SEEK_END)
        index = struct.unpack(f"<{2 * math.prod(counts)}Q", file.read(length)[:-4])
    for number, inside in enumerate(itertools.product(*map(range, counts))):
        starts = [
            p * outer + i * chunk for p, outer, i, chunk in zip(place, array.shards, inside, array.chunks, strict=True)
        ]
        if index[2 * number] == MISSING and all(start < size for start, size in zip(starts, array.shape, strict=True)):
            return "/".join(map(str, inside))
    return ""


def check_values(path: str, variable: str, light: FloatArray, bands: range) -> None:
    """Refuse NaN, infinity and negative radiance, with the first place."""
    with np.errstate(invalid="ignore"):
        if light.size == 0 or (np.isfinite(light.min()) and np.isfinite(light.max()) and light.min() >= 0):
            return
        bad = ~(np.isfinite(light) & (light >= 0))
    band, row, column = np.unravel_index(int(np.argmax(bad)), bad.shape)
    raise ValueError(
        f"{variable} in {path} holds {float(light[band, row, column]):g} in band {bands[int(band)]}, row {row}, column "
        f"{column} "
        f"({int(bad.sum())} such values); radiance is finite and nowhere below 0"
    )
