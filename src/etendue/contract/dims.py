"""Dims as distributions declare them: which of them are bands, in which unit, by which name.

In:  names of dims.
Out: what is declared of them. A dim need not be declared: one that nobody speaks of has points or labels, and no unit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from etendue.plugins import discovery

PLACE = ("y", "x")  # the dims of a picture


@dataclass(frozen=True)
class Dim:
    """What a distribution says of a dim.

    ``bins``: it is cut into bands with edges; stages are given their middles, and the edges as ``NAME_edges``. ``units``: of both.
    ``asked_in``: the unit in which transfer functions are given the middles; '' where it is the same. ``long_name`` and
    ``standard_name``: as archives name it.
    """

    bins: bool = False
    units: str = ""
    asked_in: str = ""
    long_name: str = ""
    standard_name: str = ""

    @cached_property
    def factor(self) -> float:
        """From the unit of the middles to that in which transfer functions are asked."""
        from etendue.contract.units import to_unit  # of transfer functions alone: it stands in the code behind these

        return to_unit(f"1 {self.units}", self.asked_in) if self.asked_in not in ("", self.units) else 1.0


UNDECLARED = Dim()
_KNOWN: dict[tuple[str, str], Dim] = {}


def dim(name: str) -> Dim:
    """What is declared of a dim."""
    brought = discovery.installed().first("dims", name)
    if brought is None:
        return UNDECLARED
    place = (name, brought.origin)
    if place not in _KNOWN:
        _KNOWN[place] = discovery.made_of(Dim, f"the dim {name!r}", brought)
    return _KNOWN[place]


def banded(dims: Iterable[str]) -> str:
    """Which of some dims is one of bands; '' where none is."""
    return next((name for name in dims if name not in PLACE and dim(name).bins), "")


def is_light(dims: Iterable[str]) -> bool:
    """Whether something with these dims has a value for every band and place."""
    own = {*dims}
    return own > {*PLACE} and bool(banded(own))
