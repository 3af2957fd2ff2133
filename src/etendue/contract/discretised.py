"""Stages that sample something continuous say how they can sample it more finely.

In:  a stage.
Out: its discretisations, and the parameters that refine one of them.
"""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

from etendue.contract.stage import Stage


@dataclasses.dataclass(frozen=True, kw_only=True)
class Discretised(Stage):
    """A stage that samples something continuous: bands, positions, a finite part of the plane.

    The error of an answer includes what one refinement of each discretisation changes.
    """

    @abstractmethod
    def discretisations(self) -> Mapping[str, str]:
        """Return the names of its discretisations (bins, spacing, margin); with each the reason why it cannot be
        refined, such as 'that of the file', or '' if it can."""

    @abstractmethod
    def refined(self, name: str, factor: int) -> Mapping[str, Any]:
        """Return the values of parameters that refine a discretisation: ``factor`` times as fine, or as large a margin.

        A negative factor coarsens. An empty mapping: this is as fine or coarse as it gets.
        """
