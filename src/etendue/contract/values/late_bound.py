"""A shared quantity that an earlier stage computes during the run: during planning, only its range is known.

In:  the smallest and the largest value that may be found.
Out: a placeholder for a stage's parameter, which cannot be used in arithmetic; ``ends``: the smallest and largest value
     of the placeholder, or of a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn


class NotKnown(Exception):
    """A part of the plan depends on a value that is known only during a run."""


@dataclass(frozen=True)
class LateValue:
    """Placeholder for a number between ``low`` and ``high``; arithmetic and comparisons with it raise ``NotKnown``."""

    name: str
    low: float
    high: float

    def _unknown(self, *others: object, **more: object) -> NoReturn:
        raise NotKnown(self.name)

    __float__ = __int__ = __index__ = __bool__ = __round__ = __neg__ = __abs__ = _unknown
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __pow__ = __rpow__ = (
        _unknown
    )
    __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = __lt__ = __le__ = __gt__ = __ge__ = __array__ = __format__ = (
        __array_ufunc__
    ) = __array_function__ = _unknown


def ends(value: float | LateValue) -> tuple[float, float]:
    """Return the smallest and largest possible value of a quantity: both equal to the number if it is known, or the
    ends of its range if only a run determines it.

    Examples
    --------
    >>> from etendue.api import ends
    >>> ends(2.5)
    (2.5, 2.5)
    """
    return (value.low, value.high) if isinstance(value, LateValue) else (float(value), float(value))
