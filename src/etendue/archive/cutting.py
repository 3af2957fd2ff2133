"""How the variables of a plan are cut into shards and encoded: decided once, when an array is made, and written in the journal.

In:  a plan and its layout, the axes as they are stored.
Out: for every variable the block of axis values that share a shard, and the codec of its chunks.

A shard holds the innermost axes. Axes that grow later get further shards of the same block: Zarr's grid is regular, and what is
stored stays where it is; ``etendue compact`` cuts anew. Integers and what is smooth are compressed; floats behind a stage that draws
random numbers are noise to a compressor, which takes longer than all else and saves little: they stay as they are, and so do small
chunks (``benchmarks/archive.py`` prints the bytes).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np

from etendue.archive.chunks import CODEC, RAW, Chunk
from etendue.archive.layout import GroupLayout, Layout, VariableLayout
from etendue.archive.manifest import DATA
from etendue.archive.pieces import chunk_of, known_chunk, pieces_of, room_of, windows_of
from etendue.archive.shards import EXTRA, LARGEST, block_of, shards_of
from etendue.plan.model import Plan

SMALL = 4096  # bytes of a chunk below which compressing takes longer than all else, and saves next to nothing
Blocks = Mapping[str, Mapping[str, Mapping[str, Any]]]  # by group and variable: block, codec, form, pieces, chunk


def own_chunk(variable: VariableLayout) -> tuple[int, ...]:
    """The shape of the chunks of one cell of a variable that is stored for the first time."""
    return chunk_of(variable.dims, variable.shape, int(np.dtype(variable.dtype).itemsize))


def bytes_of(variable: VariableLayout) -> int:
    """Of one cell, as in memory."""
    return int(np.prod(variable.shape)) * int(np.dtype(variable.dtype).itemsize)


def cut(plan: Plan, layout: Layout, axes: Mapping[str, Mapping[str, list[Any]]], known: Blocks) -> dict[str, dict[str, dict[str, Any]]]:
    """Block and codec of every variable; those that are known stay, unless the variable is another one now."""
    noisy = _noisy(plan)
    sizes = {path: tuple(len(values) for values in axes[path].values()) for path in layout.groups}
    found: dict[str, dict[str, dict[str, Any]]] = {path: {} for path in layout.groups}
    fresh: list[tuple[str, VariableLayout]] = []
    for path, group in layout.groups.items():
        for variable in group.variables.values():
            old = known.get(path, {}).get(variable.name)
            if old is not None and old["form"] == _form(variable) and len(old["block"]) == len(sizes[path]):
                found[path][variable.name] = dict(old)
            else:
                fresh.append((path, variable))
    chunks = [own_chunk(one) for _, one in fresh]
    pieces = [pieces_of(one.shape, chunk) for (_, one), chunk in zip(fresh, chunks, strict=True)]
    blocks = blocks_of([(sizes[path], bytes_of(one), count) for (path, one), count in zip(fresh, pieces, strict=True)])
    for (path, variable), block, chunk, count in zip(fresh, blocks, chunks, pieces, strict=True):
        noise = np.dtype(variable.dtype).kind == "f" and layout.groups[path].node in noisy
        raw = noise or bytes_of(variable) // count < SMALL
        found[path][variable.name] = {
            "block": list(block),
            "codec": RAW if raw else CODEC,
            "form": _form(variable),
            "pieces": count,
            **({"chunk": list(chunk)} if count > 1 else {}),
        }
    return found


def blocks_of(variables: Sequence[tuple[tuple[int, ...], int, int]]) -> list[tuple[int, ...]]:
    """The blocks of variables given by sizes of their axes, bytes and chunks of a cell: large enough that there are few shards."""
    largest = LARGEST
    while True:
        blocks = [block_of(*one, largest) for one in variables]
        extra = sum(shards_of(one[0], block) - 1 for one, block in zip(variables, blocks, strict=True))
        if extra <= EXTRA or largest >= LARGEST << 8:
            return blocks
        largest *= 2


def _form(variable: VariableLayout) -> str:
    return f"{variable.dtype} {'x'.join(map(str, variable.shape))}"


def _noisy(plan: Plan) -> set[str]:
    """The stages that draw random numbers, and all behind them."""
    found: set[str] = set()
    for node in plan.nodes:
        if node.is_random or any(source in found for bound in node.inputs for _, source, _ in bound):
            found.add(node.name)
    return found


def chunk_shapes(shape: tuple[int, ...], block: Sequence[int], chunk: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...] | None]:
    """Shapes of a chunk and of its shard, from that of a cell; no shard for a single number."""
    return (*(1 for _ in block), *chunk), (*block, *room_of(shape, chunk)) if block or shape else None


def chunks_at(path: str, group: GroupLayout, place: tuple[int, ...], blocks: Mapping[str, Mapping[str, Any]]) -> tuple[Chunk, ...]:
    """The chunks at one position of the axes of a group."""
    chunks = []
    for variable in group.variables.values():
        block, own = blocks[variable.name]["block"], known_chunk(variable.shape, blocks[variable.name])
        windows = windows_of(variable.shape, own)
        count, slot = len(windows), 0
        for at, size in zip(place, block, strict=True):
            slot = slot * size + at % size
        where = ".".join(["c", *(str(at // size) for at, size in zip(place, block, strict=True)), *("0" for _ in variable.shape)])
        file = f"{DATA}/{path}/{variable.name}/{where}"
        slots = prod(block) * count if block or variable.shape else 0
        shape, codec = variable.shape if count == 1 else own, blocks[variable.name]["codec"]
        for number, window in enumerate(windows):
            chunks.append(Chunk(variable.name, file, slot * count + number, slots, variable.dtype, shape, codec, window))
    return tuple(chunks)
