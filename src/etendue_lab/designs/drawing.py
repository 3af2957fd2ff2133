"""Plots of the studies of a design: indices and their convergence, and the yield over a limit.

In:  the data of an archive of a design (``Holdings``), the request.
Out: a ``Plot``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from etendue.errors import RequestError
from etendue.present.plots.asked import PlotRequest
from etendue.present.plots.drawing.panels import wrapped
from etendue.present.plots.holdings import Holdings
from etendue.present.plots.labels import name_text, unit_text
from etendue.present.plots.plot import Plot, new_figure
from etendue.types.documents import Document
from etendue_lab.designs.samples import Metric, Samples, samples_of
from etendue_lab.designs.sensitivity import convergence, sensitivity
from etendue_lab.designs.yields import units_of, wilson

MOST = 10  # factors in a plot
KINDS = {"first": "first-order index", "total": "total index", "regression": "standardised regression coefficient"}


def samples_in(holdings: Holdings) -> Samples:
    """Return the samples of the archive to which the data belong.

    Raises
    ------
    RequestError
        The data come from no archive, or the archive has no design.
    """
    if not holdings.source:
        raise RequestError("only an archive holds a design: results in memory have no record of it")
    return samples_of(Path(holdings.source).parent, holdings.archive)


def _metric(samples: Samples, asked: PlotRequest) -> Metric:
    if not asked.first:
        raise RequestError(f"name a metric: etendue plot {samples.holdings.archive} KIND METRIC")
    found = samples.metrics(asked.first, asked.at)
    usual = [one for one in found if all(asked.middle.get(dim, value) == value for dim, value in one.at.items())]
    return (usual or found)[0]


def _title(samples: Samples, metric: Metric, what: str) -> str:
    said = ", ".join(filter(None, [what, metric.title, metric.said]))
    return f"{samples.pipeline}: {said}" if samples.pipeline else said


def index_bars(holdings: Holdings, asked: PlotRequest) -> Plot:
    """Plot first-order and total indices of every factor, else regression coefficients, with their intervals."""
    samples = samples_in(holdings)
    metric = _metric(samples, asked)
    (one,) = sensitivity(samples, [metric.name], {dim: str(value) for dim, value in metric.at.items()})["metrics"]
    return bars(one, _title(samples, metric, "what matters"))


def bars(one: Document, title: str) -> Plot:
    """Plot the results of a sensitivity study for one metric."""
    kinds = ("first", "total") if one["points"] else ("regression",)
    factors = [row for row in one["factors"] if row[kinds[-1]]]
    if not factors:
        raise RequestError(
            f"{one['metric']}: nothing to plot, because all factors of the design have choices, not numbers, as values"
        )
    factors = sorted(factors, key=lambda row: abs(row[kinds[-1]]["value"]))[-MOST:]
    figure = new_figure(7.0, 1.6 + 0.42 * len(factors))
    axes = figure.add_subplot()
    places, height = np.arange(len(factors)), 0.8 / len(kinds)
    rows: list[list[Any]] = [[row["factor"]] for row in factors]
    for number, kind in enumerate(kinds):
        found = np.array([[row[kind][word] for word in ("value", "low", "high")] for row in factors])
        ends = np.abs(found[:, 1:] - found[:, :1]).T
        shift = places + (len(kinds) - 1) * height / 2 - number * height
        look = {"xerr": ends, "error_kw": {"linewidth": 0.9, "capsize": 2, "ecolor": "0.25"}}
        axes.barh(shift, found[:, 0], height * 0.92, color=f"C{number}", label=KINDS[kind], **look)
        for row, own in zip(rows, found.tolist(), strict=True):
            row += own
    axes.set_yticks(places, [wrapped(name_text(row["factor"]), 2.0) for row in factors])
    axes.axvline(0, color="0.5", linewidth=0.8)
    axes.set_xlabel("share of the variance" if len(kinds) > 1 else KINDS["regression"], fontsize=8.5)
    axes.grid(axis="x", color="0.92")
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    if len(kinds) > 1:
        axes.legend(fontsize=7.5, loc="lower right")
    axes.set_title(wrapped(title, 6.0), fontsize=9.5)
    return Plot(
        figure, ["factor", *(f"{kind} {word}".strip() for kind in kinds for word in ("", "low", "high"))], rows[::-1]
    )


def converging(holdings: Holdings, asked: PlotRequest) -> Plot:
    """Plot the total index of every factor, or its regression coefficient, over the number of points."""
    samples = samples_in(holdings)
    metric = _metric(samples, asked)
    steps = convergence(samples, metric)
    if not steps:
        raise RequestError(f"too few samples of {metric.name} are finished")
    points = np.array([step["points"] for step in steps])
    found = np.array([[[own[w] for w in ("value", "low", "high")] for own in step["factors"]] for step in steps])
    order = np.argsort(-np.abs(found[-1, :, 0]))[:MOST]
    figure = new_figure(7.0, 4.4)
    axes = figure.add_subplot()
    for number, factor in enumerate(order):
        name = name_text(samples.factors[factor].name)
        axes.plot(points, found[:, factor, 0], marker="o", markersize=3.5, linewidth=1.2, label=name)
        axes.fill_between(points, found[:, factor, 1], found[:, factor, 2], alpha=0.15, color=f"C{number}", linewidth=0)
    total = samples.method == "saltelli"
    axes.set_xscale("log", base=2)
    axes.set_xticks(points, [str(own) for own in points])
    axes.set_xlabel("points" if total else "samples", fontsize=8.5)
    axes.set_ylabel("total index" if total else "standardised regression coefficient", fontsize=8.5)
    axes.axhline(0, color="0.7", linewidth=0.8, zorder=0)
    axes.grid(color="0.92", zorder=0)
    axes.tick_params(labelsize=8)
    figure.legend(loc="outside right upper", fontsize=7.5, frameon=False)
    axes.set_title(wrapped(_title(samples, metric, "convergence"), 6.0), fontsize=9.5)
    rows = [
        [int(points[i]), samples.factors[j].name, *map(float, found[i, j])] for j in order for i in range(len(points))
    ]
    return Plot(figure, ["points", "factor", "value", "low", "high"], rows)


def yield_curve(holdings: Holdings, asked: PlotRequest) -> Plot:
    """Plot the yield over a varying limit: the share of units whose metric is at least, or at most, the limit, with
    Wilson's interval.
    """
    samples = samples_in(holdings)
    metric = _metric(samples, asked)
    values = np.sort(metric.values[units_of(samples) & np.isfinite(metric.values)])
    if len(values) < 2:
        raise RequestError(f"too few units of {metric.name} are finished")
    held = holdings.find(metric.name)
    lower = (str(held.attrs.get("better", "")) or held.known.better) == "lower"
    limits = np.unique(values)
    passed = np.array([np.sum(values <= limit) if lower else np.sum(values >= limit) for limit in limits])
    ends = np.array([wilson(float(own), len(values)) for own in passed])
    share, unit = passed / len(values), unit_text(metric.units)
    figure = new_figure(7.0, 4.2)
    axes = figure.add_subplot()
    where = "post" if lower else "pre"
    axes.step(limits, share, where=where, color="C0", linewidth=1.4)
    axes.fill_between(limits, ends[:, 0], ends[:, 1], step=where, alpha=0.2, color="C0", linewidth=0)
    axes.set_ylim(-0.02, 1.02)
    sign = "at most" if lower else "at least"
    axes.set_xlabel(wrapped(f"limit of {metric.title}{f', {unit}' if unit else ''}", 6.0), fontsize=8.5)
    axes.set_ylabel(f"share of {len(values)} units with {sign} this", fontsize=8.5)
    axes.grid(color="0.92", zorder=0)
    axes.tick_params(labelsize=8)
    axes.set_title(wrapped(_title(samples, metric, "yield"), 6.0), fontsize=9.5)
    rows = [
        [float(a), float(b), float(low), float(high)] for a, b, (low, high) in zip(limits, share, ends, strict=True)
    ]
    return Plot(figure, ["limit", "yield", "low", "high"], rows)
