"""Axes of a sweep that share a dim: their values change together, row by row. Axes with distinct dims multiply.

In:  ``[sweep]`` with entries such as ``{ values = ["1 ms", "4 ms"], dim = "shot" }``.
Out: for each such axis its distinct values, in place of a list of values, and a ``Zip``, which gives the value of each
row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from etendue.contract.values.units import as_written
from etendue.errors import Fault, nearest
from etendue.types.documents import Document, DocumentView

SAMPLE = "sample"  # the dim of a design
SPACED = frozenset({"from", "to", "steps", "spacing"})
KEYS = ("values", "dim", *sorted(SPACED))
LONGEST = 100_000  # rows of a dim


@dataclass(frozen=True)
class Zip:
    """For each row of a dim, the number of its value among the distinct values of an axis."""

    dim: str
    at: tuple[int, ...]
    shares: bool = False  # whether rows share values: stages that depend only on such axes are computed once per value
    most: int = 0  # how many distinct values there can ever be; 0: as many as there are now


def is_axis(value: DocumentView) -> bool:
    """Return whether a table in ``[sweep]`` is an axis, not a stage with axes of its own."""
    return bool(set(value) & SPACED) or ("dim" in value and set(value) <= set(KEYS))


def taken_apart(sweep: DocumentView, faults: list[Fault]) -> tuple[Document, dict[str, Zip]]:
    """Return the sweep with plain lists of values, and the axes that share a dim."""
    found, zipped = dict(sweep), dict[str, Zip]()
    for key, value in sweep.items():
        if isinstance(value, Mapping) and "dim" in value:
            found[key], one = _one(f"sweep.{key}", value, faults)
            if one:
                zipped[key] = one
    lengths: dict[str, tuple[str, int]] = {}
    for key, one in zipped.items():
        first, length = lengths.setdefault(one.dim, (key, len(one.at)))
        if length and one.at and length != len(one.at):
            text = f"{first} has {length} values and {key} has {len(one.at)}"
            faults.append(Fault(f"sweep.{key}", f"axes of one dim change together, but along {one.dim!r} {text}"))
    return found, zipped


def _one(place: str, value: DocumentView, faults: list[Fault]) -> tuple[Any, Zip | None]:
    """Return the values of an axis, as the sweep would have them without a dim, and the index of the value in
    each row.
    """
    dim, rest = value["dim"], {name: one for name, one in value.items() if name != "dim"}
    if not isinstance(dim, str) or not dim.isidentifier():
        faults.append(Fault(place, f"dim: expected a name of letters, digits and _, got {as_written(dim)}"))
    elif dim == SAMPLE:
        faults.append(Fault(place, f"dim: {SAMPLE!r} is the dim of [design]; give another name"))
    elif unknown := [name for name in rest if name not in KEYS]:
        faults.append(Fault(place, f"unknown key {unknown[0]!r}{nearest(unknown[0], KEYS)}"))
    elif "values" in rest:
        values = rest["values"]
        if len(rest) > 1 or not isinstance(values, list | tuple) or not 0 < len(values) <= LONGEST:
            faults.append(Fault(place, "expected { values = [..], dim }, or { from, to, steps, spacing, dim }"))
            return [0], None
        own, at = distinct(values)
        return own, Zip(dim, at, len(own) < len(at))
    else:
        steps = rest.get("steps")
        return rest, Zip(dim, tuple(range(steps)) if isinstance(steps, int) and 0 < steps <= LONGEST else ())
    return rest.get("values", rest), None


def distinct(values: Sequence[Any]) -> tuple[list[Any], tuple[int, ...]]:
    """Return the distinct values in the order of their first appearance, and the index of each value among them."""
    known: dict[str, int] = {}
    found, at = list[Any](), list[int]()
    for value in values:
        number = known.setdefault(f"{type(value).__name__} {value!r}", len(known))
        if number == len(found):
            found.append(value)
        at.append(number)
    return found, tuple(at)


def put_together(sweep: DocumentView, zipped: Mapping[str, Zip]) -> Document:
    """Return the sweep in the form that a pipeline file uses, without the factors of a design."""
    found: Document = {}
    for key, value in sweep.items():
        one = zipped.get(key)
        if one is None:
            found[key] = value
        elif one.dim != SAMPLE:
            spaced = isinstance(value, Mapping)
            found[key] = {**value, "dim": one.dim} if spaced else {"values": [value[i] for i in one.at], "dim": one.dim}
    return found
