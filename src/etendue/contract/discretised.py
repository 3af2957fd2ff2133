"""Stages that sample something continuous, and the parameters with which they sample it more finely.

In:  a stage.
Out: its discretisations, and the parameters that refine one of them; values of parameters that a pipeline leaves open.
"""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from etendue.contract.stage import Stage

AUTO = "auto"  # in a pipeline: the value of a parameter that is left open


@dataclasses.dataclass(frozen=True, kw_only=True)
class Discretised(Stage):
    """A stage that samples something continuous: bands, positions, a finite part of the plane.

    The stated error of an answer includes the change that one refinement of each discretisation causes.

    ``automatic``: parameters that a pipeline may leave open (``"auto"``), each with its discretisation. ``chosen``
    returns the values of these parameters; ``finer`` returns the next finer values for ``--hold``.
    """

    automatic: ClassVar[Mapping[str, str]] = MappingProxyType({})

    @abstractmethod
    def discretisations(self) -> Mapping[str, str]:
        """Return the discretisations of the stage (bins, spacing, margin) by name, each with the reason why it cannot
        be refined, such as 'fixed by the file', or '' if it can be refined.
        """

    @abstractmethod
    def refined(self, name: str, factor: int) -> Mapping[str, Any]:
        """Return the values of parameters that refine a discretisation: ``factor`` times as fine, or a margin
        ``factor`` times as large.

        A negative factor coarsens. An empty mapping means that no further step is possible.
        """

    @classmethod
    def chosen(cls, name: str, values: Mapping[str, Any], shared: Mapping[str, tuple[Any, ...]]) -> Any:
        """Return the value of a parameter that is left open, in its unit, by the rule that the documentation of the
        parameter states.

        ``values``: the known values of the other parameters; ``shared``: all values of each shared quantity in the
        pipeline, by name.
        """
        raise TypeError(f"{cls.__name__} has automatic parameters and must define chosen")

    def finer(self, name: str) -> Mapping[str, Any]:
        """Return the values of parameters with which a discretisation that is left open becomes one step finer."""
        return self.refined(name, 2)
