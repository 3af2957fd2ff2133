"""Plots on xarray's own objects: ``tree.etendue.plot.map("mean_level")``, ``dataset.etendue.plot()``,
``array.etendue.show()``.

In:  a ``DataTree`` or ``Dataset`` of an archive or of a run in memory; a ``DataArray`` of it.
Out: a ``Plot``. Importing this file registers the accessors; ``etendue.simulate`` and ``etendue.show`` import it, and
     so does xarray when it first opens something, if etendue is installed (entry point ``xarray.backends``).
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import xarray

from etendue.calls import called, called_methods
from etendue.errors import RequestError
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.drawing.strip import show_array
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.kinds import draw, kinds, listed
from etendue.present.plots.opening import opened
from etendue.present.plots.places import resolved_in
from etendue.present.plots.plot import Plot
from etendue.present.plots.summary import page
from etendue.present.plots.summary.contents import glance
from etendue.types.documents import Document

NAME = "etendue"


@called_methods
class Plots:
    """``tree.etendue.plot``: call it for the plot that fits best, or by kind: ``.map(...)``, ``.curves(...)``,
    ``.pareto(...)``, ``.strip()``.

    All kinds accept: names of variables in order; ``x``, ``y``, ``lines``, ``panels``, ``better``; values of axes by
    name (``gain=2.8``, ``stage="filter"``). For an axis whose name is also an argument, use ``at``.
    """

    def __init__(self, tree: xarray.DataTree | xarray.Dataset) -> None:
        self._tree = tree

    def __call__(self, kind: str = "", *figures: str, **words: Any) -> Plot:
        """Plot a kind or a variable; without arguments, the plot that fits best."""
        own = {name: words.pop(name) for name in ("x", "y", "lines") if name in words}
        listed = [words.pop(name, ()) for name in ("panels", "better")]
        texts = [one.split(",") if isinstance(one, str) else one for one in listed]
        panels, better = (tuple(text.strip() for text in one) for one in texts)
        at = {**dict(words.pop("at", {})), **words}
        return draw(Holdings(self._tree), kind, PlotRequest(figures, panels=panels, better=better, at=at, **own))

    def __getattr__(self, kind: str) -> Any:
        if kind not in kinds():
            raise AttributeError(f"unknown kind of plot {kind!r}; available: {', '.join(kinds())}")
        return partial(self, kind)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *kinds()]


@called_methods
class TreeAccessor:
    """``tree.etendue``: summary, plots and pictures of an archive."""

    def __init__(self, tree: xarray.DataTree | xarray.Dataset) -> None:
        self._tree = tree

    def __repr__(self) -> str:
        return page.text(glance(self._tree))

    def _repr_html_(self) -> str:
        """Return the summary as HTML: stages as small pictures, axes, metrics, failures, omissions, and next steps."""
        return page.page(glance(self._tree))

    @property
    def plot(self) -> Plots:
        return Plots(self._tree)

    def show(self, variable: str = "", **at: Any) -> Plot:
        """Show one picture of one cell, upright: ``tree.etendue.show("picture", gain=2.8)``."""
        return Plots(self._tree)("show", *([variable] if variable else []), **at)

    def list(self) -> Document:
        """Return the available kinds of plots, variables and axes."""
        return listed(Holdings(self._tree))


@called_methods
class ArrayAccessor:
    """``array.etendue``: an array as a picture."""

    def __init__(self, array: xarray.DataArray) -> None:
        self._array = array

    def show(self, **at: Any) -> Plot:
        """Show the array at given values of its dims, upright, with its true aspect and colours."""
        array = self._array.sel(resolved_in(self._array, at))
        return show_array(array.squeeze([dim for dim in array.dims if array.sizes[dim] == 1 and dim not in ("y", "x")]))


def register() -> None:
    """Register the accessors on xarray's classes, once."""
    put: Any
    for kind, accessor, put in (
        (xarray.DataTree, TreeAccessor, xarray.register_datatree_accessor),
        (xarray.Dataset, TreeAccessor, xarray.register_dataset_accessor),
        (xarray.DataArray, ArrayAccessor, xarray.register_dataarray_accessor),
    ):
        if NAME not in vars(kind):
            put(NAME)(accessor)


@called
def show(what: Any, variable: str = "", **at: Any) -> Plot:
    """Show a picture of an array, of a dataset or tree, or of the archive in a folder.

    Raises
    ------
    RequestError, ArchiveError
        There is no archive or no picture, or several pictures fit and none is chosen.
    """
    if isinstance(what, str | Path):
        what = opened(Path(what))
    if isinstance(what, xarray.DataArray):
        if variable:
            raise RequestError(f"an array holds no variable {variable!r}; omit the name")
        return ArrayAccessor(what).show(**at)
    if not isinstance(what, xarray.DataTree | xarray.Dataset):
        raise RequestError(
            f"show needs an xarray array, dataset or tree, or the folder of an archive, not {type(what).__name__}"
        )
    return TreeAccessor(what).show(variable, **at)


register()
