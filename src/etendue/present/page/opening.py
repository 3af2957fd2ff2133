"""The beginning of a page: the recommended cell of a sweep and the reason for the choice, the factor that limits it,
its error bound; and all metrics by subject.

In:  the metrics of an archive, the values of its axes, its ledger.
Out: plain JSON, except ``usable``, an array: the chosen position, the front on which it lies, its neighbours, at most
     eight metrics, all others by subject.

The front is computed from metrics of the first two opening subjects (``etendue_subjects``) that vary over the sweep.
For every usable cell, each of the two metrics is divided by the best value of all usable cells; the cell whose smaller
quotient is the largest is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.contract.arrays.variables import Variable
from etendue.contract.arrays.variables import variable as known
from etendue.contract.wording import Subject, subjects
from etendue.present.page.figures import MetricColumn
from etendue.present.page.opened import ArchivedAxis
from etendue.present.page.tables import Ledger
from etendue.present.plots.drawing.pareto import front
from etendue.types.arrays import Array
from etendue.types.documents import Document, DocumentView

OTHER = "other"
MOST_OPEN = 8
MOST_CELLS = 1_000_000  # of a front
MOST_FRONT = 60


@dataclass(frozen=True)
class Number:
    """A metric with one number per cell; if a metric has several numbers per cell, the one at index ``inner``."""

    figure: MetricColumn
    inner: int

    @property
    def known(self) -> Variable:
        return known(self.figure.variable)

    @property
    def subject(self) -> str:
        return self.known.subject or OTHER

    @property
    def said(self) -> Document:
        return {"stage": self.figure.stage, "variable": self.figure.variable, "inner": self.inner}

    @property
    def values(self) -> Array:
        """The values over its axes."""
        own = self.figure.values
        return own.reshape(*own.shape[: len(self.figure.axes)], -1)[..., self.inner]

    def over(self, axes: Sequence[ArchivedAxis]) -> Array:
        """Return the values broadcast to ``axes``, which include all axes of the metric."""
        own = list(self.figure.axes)
        sizes = [len(axis.values) if axis.dim in own else 1 for axis in axes]
        order = [own.index(axis.dim) for axis in axes if axis.dim in own]
        return np.broadcast_to(self.values.transpose(order).reshape(sizes), [len(axis.values) for axis in axes])

    def at(self, place: Mapping[str, int]) -> float:
        return float(self.values[tuple(place[dim] for dim in self.figure.axes)])

    def worth(self, values: Array) -> Array:
        """Return values of which a higher one is better: decibels and stops become linear ratios, and the sign changes
        if lower is better.
        """
        if self.figure.units in ("dB", "stop"):
            values = 10 ** (values / 20) if self.figure.units == "dB" else 2.0**values
        return values if self.known.better == "higher" else -values


def opening(
    figures: Sequence[MetricColumn], axes: Sequence[ArchivedAxis], start: Mapping[str, int], table: Ledger
) -> Document:
    """Return the beginning of the page. ``start``: the position shown if there is no choice to make."""
    numbers = [one for figure in figures if (one := _number(figure)) is not None]
    chosen = _front(numbers, axes)
    place = {**start, **chosen["place"]} if chosen else dict(start)
    return {
        "front": chosen,
        "place": place,
        "limits": _limits(figures, place),
        "error": _error(table, axes, place),
        "open": [one.said for one in _open(numbers, chosen)],
        "subjects": _subjects(figures),
    }


def _opens() -> list[str]:
    """Return the subjects of which the beginning of the page shows a metric."""
    return [name for name, one in subjects().items() if one.opens]


def _subject(name: str) -> Subject:
    return subjects().get(name, Subject())


def _number(figure: MetricColumn) -> Number | None:
    if figure.dims not in ((), ("stage",)) or figure.meanings or not np.isfinite(figure.values).any():
        return None
    return Number(figure, int(np.prod(figure.values.shape[len(figure.axes) :], dtype=int)) - 1)


def _ranked(numbers: Sequence[Number], subject: str) -> list[Number]:
    """Return the metrics of a subject, the most informative first. If several stages write a variable, only the last
    one counts.
    """
    last = {one.figure.variable: one for one in numbers if one.subject == subject}
    return sorted(last.values(), key=lambda one: one.known.rank)


def _open(numbers: Sequence[Number], chosen: DocumentView | None) -> list[Number]:
    """Return at most eight metrics: one of each opening subject, a metric of the front if it has one, then metrics
    without a subject.
    """
    found = []
    for subject in _opens():
        ranked = _ranked(numbers, subject)
        on = [one for one in ranked if chosen and one.said in (chosen["x"], chosen["y"])]
        found += (on or [one for one in ranked if one.known.better or one.known.rank == 0])[:1]
    rest = [
        one
        for one in _ranked(numbers, OTHER)
        if not any(
            one.figure.axes == other.figure.axes and np.array_equal(one.values, other.values, equal_nan=True)
            for other in found
        )
    ]
    return [*found, *rest][:MOST_OPEN]


def _subjects(figures: Sequence[MetricColumn]) -> list[Document]:
    """Return every metric by its subject, as (stage, variable)."""
    found: dict[str, list[list[str]]] = {}
    for one in figures:
        found.setdefault(known(one.variable).subject or OTHER, []).append([one.stage, one.variable])
    order = [
        *(s for s in subjects() if s in found),
        *(s for s in found if s not in (*subjects(), OTHER)),
        *([OTHER] if OTHER in found else []),
    ]
    return [{"subject": subject, "figures": found[subject]} for subject in order]


# -- the front
# ------------------------------------------------------------------------------------------------------------


def _front(numbers: Sequence[Number], axes: Sequence[ArchivedAxis]) -> Document | None:
    """Return the two metrics that the sweep trades off, and their Pareto front; None if fewer than two metrics vary."""
    if not axes or math.prod(len(axis.values) for axis in axes) > MOST_CELLS:
        return None
    moved = [own for subject in _opens() if (own := next(filter(_trades, _ranked(numbers, subject)), None))]
    if len(moved) < 2:
        return None
    x, y = moved[:2]
    over = [axis for axis in axes if axis.dim in {*x.figure.axes, *y.figure.axes}]
    worth = np.stack([one.worth(one.over(over)).ravel() for one in (x, y)], axis=1)
    there = np.isfinite(worth).all(axis=1)
    if not there.any():
        return None
    burnt = _burnt(numbers, over).ravel()
    usable = there & ~burnt if (there & ~burnt).any() else there
    shares = _shares(np.where(usable[:, None], worth, np.nan))
    on = np.flatnonzero(front(np.where(usable[:, None], worth, np.nan)))
    least = shares[on].min(axis=1)
    best = on[np.lexsort((-shares[on].sum(axis=1), -least))[0]]
    shape = [len(axis.values) for axis in over]

    def placed(cell: int) -> dict[str, int]:
        return {axis.dim: int(i) for axis, i in zip(over, np.unravel_index(cell, shape), strict=True)}

    order = on[np.argsort(worth[on, 0])]
    if len(order) > MOST_FRONT:
        order = order[np.unique(np.linspace(0, len(order) - 1, MOST_FRONT).round().astype(int))]
    place = placed(int(best))
    return {
        "x": x.said,
        "y": y.said,
        "kinds": [x.subject, y.subject],
        "said": [_subject(one.subject).said for one in (x, y)],
        "short": [_subject(one.subject).short for one in (x, y)],
        "better": [x.known.better, y.known.better],
        "dims": [axis.dim for axis in over],
        "place": place,
        "usable": usable if burnt.any() else None,
        "shares": [float(v) for v in shares[best]],
        "on": [placed(int(cell)) for cell in order],
        "cells": int(there.sum()),
        "burnt": int((there & burnt).sum()),
        "beside": _beside(x, y, over, place, usable.reshape(shape)),
    }


def _trades(one: Number) -> bool:
    """Return whether a metric varies over the sweep and has a known better direction."""
    known_values = one.values[np.isfinite(one.values)]
    return bool(one.known.better) and not one.known.counted and known_values.size > 1 and bool(np.ptp(known_values) > 0)


def _burnt(numbers: Sequence[Number], over: Sequence[ArchivedAxis]) -> Array:
    """Return a mask of the cells that may not be chosen, because a metric exceeds its limit there."""
    found = np.zeros([len(axis.values) for axis in over], bool)
    dims = {axis.dim for axis in over}
    for one in numbers:
        if set(one.figure.axes) <= dims:
            if one.known.counted == "overexposed":
                found |= np.nan_to_num(one.over(over)) > 0
            elif one.known.usable is not None:
                found |= np.nan_to_num(one.over(over)) > one.known.usable
    return found


def _shares(worth: Array) -> Array:
    """Return each value as a fraction of the best value in its column: the ratio of the two, inverted for negative
    values (lower is better); if the column reaches or crosses 0, the position within its range.
    """
    found = np.empty_like(worth)
    for number in range(worth.shape[1]):
        own = worth[:, number]
        low, high = np.nanmin(own), np.nanmax(own)
        if low > 0:
            found[:, number] = own / high
        elif high < 0:
            found[:, number] = high / own
        else:
            found[:, number] = (own - low) / (high - low) if high > low else 1.0
    return found


def _beside(
    x: Number, y: Number, over: Sequence[ArchivedAxis], place: Mapping[str, int], usable: Any
) -> list[Document]:
    """Return both metrics in the neighbouring cells along each axis, and whether each neighbour is usable."""
    found = []
    for axis in over:
        for step in (-1, 1):
            there = {**place, axis.dim: place[axis.dim] + step}
            if 0 <= there[axis.dim] < len(axis.values):
                index = tuple(there[own.dim] for own in over)
                pairs = [(one.at(place), one.at(there)) for one in (x, y)]
                values = [b for _, b in pairs]
                if all(math.isfinite(v) for pair in pairs for v in pair):
                    found.append(
                        {"dim": axis.dim, "place": there[axis.dim], "values": values, "usable": bool(usable[index])}
                    )
    return found


# -- limiting factors and errors
# -----------------------------------------------------------------------------------------


def _limits(figures: Sequence[MetricColumn], place: Mapping[str, int]) -> list[Document]:
    """Return the limiting factor of each subject in one cell and, if a metric states it, the gain from removing this
    factor.

    ``capped``: the gain from removing the factor ``cap``, which limits the metric whatever the other factors are; if it
    is above 1, the page reports this factor first.
    """
    found = []
    for one in figures:
        if not (known(one.variable).index and one.meanings and not one.dims):
            continue
        value = float(one.values[tuple(place[dim] for dim in one.axes)])
        if not (value >= 0 and value < len(one.meanings)):
            continue
        dim, cap, words = known(one.variable).names, known(one.variable).cap, known(one.variable).said
        subject, factor = known(one.variable).subject or OTHER, one.meanings[int(value)]
        gain = next(
            (
                g
                for g in figures
                if g.stage == one.stage and g.dims == (dim,) and len(one.meanings) == g.values.shape[-1]
            ),
            None,
        )
        own = gain.values[tuple(place[d] for d in gain.axes)] if gain is not None else None
        found.append(
            {
                "stage": one.stage,
                "variable": one.variable,
                "subject": subject,
                "about": _subject(subject).said or subject,
                "factor": factor,
                "said": words.get(factor, ""),
                "cap": cap,
                "cap_words": words.get(cap, cap),
                "cap_said": known(one.variable).cap_said,
                "gain": None if own is None else float(own[int(value)]),
                "capped": float(own[one.meanings.index(cap)]) if own is not None and cap in one.meanings else None,
            }
        )
    return found


def _error(table: Ledger, axes: Sequence[ArchivedAxis], place: Mapping[str, int]) -> Document:
    """Return the largest error that a stage states in the cell at a position, and the largest error bound of an
    omission there.
    """
    here = np.ones(len(table["stage"]), bool)
    for axis in axes:
        column = table["at"].get(axis.dim)
        if column is not None and axis.values:
            value = axis.values[place[axis.dim]]
            here &= np.array([v == value or v == "" or v != v for v in column.tolist()], bool)
    errors = np.where(here, np.nan_to_num(table["error"], nan=-1.0), -1.0)
    bounds = table["bound"][here]
    bounds = bounds[np.isfinite(bounds)]
    worst = int(errors.argmax()) if errors.size else 0
    said = bool(errors.size) and errors[worst] >= 0
    return {
        "stage": str(table["stage"][worst]) if said else "",
        "largest": float(errors[worst]) if said else None,
        "how": str(table["how"][worst]) if said else "",
        "bound": float(bounds.max()) if bounds.size else None,
    }
