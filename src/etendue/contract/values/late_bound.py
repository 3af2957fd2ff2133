"""A shared quantity that an earlier stage finds while a run goes on: while planning only its ends are known.

In:  the smallest and the largest value that may be found.
Out: a value that stands in a stage's parameter and cannot be reckoned with; ``ends`` of it, or of a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NoReturn


class NotKnown(Exception):
    """Something of the plan depends on a value that only a run finds."""


@dataclass(frozen=True)
class LateValue:
    """Stands for a number between ``low`` and ``high``; whoever reckons with it or compares it is stopped by
    ``NotKnown``.
    """

    name: str
    low: float
    high: float

    def _unknown(self, *others: Any, **more: Any) -> NoReturn:
        raise NotKnown(self.name)

    __float__ = __int__ = __index__ = __bool__ = __round__ = __neg__ = __abs__ = _unknown
    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = __pow__ = __rpow__ = (
        _unknown
    )
    __floordiv__ = __rfloordiv__ = __mod__ = __rmod__ = __lt__ = __le__ = __gt__ = __ge__ = __array__ = __format__ = (
        __array_ufunc__
    ) = __array_function__ = _unknown


def ends(value: Any) -> tuple[float, float]:
    """Smallest and largest value of a quantity: of a number itself, of one that is found its declared ends.

    Examples
    --------
    >>> from etendue.api import ends
    >>> ends(2.5)
    (2.5, 2.5)
    """
    return (value.low, value.high) if isinstance(value, LateValue) else (float(value), float(value))
