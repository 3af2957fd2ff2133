"""The factors whose values change together along an axis of rows, as of a design.

In:  holdings, the name of a dim.
Out: the value of every factor in each row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from etendue.pipeline.zipped import SAMPLE
from etendue.present.plots.holdings import Holdings
from etendue.types.documents import AxisValue


@dataclass(frozen=True)
class RowFactor:
    """A factor and its value by row."""

    name: str
    units: str
    values: Mapping[AxisValue, Any]

    @property
    def counted(self) -> bool:
        return not any(isinstance(value, str) for value in self.values.values())


def factors_of(holdings: Holdings, dim: str) -> list[RowFactor]:
    """Return the factors along a dim; () for an ordinary axis."""
    found: dict[str, tuple[str, dict[AxisValue, Any]]] = {}
    for group in (group for one in holdings if dim in one.axes for group in one.groups):
        for name, coordinate in group.coords.items():
            if name != dim and coordinate.dims == (dim,) and "parameter" in coordinate.attrs:
                _, values = found.setdefault(str(name), (str(coordinate.attrs.get("units", "1")), {}))
                values.update(zip(group[dim].values.tolist(), coordinate.values.tolist(), strict=True))
    return [RowFactor(name, units, values) for name, (units, values) in found.items()]


def rows_dim(holdings: Holdings) -> str:
    """Return the dim of the rows of a design, else another dim along which several factors change together; '' if there
    is none.
    """
    axes = sorted(holdings.axes, key=lambda dim: dim != SAMPLE)
    return next((dim for dim in axes if factors_of(holdings, dim)), "")


def rounded(value: Any) -> Any:
    """Return a number to three digits, as in labels."""
    return float(f"{value:.3g}") if isinstance(value, float) else value
