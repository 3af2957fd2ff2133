"""The request for a plot beside its kind, and the engine's own kinds that fulfil it.

In:  holdings, the request.
Out: a ``Plot``. Kinds that distributions register are functions of the same two.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from etendue.present.plots.drawing.budget import budget
from etendue.present.plots.drawing.curves import curves
from etendue.present.plots.drawing.maps import factor_map, figure_map
from etendue.present.plots.drawing.pareto import pareto
from etendue.present.plots.drawing.samples import parallel, scatter
from etendue.present.plots.drawing.strip import show, strip
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import places_text
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot
from etendue.types.documents import AxisValues, Document, DocumentView


@dataclass(frozen=True)
class PlotRequest:
    """The request for a plot apart from its kind; '' and () mean an automatic choice."""

    figures: tuple[str, ...] = ()
    x: str = ""
    y: str = ""
    lines: str = ""
    panels: tuple[str, ...] = ()
    better: tuple[str, ...] = ()
    at: AxisValues = field(default_factory=dict)
    blame: DocumentView | None = None  # for a budget: the document of each stage's share of the losses
    blamed_at: AxisValues | None = None  # axis values of the cell of ``blame``; None: the cell whose pictures are kept
    middle: AxisValues = field(default_factory=dict)  # values of dims that are not requested and do not fit

    @property
    def first(self) -> str:
        return self.figures[0] if self.figures else ""

    @property
    def second(self) -> str:
        return self.figures[1] if len(self.figures) > 1 else ""

    def cell(self, held: HeldVariable) -> Document:
        """Return one value for each axis that affects a variable: the requested value, else the value in ``middle``,
        else the middle value of the axis.
        """
        asked = resolved([held], self.at)
        found = {}
        for dim in held.axes:
            values = held.values_of(dim)
            found[dim] = asked.get(dim, self.middle.get(dim, values[len(values) // 2]))
        return {**found, **asked}


def map_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    return figure_map(holdings, asked.first, asked.x, asked.y, asked.panels, asked.at, asked.middle)


def names_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    """Plot a map of a variable that is an index into names, such as the limiting factor."""
    return factor_map(holdings, asked.first, asked.x, asked.y, asked.panels, asked.at, asked.middle)


def curves_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    return curves(holdings, asked.first, asked.x, asked.lines, asked.panels, asked.at, asked.middle)


def front_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    return pareto(holdings, asked.first, asked.second, asked.better, asked.at)


def strip_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    stage, _, variable = asked.first.rpartition(".")
    return strip(holdings, variable, stage, asked.at)


def picture_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    stage, _, variable = asked.first.rpartition(".")
    return show(holdings, variable, stage, asked.at)


def parallel_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    return parallel(holdings, asked.figures, asked.at, asked.middle)


def scatter_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    return scatter(holdings, asked.figures, asked.at, asked.middle)


def budget_of(holdings: Holdings, asked: PlotRequest) -> Plot:
    place = asked.middle if asked.blamed_at is None else asked.blamed_at
    return budget(
        holdings,
        asked.blame,
        places_text(dict(place), {dim: one.units_of(dim) for one in holdings for dim in one.axes}),
    )
