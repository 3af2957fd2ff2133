"""The samples of a design that an archive holds: the factors of every row, and the metrics of finished rows.

In:  the folder of an archive, or its tree.
Out: ``Samples``.
"""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from etendue.archive.records.rerun import recorded
from etendue.contract.registry import Registry, installed_stages
from etendue.contract.stage import parameters_of
from etendue.errors import RequestError
from etendue.pipeline.derived import with_rows
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.zipped import SAMPLE
from etendue.plan.designs.asked import Asked, asked_of
from etendue.plan.designs.distributions import Distribution
from etendue.plan.designs.drawing import distributions
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import places_text
from etendue.present.plots.opening import opened
from etendue.present.plots.places import resolved
from etendue.types.arrays import Array
from etendue.types.documents import AxisValues, Document, DocumentView

METRICS = ("figures", "resolution")  # roles of stages that light does not pass
DRAWS = "noise"  # the quantity that chooses draws: a factor of its own, with that name as its subject
MOST_PLACES = 64  # combinations of the other axes


@dataclass(frozen=True)
class Factor:
    """A factor of a design with its value in every row."""

    name: str
    key: str
    units: str
    values: Array
    distribution: Distribution | None = None  # None: of a list
    subject: str = ""  # role of the first stage that has the factor as a parameter

    @property
    def numeric(self) -> bool:
        return self.values.dtype.kind in "fiu"

    @property
    def codes(self) -> Array:
        """The values as numbers. A name is replaced by its position in the sorted list of names."""
        if self.numeric:
            return self.values.astype(float)
        return np.unique(self.values, return_inverse=True)[1].astype(float)


@dataclass(frozen=True)
class Metric:
    """A metric in every row, at one value of every other axis; NaN in rows that are not finished."""

    name: str
    title: str
    units: str
    at: AxisValues
    said: str  # the values in ``at`` as text; '' without other axes
    values: Array


@dataclass(frozen=True)
class Samples:
    """The rows of a design."""

    pipeline: str
    numbers: tuple[int, ...]  # of the rows, from 0
    factors: tuple[Factor, ...]
    asked: Asked
    holdings: Holdings = field(repr=False)
    record: DocumentView = field(default_factory=dict, repr=False)

    @property
    def method(self) -> str:
        return self.asked.method

    def metrics(self, name: str, at: AxisValues | None = None) -> list[Metric]:
        """Return a metric at every combination of the other axes, or at the requested combinations.

        Raises
        ------
        RequestError
            The metric does not exist, does not depend on the design, or has too many combinations.
        """
        held = self.holdings.find(name, "figure")
        if SAMPLE not in held.axes:
            raise RequestError(f"{held.name} is the same in every sample: no factor of the design affects it")
        place = resolved([held], at or {})
        for dim in held.dims:
            if dim not in place and dim != "stage":
                names = held.values_of(dim)
                raise RequestError(f"{held.name} has the dim {dim}: choose one with --at {dim}={names[0]}")
            place.setdefault(dim, held.values_of(dim)[-1])
        others = [dim for dim in held.axes if dim != SAMPLE and dim not in place]
        each = [held.values_of(dim) for dim in others]
        if int(np.prod([len(own) for own in each])) > MOST_PLACES:
            raise RequestError(f"{held.name} has too many combinations of {', '.join(others)}: choose some with --at")
        return [
            self._metric(held, {**place, **dict(zip(others, own, strict=True))}) for own in itertools.product(*each)
        ]

    def _metric(self, held: HeldVariable, place: Document) -> Metric:
        axes = {dim: value for dim, value in place.items() if dim in held.axes}
        found = held.values(axes).sel({dim: value for dim, value in place.items() if dim in held.dims})
        where = {int(n): float(v) for n, v in zip(found[SAMPLE].values, np.ravel(found.values), strict=True)}
        values = np.array([where.get(number, np.nan) for number in self.numbers])
        said = places_text(dict(place), {dim: held.units_of(dim) for dim in place}) if place else ""
        return Metric(held.name, held.title, held.units, place, said, values)

    def draws(self, metric: Metric) -> list[str]:
        """Return the stages whose noise differs from row to row and affects a metric; [] if noise is a factor."""
        if DRAWS in self.asked.factors:
            return []
        behind = self.behind(metric)
        return [n for n, own in behind.items() if own["seed"] is not None and own["shown"].get(DRAWS) != "common"]

    def behind(self, metric: Metric) -> Document:
        """Return the records of the stages from which a metric is computed, by name."""
        nodes, found = self.record.get("nodes", {}), dict[str, Any]()
        open_ = [metric.name.partition(".")[0]]
        while open_:
            name = open_.pop()
            if name in nodes and name not in found:
                found[name] = nodes[name]
                open_ += nodes[name]["inputs"]
        return found


