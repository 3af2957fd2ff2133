"""Values along axes in written form: ``gain=2.8``, ``spacing=5400 nm``, ``stage=filter``.

In:  texts from a command line or from Python; the values of an axis.
Out: the matching value, or a message with the available values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from decimal import Decimal, InvalidOperation
from typing import Any

from etendue.contract.values.tables import tables
from etendue.contract.values.units import UnitError, to_unit
from etendue.errors import Fault, RequestError, nearest
from etendue.present.plots.holdings import HeldVariable
from etendue.present.plots.labels import value_text
from etendue.types.documents import AxisValues, Document

SAME = 1e-9  # relative tolerance between an axis value and its retyped text, perhaps in another unit


def read_at(texts: Iterable[str]) -> dict[str, str]:
    """Convert ``("gain=2.8",)`` to ``{"gain": "2.8"}``."""
    found, faults = {}, []
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            faults.append(Fault(f"--at {text}", "expected axis=value"))
        elif name.strip() in found:
            faults.append(Fault(f"--at {text}", f"{name.strip()} is given twice"))
        found[name.strip()] = value.strip()
    if faults:
        raise RequestError(faults)
    return found


def is_called(name: str, dim: str, key: str) -> bool:
    """Return whether ``name`` stands for a dim: it is the name of the dim or of the parameter that the dim sets,
    ``sharpen.strength`` or in Python ``sharpen__strength``.
    """
    word = name.replace("__", ".")
    return name == dim or word in (key, *(table.place(key) for table in tables().values()))


def dim_of(held: Iterable[HeldVariable], name: str) -> tuple[str, HeldVariable | None]:
    """Return the dim that ``name`` stands for, and the variable that has this dim; ('', None) if there is none."""
    return next(
        ((dim, one) for one in held for dim in (*one.axes, *one.dims) if is_called(name, dim, one.key_of(dim))),
        ("", None),
    )


def is_value(value: Any, text: str, unit: str) -> bool:
    """Return whether a text, with or without a unit, equals a value."""
    if isinstance(value, str):
        return value == text
    if isinstance(value, bool):
        return str(value).lower() == text.lower()
    try:
        number = to_unit(_number(text), unit)
    except UnitError:
        return False
    return math.isclose(number, value, rel_tol=SAME, abs_tol=0.0)


def _number(text: str) -> Decimal | str:
    try:
        return Decimal(text)
    except InvalidOperation:
        return text


def resolved(held: Sequence[HeldVariable], at: AxisValues) -> Document:
    """Return the requested value of each dim. In ``at``, names may be dims or the parameters that axes set, and values
    may be numbers or texts with units.

    Raises
    ------
    RequestError
        The dim is unknown, or has no such value.
    """
    found: Document = {}
    faults = []
    for name, asked in at.items():
        dim, owner = dim_of(held, name)
        if owner is None:
            names = dict.fromkeys(d for h in held for d in (*h.axes, *h.dims))
            faults.append(
                Fault(
                    f"{name}={asked}",
                    f"{name} is not a dim of {' or '.join(h.name for h in held)}{nearest(name, names)}",
                )
            )
            continue
        values, units = (
            list(dict.fromkeys(v for h in held if dim in (*h.axes, *h.dims) for v in h.values_of(dim))),
            owner.units_of(dim),
        )
        match = [value for value in values if is_value(value, str(asked), units)]
        if dim in found:
            faults.append(Fault(f"{name}={asked}", f"{dim} is given twice"))
            continue
        if match:
            found[dim] = match[0]
            continue
        shown = ", ".join(map(str, values[:12])) + (", ..." if len(values) > 12 else "")  # as they are typed
        faults.append(Fault(f"{name}={asked}", f"{dim} has no such value; available: {shown}"))
    if faults:
        raise RequestError(faults)
    return found


def resolved_in(array: Any, at: AxisValues) -> Document:
    """Return the request as values of the dims of one xarray array."""
    found: Document = {}
    faults = []
    keys = {
        str(dim): str(array[dim].attrs.get("parameter", dim)) if dim in array.coords else str(dim) for dim in array.dims
    }
    for word, asked in at.items():
        name = next((dim for dim, key in keys.items() if is_called(word, dim, key)), word)
        if name not in array.dims:
            faults.append(
                Fault(f"{name}={asked}", f"{name} is not a dim of {array.name}{nearest(name, map(str, array.dims))}")
            )
            continue
        values = array[name].values.tolist() if name in array.coords else list(range(array.sizes[name]))
        units = str(array[name].attrs.get("units", "1")) if name in array.coords else "1"
        match = [value for value in values if is_value(value, str(asked), units)]
        if match:
            found[name] = match[0]
        else:
            faults.append(
                Fault(
                    f"{name}={asked}",
                    f"no such value of {name}; available: {', '.join(value_text(v, units, name) for v in values[:12])}",
                )
            )
    if faults:
        raise RequestError(faults)
    return found
