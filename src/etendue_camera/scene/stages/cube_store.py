"""Validation of a Zarr store before its values count as light: complete, correct dims and units, finite, not
negative.

In:  a store, an array in it, the values read.
Out: nothing, or a ValueError that names the file, its content and the supported forms.

A missing chunk reads as the fill value without an error, so every chunk is checked: one listing of the array's folder
(0.1 s for 10,000 chunks) and 16 bytes per chunk from the index of every shard.
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
from etendue.contract.values.bounds import MOST_POINTS, MOST_VALUES, beyond
from etendue.contract.values.units import UnitError, parse_unit
from etendue_camera.arrays import FloatArray

DIMS = ("wavelength", "y", "x")
MOST_CHUNKS = 1_000_000
MISSING = 2**64 - 1  # offset and length of a chunk missing from a shard


def refuse_links(path: str) -> None:
    """Reject links and special files: a link leads out of the store, so that its data would not be kept and hashed."""
    for folder, names, files in os.walk(path):
        for name in (*names, *files):
            kind = os.lstat(own := os.path.join(folder, name)).st_mode
            if stat.S_ISLNK(kind):
                raise ValueError(
                    f"{path} contains a link, {os.path.relpath(own, path)}; replace it by a copy of its target"
                )
            if not stat.S_ISREG(kind) and not stat.S_ISDIR(kind):
                raise ValueError(
                    f"{path} contains {os.path.relpath(own, path)}, which is not a regular file; remove it"
                )


def check_array(path: str, variable: str, array: Any, unit: str) -> None:
    """Check dims, size, dtype, packing and, if given, the unit."""
    shape = getattr(array, "shape", ())
    require.that(len(shape) == 3, f"{variable} in {path} must have the dims wavelength, y, x; its shape is {shape}")
    attributes = dict(array.attrs)
    names = tuple(getattr(array.metadata, "dimension_names", None) or attributes.get("_ARRAY_DIMENSIONS") or DIMS)
    require.that(
        names == DIMS,
        f"{variable} in {path} must have the dims wavelength, y, x in this order; its dims are "
        f"{', '.join(map(str, names))}",
    )
    for dim, size in zip(DIMS, shape, strict=True):
        text = beyond(size, f"points along {dim}", MOST_POINTS, "cut it") or ("" if size else f"no points along {dim}")
        require.that(not text, f"{variable} in {path} has {text}")
    too_many = beyond(math.prod(shape), "values", MOST_VALUES, "cut it")
    require.that(not too_many, f"{variable} in {path} has {too_many}")
    require.that(
        getattr(array.dtype, "kind", "?") in "fiu",
        f"{variable} in {path} has dtype {array.dtype}; it must be float or integer",
    )
    packed = [name for name in ("scale_factor", "add_offset") if name in attributes]
    require.that(
        not packed,
        f"{variable} in {path} is packed ({', '.join(packed)}), and would be read without unpacking; store it as "
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
    require.that(same, f"{name} in {path} is in {str(written)!r}; convert it to {unit!r}")


def values_of(path: str, group: Any, name: str, shape: tuple[int, ...], unit: str) -> FloatArray:
    """Return the values of a coordinate; raise ValueError unless they are complete and finite."""
    array = group[name]
    if getattr(array, "shape", None) != shape:
        raise ValueError(f"{name} has the shape {getattr(array, 'shape', ())}; the cube requires {shape}")
    _check_unit(name, path, dict(array.attrs), unit)
    check_chunks(path, name, array)
    try:
        values = np.asarray(array[...], dtype=float)
    except Exception as error:
        raise ValueError(f"{name} could not be read: {' '.join(str(error).split())[:150]}") from None
    if not np.isfinite(values).all():
        raise ValueError(f"{name} has {int((~np.isfinite(values)).sum())} values that are NaN or infinite")
    return values


def check_chunks(path: str, variable: str, array: Any) -> None:
    """Raise ValueError for an array with a missing chunk."""
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
    """Raise ValueError for a chunk that declares a larger decompressed size than its values need."""
    said, length = plain_files.size_unfolded(chunk)
    if (said is not None and said > 2 * size + plain_files.SMALL) or length > 2 * size + plain_files.SMALL:
        raise ValueError(f"{chunk} decompresses from {length} to {said} bytes, but its values take {size}")


def _missing(path: str, key: str, array: Any) -> str:
    return (
        f"{path} is missing the chunk {key}, which would read as {array.fill_value}; restore it, or, if all its values "
        "are that, write the store with empty chunks (write_empty_chunks = True)"
    )


def _names(path: Path) -> set[str]:
    """Return the path of every file of an array, relative to the array's folder."""
    return {
        os.path.relpath(os.path.join(folder, name), path).replace(os.sep, "/")
        for folder, _, files in os.walk(path)
        for name in files
    }


def _lost_inside(shard: Path, array: Any) -> str:
    """Return the first chunk inside the array's shape that a shard's index marks as missing, or ''."""
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
    """Raise ValueError for NaN, infinity or negative radiance, with the first position."""
    with np.errstate(invalid="ignore"):
        if light.size == 0 or (np.isfinite(light.min()) and np.isfinite(light.max()) and light.min() >= 0):
            return
        bad = ~(np.isfinite(light) & (light >= 0))
    band, row, column = np.unravel_index(int(np.argmax(bad)), bad.shape)
    raise ValueError(
        f"{variable} in {path} has {float(light[band, row, column]):g} in band {bands[int(band)]}, row {row}, column "
        f"{column} "
        f"({int(bad.sum())} such values); radiance must be finite and not negative"
    )
