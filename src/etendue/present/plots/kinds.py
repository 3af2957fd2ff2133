"""The kinds of plots, by name: the engine's own and those that distributions bring by ``etendue_plots``; and what is
drawn by default.

In:  holdings, a kind, figures, what was asked for.
Out: a ``Plot``; lists of what there is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint
from typing import Any

from etendue.errors import PluginError, RequestError, nearest
from etendue.plugins import discovery
from etendue.present.plots.asked import Asked
from etendue.present.plots.holdings import KINDS as HELD
from etendue.present.plots.holdings import Held, Holdings
from etendue.present.plots.labels import unit_text, value_text
from etendue.present.plots.places import dim_of
from etendue.present.plots.plot import Plot
from etendue.types.documents import Document

_HERE = "etendue.present.plots.asked"


@dataclass(frozen=True)
class Kind:
    """``place``: ``module:function`` of (holdings, asked), which gives a ``Plot`` or a figure of matplotlib; ``takes``:
    names of variables, at most; ``uses``: what else of `Asked` it goes by; ``index``: it is what a variable is drawn as
    that points into names.
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
        "a figure over two axes, its number in every cell; further axes as panels",
        ("x", "y", "panels", "at"),
    ),
    "curves": Kind(
        place=f"{_HERE}:curves_of",
        doc="a variable over its own dim, such as frequency, or a figure over an axis",
        uses=("x", "lines", "panels", "at"),
    ),
    "pareto": Kind(f"{_HERE}:front_of", 2, "two figures against each other, and the front, named", ("better", "at")),
    "strip": Kind(
        f"{_HERE}:strip_of",
        1,
        "all stages of one cell as pictures, each with a part enlarged; or one variable over an axis",
        ("at",),
    ),
    "show": Kind(f"{_HERE}:picture_of", 1, "one picture of one cell", ("at",)),
    "budget": Kind(f"{_HERE}:budget_of", 0, "run time, stated error and omissions by stage", ("blame",)),
}
WORDS = ("x", "y", "lines", "panels", "better")  # of `Asked`, that not every kind goes by


@cache
def kinds() -> Mapping[str, Kind]:
    """All kinds by name. The engine's own go before others of the same name; what cannot be read is left out."""
    every, found = discovery.installed(), dict(OWN)
    for name in every.names("plots"):
        for one in every.all("plots", name)[:1]:
            try:
                found.setdefault(name, discovery.made_of(Kind, f"the kind of plot {name!r}", one))
            except PluginError:
                continue
    return found


@cache
def _function(kind: str) -> Callable[[Holdings, Asked], Any]:
    place = kinds()[kind].place
    if kind in OWN:
        return EntryPoint(kind, place, "").load()  # type: ignore[no-any-return]
    with discovery.foreign(f"the kind of plot {kind!r} cannot be loaded"):
        found: Callable[[Holdings, Asked], Any] = EntryPoint(kind, place, "").load()
    return found


def draw(holdings: Holdings, kind: str = "", asked: Asked | None = None) -> Plot:
    """One plot.

    Raises
    ------
    RequestError
        No such kind, figure, axis or value.
    PluginError
        A kind that a distribution brings cannot be loaded, or gives no plot.
    """
    asked = _by_dims(holdings, asked or Asked())
    kind, figures = kind_of(holdings, kind, asked.figures)
    takes = kinds()[kind].takes
    if len(figures) > takes:
        raise RequestError(
            f"{kind} draws {takes or 'no'} {'variable' if takes == 1 else 'variables'}, not {', '.join(figures)}"
        )
    _refuse_unused(kind, asked)
    made = _function(kind)(holdings, replace(asked, figures=figures, middle=shown_at(holdings)))
    if isinstance(made, Plot):
        return made
    if not hasattr(made, "savefig"):
        raise PluginError(f"the kind of plot {kind!r} gives {type(made).__name__}; expected a figure of matplotlib")
    return Plot(made)


def _by_dims(holdings: Holdings, asked: Asked) -> Asked:
    """What was asked for with dims in the place of the parameters that they set."""

    def own(word: str) -> str:
        return dim_of(holdings, word)[0] or word if word else ""

    return replace(asked, x=own(asked.x), y=own(asked.y), lines=own(asked.lines), panels=tuple(map(own, asked.panels)))


def _refuse_unused(kind: str, asked: Asked) -> None:
    for name in WORDS:
        if getattr(asked, name) and name not in kinds()[kind].uses:
            raise RequestError(
                f"--{name} is for {' and '.join(k for k, one in kinds().items() if name in one.uses)}, not for {kind}"
            )
    if asked.at and not {"at"} <= set(kinds()[kind].uses):
        raise RequestError(f"a {kind} is of all cells: leave out --at")


def kind_of(holdings: Holdings, kind: str, figures: Sequence[str] = ()) -> tuple[str, tuple[str, ...]]:
    """The kind that is meant: as it is named, as the variable suggests that stands in its place, or what the archive
    holds most of.
    """
    if kind in kinds():
        return kind, tuple(figures)
    if kind:
        return _of_variable(holdings, kind, len(figures)), (kind, *figures)
    varying = [one for one in holdings.of_kind("figure") if any(len(one.values_of(dim)) > 1 for dim in one.axes)]
    if varying:
        return "map", ()
    if holdings.of_kind("picture") or holdings.table("frames") is not None:
        return "strip", ()
    return ("curves", ()) if holdings.of_kind("curve") else ("budget", ())


def _of_variable(holdings: Holdings, variable: str, others: int) -> str:
    """What shows a variable whose name stands in the place of a kind, beside so many others."""
    named = [one for one in holdings if variable in (one.variable, one.name)]
    if not named:
        kind, names = variable, [*kinds(), *(one.variable for one in holdings)]
        raise RequestError(
            f"{kind!r} is no kind of plot ({', '.join(kinds())}) and no variable here{nearest(kind, names)}; "
            f"etendue plot {holdings.archive} --list"
        )
    if others == 1:
        return "pareto"
    one = next((one for one in reversed(named) if one.kind == "figure"), None)
    if one is not None:
        return next((name for name, own in kinds().items() if own.index and one.known.index), "map")
    return "curves" if "curve" in {one.kind for one in named} else "show"


def shown_at(holdings: Holdings) -> Document:
    """The axis values of the cell whose pictures and figures a run shows; {} where nothing says."""
    frames = holdings.table("frames")
    found = frames.attrs.get("cell", {}) if frames is not None else {}
    return dict(found) if isinstance(found, Mapping) else {}


def listed(holdings: Holdings) -> Document:
    """What there is to be drawn."""
    units = {dim: one.units_of(dim) for one in holdings for dim in one.axes}
    return {
        "kinds": {name: kind.doc for name, kind in kinds().items()},
        "axes": {dim: [value_text(v, units[dim], dim) for v in values] for dim, values in holdings.axes.items()},
        "variables": [_said(one) for kind in HELD for one in holdings.of_kind(kind)],
    }


def _said(one: Held) -> Document:
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
