"""The distribution of one factor of a design: ``{ from, to, spacing }``, ``{ normal = [mean, deviation], at_least }``,
``{ uniform = [from, to] }``, ``{ triangular = [from, mode, to] }``, or a list of choices in equal shares.

In:  the factor as written in the file, and its parameter.
Out: ``Distribution``, which gives quantiles and densities; ``Unfit`` for anything else.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

from etendue.contract.values.parameter import Parameter
from etendue.contract.values.units import as_written
from etendue.errors import nearest
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.types.documents import DocumentView

SHAPES = {"normal": 2, "uniform": 2, "triangular": 3}  # and how many numbers each has
KEYS = (*SHAPES, "from", "to", "spacing", "at_least", "at_most", "levels")
MOST_LEVELS = 10_000
NORMAL = NormalDist()
TINY = 2.0**-53  # a share of 0 has no quantile
SAME = 1e-11  # values are rounded to 12 digits
OUTWARD = 1 / 24  # of a stratum: removes the second-order error of the mean over levels (Euler-Maclaurin)


@dataclass(frozen=True)
class Distribution:
    """Probability distribution of a number, or of the positions in a list of choices."""

    shape: str  # normal, uniform, log, triangular or choices
    numbers: tuple[float, ...]  # in the unit of the parameter; of choices: how many there are
    low: float = -math.inf  # truncated below and above
    high: float = math.inf
    levels: int = 0  # how many values are used, each in a stratum of equal probability; 0: all
    whole: bool = False  # only whole numbers

    @property
    def most(self) -> int:
        """The maximum number of distinct values; 0: unlimited."""
        if self.shape == "choices":
            return int(self.numbers[0])
        if self.whole and self.shape != "normal":
            span = int(self.numbers[-1]) - int(self.numbers[0]) + 1
            return min(span, self.levels) if self.levels else span
        return self.levels

    @property
    def centre(self) -> float:
        """The value about which the spread of the factor is reduced."""
        if self.shape == "normal":
            return self.numbers[0]
        if self.shape == "triangular":
            return self.numbers[1]
        first, last = self.numbers
        return math.sqrt(first * last) if self.shape == "log" else (first + last) / 2

    def tightened(self, share: float) -> Distribution:
        """Return the distribution with its spread about the centre reduced by the fraction ``share``."""
        keep, centre = 1 - share, self.centre
        if self.shape == "normal":
            return replace(self, numbers=(centre, keep * self.numbers[1]))
        if self.shape == "log":
            return replace(self, numbers=tuple(centre * (x / centre) ** keep for x in self.numbers))
        return replace(self, numbers=tuple(centre + keep * (x - centre) for x in self.numbers))

    def quantile(self, share: float) -> float:
        """Return the quantile at the cumulative probability ``share``; for choices: the position in the list."""
        if self.shape == "choices":
            return float(min(int(share * self.numbers[0]), int(self.numbers[0]) - 1))
        if self.levels:
            share = level_share(share, self.levels)
        low, high = self._below(self.low), self._below(self.high)
        found = min(max(self.at(low + share * (high - low)), self.low), self.high)
        return float(round(found)) if self.whole else found

    def share_below(self, value: float) -> float:
        """Return the share of the probability below a value."""
        low, high = self._below(self.low), self._below(self.high)
        return min(max((self._below(value) - low) / (high - low), 0.0), 1.0)

    def edges(self) -> list[float]:
        """Return the edges of the strata of equal probability, one per level; the outermost edges are infinite."""
        low, high = self._below(self.low), self._below(self.high)
        inner = [self.at(low + step / self.levels * (high - low)) for step in range(1, self.levels)]
        return [-math.inf, *inner, math.inf]

    def density(self, value: float) -> float:
        """Return the probability per unit of value."""
        first, *_, last = self.numbers
        if not self.low <= value <= self.high:
            return 0.0
        room = self._below(self.high) - self._below(self.low)
        if self.shape == "normal":
            return NORMAL.pdf((value - first) / last) / last / room
        if not first - SAME * abs(first) <= value <= last + SAME * abs(last):
            return 0.0
        if self.shape == "log":
            return 1 / (value * math.log(last / first)) / room
        if self.shape == "uniform":
            return 1 / (last - first) / room
        mode, width = self.numbers[1], last - first
        rising = (value - first) / (mode - first) if value < mode else (last - value) / (last - mode or 1.0)
        return max(rising, 0.0) * 2 / width / room

    def at(self, share: float) -> float:
        """Return the quantile of the untruncated distribution at the cumulative probability ``share``."""
        first, *_, last = self.numbers
        if self.shape == "normal":
            return first + last * NORMAL.inv_cdf(min(max(share, TINY), 1 - TINY))
        if self.shape == "log":
            return float(first * (last / first) ** share)
        if self.shape == "uniform":
            return first + (last - first) * share
        mode, width = self.numbers[1], last - first
        if share * width <= mode - first:
            return first + math.sqrt(share * width * (mode - first))
        return last - math.sqrt((1 - share) * width * (last - mode))

    def _below(self, value: float) -> float:
        """Return the cumulative probability of the untruncated distribution at a value."""
        if self.shape == "choices" or math.isinf(value):
            return float(value > 0)
        first, *_, last = self.numbers
        if self.shape == "normal":
            return NORMAL.cdf((value - first) / last)
        value = min(max(value, first), last)
        if self.shape == "log":
            return math.log(value / first) / math.log(last / first)
        if self.shape == "uniform":
            return (value - first) / (last - first)
        mode, width = self.numbers[1], last - first
        if value <= mode:
            return (value - first) ** 2 / (width * (mode - first)) if value > first else 0.0
        return 1 - (last - value) ** 2 / (width * (last - mode)) if value < last else 1.0


def level_share(share: float, levels: int) -> float:
    """Return the share that replaces ``share``: the middle of its stratum, moved a little outward in the first and the
    last stratum.

    The mean of f over the middles of n strata has the error (f'(0) - f'(1)) / (24 n^2). If the outer two are moved by
    1/(24 n), the error is -23 (f''(0) + f''(1)) / (1152 n^3).
    """
    stratum = min(math.floor(share * levels), levels - 1)
    return (stratum + 0.5 + OUTWARD * ((stratum == levels - 1) - (stratum == 0))) / levels


def distribution_of(written: Any, parameter: Parameter, kind: Any, folder: Path) -> Distribution:
    """Return the distribution that a file gives for a factor.

    Raises
    ------
    Unfit
        The text is not a distribution, or has values that the parameter cannot have.
    """
    if isinstance(written, list | tuple):
        if not written:
            raise Unfit("expected at least one choice, got []")
        return Distribution("choices", (len(written),))
    if parameter.numbered:
        return Distribution("choices", (len(choices_of(written)),))
    if not isinstance(written, Mapping):
        raise Unfit(f"expected a list of choices, or a table such as {{ from, to }}, got {as_written(written)}")
    for name in written:
        if name not in KEYS:
            raise Unfit(f"unknown key {name!r}{nearest(name, KEYS)}")
    if kind not in (int, float):
        raise Unfit("expected a list of choices, because the values are not numbers")
    found = _shaped(written, parameter, folder)
    levels = written.get("levels", 0)
    if isinstance(levels, bool) or not isinstance(levels, int) or not 0 <= levels <= MOST_LEVELS:
        raise Unfit(f"levels: expected a whole number from 1 to {MOST_LEVELS}, got {as_written(levels)}")
    ends = {"at_least": -math.inf, "at_most": math.inf}
    ends |= {name: _number(written[name], parameter, folder) for name in ends if name in written}
    found = replace(found, low=ends["at_least"], high=ends["at_most"], levels=levels, whole=kind is int)
    if found._below(found.high) - found._below(found.low) < 1e-9:
        raise Unfit("the probability of a value between at_least and at_most is 0")
    _check_ends(found, parameter)
    return found


def choices_of(written: Any) -> Sequence[Any]:
    """Return the choices of a factor in equal shares: those listed, or all whole numbers ``{ from, to }``."""
    if isinstance(written, list | tuple):
        return written
    if isinstance(written, Mapping) and set(written) == {"from", "to"}:
        first, last = written["from"], written["to"]
        if type(first) is int and type(last) is int and 0 <= first < last:
            return range(first, last + 1)
    raise Unfit(f"expected a list of choices, or two whole numbers {{ from, to }}, got {as_written(written)}")


def _shaped(written: DocumentView, parameter: Parameter, folder: Path) -> Distribution:
    shapes = [name for name in ("from", *SHAPES) if name in written]
    if len(shapes) != 1:
        raise Unfit(f"expected one of {{ from, to }}, {', '.join(SHAPES)}, got {as_written(dict(written))}")
    name = shapes[0]
    spacing = written.get("spacing", "linear")
    if spacing not in ("linear", "log") or ("spacing" in written and name != "from"):
        raise Unfit("spacing: expected 'linear' or 'log', beside { from, to }")
    values = [written["from"], written.get("to")] if name == "from" else written[name]
    count = SHAPES.get(name, 2)
    if not isinstance(values, list | tuple) or len(values) != count or None in values:
        raise Unfit(f"{name}: expected {count} numbers, got {as_written(written.get(name))}")
    numbers = tuple(_number(value, parameter, folder) for value in values)
    if name == "normal":
        if not numbers[1] > 0:
            raise Unfit("normal: expected [mean, deviation] with a deviation above 0; a fixed value is not a factor")
        return Distribution(name, numbers)
    if not numbers[0] < numbers[-1] or list(numbers) != sorted(numbers):
        raise Unfit(f"{name}: expected ascending numbers, got {as_written(list(values))}")
    if spacing == "log" and numbers[0] <= 0:
        raise Unfit(f"spacing 'log' requires both ends above 0, got {numbers[0]:g} to {numbers[1]:g}")
    return Distribution("log" if spacing == "log" else "uniform" if name == "from" else name, numbers)


def _number(value: Any, parameter: Parameter, folder: Path) -> float:
    """Return a number in the unit of a parameter; it may be outside the range of the parameter, because a deviation is
    not a value of the parameter.
    """
    free = replace(parameter, above=None, at_least=None, below=None, at_most=None, held=None)
    return float(resolve(value, free, float, folder))


def _check_ends(found: Distribution, parameter: Parameter) -> None:
    """Refuse a distribution whose draws reach values that the parameter cannot have."""
    first, last = (found.at(0.0), found.at(1.0)) if found.shape == "normal" else (found.numbers[0], found.numbers[-1])
    ends = {"at_least": max(found.low, first), "at_most": min(found.high, last)}
    beyond = [
        name
        for name, value in ends.items()
        if not parameter.allows(value) and not (name == "at_least" and parameter.above == value)
    ]
    if beyond:
        remedy = f"; give {' and '.join(beyond)}" if found.shape == "normal" else ""
        raise Unfit(f"extends to values outside the allowed range ({parameter.range_text()}){remedy}")
