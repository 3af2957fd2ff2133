"""The request being planned and the faults found in it so far: every module of the planner adds to the same list.

In:  a ``Pipeline`` (values as written) and a ``Registry``.
Out: faults and warnings, in the order in which they were found.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field

from etendue.contract.registry import Registry
from etendue.contract.values.units import as_written
from etendue.errors import Fault, unprintable
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Cell, CellRef, Plan


@dataclass(frozen=True)
class Choice:
    """The kind of decisions that is requested from the planner."""

    tolerance: float
    leave_out: bool  # whether anything may be left out or approximated
    precision: str  # auto, float32 or float64
    norm: str = "rms"
    expected: bool = False  # means instead of draws and rounding
    # library versions for the keys, instead of the installed ones
    versions: Mapping[str, str] = field(default_factory=dict)
    computed: frozenset[str] = frozenset()  # stages that are not left out, whatever their bound
    decided: Mapping[CellRef, Cell] = field(default_factory=dict)  # cells whose decisions are copied
    stored: bool = True  # whether results may be stored or reused: if not, cells have neither keys nor stated errors
    digits: float = 0.0  # tolerance to which the digits of pictures are rounded; 0: all stay
    earlier: tuple[Plan, ...] = ()  # plans decided alike; cells that cannot differ are taken from one of them


class Request:
    """A pipeline being checked.

    Attributes
    ----------
    whole : whether the outputs of all stages are known; if not, a missing variable is not reported as a fault
    """

    def __init__(self, pipeline: PipelineFile, registry: Registry) -> None:
        self.pipeline = pipeline
        self.registry = registry
        self.faults: list[Fault] = list(pipeline.faults)
        self.warnings: list[str] = []
        self.whole = pipeline.whole

    def fault(self, place: str, message: str) -> None:
        self.faults.append(Fault(place, message))

    def takes_label(self, place: str, label: str, known: Container[str]) -> bool:
        """Return whether an axis value may have this label; ``known`` are the labels before it."""
        if unprintable(label) or not label:
            self.fault(place, f"invalid label {as_written(label)}: expected text without control characters")
        elif label in known:
            self.fault(place, f"{label!r} appears twice; give one of them another 'label'")
        else:
            return True
        return False
