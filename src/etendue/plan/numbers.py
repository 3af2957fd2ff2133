"""Cells as numbers: what is known of every cell of a plan fits in columns, a few bytes a cell, where it stands at its
number.

In:  the nodes of a plan and the sizes of its axes.
Out: the number of a cell, from 0, in the order of the plan.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import prod
from operator import mul
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from etendue.plan.model import CellRef, Node


class Numbers:
    """The cells of a node stand one behind the other, the last axis fastest: no table of them is needed."""

    def __init__(self, nodes: Iterable[Node], sizes: Mapping[str, int]) -> None:
        self.count = 0
        self.counts: dict[str, int] = {}  # by node
        self.places: dict[str, tuple[int, tuple[int, ...]]] = {}
        for node in nodes:
            own = [sizes[dim] for dim in node.axes]
            self.places[node.name] = self.count, tuple(prod(own[place + 1 :]) for place in range(len(own)))
            self.counts[node.name] = prod(own)
            self.count += prod(own)

    def range(self, node: str) -> range:
        """The numbers of the cells of a node."""
        first = self.places[node][0]
        return range(first, first + self.counts[node])

    def of(self, ref: CellRef) -> int:
        first, strides = self.places[ref[0]]
        number: int = first + sum(map(mul, ref[1], strides))
        return number
