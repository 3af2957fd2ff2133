"""The kinds of plots, by name: the engine's own kinds and kinds that distributions register with ``etendue_plots``; and
the choice of a default.

In:  holdings, a kind, metrics, the request.
Out: a ``Plot``; lists of what is available.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

from etendue.errors import PluginError, RequestError, nearest
from etendue.plugins import discovery
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.holdings import KINDS as HELD
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import unit_text, value_text
from etendue.present.plots.places import dim_of
from etendue.present.plots.plot import Plot
from etendue.present.plots.rows import rows_dim
from etendue.types.documents import Document

_HERE = "etendue.present.plots.asked"


@dataclass(frozen=True)
class Kind:
    """``place``: ``module:function`` of (holdings, asked) that returns a ``Plot`` or a matplotlib figure; ``takes``:
    maximum number of variables; ``uses``: the fields of `PlotRequest` that the function reads; ``index``: whether it is
    the default plot of an index into names.
    """

    place: str
    takes: int = 1
    doc: str = ""
    uses: tuple[str, ...] = ()
    index: bool = False


OWN = {
    "map": Kind(
        f"{_HERE}:map_of",
        1,
        "a metric over two axes, with its value in every cell; more axes as panels",
        ("x", "y", "panels", "at"),
    ),
    "curves": Kind(
        place=f"{_HERE}:curves_of",
        doc="a variable over its own dim, such as frequency, or a metric over an axis",
        uses=("x", "lines", "panels", "at"),
    ),
    "pareto": Kind(
        f"{_HERE}:front_of", 2, "two metrics against each other, with the Pareto front labelled", ("better", "at")
    ),
    "strip": Kind(
        f"{_HERE}:strip_of",
        1,
        "all stages of one cell as pictures, each with an enlarged detail; or one variable over an axis",
        ("at",),
    ),
    "show": Kind(f"{_HERE}:picture_of", 1, "one picture of one cell", ("at",)),
    "parallel": Kind(
        f"{_HERE}:parallel_of", 8, "the samples of a design as lines over all factors and some metrics", ("at",)
    ),
    "scatter": Kind(f"{_HERE}:scatter_of", 8, "every two factors and metrics of the samples of a design", ("at",)),
    "budget": Kind(f"{_HERE}:budget_of", 0, "run time, stated error and omissions by stage", ("blame",)),
}
WORDS = ("x", "y", "lines", "panels", "better")  # fields of `PlotRequest` that not every kind uses


@cache
def kinds() -> Mapping[str, Kind]:
    """Return all kinds by name. Kinds of the engine take precedence over others of the same name; unreadable kinds are
    omitted.
    """
    every, found = discovery.installed(), dict(OWN)
    for name in every.names("plots"):
        for one in every.all("plots", name)[:1]:
            try:
                found.setdefault(name, discovery.made_of(Kind, f"the kind of plot {name!r}", one))
            except PluginError:
                continue
    return found


@cache
def _function(kind: str) -> Callable[[Holdings, PlotRequest], Any]:
    place = kinds()[kind].place
    if kind in OWN:
        return EntryPoint(kind, place, "").load()  # type: ignore[no-any-return]
    with discovery.foreign(f"the kind of plot {kind!r} cannot be loaded"):
        found: Callable[[Holdings, PlotRequest], Any] = EntryPoint(kind, place, "").load()
    return found


def draw(holdings: Holdings, kind: str = "", asked: PlotRequest | None = None) -> Plot:
    """Draw a plot.

    Raises
    ------
    RequestError
        Unknown kind, metric, axis or value.
    PluginError
        A kind of a distribution cannot be loaded, or returns no plot.
    """
    asked = _by_dims(holdings, asked or PlotRequest())
    kind, figures = kind_of(holdings, kind, asked.figures)
    takes = kinds()[kind].takes
    if len(figures) > takes:
        raise RequestError(
            f"{kind} takes {takes or 'no'} {'variable' if takes == 1 else 'variables'}, not {', '.join(figures)}"
        )
    _refuse_unused(kind, asked)
    made = _function(kind)(holdings, replace(asked, figures=figures, middle=shown_at(holdings)))
    if isinstance(made, Plot):
        return made
    if not hasattr(made, "savefig"):
        raise PluginError(
            f"the kind of plot {kind!r} returns {type(made).__name__}; it must return a matplotlib figure"
        )
    return Plot(made)


def _by_dims(holdings: Holdings, asked: PlotRequest) -> PlotRequest:
    """Return the request with each parameter replaced by the dim that sets it."""

    def own(word: str) -> str:
        return dim_of(holdings, word)[0] or word if word else ""

    return replace(asked, x=own(asked.x), y=own(asked.y), lines=own(asked.lines), panels=tuple(map(own, asked.panels)))


def _refuse_unused(kind: str, asked: PlotRequest) -> None:
    for name in WORDS:
        if getattr(asked, name) and name not in kinds()[kind].uses:
            raise RequestError(
                f"--{name} is for {' and '.join(k for k, one in kinds().items() if name in one.uses)}, not for {kind}"
            )
    if asked.at and not {"at"} <= set(kinds()[kind].uses):
        raise RequestError(f"a {kind} covers all cells: omit --at")


def kind_of(holdings: Holdings, kind: str, figures: Sequence[str] = ()) -> tuple[str, tuple[str, ...]]:
    """Return the kind of plot and its variables. If ``kind`` is a variable, the kind suits this variable; if it is '',
    the archive.
    """
    if kind in kinds():
        return kind, tuple(figures)
    if kind:
        return _of_variable(holdings, kind, len(figures)), (kind, *figures)
    varying = [one for one in holdings.of_kind("figure") if any(len(one.values_of(dim)) > 1 for dim in one.axes)]
    if varying and rows_dim(holdings) and set(holdings.axes) == {rows_dim(holdings)}:
        return "parallel", ()
    if varying:
        return "map", ()
    if holdings.of_kind("picture") or holdings.table("frames") is not None:
        return "strip", ()
    return ("curves", ()) if holdings.of_kind("curve") else ("budget", ())


def _of_variable(holdings: Holdings, variable: str, others: int) -> str:
    """Return the kind that shows a variable given in place of a kind, with ``others`` more variables."""
    named = [one for one in holdings if variable in (one.variable, one.name)]
    if not named:
        kind, names = variable, [*kinds(), *(one.variable for one in holdings)]
        raise RequestError(
            f"{kind!r} is neither a kind of plot ({', '.join(kinds())}) nor a variable{nearest(kind, names)}; "
            f"see etendue plot {holdings.archive} --list"
        )
    if others == 1:
        return "pareto"
    one = next((one for one in reversed(named) if one.kind == "figure"), None)
    if one is not None:
        return next((name for name, own in kinds().items() if own.index and one.known.index), "map")
    return "curves" if "curve" in {one.kind for one in named} else "show"


def shown_at(holdings: Holdings) -> Document:
    """Return the axis values of the cell whose pictures and metrics a run shows; {} if not recorded."""
    frames = holdings.table("frames")
    found = frames.attrs.get("cell", {}) if frames is not None else {}
    return dict(found) if isinstance(found, Mapping) else {}


def listed(holdings: Holdings) -> Document:
    """Return all kinds, axes and variables that can be plotted."""
    units = {dim: one.units_of(dim) for one in holdings for dim in one.axes}
    return {
        "kinds": {name: kind.doc for name, kind in kinds().items()},
        "axes": {dim: [value_text(v, units[dim], dim) for v in values] for dim, values in holdings.axes.items()},
        "variables": [_said(one) for kind in HELD for one in holdings.of_kind(kind)],
    }


def _said(one: HeldVariable) -> Document:
    better = str(one.attrs.get("better", "")) or one.known.better
    dims = {"axes": list(one.axes), "dims": list(one.dims)}
    return {
        "name": one.name,
        "kind": one.kind,
        **dims,
        "units": unit_text(one.units),
        "title": one.title,
        "better": better,
    }
