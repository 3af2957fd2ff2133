"""The description of a plan's axes and design.

In:  a plan.
Out: the entries ``axes`` and ``design`` of the document of ``etendue plan --json``.
"""

from __future__ import annotations

import math
from typing import Any

from etendue.contract.registry import installed_stages
from etendue.contract.values import quantities
from etendue.errors import Fault
from etendue.pipeline.zipped import SAMPLE
from etendue.plan.designs.asked import Asked, asked_of
from etendue.plan.designs.distributions import Distribution
from etendue.plan.designs.drawing import distributions, shares_of
from etendue.plan.designs.points import discrepancy
from etendue.plan.model import Axis, Plan
from etendue.types.documents import Document

MOST_POINTS = 4096  # of which the discrepancy is worked out: the time grows with the square


def axes_said(plan: Plan) -> list[Document]:
    """Return every axis: its name, values and units; for an axis of rows, also the factors that change along it."""
    return [_axis(axis) for axis in plan.positioned]


def _axis(axis: Axis) -> Document:
    said: Document = {"name": axis.key, "values": list(axis.values), "units": axis.units or None}
    if axis.rows:
        said["factors"] = {
            factor.key: {"values": list(axis.column(n)), "units": factor.units or None}
            for n, factor in enumerate(axis.factors)
        }
        said["of"] = axis.of or None
    return said


def asked_design(plan: Plan) -> tuple[Asked, dict[str, Distribution]] | None:
    """Return the design of a plan and the distribution of each factor; None for a plan without design."""
    faults: list[Fault] = []
    asked = asked_of(plan.pipeline, faults)
    return None if asked is None else (asked, distributions(asked, plan.pipeline, installed_stages(), faults))


def design_said(plan: Plan) -> Document | None:
    """Return the method, factors, cells with and without levels, and discrepancy; None for a plan without design."""
    found = asked_design(plan)
    if found is None:
        return None
    asked, own = found
    whole = plan.axis(SAMPLE)
    levels = [own[key].most if key in own and own[key].shape != "choices" else 0 for key in asked.factors]
    said: Document = {
        "method": asked.method,
        "points": asked.points,
        "rows": len(whole.values),
        "seed": asked.seed,
        "factors": {key: _factor(key, own.get(key), whole) for key in asked.factors},
        "compared": {key: value for key, value in plan.pipeline.shared.items() if _compared(key, value)},
        "cells": len(plan.cells),
        "cells_unshared": sum(_unshared(plan, node.axes, len(whole.values)) for node in plan.nodes),
        "discrepancy": None,
        "discrepancy_without_levels": None,
    }
    if own and asked.drawn <= MOST_POINTS:
        shares = shares_of(asked)[:: asked.per_point]
        without, having = discrepancy(shares, levels)
        said |= {"discrepancy": having, "discrepancy_without_levels": without}
    return said


def _compared(key: str, value: Any) -> bool:
    """Return whether a shared quantity has the value that makes rows differ by their factors alone."""
    return key in quantities.names() and quantities.declared(key).compared == value != ""


def _factor(key: str, own: Distribution | None, whole: Axis) -> Document:
    at = next((n for n, factor in enumerate(whole.factors) if factor.key == key), None)
    values: tuple[Any, ...] = () if at is None else whole.column(at)
    numbers = [value for value in values if not isinstance(value, str | bool)]
    return {
        "distribution": own.shape if own else "list",
        "levels": (own.levels if own else 0) or None,
        "distinct": len(set(values)),
        "from": min(numbers) if numbers else None,
        "to": max(numbers) if numbers else None,
        "units": whole.factors[at].units or None if at is not None else None,
    }


def _unshared(plan: Plan, dims: tuple[str, ...], rows: int) -> int:
    """Return the number of cells that a stage would have if every row had its own cell."""
    sizes = [rows if plan.axis(dim).of == SAMPLE else len(plan.axis(dim).values) for dim in dims]
    return math.prod(sizes)
