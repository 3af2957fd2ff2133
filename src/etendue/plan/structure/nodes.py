"""The graph of a plan: swept axes, and the stages with the axes that reach them. Frozen values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import Probe, draws_anew, ends_in_sum, is_random, is_source, is_transfer
from etendue.contract.stage import Stage, quantities_of
from etendue.types.documents import DocumentView


@dataclass(frozen=True)
class Axis:
    """One swept parameter. ``key`` is its name in the file; ``dim`` is its name as a dimension."""

    key: str
    dim: str
    values: tuple[Any, ...]  # floats, ints or texts; labels if the axis swaps a stage
    units: str = ""
    gives: Mapping[str, tuple[Any, ...]] = field(
        default_factory=dict, hash=False
    )  # values by parameter, for an axis that sets several at once
    factors: tuple[Axis, ...] = ()  # axes whose values change together along this one
    rows: tuple[tuple[int, ...], ...] = ()  # by position: the position on each of them
    of: str = ""  # the axis of which this one has the distinct combinations of some factors; '' for one of its own
    places: tuple[int, ...] = ()  # by position on that axis: the position here

    def value(self, name: str, position: int) -> Any:
        """Return the value of a parameter at a position."""
        return self.gives[name][position] if name in self.gives else self.values[position]

    def column(self, factor: int) -> tuple[Any, ...]:
        """Return the value of one factor of the axis at every position."""
        return tuple([self.factors[factor].values[row[factor]] for row in self.rows])


@dataclass(frozen=True)
class Alternative:
    """One stage that a node can use: its class and its fixed parameters."""

    use: str
    label: str
    kind: type[Stage]
    values: DocumentView
    distribution: str
    version: str
    digest: str
    written: frozenset[str] = frozenset()  # parameters that the file gives


@dataclass(frozen=True)
class Node:
    """A stage of the pipeline, with its inputs and the axes that affect it."""

    name: str
    number: int
    place: str
    alternatives: tuple[Alternative, ...]
    direct: tuple[tuple[str, str], ...]  # (axis dim, parameter) set by an axis
    use_axis: str | None  # dim of the axis that swaps this stage
    # per alternative: (port or shared quantity, node, variable); ports first
    inputs: tuple[tuple[tuple[str, str, str], ...], ...]
    looks_at: tuple[tuple[str, str, tuple[str, ...]], ...]  # (port, 'transfer' or variable, nodes in order)
    writes: Mapping[str, Declaration]
    axes: tuple[str, ...]
    # optional variables that nothing uses
    optional: Mapping[str, Declaration] = field(default_factory=dict)
    segment: tuple[str, ...] = ()  # names of the transfer nodes of its segment, up to itself
    mapped: tuple[str, ...] = ()  # leading dims of its inputs over which it is run slice by slice

    @property
    def found(self) -> dict[str, str]:
        """The shared quantities that earlier stages write, each with the stage that writes it."""
        pairs = zip(self.alternatives, self.inputs, strict=True)
        return {name: source for one, bound in pairs for name, source, _ in bound if name in quantities_of(one.kind)}

    @property
    def kind(self) -> type[Stage]:
        return self.alternatives[0].kind

    @property
    def is_source(self) -> bool:
        return is_source(self.kind)

    @property
    def is_transfer(self) -> bool:
        return is_transfer(self.kind)

    @property
    def ends_in_sum(self) -> bool:
        return ends_in_sum(self.kind)

    @property
    def is_probe(self) -> bool:
        return issubclass(self.kind, Probe)

    @property
    def is_random(self) -> bool:
        return any(is_random(a.kind) for a in self.alternatives)

    @property
    def draws_anew(self) -> bool:
        return any(draws_anew(a.kind) for a in self.alternatives)
