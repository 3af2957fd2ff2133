"""The kinds of plots, by name, and what is drawn when none is named.

In:  holdings, a kind, figures, what was asked for.
Out: a ``Plot``; lists of what there is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from etendue.errors import RequestError, nearest
from etendue.present.plots.budget import budget
from etendue.present.plots.curves import curves
from etendue.present.plots.holdings import KINDS as HELD
from etendue.present.plots.holdings import Held, Holdings
from etendue.present.plots.labels import places_text, unit_text, value_text
from etendue.present.plots.maps import factor_map, figure_map
from etendue.present.plots.pareto import pareto
from etendue.present.plots.places import dim_of
from etendue.present.plots.plot import Plot
from etendue.present.plots.strip import show, strip

KINDS = {
    "map": "a figure over two axes, its number in every cell; further axes as panels",
    "curves": "a variable over its own dim (frequency, wavelength), or a figure over an axis",
    "pareto": "two figures against each other, and the front, named",
    "limits": "which factor limits resolution where",
    "strip": "all stages of one cell as pictures, each with a part enlarged; or one variable over an axis",
    "show": "one picture of one cell",
    "budget": "run time, stated error and omissions by stage",
}
TAKES = {"map": 1, "curves": 1, "pareto": 2, "limits": 1, "strip": 1, "show": 1, "budget": 0}  # names of variables, at most


@dataclass(frozen=True)
class Asked:
    """What was asked for beside the kind; '' and (): as fits."""

    figures: tuple[str, ...] = ()
    x: str = ""
    y: str = ""
    lines: str = ""
    panels: tuple[str, ...] = ()
    better: tuple[str, ...] = ()
    at: Mapping[str, Any] = field(default_factory=dict)
    blame: Mapping[str, Any] | None = None  # of a budget: the document of `etendue losses`
    blamed_at: Mapping[str, Any] | None = None  # the axis values of the cell that it is of; None: of the one whose pictures there are


def draw(holdings: Holdings, kind: str = "", asked: Asked | None = None) -> Plot:
    """One plot.

    Raises
    ------
    RequestError
        No such kind, figure, axis or value.
    """
    asked = _by_dims(holdings, asked or Asked())
    kind, figures = kind_of(holdings, kind, asked.figures)
    if len(figures) > TAKES[kind]:
        raise RequestError(
            f"{kind} draws {TAKES[kind] or 'no'} {'variable' if TAKES[kind] == 1 else 'variables'}, not {', '.join(figures)}"
        )
    _refuse_unused(kind, asked)
    first, second = (*figures, "", "")[:2]
    middle = shown_at(holdings)
    if kind in ("map", "limits"):
        return {"map": figure_map, "limits": factor_map}[kind](holdings, first, asked.x, asked.y, asked.panels, asked.at, middle)
    if kind == "curves":
        return curves(holdings, first, asked.x, asked.lines, asked.panels, asked.at, middle)
    if kind == "pareto":
        return pareto(holdings, first, second, asked.better, asked.at)
    if kind == "budget":
        place = middle if asked.blamed_at is None else asked.blamed_at
        return budget(holdings, asked.blame, places_text(dict(place), {dim: one.units_of(dim) for one in holdings for dim in one.axes}))
    stage, _, variable = first.rpartition(".")
    return {"strip": strip, "show": show}[kind](holdings, variable, stage, asked.at)


USES = {
    "x": ("map", "limits", "curves"),
    "y": ("map", "limits"),
    "lines": ("curves",),
    "panels": ("map", "limits", "curves"),
    "better": ("pareto",),
}


def _by_dims(holdings: Holdings, asked: Asked) -> Asked:
    """What was asked for with dims in the place of the parameters that they set."""

    def own(word: str) -> str:
        return dim_of(holdings, word)[0] or word if word else ""

    return replace(asked, x=own(asked.x), y=own(asked.y), lines=own(asked.lines), panels=tuple(map(own, asked.panels)))


def _refuse_unused(kind: str, asked: Asked) -> None:
    for name, kinds in USES.items():
        if getattr(asked, name) and kind not in kinds:
            raise RequestError(f"--{name} is for {' and '.join(kinds)}, not for {kind}")
    if asked.at and kind == "budget":
        raise RequestError("a budget is of all cells: leave out --at")


def kind_of(holdings: Holdings, kind: str, figures: Sequence[str] = ()) -> tuple[str, tuple[str, ...]]:
    """The kind that is meant: as it is named, as the variable suggests that stands in its place, or what the archive holds most of."""
    if kind in KINDS:
        return kind, tuple(figures)
    if kind:  # the name of a variable in the place of a kind
        named = [one for one in holdings if kind in (one.variable, one.name)]
        if not named:
            names = [*KINDS, *(one.variable for one in holdings)]
            raise RequestError(
                f"{kind!r} is no kind of plot ({', '.join(KINDS)}) and no variable here{nearest(kind, names)}; "
                f"etendue plot {holdings.archive} --list"
            )
        figures = (kind, *figures)
        if len(figures) == 2:
            return "pareto", tuple(figures)
        kinds = {one.kind for one in named}
        if "figure" in kinds:
            one = next(one for one in reversed(named) if one.kind == "figure")
            return ("limits" if one.known.index else "map"), tuple(figures)
        return ("curves" if "curve" in kinds else "show"), tuple(figures)
    varying = [one for one in holdings.of_kind("figure") if any(len(one.values_of(dim)) > 1 for dim in one.axes)]
    if varying:
        return "map", ()
    if holdings.of_kind("picture") or holdings.table("frames") is not None:
        return "strip", ()
    return ("curves", ()) if holdings.of_kind("curve") else ("budget", ())


def shown_at(holdings: Holdings) -> dict[str, Any]:
    """The axis values of the cell whose pictures and figures a run shows; {} where nothing says."""
    frames = holdings.table("frames")
    found = frames.attrs.get("cell", {}) if frames is not None else {}
    return dict(found) if isinstance(found, Mapping) else {}


def listed(holdings: Holdings) -> dict[str, Any]:
    """What there is to be drawn."""
    units = {dim: one.units_of(dim) for one in holdings for dim in one.axes}
    return {
        "kinds": KINDS,
        "axes": {dim: [value_text(v, units[dim], dim) for v in values] for dim, values in holdings.axes.items()},
        "variables": [_said(one) for kind in HELD for one in holdings.of_kind(kind)],
    }


def _said(one: Held) -> dict[str, Any]:
    better = str(one.attrs.get("better", "")) or one.known.better
    dims = {"axes": list(one.axes), "dims": list(one.dims)}
    return {"name": one.name, "kind": one.kind, **dims, "units": unit_text(one.units), "title": one.title, "better": better}
