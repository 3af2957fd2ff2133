"""Run time, error and omissions by stage, from the ledger of an archive.

In:  holdings with a table ``ledger``.
Out: a ``Plot`` of three columns of bars over the stages in their order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.wording import words as called
from etendue.errors import RequestError
from etendue.plugins.shares import shared_out
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.labels import number_text
from etendue.present.plots.plot import Plot, new_figure
from etendue.types.documents import AxisValue, DocumentView

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = ("stage", "cells", "failed", "left_out", "approximated", "seconds", "seconds_saved", "error", "how", "bound")


def budget(holdings: Holdings, blame: DocumentView | None = None, place: str = "") -> Plot:
    """Plot CPU time, stated error and omissions by stage; with ``blame``, a document of ``etendue_shares``, also
    each stage's share of the losses at a ``place`` of the sweep.

    Raises
    ------
    RequestError
        There is no ledger.
    """
    rows = by_stage(holdings)
    losses = list(blame["losses"]) if blame else []
    high = 1.5 + 0.24 * len(rows)
    below = 1.5 + 0.24 * max(len(loss["stages"]) for loss in losses) if losses else 0.0
    whole = new_figure(11.0, high + below)
    figure, second = whole.subfigures(2, 1, height_ratios=(high, below)) if losses else (whole, None)
    time, error, left = figure.subplots(1, 3, sharey=True, width_ratios=(1.0, 1.25, 1.0))
    at = {name: [row[number] for row in rows] for number, name in enumerate(COLUMNS)}
    _draw_time(time, at)
    _draw_error(error, at)
    _draw_cells(left, at)
    for axes in (time, error, left):
        axes.tick_params(labelsize=7.5, length=2)
        axes.grid(axis="x", color="0.93")
        axes.set_axisbelow(True)
        axes.legend(
            fontsize=7,
            frameon=False,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.04 - 0.5 / max(len(rows), 4)),
            ncols=2,
        )
    figure.suptitle(
        f"{holdings.pipeline + ': ' if holdings.pipeline else ''}time, error and omissions by stage", fontsize=10
    )
    if blame is None:
        return Plot(
            whole,
            COLUMNS,
            rows,
            [f"each stage's share of the loss of {called()['lost']}: --blame"] if shared_out() else [],
        )
    for axes, loss in zip(
        np.atleast_1d(second.subplots(1, len(losses))) if second is not None else (), losses, strict=True
    ):
        _draw_loss(axes, loss)
    if second is not None and place:
        second.suptitle(f"each stage's share of the loss, at {place}", fontsize=10)
    where = f" at {place}" if place else ""
    notes = [f"no losses{where}: {blame['why']}"] if blame.get("why") else []
    notes += [f"losses are given for the {called()['cell']}{where}"] if place and not notes else []
    notes += map(str, blame["notes"])
    return Plot(
        whole, (*COLUMNS, *(f"{loss['what'].lower()}_share" for loss in losses)), _with_shares(rows, losses), notes
    )


def _draw_time(axes: Axes, at: Mapping[str, list[AxisValue]]) -> None:
    """Draw bars of the CPU time that each stage has spent and saved."""
    rank = np.arange(len(at["stage"]))
    seconds, saved = np.nan_to_num(np.array(at["seconds"], float)), np.nan_to_num(np.array(at["seconds_saved"], float))
    axes.barh(rank, seconds, color="#4477aa", label="spent")
    axes.barh(
        rank,
        saved,
        left=seconds,
        color="none",
        edgecolor="#4477aa",
        hatch="////",
        linewidth=0.6,
        label="saved (planned)",
    )
    top = max(float((seconds + saved).max()), 1e-9)
    for row, (own, more) in enumerate(zip(seconds, saved, strict=True)):
        axes.text(own + more + 0.01 * top, row, _seconds(own), va="center", fontsize=7)
    axes.set_xlim(0, 1.22 * top)
    axes.set_title(f"CPU time: {_seconds(float(seconds.sum()))} total", fontsize=9)
    axes.set_yticks(
        rank,
        [
            f"{name}  ({cells} {'cell' if cells == 1 else 'cells'})"
            for name, cells in zip(at["stage"], at["cells"], strict=True)
        ],
        fontsize=7.5,
    )
    axes.invert_yaxis()


def _draw_error(axes: Axes, at: Mapping[str, list[AxisValue]]) -> None:
    """Draw bars of stated errors by stage, on a logarithmic axis."""
    rank = np.arange(len(at["stage"]))
    stated = np.array([np.nan if v is None else v for v in at["error"]], float)
    bound = np.array(at["bound"], float)
    positive = np.concatenate([stated[stated > 0], bound[bound > 1e-12]])
    low = 10.0 ** np.floor(np.log10(max(float(positive.min()), 1e-12)) - 0.3) if positive.size else 1e-9
    axes.set_xscale("log")
    axes.barh(
        rank - 0.19,
        np.where(stated > low, stated - low, 0),
        left=low,
        height=0.36,
        color="#cc6677",
        label="of the stage",
    )
    axes.barh(
        rank + 0.19,
        np.where(bound > low, bound - low, 0),
        left=low,
        height=0.36,
        color="#ddcc77",
        label="error bound of omissions",
    )
    axes.set_xlim(low, max(2.0 * float(positive.max()), 10 * low) * 12 if positive.size else 1.0)
    for row, (own, how) in enumerate(zip(stated, at["how"], strict=True)):
        text = "unknown" if np.isnan(own) else f"{'exact' if own == 0 else f'{own:.0e}'.replace('e-0', 'e-')}, {how}"
        axes.text(own * 1.15 if own > low else low * 1.15, row - 0.19, text, va="center", fontsize=6.5)
    axes.set_title("largest error, relative to full scale", fontsize=9)


def _draw_cells(axes: Axes, at: Mapping[str, list[AxisValue]]) -> None:
    """Draw bars of the shares of each stage's cells that were left out, computed more coarsely, or failed."""
    rank = np.arange(len(at["stage"]))
    shares = {
        name: np.array(at[name], float) / np.maximum(np.array(at["cells"], float), 1)
        for name in ("left_out", "approximated", "failed")
    }
    start = np.zeros(len(rank))
    for name, colour, words in (
        ("left_out", "#117733", "left out"),
        ("approximated", "#88ccee", "coarser"),
        ("failed", "#c03028", "failed or skipped"),
    ):
        if name != "failed" or shares[name].any():
            axes.barh(rank, 100 * shares[name], left=100 * start, color=colour, label=words)
            start = start + shares[name] if name != "approximated" else start
    axes.set_xlim(0, 105)
    axes.set_title("share of cells, %", fontsize=9)


