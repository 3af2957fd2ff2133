"""Cost before running: bytes stored and seconds expected.

Seconds are estimated from ``nanoseconds``, a stage's time at its defaults per value written (per padded value and band
for transfer functions), and from the costs of its knobs. The table at the end of a run has the measured times.
"""

from __future__ import annotations

from collections.abc import Iterable

from etendue.contract.arrays.grid import Grid
from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import Summed
from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, Node

LARGEST_WHOLE = 128 << 20  # a variable with bands above this is made and stored one band at a time
BYTES = {"uint8": 1, "uint16": 2, "uint32": 4}


def bytes_of(declaration: Declaration, grid: Grid, precision: str) -> int:
    return grid.count * BYTES.get(declaration.dtype, 4 if precision == "float32" else 8)


def too_large(declaration: Declaration, grid: Grid, precision: str) -> bool:
    """Return whether a variable is made and stored one band at a time."""
    by_band = declaration.dims[1:] == ("y", "x") and declaration.dims[0] == grid.banded
    return by_band and bytes_of(declaration, grid, precision) > LARGEST_WHOLE


def alike(cells: Iterable[Cell]) -> list[tuple[Cell, int]]:
    """Return one cell of each group that costs the same, with the size of the group. Cells cost the same if they have
    one stage and the same grids.
    """
    groups: Once[list[Cell]] = Once()
    for cell in cells:
        groups((cell.stage, cell.grids, cell.input_grids), list, cell.left_out is None).append(cell)
    return [(own[0], len(own)) for own in groups.values()]


def cell_bytes(node: Node, cell: Cell, precision: str, variables: Iterable[str] | None = None) -> int:
    chosen = node.writes if variables is None else variables
    return sum(bytes_of(node.writes[v], cell.grids[v], precision) for v in chosen)


def cell_seconds(node: Node, cell: Cell, precision: str) -> float:
    """Return the expected seconds of one cell on one thread."""
    if cell.left_out:
        return 2e-5
    rate = cell.stage.nanoseconds
    if node.segment and cell.inputs:
        grid = cell.input_grids[cell.inputs[0][0]]
        terms = cell.stage.terms() if isinstance(cell.stage, Summed) else 0
        transformed = min(1.0, terms / grid.bands().size) if terms else 1.0  # share of the bands that are transformed
        values = 1.6 * grid.count * transformed
    else:
        values = max(
            [grid.count for grid in cell.grids.values()] + [grid.count / 4 for grid in cell.input_grids.values()]
        )
    return 5e-5 + 1e-9 * rate * knobs_cost(cell.stage) * values * (1.0 if precision == "float32" else 1.6)


def knobs_cost(stage: Stage) -> float:
    """Return the time at the stage's settings relative to its time at the defaults: the product over all knobs with
    known costs.
    """
    found = 1.0
    for name, (parameter, _, default) in parameters_of(type(stage)).items():
        if parameter.costs:
            found *= _cost(parameter, getattr(stage, name)) / _cost(parameter, default)
    return found


def _cost(parameter: Parameter, value: bool | float) -> float:
    """Return the cost of a setting; for a value between two settings, that of the finer one."""
    if value in parameter.settings:
        return parameter.costs[parameter.settings.index(value)]
    falling = (
        parameter.settings[0] > parameter.settings[-1] and parameter.settings[-1] != 0
    )  # counts may end in 0, which stands for all
    finer = (i for i, one in enumerate(parameter.settings) if one != 0 and (value >= one if falling else value <= one))
    return parameter.costs[next(finer, -1)]
