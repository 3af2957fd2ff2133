"""What a kernel asks of its arguments, and what it says where it is not given: the name, what came, what may come.

In:  an argument, and whether it is as it has to be.
Out: the argument, numbers in floating point; ``ValueError`` where it is not fine.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from etendue.types.arrays import Array


def that(fine: Any, text: str) -> None:
    """``TEXT``, unless it is fine: what no other sentence here says."""
    if not fine:
        raise ValueError(text)


def must(fine: Any, name: str, value: object, what: str) -> None:
    """``NAME is VALUE; it must be WHAT``, unless all is fine."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} is {value}; it must be {what}")


def positive(name: str, value: ArrayLike, unit: str = "") -> None:
    must(np.asarray(value) > 0, name, value, f"above 0{unit}")


def finite(name: str, value: ArrayLike) -> None:
    must((np.asarray(value) > 0) & np.isfinite(value), name, value, "above 0 and finite")


def allowed(fine: Any, name: str, value: object, what: str) -> None:
    """``NAME is VALUE; allowed are WHAT``, unless all is fine."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} is {value!r}; allowed are {what}")


def only(fine: Any, name: str, value: object, what: str) -> None:
    """``NAME is VALUE; allowed is WHAT``, unless all is fine."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} is {value}; allowed is {what}")


def shape(fine: Any, name: str, array: Any, what: str) -> None:
    """``NAME has shape SHAPE; allowed is WHAT``, unless all is fine."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} has shape {array.shape}; allowed is {what}")


def equal_shapes(name: str, array: Array, other: str, reference: Array) -> None:
    if array.shape != reference.shape:
        raise ValueError(f"{name} has shape {array.shape} and {other} {reference.shape}; allowed are equal shapes")


def floating(values: ArrayLike) -> Array:
    """An array in its own precision; of whole numbers, in double."""
    array = np.asarray(values)
    return array if array.dtype.kind == "f" else array.astype(np.float64)


def at_least_zero(name: str, values: ArrayLike, unit: str = "") -> Array:
    array = floating(values)
    if not (array >= 0).all():
        raise ValueError(f"{name} is {_worst(array)!r}{unit}; allowed are numbers at or above 0")
    return array


def above_zero(name: str, values: ArrayLike) -> Array:
    array = floating(values)
    if not (array > 0).all():
        raise ValueError(f"{name} is {_worst(array)!r}; allowed are numbers above 0")
    return array


def amount(name: str, value: float) -> float:
    """A finite number from 0."""
    value = float(value)
    allowed(0 <= value < math.inf, name, value, "finite numbers at or above 0")
    return value


def _worst(array: Array) -> float:
    return float(np.min(array))  # NaN wins, as it should