def _draw_loss(axes: Axes, loss: DocumentView) -> None:
    """Draw bars of each stage's share of the loss; bars of stages that reduce the loss extend to the left."""
    names, shares = [one["stage"] for one in loss["stages"]], np.array([_known(one["share"]) for one in loss["stages"]])
    place = np.arange(len(names))
    axes.barh(place, 100 * shares, color=np.where(shares < 0, "#44aa77", "#cc6677"))
    low, high = (
        min(0.0, 100 * float(np.nanmin(shares, initial=0.0))),
        max(0.0, 100 * float(np.nanmax(shares, initial=0.0))),
    )
    for row, share in enumerate(shares):
        text = "unknown" if np.isnan(share) else f"{100 * share:.1f} %"
        axes.text(100 * max(np.nan_to_num(share), 0.0) + 0.02 * (high - low), row, text, va="center", fontsize=7)
    axes.set_xlim(low - 0.03 * (high - low), high + 0.25 * (high - low) if high > low else 1.0)
    axes.set_yticks(place, names, fontsize=7.5)
    axes.invert_yaxis()
    axes.axvline(0, color="0.4", linewidth=0.8)
    axes.set_title(f"{loss['what']}: {loss['value']:.3g}, ideal {loss['ideal']:.3g}\n({loss['figure']})", fontsize=8.5)
    axes.set_xlabel("share of the loss, %; below 0: reduces the loss", fontsize=7.5)
    axes.tick_params(labelsize=7.5, length=2)
    axes.grid(axis="x", color="0.93")
    axes.set_axisbelow(True)


def _known(share: Any) -> float:
    return np.nan if share is None else float(share)


def _with_shares(rows: list[list[Any]], losses: Sequence[DocumentView]) -> list[list[Any]]:
    """Append each stage's share of every loss to its row; stages whose losses are merged get a separate row."""
    shares = [{one["stage"]: one["share"] for one in loss["stages"]} for loss in losses]
    names = [row[0] for row in rows]
    apart = [name for name in dict.fromkeys(name for own in shares for name in own) if name not in names]
    beside = [[name, *[None] * (len(COLUMNS) - 1)] for name in apart]
    return [[*row, *(own.get(row[0]) for own in shares)] for row in [*rows, *beside]]


def by_stage(holdings: Holdings) -> list[list[Any]]:
    """Return a row for each stage, in order, with the columns of ``COLUMNS``.

    Raises
    ------
    RequestError
        There is no ledger.
    """
    ledger = holdings.table("ledger")
    if ledger is None:
        raise RequestError("no ledger: a budget needs a complete archive or the complete result of a run")
    stages = ledger["stage"].values.astype(object)
    rows = []
    for name in dict.fromkeys(stages.tolist()):
        own = ledger.isel(cell=np.flatnonzero(stages == name))
        status = own["status"].values.astype(object)
        error = own["error"].values
        omitted = [int((own[name].values.astype(object) != "").sum()) for name in ("why_left_out", "approximated")]
        seconds = [float(np.nansum(own[name].values)) for name in ("seconds", "seconds_saved")]
        worst = float(np.nanmax(error)) if np.isfinite(error).any() else None
        how, bound = str(own["how"].values.astype(object)[0]), float(np.nan_to_num(own["bound"].values).max())
        rows.append(
            [
                name,
                len(status),
                int(np.isin(status, ("failed", "skipped")).sum()),
                *omitted,
                *seconds,
                worst,
                how,
                bound,
            ]
        )
    return rows


def _seconds(value: float) -> str:
    if value >= 60:
        return f"{value / 60:.3g} min"
    return f"{number_text(value)} s" if value >= 1 else f"{1e3 * value:.3g} ms"
