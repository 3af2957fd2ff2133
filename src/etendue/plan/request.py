"""What is asked for, and what has been found wrong with it so far: every room of the planner adds to the same list.

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


@dataclass(frozen=True)
class Choice:
    """How the planner was asked to decide."""

    tolerance: float
    leave_out: bool  # whether anything may be left out or approximated
    precision: str  # auto, float32 or float64
    norm: str = "rms"
    expected: bool = False  # means in the place of draws and rounding
    versions: Mapping[str, str] = field(default_factory=dict)  # of libraries, in keys: not those that are installed
    computed: frozenset[str] = frozenset()  # stages that are not left out, whatever their bound


class Request:
    """A pipeline being checked.

    Attributes
    ----------
    whole : whether what every stage writes is known; else nothing is concluded from a lack
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
        """Whether a value of an axis may be called so; ``known``: labels of the values in front of it."""
        if unprintable(label) or not label:
            self.fault(place, f"the label {as_written(label)} is no plain name: text without control characters")
        elif label in known:
            self.fault(place, f"{label!r} stands twice; give one of them another 'label'")
        else:
            return True
        return False
