"""Decide which cells of large frames can be computed in strips, and the number of rows of a strip.

In:  a plan.
Out: for a cell, its frame and the rows around a row that it needs.

A cell is computed in strips if its frame is large and its stage needs no more than a few rows around a row (``Haloed``,
or ``elementwise``). Neighbouring cells of this kind on one frame are computed together, so that arrays that only these
cells read never exist as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Banded, Probe, halo_of, is_source, is_transfer
from etendue.contract.stage import looks_at_stages, reads_of
from etendue.plan import cost
from etendue.plan.model import Cell, Node, Plan

LARGEST_WHOLE = 1 << 21  # pixels; frames up to this size are computed whole
STRIP = 1 << 19  # approximate pixels of a strip
TILE = 64  # rows; strips end at tile boundaries of fixed patterns
HALOS = 16  # minimum ratio of strip rows to halo rows: at most 1/8 (a halo on both sides) is computed twice

Frame = tuple[int, int]


@dataclass
class Walker:
    """A cell that may be computed in strips: its frame, and the rows around a row that it needs."""

    frame: Frame
    halo: int


def has_rows(dims: tuple[str, ...]) -> bool:
    """Return True if an array covers the pixels of a frame."""
    return dims[-2:] == ("y", "x")


def is_large(grids: Mapping[str, Grid], input_grids: Mapping[str, Grid]) -> bool:
    """Return True if a cell reads or writes a frame too large to compute whole."""
    every = (*grids.values(), *input_grids.values())
    return any("y" in grid and "x" in grid and grid["y"].size * grid["x"].size > LARGEST_WHOLE for grid in every)


def by_band(node: Node, cell: Cell, precision: str) -> tuple[str, ...]:
    """Return the variables of a cell that are computed by band: too large to hold, from a stage that supports it."""
    if cell.left_out is not None or cell.mapped or not (isinstance(cell.stage, Banded) or node.segment):
        return ()
    return tuple(v for v, d in node.writes.items() if cost.too_large(d, cell.grids[v], precision))


def walker(plan: Plan, node: Node, cell: Cell) -> Walker | None:
    """Return the frame and the halo of a cell of a large frame; None if the cell needs more than a few rows."""
    kind = type(cell.stage)
    if plan.expected or cell.mapped or node.segment or not cell.inputs or by_band(node, cell, plan.precision):
        return None
    if is_transfer(kind) or is_source(kind) or issubclass(kind, Probe):
        return None
    if cell.looks_at and any(not looks_at_stages(what) for _, what, _ in node.looks_at):
        return None
    frame = _one_frame(node, cell)
    if frame is None or frame[0] * frame[1] <= LARGEST_WHOLE:
        return None
    if cell.left_out is not None:
        ports = reads_of(kind)
        read = {variable for port, _, variable in cell.inputs if port in ports}
        return Walker(frame, 0) if read >= set(node.writes) else None
    halo = halo_of(cell.stage)
    if halo is None or frame[0] < 2 * max(TILE, HALOS * halo):
        return None
    return Walker(frame, halo)


def _one_frame(node: Node, cell: Cell) -> Frame | None:
    """Return the frame of all inputs and outputs of a cell that cover pixels; None if there are several frames, or
    arrays with rows but no columns.
    """
    ports = reads_of(type(cell.stage))
    read = [(cell.input_grids[port], ports[port].dims) for port, _, _ in cell.inputs if port in ports]
    written = [(cell.grids[v], d.dims) for v, d in node.writes.items()]
    frames = {_frame(grid, dims) for grid, dims in (*read, *written) if "y" in dims}
    alone = len(frames) == 1 and any(has_rows(dims) for _, dims in written)
    return frames.pop() if alone else None


def _frame(grid: Grid, dims: tuple[str, ...]) -> Frame | None:
    return (grid["y"].size, grid["x"].size) if has_rows(dims) else None


def rows_of(width: int, halos: list[int]) -> int:
    """Return the number of rows of each strip of cells that are computed together."""
    return max(STRIP // width, *(HALOS * halo for halo in halos), TILE) // TILE * TILE
