"""Sensitivity of a metric to the factors of a design.

In:  the samples of an archive, metrics.
Out: a document: indices with intervals, regression, ranks, main effects, pairs, convergence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from etendue.errors import RequestError
from etendue.types.arrays import Array
from etendue.types.documents import AxisValues, Document
from etendue_lab.designs.indices import Indices, indices, mixed_of
from etendue_lab.designs.regression import coefficients, main_effect, pairs, rank_correlations, with_interval
from etendue_lab.designs.samples import DRAWS, Metric, Samples

FEWEST = 8  # smallest number of rows or points that is evaluated
WIDE = 0.4  # width of an interval above which a note says that more samples are needed
TOLD = 0.01  # smallest share of the variance for which a product of two factors is listed


def sensitivity(samples: Samples, names: Sequence[str], at: AxisValues | None = None) -> Document:
    """Return the contribution of every factor to each metric.

    Raises
    ------
    RequestError
        A metric is unknown, or too few of its rows are finished.
    """
    found = [_of_metric(samples, metric) for name in names for metric in samples.metrics(name, at)]
    return {
        "pipeline": samples.pipeline,
        "method": samples.method,
        "rows": len(samples.numbers),
        "factors": [{"name": one.name, "key": one.key, "units": one.units} for one in samples.factors],
        "metrics": found,
    }


def _of_metric(samples: Samples, metric: Metric) -> Document:
    there = np.isfinite(metric.values)
    columns = np.stack([factor.codes for factor in samples.factors], axis=1)[there]
    values = metric.values[there]
    if len(values) < FEWEST:
        raise RequestError(f"{metric.name}: {len(values)} samples are finished; at least {FEWEST} are needed")
    explained = coefficients(columns, values)[1]
    regressed, ranks = with_interval(columns, values), rank_correlations(columns, values)
    products = pairs(columns, values)
    own = indices_of(samples, metric)
    names = [factor.name for factor in samples.factors]
    rows = [
        {
            "factor": name,
            "subject": samples.factors[n].subject,
            "first": _interval(own.first[n]) if own else None,
            "total": _interval(own.total[n]) if own else None,
            "main_effect": main_effect(columns[:, n], values),
            "regression": _interval(regressed[n]) if samples.factors[n].numeric else None,
            "rank": float(ranks[n]) if samples.factors[n].numeric else None,
        }
        for n, name in enumerate(names)
    ]
    return {
        "metric": metric.name,
        "title": metric.title,
        "at": dict(metric.at),
        "said": metric.said,
        "units": metric.units,
        "samples": len(values),
        "points": own.points if own else None,
        "mean": float(values.mean()),
        "deviation": float(values.std()),
        "explained": explained,
        "factors": rows,
        "subjects": subjects_of(rows),
        "pairs": [
            {"factors": [names[j], names[i]], "share": float(products[i, j])}
            for i in range(len(names))
            for j in range(i)
            if products[i, j] >= TOLD
        ],
        "convergence": convergence(samples, metric),
        "notes": _notes(samples, metric, own),
    }


def subjects_of(rows: Sequence[Document]) -> list[Document]:
    """Return for each subject the sum of the first-order indices of its factors or, without indices, of their main
    effects. Also return the closed index: the share of the variance that these factors explain together. It is known if
    the subject has one factor, all factors, or all factors but one.

    For all factors but one, this share is 1 minus the total index of the remaining factor.
    """
    found = []
    for subject in dict.fromkeys(row["subject"] for row in rows):
        own, others = ([row for row in rows if (row["subject"] == subject) is here] for here in (True, False))
        single = [row["first"]["value"] if row["first"] else row["main_effect"] for row in own]
        closed = None
        if rows[0]["first"]:
            if not others:
                closed = {"value": 1.0, "low": 1.0, "high": 1.0}
            elif len(own) == 1:
                closed = own[0]["first"]
            elif len(others) == 1:
                left = others[0]["total"]
                closed = {"value": 1 - left["value"], "low": 1 - left["high"], "high": 1 - left["low"]}
        names = [row["factor"] for row in own]
        found.append({"subject": subject, "factors": names, "sum": float(sum(single)), "closed": closed})
    return sorted(found, key=lambda one: -one["sum"])


def _interval(found: Array) -> Document:
    return dict(zip(("value", "low", "high"), map(float, found), strict=True))


def indices_of(samples: Samples, metric: Metric, points: int | None = None) -> Indices | None:
    """Return the Sobol' indices of the first points of a Saltelli design; None for other designs."""
    mixed = _mixed(samples, metric)
    return indices(mixed[:points]) if mixed is not None and len(mixed) >= FEWEST else None


def _mixed(samples: Samples, metric: Metric) -> Array | None:
    if samples.method != "saltelli":
        return None
    factors = len(samples.asked.factors)
    whole = np.full((samples.numbers[-1] // (factors + 2) + 1) * (factors + 2), np.nan)
    whole[list(samples.numbers)] = metric.values
    found = mixed_of(whole, factors)
    keys = [factor.key for factor in samples.factors]
    kept = [n for n, key in enumerate(samples.asked.factors) if key in keys]
    return found[:, [0, 1, *(n + 2 for n in kept)]]


def convergence(samples: Samples, metric: Metric) -> list[Document]:
    """Return the results for the first points of a design, doubling their number each time: total indices of a Saltelli
    design, else regression coefficients, each with its interval.
    """
    mixed = _mixed(samples, metric)
    there = np.isfinite(metric.values)
    columns, values = np.stack([factor.codes for factor in samples.factors], axis=1)[there], metric.values[there]
    most = len(values) if mixed is None else len(mixed)
    found: list[Document] = []
    points = FEWEST * 2
    while points < 2 * most:
        points = min(points, most)
        part: Any = with_interval(columns[:points], values[:points]) if mixed is None else indices(mixed[:points]).total
        found.append({"points": points, "factors": [_interval(own) for own in part]})
        points *= 2
    return found


def _notes(samples: Samples, metric: Metric, own: Indices | None) -> list[str]:
    notes = []
    lacking = int((~np.isfinite(metric.values)).sum())
    if lacking:
        notes.append(f"{metric.name}: {lacking} of {len(samples.numbers)} samples are not finished")
    if samples.method != "saltelli":
        notes.append("Sobol' indices need a design with method = 'saltelli'; main effects are first-order estimates")
    elif own is None:
        notes.append(f"too few complete points for indices: at least {FEWEST} are needed")
    elif (width := float(np.ptp(np.concatenate([own.first, own.total])[:, 1:], axis=1).max())) > WIDE:
        notes.append(
            f"{metric.name}: {own.points} points leave intervals {width:.2g} wide; to extend the design, run it again "
            f"with --set design.points={4 * own.points}"
        )
    if draws := samples.draws(metric):
        stages = ", ".join(draws)
        notes.append(
            f"{metric.name}: the noise of {stages} is drawn anew in every sample and is part of the variance; "
            f"set noise = 'common' for indices of the factors alone, or noise = {{ from = 0, to = 9999 }} as a factor"
        )
    elif DRAWS in samples.asked.factors:
        notes.append(f"{metric.name}: the total index of the factor noise is the share of the random draws")
    elif any(node["shown"].get(DRAWS) == "common" for node in samples.behind(metric).values()):
        notes.append(
            f"{metric.name}: noise = 'common': the same noise in every sample, so that indices describe factors only"
        )
    if samples.asked.correlated:
        notes.append(
            "some factors are correlated: a coefficient is the effect of one factor at fixed values of the others"
        )
    return notes
