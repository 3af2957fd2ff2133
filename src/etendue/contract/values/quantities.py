"""Quantities that several stages share; each is declared once, by a distribution.

``quantity("NAME")`` is the field of a stage that uses it. In a pipeline file they are in one table
(``contract.values.tables``): one value for all stages that use it.
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
    """The declaration of a shared quantity: the keywords of ``param()``, its name as an axis, and a default unless it
    must be given.

    ``prefix`` is written before the values of the quantity instead of its name; ``off`` is the value that turns the
    quantity off.

    ``scales``: another quantity whose values this quantity multiplies or explains. If a preset gives a value of this
    quantity and the pipeline gives a value of the other, the two therefore do not match.

    ``compared``: a design for Sobol' indices uses this value of the quantity, unless the pipeline gives one, so that
    samples differ only by their factors.
    """

    shared: bool = True
    long_name: str = ""
    prefix: str = ""
    off: float | None = None
    scales: str = ""
    compared: str = ""
    default: Any = dataclasses.field(default_factory=lambda: MISSING)

    def __post_init__(self) -> None:
        for name in ("choices", "held", "apart", "default", "example", "tried"):
            if isinstance(getattr(self, name), list):
                object.__setattr__(self, name, tuple(getattr(self, name)))
        parse_unit(self.units)
        for name in ("above", "at_least", "below", "at_most"):
            if isinstance(getattr(self, name), str | bool):
                raise TypeError(f"{name} is {getattr(self, name)!r}; expected a number")


def quantity(name: str, doc: str = "") -> Any:
    """Return the dataclass field of a shared quantity; ``doc`` describes which of its values a stage takes.

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
    """Return the ``Parameter`` of a quantity, and its default (``MISSING`` if a value is required).

    Raises
    ------
    PluginError
        If no distribution provides the quantity, or its declaration cannot be read.
    """
    brought = discovery.installed().first("quantities", name)
    if brought is None:
        hint = (
            nearest(name, names())
            or "; a distribution brings one with etendue_quantities() in a separate manifest module"
        )
        raise PluginError(
            f"unknown {next(iter(tables()))} quantity {name!r}{hint}{discovery.installed().missed('quantities', name)}"
        )
    return discovery.made_of(Quantity, f"the {next(iter(tables()))} quantity {name!r}", brought)


def long_name(name: str) -> str:
    """Return the long name of an axis in an archive."""
    return (declared(name).long_name if name in names() else "") or name
