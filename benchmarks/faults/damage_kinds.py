"""Kinds of damage to an archive: changes of its files, accidental or deliberate.

In:  a sound archive, a copy of it, a random generator.
Out: the copy is damaged; the paths that must be named.
"""

from __future__ import annotations

import json
import random
import re
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import google_crc32c
import numpy as np

from etendue.archive.sharding.chunks import decode, encode
from etendue.archive.sharding.shards import index_bytes

if TYPE_CHECKING:
    from damages import Sound

SHARD, SCALAR = "data.zarr/irradiance/irradiance/c.0.0.0.0", "data.zarr/lens_numbers/hyperfocal_distance/c.0"


# -- ways to change a file
# --------------------------------------------------------------------------------------------------

Draw = random.Random
Act = Callable[["Sound", Path, Draw], list[str]]  # returns the paths that must be named


def flip(path: Path, draw: Draw, start: int = 0, end: int | None = None) -> None:
    data = bytearray(path.read_bytes())
    data[draw.randrange(start, len(data) if end is None else end)] ^= 1 << draw.randrange(8)
    path.write_bytes(data)


def a_bit_of(*paths: str) -> Act:
    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        path = draw.choice(paths)
        flip(archive / path, draw)
        return [path]

    return act


def removed(*paths: str) -> Act:
    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        path = draw.choice(paths)
        (archive / path).unlink()
        return [path]

    return act


def edited(path: str, change: Callable[[dict], object]) -> Act:
    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        document = json.loads((archive / path).read_text())
        change(document)
        (archive / path).write_text(json.dumps(document, indent=1))
        return [path]

    return act


def an_input(archive: Path) -> str:
    return next(f"inputs/{p.name}" for p in (archive / "inputs").iterdir())


# -- chunks
# -----------------------------------------------------------------------------------------------------------------


def bit_in_chunk(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sound.shards())
    _, at, size = draw.choice(sound.in_file(path))
    flip(archive / path, draw, at, at + size - 4)
    return [path]


def bit_in_checksum(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sound.shards())
    _, at, size = draw.choice(sound.in_file(path))
    flip(archive / path, draw, at + size - 4, at + size)
    return [path]


def random_bytes(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sound.shards())
    _, at, size = draw.choice(sound.in_file(path))
    data = bytearray((archive / path).read_bytes())
    data[at : at + size] = bytes(b ^ 0xFF for b in data[at : at + size])
    (archive / path).write_bytes(data)
    return [path]


def edited_chunk(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sound.shards())
    _, at, size = draw.choice(sound.in_file(path))
    data = bytearray((archive / path).read_bytes())
    data[at + size - 5] ^= 1
    data[at + size - 4 : at + size] = int(google_crc32c.value(bytes(data[at : at + size - 4]))).to_bytes(4, "little")
    (archive / path).write_bytes(data)
    return [path]


