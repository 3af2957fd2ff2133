"""Check that a run fits the machine's memory and disk before anything runs; used by plans and runs with the same
messages.

In:  a plan, the place of its results, the number of workers.
Out: nothing, or ``MachineError`` with the cell that needs most memory, and a remedy.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from etendue.compute.tables import LARGEST_CACHE
from etendue.errors import MachineError
from etendue.plan import machine
from etendue.plan.cost import alike, cell_bytes
from etendue.plan.model import Cell, CellRef, Plan
from etendue.run.peak_memory import kept_bytes, peak_memory
from etendue.telling import human_bytes
from etendue.types.documents import AxisValue


def check_machine(plan: Plan, archive: Path | None, workers: int = 1, pictures: bool = True) -> None:
    """Raise ``MachineError`` for a plan that cannot fit, naming the responsible cell and axis."""
    available, need = machine.available_memory(), kept_bytes(plan)
    if available and _at_most(plan, workers) + (need if archive is None else 0) > available:
        _check_memory(plan, archive, workers, pictures, available)
    if archive is not None:
        folder = archive.absolute()
        while not folder.exists():
            folder = folder.parent
        held = (
            sum(512 * f.stat().st_blocks for f in archive.rglob("*") if f.is_file())
            if archive.exists() and need > 1e9
            else 0
        )
        free = shutil.disk_usage(folder).free + held
        if need > free:
            raise MachineError(
                f"about {human_bytes(need)} would be stored, but only {human_bytes(free)} are free on the "
                f"disk{_way_out(plan, _of_one(plan), free)}"
            )


def _at_most(plan: Plan, workers: int) -> float:
    """Return an upper bound of the memory of a run (bytes), as if the results of all stages were in memory at once. For
    small plans this avoids the simulation of jobs, which takes longer than the jobs themselves.
    """
    most = 0.0
    for node in plan.nodes:
        most += max((_of_cell(plan, cell) for cell, _ in alike(plan.of(node.name))), default=0.0)
    return workers * most + LARGEST_CACHE


def _of_cell(plan: Plan, cell: Cell) -> float:
    size = 4 if plan.precision == "float32" else 8
    return (
        (6 + cell.stage.working) * size * sum(grid.count for grid in (*cell.grids.values(), *cell.input_grids.values()))
    )


def _check_memory(plan: Plan, archive: Path | None, workers: int, pictures: bool, available: int) -> None:
    peak = peak_memory(plan, workers, archive is None, pictures)
    if peak.bytes > available:
        where = "held in memory" if archive is None else "held at once"
        at = f", most of it by {_cell(plan, peak.ref)}" if peak.ref else ""
        if workers > 1 and peak_memory(plan, 1, archive is None, pictures).bytes <= available:
            way_out = "; use --workers 1"
        else:
            way_out = _way_out(plan, peak.alone, available)
        raise MachineError(
            f"about {human_bytes(peak.bytes)} would be {where}{at}, but only {human_bytes(available)} are free{way_out}"
        )


def _cell(plan: Plan, ref: CellRef) -> str:
    """Return a stage and its axis values in words."""
    labels: dict[str, AxisValue] = plan.labels(ref)
    at = ", ".join(f"{plan.axis(dim).key} = {value}" for dim, value in labels.items())
    return f"{ref[0]!r}{f' at {at}' if at else ''}"


def _of_one(plan: Plan) -> int:
    """Return the size of the largest stored cell, bytes."""
    return max(
        (
            cell_bytes(n, c, plan.precision, [v for v in n.writes if (n.name, v) in plan.with_arrays])
            for n in plan.nodes
            for c, _ in alike(plan.of(n.name))
        ),
        default=0,
    )


def _way_out(plan: Plan, one: int, room: int) -> str:
    """Return a text that says how to make a plan smaller; if a single cell does not fit, or nothing is swept, only
    smaller cells help.
    """
    longest = max(plan.axes, key=lambda a: len(a.values), default=None)
    if longest is None or one > room:
        what = f"one cell takes {human_bytes(one)}" if one > room else "nothing is swept"
        return (
            f"; {what}: use a coarser spacing or wider bands in the first stage, a smaller window, or a shorter 'keep'"
        )
    return f"; the axis {longest.key} has {len(longest.values)} values; shorten 'keep' or the sweep"