def samples_of(folder: Path, name: str = "") -> Samples:
    """Return the samples of an archive; ``name``: the name of the archive in messages.

    Raises
    ------
    RequestError
        The archive has a grid, not a design.
    """
    run = recorded(folder)
    pipeline = run.pipeline()
    name = shlex.quote(name or str(folder))
    if not pipeline.design:
        raise RequestError(f"{name} holds a grid, not a design; run its pipeline with [design], or with --design")
    holdings = Holdings(opened(folder), name)
    held = [one for one in holdings if SAMPLE in one.axes]
    numbers = tuple(sorted({int(row) for one in held for row in one.values_of(SAMPLE)}))
    if not numbers:
        raise RequestError(f"{name} holds no variable that a factor of its design affects")
    faults: list[Any] = []
    asked = asked_of(with_rows(pipeline, SAMPLE, numbers) if max(numbers) else pipeline, faults)
    if asked is None:
        raise RequestError(faults)
    of = distributions(asked, pipeline, installed_stages(), faults)
    found = [one for key in asked.factors if (one := _factor(key, held, numbers, of.get(key))) is not None]
    factors = [replace(one, subject=subject_of(one.key, pipeline, installed_stages())) for one in found]
    return Samples(holdings.pipeline, numbers, tuple(factors), asked, holdings, run.record)


def subject_of(key: str, pipeline: PipelineFile, registry: Registry) -> str:
    """Return the subject of a factor: the role of the first stage of the pipeline that has the factor as a parameter.
    Stages that compute metrics count only if there is no other such stage.
    """
    if key == DRAWS:
        return DRAWS
    stage, dot, name = key.partition(".")
    found = []
    for entry in pipeline.stages:
        if entry.use in registry and (entry.name == stage or not dot):
            kind = registry.load(entry.use)
            if name == "use" or (name or key) in parameters_of(kind):
                found.append(kind.role or entry.name)
    return next((role for role in found if role not in METRICS), (found or [""])[0])


def _factor(key: str, held: Sequence[HeldVariable], numbers: tuple[int, ...], of: Distribution | None) -> Factor | None:
    """Return a factor from the coordinates of the variables that depend on it; None if no variable depends on it."""
    where: dict[int, Any] = {}
    found: xarray.DataArray | None = None
    for coordinate in _coordinates(key, held):
        found = coordinate
        where.update(zip(map(int, coordinate[SAMPLE].values), coordinate.values.tolist(), strict=True))
        if len(where) == len(numbers):
            break
    if found is None:
        return None
    values = [where.get(number) for number in numbers]
    names = any(isinstance(value, str) for value in values)
    array = np.array(["" if v is None else str(v) for v in values] if names else values)
    return Factor(str(found.name), key, str(found.attrs.get("units", "1")), array, of)


def _coordinates(key: str, held: Sequence[HeldVariable]) -> Iterator[xarray.DataArray]:
    for one in held:
        for group in one.groups:
            for coordinate in group.coords.values():
                if coordinate.attrs.get("parameter") == key and coordinate.dims == (SAMPLE,):
                    yield coordinate


def by_place(samples: Samples, names: Sequence[str], at: AxisValues) -> list[list[Metric]]:
    """Return the values of several metrics at every combination of the other axes that affect at least one of them."""
    every = [samples.metrics(name, _own(samples, name, at)) for name in names]
    axes: dict[str, dict[Any, None]] = {}
    for some in every:
        for metric in some:
            for dim, value in metric.at.items():
                if dim in samples.holdings.find(metric.name).axes:
                    axes.setdefault(dim, {})[value] = None
    found = []
    for values in itertools.product(*axes.values()):
        place = dict(zip(axes, values, strict=True))
        found.append([_at(some, place) for some in every])
    return found


def _own(samples: Samples, name: str, at: AxisValues) -> Document:
    """Return the requested axis values, without those of axes that a metric does not have."""
    held = samples.holdings.find(name, "figure")
    words = {word: value for word, value in at.items() if _has(held, word)}
    return words


def _has(held: HeldVariable, word: str) -> bool:
    return any(word in (dim, held.key_of(dim)) for dim in (*held.axes, *held.dims))


def _at(some: Sequence[Metric], place: Mapping[str, Any]) -> Metric:
    return next(m for m in some if all(m.at.get(dim, value) == value for dim, value in place.items()))
