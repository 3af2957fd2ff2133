"""What is asked for, and what has been found wrong with it so far: every room of the planner adds to the same list.

In:  a ``Pipeline`` (values as written) and a ``Registry``.
Out: faults and warnings, in the order in which they were found.
"""

from __future__ import annotations

from etendue.contract.registry import Registry
from etendue.errors import Fault
from etendue.pipeline.file import Pipeline


class Request:
    """A pipeline being checked.

    Attributes
    ----------
    whole : whether what every stage writes is known; else nothing is concluded from a lack
    """

    def __init__(self, pipeline: Pipeline, registry: Registry) -> None:
        self.pipeline = pipeline
        self.registry = registry
        self.faults: list[Fault] = list(pipeline.faults)
        self.warnings: list[str] = []
        self.whole = pipeline.whole

    def fault(self, place: str, message: str) -> None:
        self.faults.append(Fault(place, message))
