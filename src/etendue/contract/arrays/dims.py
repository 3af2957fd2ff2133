"""Dims as distributions declare them: division into bands, units and names.

In:  names of dims.
Out: their declarations. A dim need not be declared; an undeclared dim has points or labels, and no unit.
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
    """The declaration of a dim.

    ``bins``: the dim is divided into bands with edges; stages get the centres, and the edges as ``NAME_edges``.
    ``units``: unit of centres and edges. ``asked_in``: the unit in which transfer functions get the centres; '' if it
    is ``units``. ``long_name``, ``standard_name``: names of the dim in archives. ``example``: edges, evenly spaced
    positions or names with which stages are tested; ``spacing``: the shared quantity that gives the distance between
    samples along the dim.
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
        """The factor from the unit of the centres to the unit in which transfer functions take them."""
        # imported late: only transfer functions need it, so only their digests cover it
        from etendue.contract.values.units import (
            to_unit,  # in the code digest of transfer functions only
        )

        return to_unit(f"1 {self.units}", self.asked_in) if self.asked_in not in ("", self.units) else 1.0


UNDECLARED = Dim()
_KNOWN: dict[tuple[str, str], Dim] = {}


def dim(name: str) -> Dim:
    """Return the declaration of a dim."""
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
    """Return the names of all declared dims."""
    return tuple(discovery.installed().names("dims"))


def banded(dims: Iterable[str]) -> str:
    """Return the first dim that is divided into bands; '' if there is none."""
    return next((name for name in dims if name not in PLACE and dim(name).bins), "")


def is_light(dims: Iterable[str]) -> bool:
    """Return whether an array with these dims has a value for every band and position."""
    own = {*dims}
    return own > {*PLACE} and bool(banded(own))
