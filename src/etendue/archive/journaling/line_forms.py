"""Validation of journal lines: their keys and types, and that no path leads out of the archive.

In:  a line decoded from JSON.
Out: the line in the archive's types; ``ValueError`` or ``TypeError`` if it is invalid.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec

from etendue.archive.journaling.entries import EVENTS
from etendue.contract.ports import WrittenChunk
from etendue.types.documents import Document

LARGEST = 2**62  # largest offset in a file

OF_A_CELL = frozenset(
    {"event", "cell", "key", "status", "seconds", "clipped", "clipped_flux", "floored", "platform", "files"}
)
FIELDS = {
    "axes": frozenset({"event", "group", "axes"}),
    "arrays": frozenset({"event", "group", "names"}),
    "run": frozenset({"event", "planned", "todo"}),
    "blocks": frozenset({"event", "group", "blocks"}),
    "same": frozenset({"event", "group", "same"}),
    "shard": frozenset({"event", "path", "size", "kept"}),
    "closed": frozenset({"event"}),
    "outdated": frozenset({"event", "cells"}),
    "record": frozenset({"event", "path", "text"}),
    **dict.fromkeys(EVENTS, OF_A_CELL),
}


Number = Annotated[int, msgspec.Meta(ge=0, le=LARGEST)]


@dataclass
class Going:
    """The last run: by stage, the number of cells requested and the number to compute; the cells that have ended."""

    planned: Mapping[str, int]
    todo: Mapping[str, int]
    ended: set[str] = field(default_factory=set)


class OfACell(msgspec.Struct, forbid_unknown_fields=True, gc=False):
    """A line about a cell, as ``Journal`` writes it."""

    event: Literal["start", "done", "failed", "removed"]
    cell: str
    key: str
    sum: str
    status: Literal["done", "left_out", "failed", "skipped", "not_computed"] = "done"
    seconds: float = 0.0
    clipped: float = 0.0
    clipped_flux: float = 0.0
    floored: float = 0.0
    platform: str = ""
    files: list[tuple[str, Number, str, Number, Number, Number]] = []


decode_of_a_cell = msgspec.json.Decoder(OfACell).decode


def files_of(written: Any) -> tuple[tuple[WrittenChunk, ...], int]:
    """Return the chunks of a cell, and the number of chunks with a separate file; for these, old archives recorded only
    the size.
    """
    files, a_cell = [], 0
    for one in written:
        if len(one) == 3:
            path, size, _ = one
            a_cell += 1
            files.append(WrittenChunk(inside(path), 0, "", 0, of_kind(int, size), 0))
        else:
            path, slot, part, *numbers = one
            offset, size, digest = (of_kind(int, n) for n in numbers)
            files.append(WrittenChunk(inside(path), of_kind(int, slot), inside(part), offset, size, digest))
        if any(abs(n) > LARGEST for n in (files[-1].slot, files[-1].offset, files[-1].size, files[-1].digest)):
            raise ValueError("a number larger than any file")
    return tuple(files), a_cell


def kept_of(written: Any) -> tuple[tuple[str, int, int, int], ...]:
    """Return the byte ranges in a shard, each as part name, offset in the part, offset in the shard, and length."""
    kept = []
    for part, *numbers in written:
        start, to, length = (of_kind(int, n) for n in numbers)
        kept.append((inside(part), start, to, length))
    return tuple(kept)


def block_of(written: Any) -> Document:
    words = {name: of_kind(str, written[name]) for name in ("codec", "form")}
    block = {"block": [of_kind(int, n) for n in written["block"]], **words, "pieces": of_kind(int, written["pieces"])}
    if "chunk" in written:
        block["chunk"] = [of_kind(int, n) for n in written["chunk"]]
    if min([*block["block"], block["pieces"], *block.get("chunk", ())]) < 1:
        raise ValueError("a block with a size below 1")
    return block


def same_of(written: Any) -> dict[str, str]:
    """Return, for each variable of a group that has no array, the path of the array of the same name that it equals."""
    found = {inside(name): inside(of_kind(str, path).removeprefix("/")) for name, path in written.items()}
    if not all(path == f"{path.rpartition('/')[0]}/{name}" and "//" not in path for name, path in found.items()):
        raise ValueError("a path to another variable")
    return {name: f"/{path}" for name, path in found.items()}


def of_kind(kind: Any, value: Any) -> Any:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"expected {kind}, got {type(value)}")
    return value


def inside(path: Any) -> str:
    """Return a path below the archive; raise if it leads out of it."""
    if not isinstance(path, str) or leads_out(path):
        raise ValueError("a path that leads out of the archive")
    return path


def leads_out(path: str) -> bool:
    return path[:1] == "/" or (".." in path and ".." in path.split("/"))


def axis_of(written: list[Any]) -> list[Any]:
    values = [float(one["float"]) if isinstance(one, dict) else one for one in written]
    if len({isinstance(one, str) for one in values}) > 1 or not all(
        isinstance(one, str | int | float) for one in values
    ):
        raise ValueError("an axis whose values are not all texts or all numbers")
    return values


def summed(line: bytes) -> bytes:
    """Return a line with its checksum at the end."""
    return line[:-1] + b',"sum":"%08x"}' % zlib.crc32(line)


def written(value: object) -> object:
    """Return an axis value for JSON, in which infinity and NaN must be text."""
    return {"float": repr(value)} if isinstance(value, float) and not math.isfinite(value) else value
