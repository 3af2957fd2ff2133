"""The share of units of a design that pass requirements, and the changes that would increase it.

In:  the samples of an archive, requirements such as ``mtf50_lp_mm >= 60``.
Out: a document: the share that passes with its interval, the failed requirements, and the gain from a smaller spread of
each factor.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

import numpy as np

from etendue.contract.values.units import UnitError, to_unit
from etendue.errors import Fault, RequestError
from etendue.plan.designs.distributions import Distribution
from etendue.types.arrays import Array
from etendue.types.documents import AxisValues, Document
from etendue_lab.designs.samples import Factor, Metric, Samples, by_place

TIGHTER = 0.1  # fraction by which a spread is reduced
QUANTILE = 1.959963984540054  # of the normal distribution, for a 95 % interval
FEWEST = 8
_FORM = re.compile(r"\s*([\w.]+)\s*(>=|<=|>|<)\s*(.+?)\s*")


@dataclass(frozen=True)
class Requirement:
    """A limit that a metric must meet."""

    metric: str
    sign: str
    limit: str
    text: str

    def value(self, units: str) -> float:
        """Return the limit in the unit of the metric."""
        try:
            number: Any = Decimal(self.limit)
        except InvalidOperation:
            number = self.limit
        try:
            return float(to_unit(number, units))
        except UnitError as error:
            raise RequestError([Fault(f"--require '{self.text}'", str(error))]) from None

    def margin(self, metric: Metric) -> Array:
        """Return the margin by which each unit meets the requirement, in the unit of the metric; negative for a failed
        unit.
        """
        limit = self.value(metric.units)
        return metric.values - limit if self.sign.startswith(">") else limit - metric.values

    def holds(self, metric: Metric) -> Array:
        margin = self.margin(metric)
        return margin >= 0 if "=" in self.sign else margin > 0


def required(texts: Sequence[str]) -> list[Requirement]:
    """Parse requirements; return them in the order in which they are written.

    Raises
    ------
    RequestError
        A requirement does not have the form of a requirement.
    """
    found, faults = [], []
    for text in texts:
        match = _FORM.fullmatch(text)
        if match is None:
            faults.append(Fault(f"--require '{text}'", "expected METRIC >= VALUE, or with <=, >, <"))
        else:
            found.append(Requirement(match[1], match[2], match[3], text.strip()))
    if faults or not found:
        raise RequestError(faults or [Fault("--require", "give at least one, such as 'mean_snr >= 20'")])
    return found


def wilson(passed: float, rows: float) -> tuple[float, float]:
    """Return the ends of Wilson's interval of a share at 95 %."""
    share, square = passed / rows, QUANTILE**2
    centre = (share + square / (2 * rows)) / (1 + square / rows)
    half = QUANTILE / (1 + square / rows) * np.sqrt(share * (1 - share) / rows + square / (4 * rows**2))
    return float(centre - half) if passed else 0.0, float(centre + half) if passed < rows else 1.0


def yields(samples: Samples, requirements: Sequence[Requirement], at: AxisValues | None = None) -> Document:
    """Return the share of units that fulfil all requirements, at every combination of the other axes.

    Raises
    ------
    RequestError
        A metric is unknown, or too few units are finished.
    """
    places = by_place(samples, [one.metric for one in requirements], at or {})
    return {
        "pipeline": samples.pipeline,
        "method": samples.method,
        "requirements": [one.text for one in requirements],
        "places": [_at_place(samples, requirements, metrics) for metrics in places],
    }


def units_of(samples: Samples) -> Array:
    """Return the rows that are independent units: in a Saltelli design the points A and B, but not their mixtures."""
    numbers = np.array(samples.numbers)
    if samples.method != "saltelli":
        return np.ones(len(numbers), bool)
    return numbers % (len(samples.asked.factors) + 2) < 2


