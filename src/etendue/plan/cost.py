"""Cost before running: bytes stored, seconds expected.

Seconds are an estimate from a stage's ``nanoseconds`` per value written (per padded value and band for transfer
functions), which is what it takes at its defaults, and from the costs of its knobs; the table at the end of a run has
the measured ones.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any

from etendue.contract.capabilities import Summed
from etendue.contract.grid import Grid
from etendue.contract.parameter import Parameter
from etendue.contract.stage import Stage, parameters_of
from etendue.contract.variables import Declaration
from etendue.plan.model import Cell, Node, told_by

LARGEST_WHOLE = 128 << 20  # a variable with bands above this is made and stored one band at a time
BYTES = {"uint8": 1, "uint16": 2, "uint32": 4}


def bytes_of(declaration: Declaration, grid: Grid, precision: str) -> int:
    return grid.count * BYTES.get(declaration.dtype, 4 if precision == "float32" else 8)


def too_large(declaration: Declaration, grid: Grid, precision: str) -> bool:
    """Whether a variable is made and stored one band at a time."""
    by_band = declaration.dims[1:] == ("y", "x") and declaration.dims[0] == grid.banded
    return by_band and bytes_of(declaration, grid, precision) > LARGEST_WHOLE


def alike(cells: Iterable[Cell]) -> list[tuple[Cell, int]]:
    """Of the cells of a node one of each that cost the same, being of one stage and of the same grids, and how many
    there are.
    """
    found: dict[tuple[Hashable, ...], list[Any]] = {}
    for cell in cells:
        place = id(cell.stage), told_by(cell.grids, cell.input_grids), cell.left_out is None
        known = found.get(place)
        if known is None:
            found[place] = [cell, 1]
        else:
            known[1] += 1
    return [(cell, count) for cell, count in found.values()]


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
        terms = cell.stage.terms() if isinstance(cell.stage, Summed) else 0
        transformed = min(1.0, terms / grid.bands().size) if terms else 1.0  # of as many planes as there are bands
        values = 1.6 * grid.count * transformed
    else:
        values = max(
            [grid.count for grid in cell.grids.values()] + [grid.count / 4 for grid in cell.input_grids.values()]
        )
    return 5e-5 + 1e-9 * rate * knobs_cost(cell.stage) * values * (1.0 if precision == "float32" else 1.6)


def knobs_cost(stage: Stage) -> float:
    """How many times what it takes at its defaults a stage takes with its settings: the product over knobs of which
    that is known.
    """
    found = 1.0
    for name, (parameter, _, default) in parameters_of(type(stage)).items():
        if parameter.costs:
            found *= _cost(parameter, getattr(stage, name)) / _cost(parameter, default)
    return found


def _cost(parameter: Parameter, value: bool | float) -> float:
    """Of a setting, or of the next finer one where a file writes a value between two of them."""
    if value in parameter.settings:
        return parameter.costs[parameter.settings.index(value)]
    falling = (
        parameter.settings[0] > parameter.settings[-1] and parameter.settings[-1] != 0
    )  # ladders of counts may end in 0, all of them
    finer = (i for i, one in enumerate(parameter.settings) if one != 0 and (value >= one if falling else value <= one))
    return parameter.costs[next(finer, -1)]
