"""Check the arguments of kernels. An error names the argument, the value it got and the values allowed.

In:  an argument, and whether it is valid.
Out: the argument, as floating point if it is numeric; ``ValueError`` if it is invalid.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from etendue.types.arrays import Array


def that(fine: Any, text: str) -> None:
    """Raise ``TEXT`` unless ``fine``; for messages that do not fit another function of this module."""
    if not fine:
        raise ValueError(text)


def must(fine: Any, name: str, value: object, what: str) -> None:
    """Raise ``NAME is VALUE; it must be WHAT`` unless all of ``fine`` is true."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} is {value}; it must be {what}")


def positive(name: str, value: ArrayLike, unit: str = "") -> None:
    must(np.asarray(value) > 0, name, value, f"above 0{unit}")


def finite(name: str, value: ArrayLike) -> None:
    must((np.asarray(value) > 0) & np.isfinite(value), name, value, "above 0 and finite")


def allowed(fine: Any, name: str, value: object, what: str) -> None:
    """Raise ``NAME is VALUE; allowed: WHAT`` unless all of ``fine`` is true."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} is {value!r}; allowed: {what}")


def only(fine: Any, name: str, value: object, what: str) -> None:
    """Raise ``NAME is VALUE; allowed: WHAT`` unless all of ``fine`` is true."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} is {value}; allowed: {what}")


def shape(fine: Any, name: str, array: Any, what: str) -> None:
    """Raise ``NAME has shape SHAPE; allowed: WHAT`` unless all of ``fine`` is true."""
    if fine is not True and not np.all(fine):
        raise ValueError(f"{name} has shape {array.shape}; allowed: {what}")


def equal_shapes(name: str, array: Array, other: str, reference: Array) -> None:
    if array.shape != reference.shape:
        raise ValueError(f"{name} has shape {array.shape} and {other} {reference.shape}; allowed: equal shapes")


def floating(values: ArrayLike) -> Array:
    """Return an array in its own precision; integers become double precision."""
    array = np.asarray(values)
    return array if array.dtype.kind == "f" else array.astype(np.float64)


def at_least_zero(name: str, values: ArrayLike, unit: str = "") -> Array:
    array = floating(values)
    if not (array >= 0).all():
        raise ValueError(f"{name} is {_worst(array)!r}{unit}; allowed: numbers at or above 0")
    return array


def above_zero(name: str, values: ArrayLike) -> Array:
    array = floating(values)
    if not (array > 0).all():
        raise ValueError(f"{name} is {_worst(array)!r}; allowed: numbers above 0")
    return array


def amount(name: str, value: float) -> float:
    """Return a number if it is finite and at least 0."""
    value = float(value)
    allowed(0 <= value < math.inf, name, value, "finite numbers at or above 0")
    return value


def _worst(array: Array) -> float:
    return float(np.min(array))  # NaN is reported first, as it should be