def swapped_chunks(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    """Swap two chunks of one shard that have the same size."""
    pairs = []
    for path in sound.shards():
        own = sound.in_file(path)
        data = (archive / path).read_bytes()
        pairs += [
            (path, a, b, s)
            for i, (_, a, s) in enumerate(own)
            for _, b, t in own[i + 1 :]
            if s == t and data[a : a + s] != data[b : b + s]
        ]
    path, a, b, size = draw.choice(pairs)
    data = bytearray((archive / path).read_bytes())
    data[a : a + size], data[b : b + size] = data[b : b + size], data[a : a + size]
    (archive / path).write_bytes(data)
    return [path]


def swapped_shards(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    """Swap two chunk files."""
    files = [path for path in sorted(sound.slots) if "/mosaic/" in path or "/exposure/" in path or path == SHARD]
    one, other = draw.sample(files, 2)
    a, b = (archive / one).read_bytes(), (archive / other).read_bytes()
    (archive / one).write_bytes(b)
    (archive / other).write_bytes(a)
    return [one, other]


def foreign_shard(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    """Put in the shard of another archive of the same pipeline, with other numbers."""
    there = [
        p
        for p in sound.shards()
        if (sound.other / p).is_file() and (sound.other / p).read_bytes() != (archive / p).read_bytes()
    ]
    path = draw.choice(there)
    shutil.copy(sound.other / path, archive / path)
    return [path]


def index(change: Callable[[bytearray, int, Draw], bytes]) -> Act:
    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        path = draw.choice(sound.shards())
        data = bytearray((archive / path).read_bytes())
        length = 16 * sound.slots[path] + 4
        (archive / path).write_bytes(data[:-length] + change(data[-length:], sound.slots[path], draw))
        return [path]

    return act


def flipped_index(own: bytearray, slots: int, draw: Draw) -> bytes:
    own[draw.randrange(len(own))] ^= 1 << draw.randrange(8)
    return bytes(own)


def swapped_index(own: bytearray, slots: int, draw: Draw) -> bytes:
    """Swap two chunks in the index, with a valid checksum."""
    table = np.frombuffer(bytes(own[:-4]), "<u8").reshape(-1, 2).copy()
    there = [n for n in range(len(table)) if table[n, 0] != 2**64 - 1]
    a, b = draw.sample(there, 2)
    table[[a, b]] = table[[b, a]]
    return index_bytes(slots, {n: (int(table[n, 0]), int(table[n, 1])) for n in there})


def forgotten_index(own: bytearray, slots: int, draw: Draw) -> bytes:
    """Mark a chunk as missing, with a valid checksum: plain Zarr reads fill values."""
    table = np.frombuffer(bytes(own[:-4]), "<u8").reshape(-1, 2)
    there = [n for n in range(len(table)) if table[n, 0] != 2**64 - 1]
    gone = draw.choice(there)
    return index_bytes(slots, {n: (int(table[n, 0]), int(table[n, 1])) for n in there if n != gone})


def cut_shard(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sound.shards())
    data = (archive / path).read_bytes()
    (archive / path).write_bytes(data[: draw.randrange(1, len(data))])
    return [path]


def lengthened(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sound.shards())
    (archive / path).write_bytes((archive / path).read_bytes() + b"\0" * draw.randrange(1, 99))
    return [path]


def in_its_place(put: Callable[[Path, Path], object]) -> Act:
    """Put something else in place of a chunk file; ``put`` gets its path and that of the file in another archive."""

    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        path = draw.choice(sorted(sound.slots))
        (archive / path).unlink()
        put(archive / path, sound.other / path)
        return [path]

    return act


lost_file = in_its_place(lambda path, other: None)


def lost_array(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = draw.choice(sorted(sound.slots)).rpartition("/")[0]
    shutil.rmtree(archive / path)
    return [f"{path}/zarr.json"]


# -- metadata, tables
# ---------------------------------------------------------------------------------------------------------


def small_array(path: str, change: Callable[[np.ndarray], object], dtype: str) -> Act:
    """Change numbers of a coordinate, status or table, with a valid checksum."""

    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        file = archive / path
        shape = tuple(json.loads((archive / re.sub(r"/c/[\d/]*$", "/zarr.json", path)).read_text())["shape"])
        array = decode(file.read_bytes(), dtype, shape).copy()
        change(array)
        file.write_bytes(encode(array))
        return [path]

    return act


def first(value: object) -> Callable[[np.ndarray], object]:
    return lambda array: array.__setitem__((0,) * array.ndim, value)


def swapped_columns(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    one, other = "data.zarr/ledger/key/c/0", "data.zarr/ledger/stage/c/0"
    a, b = (archive / one).read_bytes(), (archive / other).read_bytes()
    (archive / one).write_bytes(b)
    (archive / other).write_bytes(a)
    return [one, other]


# -- journal, manifest
# ----------------------------------------------------------------------------------------------------------


def of_event(event: str, change: Callable[[list[bytes], int, Draw], object]) -> Act:
    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        lines = list(sound.lines)
        own = [n for n, line in enumerate(lines) if line.startswith(b'{"event":"%s"' % event.encode())]
        if event == "done":
            stored = {cell for cell, _, _ in sound.places}
            own = [n for n in own if json.loads(lines[n])["cell"] in stored]
        change(lines, draw.choice(own), draw)
        (archive / "journal.jsonl").write_bytes(b"".join(lines))
        return ["journal.jsonl"]

    return act


def drop(lines: list[bytes], at: int, draw: Draw) -> None:
    del lines[at]


def flip_line(lines: list[bytes], at: int, draw: Draw) -> None:
    data = bytearray(lines[at])
    data[draw.randrange(len(data) - 1)] ^= 1 << draw.randrange(8)
    lines[at] = bytes(data)


def swap_keys(lines: list[bytes], at: int, draw: Draw) -> None:
    """Change the key in a line, with a valid checksum."""
    line = re.sub(rb'"key":"(.)', lambda m: b'"key":"' + (b"0" if m[1] != b"0" else b"1"), lines[at])
    body = re.sub(rb',"sum":"[0-9a-f]{8}"\}\n$', b"}", line)
    lines[at] = body[:-1] + b',"sum":"%08x"}\n' % zlib.crc32(body)


def early(lines: list[bytes], at: int, draw: Draw) -> None:
    """Move a line before the one that says that its cell was begun."""
    lines.insert(0, lines.pop(at))


def torn(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    data = b"".join(sound.lines)
    (archive / "journal.jsonl").write_bytes(data[: len(data) - draw.randrange(1, len(data) // 3)])
    return ["journal.jsonl"]


def no_journal(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    (archive / "journal.jsonl").unlink()
    return ["journal.jsonl"]


# -- beside the store
# -------------------------------------------------------------------------------------------------------------


def input_changed(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = an_input(archive)
    flip(archive / path, draw)
    return [path]


def input_lost(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    path = an_input(archive)
    (archive / path).unlink()
    return [path]


def added(*paths: str) -> Act:
    def act(sound: Sound, archive: Path, draw: Draw) -> list[str]:
        path = draw.choice(paths)
        (archive / path).parent.mkdir(parents=True, exist_ok=True)
        (archive / path).write_bytes(draw.randbytes(draw.randrange(1, 400)))
        return [path]

    return act


def added_array(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    """Add a foreign array to one of our groups."""
    source, target = "data.zarr/irradiance/irradiance", "data.zarr/irradiance/mine"
    shutil.copytree(archive / source, archive / target)
    return [f"{target}/zarr.json"]


def filled_lock(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    (archive / "lock").write_bytes(draw.randbytes(5))
    return ["lock"]


def two_shards(sound: Sound, archive: Path, draw: Draw) -> list[str]:
    return (
        bit_in_chunk(sound, archive, draw)
        + lost_file(sound, archive, draw)
        + a_bit_of("data.zarr/zarr.json")(sound, archive, draw)
    )


META, RECORD = "data.zarr/irradiance/irradiance/zarr.json", "runs/0002.json"
KINDS: dict[str, Act] = {
    "bit flipped in a chunk": bit_in_chunk,
    "bit flipped in a chunk's checksum": bit_in_checksum,
    "chunk overwritten at random": random_bytes,
    "chunk edited, checksum valid": edited_chunk,
    "bit flipped in a single number": a_bit_of(SCALAR),
    "two chunks swapped": swapped_chunks,
    "two shards swapped": swapped_shards,
    "shard of another archive": foreign_shard,
    "bit flipped in an index": index(flipped_index),
    "two index entries swapped": index(swapped_index),
    "chunk missing from an index": index(forgotten_index),
    "shard truncated": cut_shard,
    "chunk file emptied": in_its_place(lambda path, other: path.touch()),
    "shard lengthened": lengthened,
    "chunk file deleted": lost_file,
    "array deleted": lost_array,
    "folder in place of a chunk file": in_its_place(lambda path, other: path.mkdir()),
    "link in place of a chunk file": in_its_place(Path.symlink_to),
    "bit flipped in array metadata": a_bit_of(META, "data.zarr/lens_numbers/hyperfocal_distance/zarr.json"),
    "array metadata deleted": removed(META, "data.zarr/scene/wavelength/zarr.json"),
    "unit edited": edited(META, lambda d: d["attributes"].update(units="lux")),
    "shape edited": edited(META, lambda d: d["shape"].__setitem__(0, 1)),
    "dims swapped": edited(META, lambda d: d.update(dimension_names=d["dimension_names"][::-1])),
    "fill value edited": edited(META, lambda d: d.update(fill_value=0.0)),
    "group metadata deleted": removed(
        "data.zarr/scene/zarr.json", "data.zarr/pixel/zarr.json", "data.zarr/ledger/zarr.json"
    ),
    "bit flipped in root metadata": a_bit_of("data.zarr/zarr.json"),
    "array missing from root metadata": edited(
        "data.zarr/zarr.json", lambda d: d["consolidated_metadata"]["metadata"].pop("irradiance/irradiance")
    ),
    "bit flipped in a coordinate": a_bit_of("data.zarr/irradiance/f_number/c/0", "data.zarr/scene/wavelength/c/0"),
    "coordinate deleted": removed("data.zarr/irradiance/f_number/c/0", "data.zarr/scene/wavelength/c/0"),
    "coordinate edited, checksum valid": small_array("data.zarr/irradiance/f_number/c/0", first(3.0), "<f8"),
    "bit flipped in a text coordinate": a_bit_of("data.zarr/pixel/4x4/back/c/0"),
    "status edited, checksum valid": small_array("data.zarr/irradiance/status/c/0", first(4), "|u1"),
    "bit flipped in a table": a_bit_of(
        "data.zarr/ledger/key/c/0", "data.zarr/ledger/error/c/0", "data.zarr/summary/stage/c/0"
    ),
    "time edited, checksum valid": small_array("data.zarr/ledger/seconds/c/0", first(9.0), "<f8"),
    "two columns swapped": swapped_columns,
    "bit flipped in the pictures": a_bit_of("data.zarr/frames/preview/c/0/0/0/0", "contact_sheet.png"),
    "bit flipped in a cell's line": of_event("done", flip_line),
    "cell's line deleted": of_event("done", drop),
    "line edited, checksum valid": of_event("done", swap_keys),
    "line moved": of_event("done", early),
    "line of a shard deleted": of_event("shard", drop),
    "line of an axis deleted": of_event("axes", drop),
    "line of blocks deleted": of_event("blocks", drop),
    "bit flipped in any other line": of_event("arrays", flip_line),
    "journal truncated": torn,
    "journal deleted": no_journal,
    "bit flipped in the manifest": a_bit_of("manifest.json"),
    "manifest deleted": removed("manifest.json"),
    "bit flipped in a record": a_bit_of(RECORD, "runs/0001.json", "runs/0001.toml", "runs/0002.toml"),
    "record deleted": removed(RECORD, "runs/0001.json", "runs/0001.toml", "runs/0002.toml"),
    "record edited": edited(RECORD, lambda d: d["platform"].update(numpy="0.0.1")),
    "bit flipped in an input": input_changed,
    "input deleted": input_lost,
    "input added": added("inputs/mine.csv", "inputs/" + "0" * 64 + ".csv"),
    "bit flipped in crate or citation": a_bit_of("ro-crate-metadata.json", "CITATION.cff"),
    "crate or citation deleted": removed("ro-crate-metadata.json", "CITATION.cff"),
    "measured errors edited": edited("measured.json", lambda d: d["key"].update(error=0.5)),
    "bit flipped in the owner's name": a_bit_of("run.id"),
    "content written to the lock": filled_lock,
    "chunk added": added(
        "data.zarr/irradiance/irradiance/c.9.0.0.0", "data.zarr/mosaic/4x4/raw_charge/c.7", "data.zarr/scene/c"
    ),
    "file added to a group": added(
        "data.zarr/irradiance/notes.txt", "data.zarr/ledger/x", "data.zarr/x", "runs/0009.json"
    ),
    "array added to a group": added_array,
    "half-written files left": added(
        "data.zarr/scene/.zarr.json.1.2.partial", "data.zarr/irradiance/irradiance/.c.0.0.0.0.0123456789ab.part"
    ),
    "three damages at once": two_shards,
}
