"""Cost before running: bytes stored, memory held, seconds expected.

Seconds are an estimate from a stage's ``nanoseconds`` per value written (per padded value and band for transfer
functions); the table at the end of a run has the measured ones.
"""

from __future__ import annotations

from collections.abc import Iterable

from etendue.plan.model import Cell, Node
from etendue.spec.capabilities import Summed
from etendue.spec.grid import Grid
from etendue.spec.variables import Declaration

LARGEST_WHOLE = 128 << 20  # a variable with wavelength above this is made and stored one band at a time
BYTES = {"uint8": 1, "uint16": 2, "uint32": 4}


def item_bytes(declaration: Declaration, precision: str) -> int:
    return BYTES.get(declaration.dtype, 4 if precision == "float32" else 8)


def bytes_of(declaration: Declaration, grid: Grid, precision: str) -> int:
    return grid.count * item_bytes(declaration, precision)


def too_large(declaration: Declaration, grid: Grid, precision: str) -> bool:
    """Whether a variable is made and stored one wavelength band at a time."""
    return declaration.dims == ("wavelength", "y", "x") and bytes_of(declaration, grid, precision) > LARGEST_WHOLE


def cell_bytes(node: Node, cell: Cell, precision: str, variables: Iterable[str] | None = None) -> int:
    chosen = node.writes if variables is None else variables
    return sum(bytes_of(node.writes[v], cell.grids[v], precision) for v in chosen)


def cell_seconds(node: Node, cell: Cell, precision: str) -> float:
    """Expected seconds of one cell on one thread."""
    if cell.left_out:
        return 2e-5
    rate = cell.stage.nanoseconds
    if node.segment and cell.inputs:
        grid = cell.input_grids[cell.inputs[0][0]]
        values = 1.6 * grid.count
    else:
        values = max([grid.count for grid in cell.grids.values()] + [grid.count / 4 for grid in cell.input_grids.values()])
    return 5e-5 + 1e-9 * rate * values * (1.0 if precision == "float32" else 1.6)


def cell_memory(node: Node, cell: Cell, precision: str) -> int:
    """Bytes held while one cell is computed: what it reads, writes, and its working copies; of what is made by band, few bands."""
    size = 4 if precision == "float32" else 8
    own = sum(_held(d.dims, cell.grids[v], precision, item_bytes(d, precision)) for v, d in node.writes.items())
    read = sum(_held(tuple(dim for dim, _ in g.entries), g, precision, size) for g in cell.input_grids.values())
    grid = cell.input_grids[cell.inputs[0][0]] if node.segment else None
    gathered = (cell.stage.terms() if isinstance(cell.stage, Summed) else 0) * size * grid["y"].size * grid["x"].size if grid else 0
    return 2 * own + gathered + (5 * read if node.segment else 2 * read)


def _held(dims: tuple[str, ...], grid: Grid, precision: str, size: int) -> int:
    """Bytes of a variable, or of three of its bands where it is made by band."""
    whole = size * grid.count
    return 3 * whole // grid.bands().size if set(dims) == {"wavelength", "y", "x"} and whole > LARGEST_WHOLE else whole
