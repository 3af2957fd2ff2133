"""Assignment of dims: along the sides of a panel, over panels, or fixed at one value.

In:  the dims of the plotted variable with their values; the request.
Out: an ``Arrangement``; dims fixed for lack of room are named in the title.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from etendue.contract.wording import first, prefix
from etendue.errors import RequestError, nearest
from etendue.present.plots.holdings import HeldVariable
from etendue.present.plots.labels import name_text, value_text
from etendue.types.documents import AxisValues

MOST_PANELS = 16


@dataclass(frozen=True)
class PlotDim:
    """A dim with its values and unit, for labels."""

    name: str
    values: tuple[Any, ...]
    units: str = "1"

    @property
    def title(self) -> str:
        return name_text(self.name, self.units)

    def text(self, value: Any) -> str:
        """Return a value with its unit, and with the name of the dim if the unit does not identify it."""
        text = value_text(value, self.units, self.name)
        bare = not isinstance(value, str) and self.units in ("", "1") and not prefix(self.name)
        return f"{self.name.replace('_', ' ')} {text}" if bare else text

    @property
    def counted(self) -> bool:
        return bool(self.values) and not any(isinstance(value, str) for value in self.values)

    @property
    def spread(self) -> bool:
        """Return whether the values of the dim are better shown on a logarithmic axis."""
        if not self.counted or len(self.values) < 3 or min(self.values) <= 0:
            return False
        ordered = sorted(self.values)
        return bool(ordered[-1] / ordered[0] >= 4 and ordered[-1] - ordered[-2] > 1.4 * (ordered[1] - ordered[0]))


@dataclass(frozen=True)
class Arrangement:
    """The place of every dim."""

    x: PlotDim | None
    y: PlotDim | None
    panels: tuple[PlotDim, ...] = ()
    fixed: AxisValues = field(default_factory=dict)
    said: tuple[str, ...] = ()  # texts of the fixed dims

    @property
    def at(self) -> str:
        return ", ".join(self.said)


def dims_of(held: Sequence[HeldVariable]) -> list[PlotDim]:
    """Return the dims of the plotted variables: first the preferred axes of the sweep, then its other axes, then named
    dims such as ``stage``.
    """
    found: dict[str, PlotDim] = {}
    for one in held:
        own = [*one.axes, *(dim for dim in one.dims if not one.is_counted(dim))]
        for dim in own:
            values = [*(found[dim].values if dim in found else ()), *one.values_of(dim)]
            values = list(dict.fromkeys(values))
            if dim in one.axes and not any(isinstance(v, str) for v in values):
                values.sort()
            found[dim] = PlotDim(dim, tuple(values), one.units_of(dim))
    axes = {dim for one in held for dim in one.axes}
    rank = {name: place for place, name in enumerate(first("sides"))}
    return sorted(found.values(), key=lambda dim: (dim.name not in axes, rank.get(dim.name, len(rank))))


def arranged(
    dims: Sequence[PlotDim],
    sides: int,
    along: Sequence[str] = (),
    panels: Sequence[str] = (),
    at: AxisValues | None = None,
    most: int = MOST_PANELS,
    middle: AxisValues | None = None,
) -> Arrangement:
    """Place dims: up to ``sides`` of them along the sides of a panel, others over panels as long as they fit, and each
    remaining dim at one value.

    ``at`` fixes the values of dims; ``middle`` gives the values at which dims that do not fit are shown, by default the
    middle of each dim.

    Raises
    ------
    RequestError
        A requested dim does not exist, or is requested twice.
    """
    at = dict(at or {})
    x, y = (*along, "", "")[:2]
    free = {dim.name: dim for dim in dims if dim.name not in at}
    asked = [name for name in (x, y, *panels) if name]
    _check(asked, free, at)
    x, y = _sides(x, y, sides, [dim for dim in free.values() if dim.name not in asked and len(dim.values) > 1])
    rest = [dim for dim in free.values() if dim.name not in (x, y, *panels)]
    chosen, left = _over_panels([free[name] for name in panels], rest, most)
    single = [(dim, dim.values[0]) for dim in rest if len(dim.values) == 1]
    fixed = [*single, *((dim, _value(dim, middle or {})) for dim in left)]
    said = [dim.text(at[dim.name]) for dim in dims if dim.name in at] + [dim.text(value) for dim, value in fixed]
    at |= {dim.name: value for dim, value in fixed}
    return Arrangement(free.get(x), free.get(y), tuple(chosen), at, tuple(said))


def _check(asked: Sequence[str], free: Mapping[str, PlotDim], at: AxisValues) -> None:
    for name in asked:
        if name not in free:
            why = "it is fixed" if name in at else f"not a dim of the plotted variable{nearest(name, free)}"
            raise RequestError(f"{name}: {why}")
    if len(set(asked)) < len(asked):
        raise RequestError("each dim can be used once, as x, y or panels")


def _sides(x: str, y: str, sides: int, free: Sequence[PlotDim]) -> tuple[str, str]:
    """Return the dims along the sides x and y: the requested ones, else numeric dims before named dims."""
    candidates = [dim.name for dim in sorted(free, key=lambda dim: not dim.counted)]
    if not x and candidates:
        x = candidates.pop(0)
    if sides > 1 and not y and candidates:
        y = candidates.pop(0)
    return x, y


def _over_panels(chosen: list[PlotDim], rest: Sequence[PlotDim], most: int) -> tuple[list[PlotDim], list[PlotDim]]:
    """Return the dims over which panels are laid out (at most two, the second for the rows), and the dims that do not
    fit.
    """
    left, room = [], most // max(1, math.prod(len(dim.values) for dim in chosen))
    for dim in sorted((dim for dim in rest if len(dim.values) > 1), key=lambda dim: len(dim.values)):
        if len(chosen) < 2 and len(dim.values) <= room:
            chosen.append(dim)
            room //= len(dim.values)
        else:
            left.append(dim)
    if len(chosen) == 2 and len(chosen[1].values) > len(chosen[0].values):
        chosen.reverse()  # the shorter one becomes the rows
    return chosen, left


def _value(dim: PlotDim, middle: AxisValues) -> Any:
    """Return the value at which to show a dim that does not fit: the value in ``middle`` if the dim has it, else the
    middle value of the dim.
    """
    value = middle.get(dim.name)
    return value if value in dim.values else dim.values[len(dim.values) // 2]
