"""What is asked of a plot beside its kind, and the engine's own kinds as they answer it.

In:  holdings, what was asked for.
Out: a ``Plot``. Kinds that distributions bring are functions of the same two.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from etendue.present.plots.budget import budget
from etendue.present.plots.curves import curves
from etendue.present.plots.holdings import Held, Holdings
from etendue.present.plots.labels import places_text
from etendue.present.plots.maps import factor_map, figure_map
from etendue.present.plots.pareto import pareto
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot
from etendue.present.plots.strip import show, strip
from etendue.types.documents import Document, DocumentView, Place


@dataclass(frozen=True)
class Asked:
    """What was asked for beside the kind; '' and (): as fits."""

    figures: tuple[str, ...] = ()
    x: str = ""
    y: str = ""
    lines: str = ""
    panels: tuple[str, ...] = ()
    better: tuple[str, ...] = ()
    at: Place = field(default_factory=dict)
    blame: DocumentView | None = None  # of a budget: the document of who shares losses out
    blamed_at: Place | None = (
        None  # the axis values of the cell that it is of; None: of the one whose pictures there are
    )
    middle: Place = field(default_factory=dict)  # where what is not asked for and does not fit is fixed

    @property
    def first(self) -> str:
        return self.figures[0] if self.figures else ""

    @property
    def second(self) -> str:
        return self.figures[1] if len(self.figures) > 1 else ""

    def cell(self, held: Held) -> Document:
        """One value of every axis that reaches a variable: as it was asked for, else where a run's pictures are,
        else in the middle.
        """
        asked = resolved([held], self.at)
        found = {}
        for dim in held.axes:
            values = held.values_of(dim)
            found[dim] = asked.get(dim, self.middle.get(dim, values[len(values) // 2]))
        return {**found, **asked}


def map_of(holdings: Holdings, asked: Asked) -> Plot:
    return figure_map(holdings, asked.first, asked.x, asked.y, asked.panels, asked.at, asked.middle)


def names_of(holdings: Holdings, asked: Asked) -> Plot:
    """A map of an index into names: of what limits, for one."""
    return factor_map(holdings, asked.first, asked.x, asked.y, asked.panels, asked.at, asked.middle)


def curves_of(holdings: Holdings, asked: Asked) -> Plot:
    return curves(holdings, asked.first, asked.x, asked.lines, asked.panels, asked.at, asked.middle)


def front_of(holdings: Holdings, asked: Asked) -> Plot:
    return pareto(holdings, asked.first, asked.second, asked.better, asked.at)


def strip_of(holdings: Holdings, asked: Asked) -> Plot:
    stage, _, variable = asked.first.rpartition(".")
    return strip(holdings, variable, stage, asked.at)


def picture_of(holdings: Holdings, asked: Asked) -> Plot:
    stage, _, variable = asked.first.rpartition(".")
    return show(holdings, variable, stage, asked.at)


def budget_of(holdings: Holdings, asked: Asked) -> Plot:
    place = asked.middle if asked.blamed_at is None else asked.blamed_at
    return budget(
        holdings,
        asked.blame,
        places_text(dict(place), {dim: one.units_of(dim) for one in holdings for dim in one.axes}),
    )
