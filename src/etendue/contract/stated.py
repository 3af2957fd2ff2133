"""Errors that are the same for all values of a stage: a number per precision, and its basis.

In:  bounds relative to full scale, for 32 and 64 bits.
Out: the value of a class's ``error``, instead of a method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from etendue.contract.arrays.facts import Facts
    from etendue.contract.arrays.grid import Grid


@dataclass(frozen=True)
class Stated:
    """A fixed error and its basis. It is called like a method: ``stage.error(facts, grid, precision)``."""

    float32: float
    float64: float
    how: str

    def __call__(
        self, facts: Facts | Mapping[str, Facts], grid: Mapping[str, Grid], precision: str
    ) -> tuple[float, str]:
        return (self.float32 if precision == "float32" else self.float64), self.how


def proved(float32: float, float64: float | None = None) -> Stated:
    """Return an error that follows from the arithmetic: one number for single and one for double precision, or one
    number for both.

    Examples
    --------
    >>> from etendue.api import Stage, proved
    >>> class Halved(Stage):
    ...     error = proved(1e-7, 2e-16)
    >>> Halved().error(None, None, "float64")
    (2e-16, 'proved')
    """
    return Stated(float32, float32 if float64 is None else float64, "proved")


def measured(float32: float, float64: float | None = None) -> Stated:
    """Return an error measured against a reference.

    Examples
    --------
    >>> from etendue.api import measured
    >>> measured(3e-7)(None, None, "float32")
    (3e-07, 'measured')
    """
    return Stated(float32, float32 if float64 is None else float64, "measured")


def fitted(float32: float, float64: float | None = None) -> Stated:
    """Return an error read from a rule that was fitted to measured errors.

    Examples
    --------
    >>> from etendue.api import fitted
    >>> fitted(2e-5)(None, None, "float32")
    (2e-05, 'fitted')
    """
    return Stated(float32, float32 if float64 is None else float64, "fitted")
