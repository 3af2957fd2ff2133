"""The request of a search, as written: goals, limits and ranges.

In:  ``mean_snr``, ``mtf50[mean]``, ``pixel_pitch <= 3``, ``f_number=1.4:8``, ``demosaic.use=a,b``.
Out: values with the units and types that the stages declare; one ``RequestError`` with all faults.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from etendue.builder.pipeline import number as number_of
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.contract.values.tables import tables
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.file import PipelineFile
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.types.documents import Document, DocumentView

PICKS: Mapping[str, Any] = {"mean": np.mean, "min": np.min, "max": np.max}
_METRIC = re.compile(r"([A-Za-z_][\w.]*)(?:\[(-?\d+|mean|min|max)\])?")
_LIMIT = re.compile(r"(.+?)\s*(<=|>=)\s*(.+)")


@dataclass(frozen=True)
class Metric:
    """A variable that gives one number; ``pick`` selects the number if the variable has several values."""

    name: str
    pick: str = ""

    def __str__(self) -> str:
        return f"{self.name}[{self.pick}]" if self.pick else self.name

    def of(self, record: DocumentView) -> float:
        """Return the value of this metric from a record of variables."""
        values = np.ravel(record[self.name])
        if self.pick in PICKS:
            return float(PICKS[self.pick](values))
        if self.pick and -values.size <= int(self.pick) < values.size:
            return float(values[int(self.pick)])
        if self.pick or values.size != 1:
            raise RequestError(
                [
                    Fault(
                        str(self),
                        f"{self.name} has {values.size} values; name one of them, {self.name}[0] to "
                        f"{self.name}[{values.size - 1}], or {self.name}[mean], [min] or [max]; if these are the "
                        f"points of a sweep, search its axes (--over) or fix them (--set)",
                    )
                ]
            )
        return float(values[0])


@dataclass(frozen=True)
class Goal:
    """A metric to make small, or large."""

    metric: Metric
    largest: bool = False

    def better(self, one: float, other: float) -> bool:
        return one > other if self.largest else one < other


@dataclass(frozen=True)
class Limit:
    """A metric that must be at most, or at least, a bound."""

    metric: Metric
    most: bool
    bound: float

    def __str__(self) -> str:
        return f"{self.metric} {'<=' if self.most else '>='} {self.bound:g}"

    def excess(self, value: float) -> float:
        """Return the excess of a value over the bound, relative to the bound; 0 or less if the limit is met."""
        over = value - self.bound if self.most else self.bound - value
        return over / (abs(self.bound) or 1.0)


@dataclass(frozen=True)
class Range:
    """The allowed values of a setting: numbers between two ends, or a list of choices."""

    key: str
    low: float = 0.0
    high: float = 0.0
    logarithmic: bool = False
    whole: bool = False
    choices: tuple[Any, ...] = ()
    unit: str = ""

    def __str__(self) -> str:
        if self.choices:
            return f"{self.key} = {', '.join(map(str, self.choices))}"
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        return f"{self.key} = {self.low:g} to {self.high:g}{unit}{', logarithmic' if self.logarithmic else ''}"


@dataclass(frozen=True)
class Asked:
    """A search: its goals, its limits, and the settings that it varies."""

    goals: tuple[Goal, ...]
    limits: tuple[Limit, ...]
    ranges: tuple[Range, ...]
    seed: int = 0
    sampler: str = "model"
    notes: tuple[str, ...] = ()

    @property
    def metrics(self) -> list[str]:
        """The variables that every evaluation needs."""
        every = [*(goal.metric for goal in self.goals), *(limit.metric for limit in self.limits)]
        return list(dict.fromkeys(metric.name for metric in every))

    def document(self) -> Document:
        return {
            "minimise": [str(one.metric) for one in self.goals if not one.largest],
            "maximise": [str(one.metric) for one in self.goals if one.largest],
            "subject": [str(one) for one in self.limits],
            "over": [str(one) for one in self.ranges],
            "seed": self.seed,
            "sampler": self.sampler,
        }


class _Reader:
    """Reads the texts of a request, and gathers its faults."""

    def __init__(self, pipeline: PipelineFile, registry: Registry) -> None:
        self.pipeline, self.faults, self.notes = pipeline, list[Fault](), list[str]()
        self.shared: dict[str, tuple[Parameter, Any]] = {}
        self.own: dict[str, tuple[Parameter, Any]] = {}
        for entry in pipeline.stages:
            kind = registry.load(entry.use) if entry.use in registry else None
            for name, (parameter, type_, _) in (parameters_of(kind) if kind else {}).items():
                (self.shared if parameter.shared else self.own).setdefault(
                    name if parameter.shared else f"{entry.name}.{name}", (parameter, type_)
                )

    def known(self, key: str) -> tuple[str, tuple[Parameter, Any] | None]:
        """Return the name of a parameter as an override uses it, and its declaration; the declaration is None if no
        stage has the parameter.
        """
        head, _, tail = key.partition(".")
        name = tail if tail and head in tables() and key not in self.own else key
        return name, self.shared.get(name) or self.own.get(name)

    def metric(self, place: str, text: str) -> Metric | None:
        found = _METRIC.fullmatch(text.strip())
        if found is None:
            self.faults.append(
                Fault(place, f"expected the name of a metric, such as mean_snr or mtf50[0], got {text!r}")
            )
            return None
        return Metric(found[1], found[2] or "")

    def range(self, text: str) -> Range | None:
        key, mark, rest = (part.strip() for part in text.partition("="))
        if not mark or not rest:
            self.faults.append(Fault(f"--over {text}", "expected NAME=LOW:HIGH, NAME=LOW:HIGH:log or NAME=A,B"))
            return None
        name, declared = self.known(key)
        stages = [entry.name for entry in self.pipeline.stages]
        if declared is None and not (name.endswith(".use") and name.partition(".")[0] in stages):
            known = [*self.shared, *self.own, *(f"{stage}.use" for stage in stages)]
            self.faults.append(
                Fault(f"--over {key}", f"no stage of this pipeline has this parameter{nearest(key, known)}")
            )
            return None
        if ":" not in rest:
            return Range(name, choices=tuple(part.strip() for part in rest.split(",")))
        if declared is None or declared[1] not in (int, float):
            self.faults.append(Fault(f"--over {key}", "is not a number: give choices, NAME=A,B"))
            return None
        return self.between(name, text, [part.strip() for part in rest.split(":")], declared)

    def between(self, name: str, text: str, parts: list[str], declared: tuple[Parameter, Any]) -> Range | None:
        """Return the range between two ends; ``parts``: the ends, and ``log`` or ``linear`` if given."""
        if len(parts) not in (2, 3) or parts[2:] not in ([], ["log"], ["linear"]):
            self.faults.append(Fault(f"--over {text}", "expected NAME=LOW:HIGH or NAME=LOW:HIGH:log"))
            return None
        key = text.partition("=")[0].strip()
        low, high = (self.value(f"--over {key}", part, declared) for part in parts[:2])
        if low is None or high is None:
            return None
        logarithmic = parts[2:] == ["log"]
        if not low < high or (logarithmic and low <= 0):
            self.faults.append(Fault(f"--over {text}", "expected two ends, the lower end first; for log both above 0"))
            return None
        return Range(name, low, high, logarithmic, declared[1] is int, unit=declared[0].units)

    def value(self, place: str, text: str, declared: tuple[Parameter, Any]) -> float | None:
        try:
            return float(resolve(number_of(text), declared[0], declared[1], self.pipeline.folder))
        except Unfit as error:
            self.faults.append(Fault(place, str(error)))
            return None

    def limit(self, text: str, ranges: dict[str, Range]) -> Limit | None:
        """Return a limit on a metric. A limit on a setting narrows the range of the setting instead, so that no value
        beyond the limit is computed.
        """
        place, found = f"--subject {text}", _LIMIT.fullmatch(text.strip())
        if found is None:
            self.faults.append(Fault(place, "expected METRIC <= NUMBER or METRIC >= NUMBER"))
            return None
        name, declared = self.known(found[1])
        if declared is not None:
            bound = self.value(place, found[3], declared)
            if bound is not None:
                self.narrow(place, name, found[2] == "<=", bound, ranges)
            return None
        metric, number = self.metric(place, found[1]), number_of(found[3])
        if not isinstance(number, int | float):
            self.faults.append(Fault(place, f"expected a number in the metric's unit, got {found[3]!r}"))
            return None
        return None if metric is None else Limit(metric, found[2] == "<=", float(number))

    def narrow(self, place: str, name: str, most: bool, bound: float, ranges: dict[str, Range]) -> None:
        own = ranges.get(name)
        if own is None or own.choices:
            self.faults.append(Fault(place, f"{name} is not searched between two ends: add --over {name}=LOW:HIGH"))
            return
        low, high = (own.low, min(own.high, bound)) if most else (max(own.low, bound), own.high)
        if own.whole:
            low, high = math.ceil(low), math.floor(high)
        if low > high:
            self.faults.append(Fault(place, f"cannot be met: {own}"))
        elif (low, high) != (own.low, own.high):
            ranges[name] = replace(own, low=low, high=high)
            self.notes.append(
                f"{place.removeprefix('--subject ')}: {ranges[name]}; no value beyond the limit is computed"
            )


def read_request(
    pipeline: PipelineFile,
    registry: Registry,
    minimise: Iterable[str] = (),
    maximise: Iterable[str] = (),
    subject: Iterable[str] = (),
    over: Iterable[str] = (),
) -> Asked:
    """Return the request of a search.

    Raises
    ------
    RequestError
        The texts have faults; the message lists every fault.
    """
    reader = _Reader(pipeline, registry)
    goals = [(reader.metric(f"--minimise {text}", text), False) for text in minimise]
    goals += [(reader.metric(f"--maximise {text}", text), True) for text in maximise]
    ranges = {one.key: one for text in over if (one := reader.range(text)) is not None}
    limits = [reader.limit(text, ranges) for text in subject]
    if not goals:
        reader.faults.append(Fault("--minimise", "name at least one metric to minimise or maximise"))
    if not ranges and not reader.faults:
        reader.faults.append(Fault("--over", "name at least one setting to search over, such as f_number=1.4:8"))
    if reader.faults:
        raise RequestError(reader.faults, pipeline.file)
    return Asked(
        tuple(Goal(metric, largest) for metric, largest in goals if metric is not None),
        tuple(one for one in limits if one is not None),
        tuple(ranges.values()),
        notes=tuple(reader.notes),
    )


def read_ranges(pipeline: PipelineFile, registry: Registry, over: Iterable[str]) -> tuple[Range, ...]:
    """Return ranges of settings.

    Raises
    ------
    RequestError
        The texts have faults; the message lists every fault.
    """
    reader = _Reader(pipeline, registry)
    ranges = [reader.range(text) for text in ([over] if isinstance(over, str) else over)]
    if reader.faults:
        raise RequestError(reader.faults, pipeline.file)
    return tuple(one for one in ranges if one is not None)
