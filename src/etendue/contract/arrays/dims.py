"""Dims as distributions declare them: which of them are bands, in which unit, by which name.

In:  names of dims.
Out: what is declared of them. A dim need not be declared: one that nobody speaks of has points or labels, and no unit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

from etendue.plugins import discovery

PLACE = ("y", "x")  # the dims of a picture


@dataclass(frozen=True)
class Dim:
    """What a distribution says of a dim.

    ``bins``: it is cut into bands with edges; stages are given their middles, and the edges as ``NAME_edges``.
    ``units``: of both. ``asked_in``: the unit in which transfer functions are given the middles; '' where it is the
    same. ``long_name`` and ``standard_name``: as archives name it. ``example``: edges, evenly spaced places or names
    with which stages are tried; ``spacing``: the shared quantity that is the distance of its samples.
    """

    bins: bool = False
    units: str = ""
    asked_in: str = ""
    long_name: str = ""
    standard_name: str = ""
    example: tuple[Any, ...] = ()
    spacing: str = ""
    doc: str = ""

    @cached_property
    def factor(self) -> float:
        """From the unit of the middles to that in which transfer functions are asked."""
        from etendue.contract.values.units import (
            to_unit,  # of transfer functions alone: it stands in the code behind these
        )

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
        made = discovery.made_of(Dim, f"the dim {name!r}", brought)
        _KNOWN[place] = replace(made, example=tuple(made.example))
    return _KNOWN[place]


@cache
def declared_dims() -> tuple[str, ...]:
    """Every dim of which somebody speaks."""
    return tuple(discovery.installed().names("dims"))


def banded(dims: Iterable[str]) -> str:
    """Which of some dims is one of bands; '' where none is."""
    return next((name for name in dims if name not in PLACE and dim(name).bins), "")


def is_light(dims: Iterable[str]) -> bool:
    """Whether something with these dims has a value for every band and place."""
    own = {*dims}
    return own > {*PLACE} and bool(banded(own))
