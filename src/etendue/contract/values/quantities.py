"""Quantities that several stages share, brought by distributions, declared once.

``quantity("NAME")`` is the field of a stage that uses it. In a pipeline file they stand under one table
(``contract.values.tables``): one value, however many stages use it.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

from etendue.contract.values.parameter import MISSING, Parameter
from etendue.contract.values.tables import tables
from etendue.contract.values.units import parse_unit
from etendue.errors import PluginError, nearest
from etendue.plugins import discovery


@dataclasses.dataclass(frozen=True)
class Quantity(Parameter):
    """What a distribution says of a shared quantity: the words of ``param()``, its name as an axis, a default unless it
    must be given.

    ``prefix`` stands in front of its values in the place of its name; ``off`` is the value that says that it does not
    count.

    ``scales``: a quantity whose every value it multiplies: a preset's value of the one does not fit a pipeline's own of
    the other.
    """

    shared: bool = True
    long_name: str = ""
    prefix: str = ""
    off: float | None = None
    scales: str = ""
    default: Any = dataclasses.field(default_factory=lambda: MISSING)

    def __post_init__(self) -> None:
        for name in ("choices", "held", "default", "example"):
            if isinstance(getattr(self, name), list):
                object.__setattr__(self, name, tuple(getattr(self, name)))
        parse_unit(self.units)
        for name in ("above", "at_least", "below", "at_most"):
            if isinstance(getattr(self, name), str | bool):
                raise TypeError(f"{name} is {getattr(self, name)!r}; expected a number")


def quantity(name: str, doc: str = "") -> Any:
    """The dataclass field of a shared quantity; ``doc`` says of a stage that takes some of its values which.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from etendue.api import Stage, quantity
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Sampling(Stage):
    ...     pixel_pitch: float = quantity("pixel_pitch")  # its unit, range and default are those of the vocabulary
    >>> Sampling(pixel_pitch=5.4).pixel_pitch
    5.4
    """
    found = declared(name)
    if doc:
        found = dataclasses.replace(found, doc=doc)
    return dataclasses.field(default=found.default, metadata={"parameter": found})


def names() -> tuple[str, ...]:
    return tuple(discovery.installed().names("quantities"))


@cache
def declared(name: str) -> Quantity:
    """What is allowed for a quantity, and its default (``MISSING`` where it must be given).

    Raises
    ------
    PluginError
        Nobody brings it, or what is brought cannot be read.
    """
    brought = discovery.installed().first("quantities", name)
    if brought is None:
        hint = (
            nearest(name, names())
            or "; a distribution brings one by etendue_quantities() in a manifest that is a module of its own"
        )
        raise PluginError(
            f"there is no {next(iter(tables()))} quantity "
            f"{name!r}{hint}{discovery.installed().missed('quantities', name)}"
        )
    return discovery.made_of(Quantity, f"the {next(iter(tables()))} quantity {name!r}", brought)


def long_name(name: str) -> str:
    """What an axis of an archive is called."""
    return (declared(name).long_name if name in names() else "") or name