def _at_place(samples: Samples, requirements: Sequence[Requirement], metrics: Sequence[Metric]) -> Document:
    own = units_of(samples)
    there: Array = own & np.isfinite(np.stack([metric.values for metric in metrics])).all(axis=0)
    units = int(there.sum())
    if units < FEWEST:
        raise RequestError(f"{units} units are finished; at least {FEWEST} are needed")
    holds = np.stack([one.holds(metric) for one, metric in zip(requirements, metrics, strict=True)])[:, there]
    passes: Array = np.asarray(holds.all(axis=0))
    passed = int(passes.sum())
    low, high = wilson(passed, units)
    at = {dim: value for metric in metrics for dim, value in metric.at.items() if dim != "stage"}
    fails = [
        {
            "requirement": one.text,
            "stage": metric.at.get("stage"),
            "failed": float((~own_holds).mean()),
            "alone": float((~own_holds & np.delete(holds, number, axis=0).all(axis=0)).mean()),
            "at_risk": float(np.quantile(one.margin(metric)[there], 0.05)),
            "units": metric.units,
        }
        for number, (one, metric, own_holds) in enumerate(zip(requirements, metrics, holds, strict=True))
    ]
    spreads = [
        tightened(samples, factor, passes, there)
        for factor in samples.factors
        if factor.numeric and factor.distribution is not None and factor.distribution.shape != "choices"
    ]
    lacking = int(own.sum()) - units
    return {
        "at": at,
        "said": next((metric.said for metric in metrics if metric.said), "") if at else "",
        "units": units,
        "passed": passed,
        "yield": {"value": passed / units, "low": low, "high": high},
        "fails": sorted(fails, key=lambda one: -one["failed"]),
        "tighter": sorted(spreads, key=lambda one: -one["gain"]["value"]),
        "notes": [f"{lacking} units are not finished and are not counted"] if lacking else [],
    }


def weights_of(samples: Samples, factor: Factor, share: float = TIGHTER) -> Array:
    """Return the weight of each row for a smaller spread of one factor: its probability density with the smaller
    spread, divided by its present density. ``share``: the fraction by which the spread is reduced.
    """
    now = factor.distribution
    assert now is not None
    then = now.tightened(share)
    values = factor.values.astype(float)
    if now.levels:
        edges = now.edges()
        stratum = np.clip(np.searchsorted(edges, values) - 1, 0, now.levels - 1)
        mass = np.diff([then.share_below(edge) for edge in edges])
        return np.asarray(mass[stratum] * now.levels)
    density = np.array([now.density(value) for value in values.tolist()])
    other = np.array([then.density(value) for value in values.tolist()])
    weights = np.where(density > 0, other / np.where(density > 0, density, 1), 0.0)
    if samples.asked.correlated:
        weights = weights * _of_copula(samples, factor, then)
    return np.asarray(weights)


def _of_copula(samples: Samples, factor: Factor, then: Distribution) -> Array:
    """Return the ratio of the copula densities of correlated factors: with the new distribution of one factor over the
    present one.
    """
    keys = list(samples.asked.factors)
    scores = np.zeros((len(samples.numbers), len(keys)))
    for one in samples.factors:
        own = one.distribution
        if own is not None and own.shape != "choices":
            scores[:, keys.index(one.key)] = _scores(own, one)
    precision = np.linalg.inv(np.array(samples.asked.correlated)) - np.eye(len(keys))
    moved = scores.copy()
    at = keys.index(factor.key)
    moved[:, at] = _scores(then, factor)
    power = [np.einsum("ni,ij,nj->n", own, precision, own) for own in (scores, moved)]
    return np.asarray(np.exp(0.5 * (power[0] - power[1])))


def _scores(of: Distribution, factor: Factor) -> Array:
    """Return the values of a factor transformed to standard normal scores."""
    from scipy.special import ndtri

    shares = np.array([of.share_below(float(value)) for value in factor.values])
    return np.asarray(ndtri(np.clip(shares, 1e-12, 1 - 1e-12)))


def tightened(samples: Samples, factor: Factor, passes: Array, there: Array) -> Document:
    """Predict the yield with a smaller spread of one factor by giving other weights to the finished units. Return the
    gain in yield, its interval, and the number of equally weighted units that would be as accurate.
    """
    weights = weights_of(samples, factor)[there]
    mean = float(weights.mean())
    units, now = len(passes), float(passes.mean())
    if mean <= 0:
        nothing = {"value": 0.0, "low": -1.0, "high": 1.0}
        return {"factor": factor.name, "yield": now, "gain": nothing, "effective": 0.0}
    found = float((weights * passes).sum() / weights.sum())
    change = weights / mean * (passes - found) - (passes - now)
    half = QUANTILE * float(change.std(ddof=1)) / np.sqrt(units)
    gain = found - now
    return {
        "factor": factor.name,
        "yield": found,
        "gain": {"value": gain, "low": gain - half, "high": gain + half},
        "effective": float(weights.sum() ** 2 / (weights**2).sum()),
    }
