"""What keys the random numbers of a cell: the values, of its stage and of those it depends on, that differ from their
defaults.

In:  cells of a plan.
Out: lines of text; those whose value is found while the run goes on are left open.

A parameter that is added with a default, a knob of fidelity, and how a quantity was found change no draw: given, swept
or found, the same value is the same word.
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
    """A line whose value a run finds: of which stage and parameter, and which cell writes it."""

    stage: str
    name: str
    default: Any
    ref: CellRef
    variable: str


def line(stage: str, name: str, value: Any) -> str:
    return f"{stage}.{name}={canonical(value)}"


def own_lines(name: str, stage: Stage) -> tuple[str, ...]:
    """The lines of one stage under the name that it has in the pipeline."""
    files = files_of(stage)
    found = []
    for parameter, (declared, _, default) in parameters_of(type(stage)).items():
        value = getattr(stage, parameter)
        if declared.fidelity or isinstance(value, LateValue) or value == default:
            continue
        found.append(line(name, parameter, file_digest(files[parameter]) if parameter in files else value))
    return tuple(found)


def seed_of(seed: int, node: str, lines: Set[str]) -> bytes:
    """Words for a generator."""
    return f"{seed}|{node}|{digest(chr(10).join(sorted(lines)).encode())}".encode()


def behind(cells: Mapping[CellRef, Cell], starts: list[Cell]) -> list[Cell]:
    """Some cells and every cell that they read through their ports, at any distance. What a quantity was found from
    is none of them.
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
