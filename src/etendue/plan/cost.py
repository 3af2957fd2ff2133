"""Cost before running: bytes stored and seconds expected.

Seconds are estimated from a stage's ``nanoseconds`` and from the costs of its knobs. ``nanoseconds`` is the time at
default settings per value written; for transfer functions, per padded value and band. The table at the end of a run has
the measured times. The ratio of measured to estimated seconds is cached on this machine by stage and size (``Rates``).
Plans report seconds corrected by this ratio, but no decision depends on it.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

from etendue import cache
from etendue.contract.arrays.grid import Grid
from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import Summed
from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, CellRef, Node, Plan

LARGEST_WHOLE = 128 << 20  # a variable with bands and more bytes than this is computed and stored one band at a time
WRITING = 4e-9  # assumed seconds to compress and write a byte on a machine that has not measured them yet
SAMPLED = 64  # number of cells per stage whose seconds are cached after a run
OCTAVES = 2  # width of a size class in the cache, octaves
BYTES = {"uint8": 1, "uint16": 2, "uint32": 4}


def bytes_of(declaration: Declaration, grid: Grid, precision: str) -> int:
    return grid.count * BYTES.get(declaration.dtype, 4 if precision == "float32" else 8)


def too_large(declaration: Declaration, grid: Grid, precision: str) -> bool:
    """Return whether a variable is computed and stored one band at a time."""
    by_band = declaration.dims[1:] == ("y", "x") and declaration.dims[0] == grid.banded
    return by_band and bytes_of(declaration, grid, precision) > LARGEST_WHOLE


def counted(cells: Iterable[Cell]) -> Iterable[tuple[Cell, int]]:
    """Return, for each group of cells that differ only in place and facts, the first cell and the number of cells."""
    cells = list(cells)
    every = [cell.settled for cell in cells]
    first = dict(zip(reversed(every), reversed(cells), strict=True))
    return [(first[settled], count) for settled, count in Counter(every).items()]


def alike(cells: Iterable[Cell]) -> list[tuple[Cell, int]]:
    """Return one cell of each group of cells with equal cost, and the number of cells in the group. Cells with the same
    stage and equal grids have equal cost.
    """
    groups: Once[list[tuple[Cell, int]]] = Once()
    for cell, count in counted(cells):
        groups((cell.stage, cell.grids, cell.input_grids), list, cell.left_out is None).append((cell, count))
    return [(own[0][0], sum(count for _, count in own)) for own in groups.values()]


def cell_bytes(node: Node, cell: Cell, precision: str, variables: Iterable[str] | None = None) -> int:
    chosen = node.writes if variables is None else variables
    return sum(bytes_of(node.writes[v], cell.grids[v], precision) for v in chosen)


def cell_seconds(node: Node, cell: Cell, precision: str) -> float:
    """Return the expected seconds of one cell on one thread."""
    # A cell that is left out still takes the engine's time to pass its input on and to report it.
    if cell.left_out:
        return 2e-5
    rate = cell.stage.nanoseconds
    if node.segment and cell.inputs:
        grid = cell.input_grids[cell.inputs[0][0]]
        terms = cell.stage.terms() if isinstance(cell.stage, Summed) else 0
        # Fraction of the bands that are transformed.
        transformed = min(1.0, terms / grid.bands().size) if terms else 1.0
        values = 1.6 * grid.count * transformed
    else:
        values = max(
            [grid.count for grid in cell.grids.values()] + [grid.count / 4 for grid in cell.input_grids.values()]
        )
    return 5e-5 + 1e-9 * rate * knobs_cost(cell.stage) * values * (1.0 if precision == "float32" else 1.6)


def knobs_cost(stage: Stage) -> float:
    """Return the run time of a stage at its settings relative to its run time at the default settings: the product over
    all knobs with known costs.
    """
    found = 1.0
    for name, (parameter, _, default) in parameters_of(type(stage)).items():
        if parameter.costs:
            found *= _cost(parameter, getattr(stage, name)) / _cost(parameter, default)
    return found


def _cost(parameter: Parameter, value: bool | float) -> float:
    """Return the cost of a setting; for a value between two settings, the cost of the finer setting."""
    if value in parameter.settings:
        return parameter.costs[parameter.settings.index(value)]
    # counts may end in 0, which stands for all
    falling = parameter.settings[0] > parameter.settings[-1] and parameter.settings[-1] != 0
    finer = (i for i, one in enumerate(parameter.settings) if one != 0 and (value >= one if falling else value <= one))
    return parameter.costs[next(finer, -1)]


# -- what this machine has measured ---------------------------------------------------------------------------------


class Rates:
    """Ratio of measured to estimated seconds by stage and size, from earlier runs on this machine (cached)."""

    @cached_property
    def known(self) -> dict[str, dict[str, float]]:
        """The ratio of measured to predicted seconds, by stage and precision and, within these, by size (``_size``);
        under 'writing', the seconds per byte.
        """
        try:
            document = json.loads(cache.read("rates", "stages") or b"{}")
            return {
                str(name): {str(int(size)): float(value) for size, value in own.items() if 0 < float(value) < math.inf}
                for name, own in document.items()
            }
        except (ValueError, AttributeError, TypeError):
            return {}

    def seconds(self, cell: Cell, estimate: float, precision: str) -> float | None:
        """Return the expected seconds of a cell: ``estimate`` times the measured ratio of the nearest size; None if the
        cell is left out or its stage never ran on this machine.
        """
        own = self.known.get(_place(cell.stage, precision))
        if not own or cell.left_out:
            return None
        return own[min(own, key=lambda size: abs(int(size) - _size(estimate)))] * estimate

    @property
    def per_byte(self) -> float | None:
        """Return the seconds to compress and write a byte; None if this machine has not measured them."""
        return self.known.get("writing", {}).get("0")

    def learn(
        self, cells: Mapping[str, tuple[Node, list[tuple[Cell, float]]]], precision: str, written: tuple[int, float]
    ) -> None:
        """Add to the cache, by stage, the measured seconds of some cells; ``written``: (bytes, seconds) of writing."""
        found = {name: dict(own) for name, own in Rates().known.items()}
        for node, measured in cells.values():
            sums: dict[tuple[str, str], list[float]] = {}
            for cell, seconds in measured:
                estimate = cell_seconds(node, cell, precision)
                own = sums.setdefault((_place(cell.stage, precision), str(_size(estimate))), [0.0, 0.0])
                own[0] += seconds
                own[1] += estimate
            for (place, size), (seconds, estimate) in sums.items():
                if seconds > 0:
                    found.setdefault(place, {})[size] = float(f"{seconds / estimate:.3g}")
        if written[0] >= 1 << 20:
            found["writing"] = {"0": float(f"{written[1] / written[0]:.3g}")}
        if found:
            cache.write("rates", "stages", json.dumps(found).encode())


def _place(stage: Stage, precision: str) -> str:
    return f"{type(stage).__module__}.{type(stage).__qualname__} {precision}"


def _size(estimate: float) -> int:
    return round(math.log2(estimate) * OCTAVES)


def seconds_of(node: Node, groups: Iterable[tuple[Cell, int]], precision: str, rates: Rates) -> tuple[float, bool]:
    """Return the seconds of some cells of a stage, without writing, and whether this machine has run the stage. Each
    cell is given with the number of cells that have the same cost.
    """
    total, known = 0.0, True
    for cell, count in groups:
        estimate = cell_seconds(node, cell, precision)
        own = rates.seconds(cell, estimate, precision)
        known = known and (own is not None or cell.left_out is not None)
        total += count * (estimate if own is None else own)
    return total, known


def with_writing(node: Node, cells: Iterable[Cell], precision: str, stored: int, rates: Rates) -> tuple[float, bool]:
    """Return the seconds of some cells of a stage and of writing their ``stored`` bytes, and whether both were measured
    on this machine.
    """
    seconds, known = seconds_of(node, alike(cells), precision, rates)
    per_byte = rates.per_byte
    if per_byte is None:
        return seconds + stored * WRITING, known and not stored
    return seconds + stored * per_byte, known


def remember(plan: Plan, reports: Mapping[CellRef, Any], written: tuple[int, float]) -> None:
    """Cache the measured seconds of some cells of each stage of a run; ``written``: (bytes, seconds) of writing."""
    found: dict[str, tuple[Node, list[tuple[Cell, float]]]] = {}
    for node in plan.nodes:
        cells = plan.of(node.name)
        chosen = cells[:: max(1, len(cells) // SAMPLED)]
        done = [(cell, reports[cell.ref]) for cell in chosen if cell.ref in reports]
        own = [(cell, report.seconds) for cell, report in done if report.status == "done" and not cell.left_out]
        if own:
            found[node.name] = node, own
    if found:
        Rates().learn(found, plan.precision, written)
