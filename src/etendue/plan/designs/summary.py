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
from etendue.plan.designs.asked import asked_of
from etendue.plan.designs.distributions import Distribution
from etendue.plan.designs.drawing import distributions, shares_of
from etendue.plan.designs.points import discrepancy
from etendue.plan.model import Axis, Plan
from etendue.types.documents import Document

MOST_POINTS = 4096  # largest number of points whose discrepancy is computed: the time grows with the square


def axis_said(axis: Axis) -> Document:
    """Return the name, values and units of an axis; for an axis of rows, also the factors that change along it."""
    said: Document = {"name": axis.key, "values": list(axis.values), "units": axis.units or None}
    if axis.rows:
        said["factors"] = {
            factor.key: {"values": list(axis.column(n)), "units": factor.units or None}
            for n, factor in enumerate(axis.factors)
        }
        said["of"] = axis.of or None
    return said


def design_said(plan: Plan) -> Document | None:
    """Return a description of the design: its method and factors, the number of cells and how many there would be if
    rows shared no cells, the discrepancy with and without levels; None for a plan without design.
    """
    faults: list[Fault] = []
    asked = asked_of(plan.pipeline, faults)
    if asked is None:
        return None
    own = distributions(asked, plan.pipeline, installed_stages(), faults)
    whole = plan.axis(SAMPLE)
    rows = len(whole.values)
    levels = [own[key].most if key in own and own[key].shape != "choices" else 0 for key in asked.factors]
    said: Document = {
        "method": asked.method,
        "points": asked.points,
        "rows": rows,
        "seed": asked.seed,
        "factors": {key: _factor(key, own.get(key), whole) for key in asked.factors},
        "compared": {  # the quantities whose values make rows differ by their factors alone
            key: value
            for key, value in plan.pipeline.shared.items()
            if key in quantities.names() and quantities.declared(key).compared == value != ""
        },
        "cells": len(plan.cells),
        "cells_unshared": sum(  # if every row had its own cell of each stage
            math.prod(rows if plan.axis(dim).of == SAMPLE else len(plan.axis(dim).values) for dim in node.axes)
            for node in plan.nodes
        ),
        "discrepancy": None,
        "discrepancy_without_levels": None,
    }
    if own and asked.drawn <= MOST_POINTS:
        shares = shares_of(asked)[:: asked.per_point]
        without, having = discrepancy(shares, levels)
        said |= {"discrepancy": having, "discrepancy_without_levels": without}
    return said


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
