"""One parameter of a stage: its unit, range, choices and role.

In:  keywords of ``param``.
Out: the field of a dataclass.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

MISSING = dataclasses.MISSING


@dataclasses.dataclass(frozen=True)
class Parameter:
    """The allowed values of one parameter, apart from its type."""

    units: str = "1"
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    choices: tuple[str, ...] | None = None
    numbered: bool = False  # beside its choices, whole numbers from 0, which a stage gets as text
    shared: bool = False
    fidelity: bool = False
    reference: str = ""
    settings: tuple[
        Any, ...
    ] = ()  # of a fidelity parameter, from the cheapest to the reference; empty if they have no order
    costs: tuple[float, ...] = ()  # of the stage at each setting, relative to one of them; empty if not measured
    # of a fidelity parameter: it changes a grid, what a scene shows or an interval; only studies vary it, never a plan
    studied: bool = False
    # of a fidelity parameter: settings finer than its default are too costly; neither a plan nor a reference takes them
    dear: bool = False
    exact: bool = False  # of a fidelity parameter: its reference is exact although it is neither 0 nor infinite
    file: bool = False  # the path of a file
    folder: bool = False  # of a file or a folder
    table: bool = False  # a name, or the path of a CSV file
    along: str = ""  # mapped over this dim, a stage gets the label of its slice instead of the value
    held: tuple[float, float] | None = None  # range that its stages support; the plan refuses values outside it
    length: int | None = None
    one_for_all: bool = False  # a list that may be written as a single number
    infinite: bool = False
    # values with a meaning of their own, which is not the limit of the numbers beside them: 0 for "as the others say"
    apart: tuple[float, ...] = ()
    # value for testing a stage that has no default, or a large one; a file as in a pipeline, "package:..."
    example: Any = None
    tried: tuple[Any, ...] = ()  # other values for testing a text without choices
    doc: str = ""

    @property
    def closed_form(self) -> bool:
        """Whether the reference setting is exact: declared as exact, or 0 or infinite, so that it omits nothing."""
        last = self.settings[-1] if self.settings else None
        return self.exact or (
            isinstance(last, int | float) and not isinstance(last, bool) and (last == 0 or math.isinf(last))
        )

    def range_text(self) -> str:
        """Return the allowed range in words; '' if every value is allowed."""
        parts = []
        for word, limit in (
            ("above", self.above),
            ("at least", self.at_least),
            ("below", self.below),
            ("at most", self.at_most),
        ):
            if limit is not None:
                parts.append(f"{word} {limit:g}")
        text = " and ".join(parts)
        return f"{text} {self.units}".strip() if text and self.units not in ("1", "") else text

    def shown_range(self) -> str:
        """Return the range in words, with the part of it that the stages support."""
        if self.numbered:
            return "or a whole number from 0"
        if self.held is None:
            return self.range_text()
        return f"{self.range_text()}; computed from {self.held[0]:g} to {self.held[1]:g}".removeprefix("; ")

    def allows(self, value: float) -> bool:
        return (
            (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.below is None or value < self.below)
            and (self.at_most is None or value <= self.at_most)
        )


def param(default: Any = MISSING, **allowed: Any) -> Any:
    """Declare a parameter of a stage: its default, unit, range and role (see ``Parameter``).

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from etendue.api import Stage, param
    >>> @dataclass(frozen=True, kw_only=True)
    ... class Fading(Stage):
    ...     loss: float = param(0.1, units="mm-1", at_least=0, below=1, doc="share lost per mm")
    >>> Fading().loss
    0.1
    """
    parameter = Parameter(**allowed)
    if parameter.fidelity and not parameter.reference:
        raise TypeError("a fidelity parameter must name its reference: param(..., fidelity=True, reference='...')")
    if not parameter.fidelity and (parameter.settings or parameter.studied):
        raise TypeError(
            "only a fidelity parameter can have settings or be studied: param(..., fidelity=True, reference='...', "
            "settings=(...))"
        )
    if parameter.settings and not _lies_within(default, parameter.settings):
        raise TypeError(
            f"settings must go from the cheapest to the reference and contain the default {default!r}; got "
            f"{parameter.settings}"
        )
    if parameter.costs and (
        len(parameter.costs) != len(parameter.settings) or not all(cost > 0 for cost in parameter.costs)
    ):
        raise TypeError(
            f"costs must be numbers above 0, one per setting ({len(parameter.settings)}); got {parameter.costs}"
        )
    return (
        dataclasses.field(default=default, metadata={"parameter": parameter})
        if default is not MISSING
        else dataclasses.field(metadata={"parameter": parameter})
    )


def _lies_within(default: bool | float, settings: tuple[Any, ...]) -> bool:
    """Return whether a default is one of the settings, or a number between the first and the last of them."""
    if len(settings) < 2 or len(set(settings)) < len(settings):
        return False
    if default in settings:
        return True
    ends = (settings[0], settings[-1])
    return all(isinstance(value, int | float) for value in (default, *ends)) and min(ends) < default < max(ends)
