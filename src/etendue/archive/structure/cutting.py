"""Decide how the variables of a plan are split into shards and encoded. The decision is made once, when an array is
created, and recorded in the journal.

In:  a plan and its layout, and the axes as stored.
Out: for every variable, the block of axis values that share a shard, and the codec of its chunks.

A shard holds the innermost axes. Axes that grow later get further shards of the same block: Zarr's grid is regular,
and stored chunks keep their places; ``etendue compact`` splits an archive again. Integers and smooth data are
compressed. Floats after a stage that draws random numbers look like noise to a compressor, which would take longer than
everything else and save little. They are stored uncompressed, and so are small chunks (``benchmarks/archive.py`` prints
the bytes).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import ceil, prod
from typing import TYPE_CHECKING

import numpy as np

from etendue.archive.records.manifest import DATA
from etendue.archive.sharding.chunks import CODEC, DENSE, RAW, Chunk
from etendue.archive.sharding.partition import Shape, counts_of, known_chunk, pieces_of, windows_of
from etendue.archive.sharding.shards import EXTRA, LARGEST, block_of
from etendue.archive.structure.layout import Layout, VariableLayout
from etendue.contract.arrays.dims import is_light
from etendue.plan import cost
from etendue.plan.expansion.digits import is_rounded
from etendue.plan.model import Plan
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.types.arrays import Array
    from etendue.types.documents import AxisValue

LARGEST_CHUNK = 64 << 20  # bytes; a larger cell is split into row bands
BANDS = 4  # this many row bands together hold about as much as the largest chunk, so one is 16 MB
SMALL = 4096  # bytes; compressing a smaller chunk takes longer than everything else and saves next to nothing
Blocks = Mapping[str, Mapping[str, DocumentView]]  # by group and variable: block, codec, form, pieces, chunk


def chunk_of(dims: Sequence[str], shape: Shape, itemsize: int) -> Shape:
    """Return the shape of the chunks of a cell; the shape of the cell if one chunk holds it."""
    whole = tuple(max(n, 1) for n in shape)
    # such light is computed by band; Blosc cannot compress 2 GiB or more
    if len(dims) == 3 and is_light(dims) and itemsize * prod(shape) > cost.LARGEST_WHOLE:
        whole = (1, *whole[1:])
    size = itemsize * prod(whole)
    if size <= LARGEST_CHUNK or tuple(dims)[-2:] != ("y", "x"):
        return whole
    rows = ceil(whole[-2] / ceil(size * BANDS / LARGEST_CHUNK))
    # Prefer a height that divides the rows evenly, down to half as high: no fill values then.
    even = next((n for n in range(rows, rows // 2, -1) if whole[-2] % n == 0), rows)
    return (*whole[:-2], even, whole[-1])


def bytes_of(variable: VariableLayout) -> int:
    """Return the bytes of one cell of a variable in memory."""
    return int(np.prod(variable.shape)) * int(np.dtype(variable.dtype).itemsize)


def cut(
    plan: Plan, layout: Layout, axes: Mapping[str, Mapping[str, list[AxisValue]]], known: Blocks
) -> dict[str, dict[str, Document]]:
    """Return block and codec of every variable; known blocks and codecs are kept unless the variable's form has
    changed.
    """
    noisy = _noisy(plan)

    def dense(path: str, variable: VariableLayout) -> bool:
        return plan.digits > 0 and is_rounded(plan.node(layout.groups[path].node).writes[variable.name])

    sizes = {path: tuple(len(values) for values in axes[path].values()) for path in layout.groups}
    found: dict[str, dict[str, Document]] = {path: {} for path in layout.groups}
    fresh: list[tuple[str, VariableLayout]] = []
    for path, group in layout.groups.items():
        for variable in group.variables.values():
            old = known.get(path, {}).get(variable.name)
            fits = old is not None and old["form"] == _form(variable) and len(old["block"]) == len(sizes[path])
            if old is not None and fits and (old["codec"] == DENSE) == dense(path, variable):
                found[path][variable.name] = dict(old)
            else:
                fresh.append((path, variable))
    chunks = [chunk_of(one.dims, one.shape, int(np.dtype(one.dtype).itemsize)) for _, one in fresh]
    pieces = [pieces_of(one.shape, chunk) for (_, one), chunk in zip(fresh, chunks, strict=True)]
    blocks = blocks_of([(sizes[path], bytes_of(one), count) for (path, one), count in zip(fresh, pieces, strict=True)])
    for (path, variable), block, chunk, count in zip(fresh, blocks, chunks, pieces, strict=True):
        noise = np.dtype(variable.dtype).kind == "f" and layout.groups[path].node in noisy
        small = bytes_of(variable) // count < SMALL
        found[path][variable.name] = {
            "block": list(block),
            "codec": RAW if small else DENSE if dense(path, variable) else RAW if noise else CODEC,
            "form": _form(variable),
            "pieces": count,
            **({"chunk": list(chunk)} if count > 1 else {}),
        }
    return found


def blocks_of(variables: Sequence[tuple[tuple[int, ...], int, int]]) -> list[tuple[int, ...]]:
    """Return the blocks of variables given as (axis sizes, bytes per cell, chunks per cell), large enough to keep the
    number of shards small.
    """
    largest = LARGEST
    # Double the size limit until all variables together have few shards: each shard is a file to open and to index.
    while True:
        blocks = [block_of(*one, largest) for one in variables]
        extra = sum(pieces_of(one[0], block) - 1 for one, block in zip(variables, blocks, strict=True))
        if extra <= EXTRA or largest >= LARGEST << 8:
            return blocks
        largest *= 2


def _form(variable: VariableLayout) -> str:
    return f"{variable.dtype} {'x'.join(map(str, variable.shape))}"


def _noisy(plan: Plan) -> set[str]:
    """Return the stages that draw random numbers and all stages after them."""
    found: set[str] = set()
    for node in plan.nodes:
        if node.is_random or any(source in found for bound in node.inputs for _, source, _ in bound):
            found.add(node.name)
    return found


def chunk_shapes(
    shape: tuple[int, ...], block: Sequence[int], chunk: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...] | None]:
    """Return the shapes of a chunk and of its shard in the array of a variable; the shard is None for a single number
    without axes. A shard covers the rows of a cell, rounded up to whole chunks.
    """
    room = (count * own for count, own in zip(counts_of(shape, chunk), chunk, strict=True))
    return (*(1 for _ in block), *chunk), (*block, *room) if block or shape else None


class Whereabouts:
    """The places of the chunks of one variable of a group: file and slot by the position of a cell."""

    def __init__(self, path: str, variable: VariableLayout, known: DocumentView) -> None:
        self.variable, self.block, self.codec = variable, tuple(known["block"]), known["codec"]
        chunk = known_chunk(variable.shape, known)
        self.windows = windows_of(variable.shape, chunk)
        self.count = len(self.windows)
        self.shape = variable.shape if self.count == 1 else chunk
        self.slots = prod(self.block) * self.count if self.block or variable.shape else 0
        self.folder, self.inner = f"{DATA}/{path}/{variable.name}", ["0"] * len(variable.shape)
        self.files: dict[tuple[int, ...], str] = {}  # each name is built once: a shard has many chunks

    def at(self, place: tuple[int, ...]) -> tuple[str, int]:
        """Return the shard of a cell and the first of its slots in this shard."""
        slot = 0
        for at, size in zip(place, self.block, strict=True):
            slot = slot * size + at % size
        shard = tuple([at // size for at, size in zip(place, self.block, strict=True)])
        file = self.files.get(shard)
        if file is None:
            file = self.files[shard] = f"{self.folder}/{'.'.join(['c', *map(str, shard), *self.inner])}"
        return file, slot * self.count

    def all_at(self, places: Array) -> tuple[list[str], Array, Array]:
        """Return the shards of some cells and, for each cell, the index of its shard and the first of its
        slots in it.
        """
        slot, shard = np.zeros(len(places), np.int64), np.zeros(len(places), np.int64)
        for at, size in zip(places.T, self.block, strict=True):
            slot, shard = slot * size + at % size, shard * (int(at.max(initial=0)) // size + 1) + at // size
        _, first, which = np.unique(shard, return_index=True, return_inverse=True)
        return [self.at(tuple(places[n].tolist()))[0] for n in first], which, slot * self.count

    def chunks(self, place: tuple[int, ...]) -> Iterator[Chunk]:
        file, slot = self.at(place)
        own = self.variable
        for number, window in enumerate(self.windows):
            yield Chunk(own.name, file, slot + number, self.slots, own.dtype, self.shape, self.codec, window)
