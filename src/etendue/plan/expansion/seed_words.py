"""Build the words that key the random numbers of a cell: all parameter values, of its stage and of the stages it
depends on, that differ from their defaults.

In:  cells of a plan.
Out: lines of text; lines whose value is found during the run are left open.

Draws do not depend on a new parameter with a default, on an accuracy setting, or on the way a quantity was obtained.
Whether a value is given, swept or found by a run, it makes the same word.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Any

from etendue.contract.stage import Stage, files_of, parameters_of
from etendue.contract.values.late_bound import LateValue
from etendue.plan.identity.keys import canonical, digest, file_digest
from etendue.plan.model import Cell, CellRef


@dataclass(frozen=True)
class Open:
    """A line whose value a run finds: its stage and parameter, and the cell that writes the value."""

    stage: str
    name: str
    default: Any
    ref: CellRef
    variable: str


def line(stage: str, name: str, value: Any) -> str:
    return f"{stage}.{name}={canonical(value)}"


def own_lines(name: str, stage: Stage) -> tuple[str, ...]:
    """Return the lines of one stage, under its name in the pipeline."""
    files = files_of(stage)
    found = []
    for parameter, (declared, _, default) in parameters_of(type(stage)).items():
        value = getattr(stage, parameter)
        if declared.fidelity or isinstance(value, LateValue) or value == default:
            continue
        found.append(line(name, parameter, file_digest(files[parameter]) if parameter in files else value))
    return tuple(found)


def seed_of(seed: int, node: str, lines: Set[str]) -> bytes:
    """Return the words that seed a generator."""
    return f"{seed}|{node}|{digest(chr(10).join(sorted(lines)).encode())}".encode()


def behind(cells: Mapping[CellRef, Cell], starts: list[Cell]) -> list[Cell]:
    """Return some cells and every cell that they read through their ports, directly or indirectly. Cells that only
    find a quantity are not included: the value counts, not its origin.
    """
    seen: dict[CellRef, Cell] = {}
    open_ = list(starts)
    while open_:
        cell = open_.pop()
        if cell.ref in seen:
            continue
        seen[cell.ref] = cell
        found = {name for name, _, _ in cell.found} if cell.inputs else ()
        open_ += [cells[ref] for port, ref, _ in cell.inputs if port not in found]
    return list(seen.values())
