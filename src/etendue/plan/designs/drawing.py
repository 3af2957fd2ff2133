"""Draw the design of a pipeline: every factor becomes an axis whose values change together along the dim ``sample``.

In:  a pipeline with ``[design]``, the installed stages.
Out: the same pipeline with the factors in its sweep, in front of its own axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from decimal import Decimal
from typing import Any

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.contract.values.quantities import Quantity
from etendue.errors import Fault, PluginError
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.pipeline.zipped import SAMPLE, Zip, distinct
from etendue.plan.designs.asked import Asked, asked_of, factors_of
from etendue.plan.designs.distributions import Distribution, choices_of, distribution_of
from etendue.plan.designs.points import unit_points
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.types.arrays import Array
from etendue.types.documents import Document


def with_design(pipeline: PipelineFile, registry: Registry) -> PipelineFile:
    """Return the pipeline with its design drawn; faults of the design are added to the pipeline's faults."""
    if not pipeline.design:
        return pipeline
    faults: list[Fault] = []
    asked = asked_of(pipeline, faults)
    own = {key: one for key, one in pipeline.zipped.items() if one.dim != SAMPLE}
    sweep = {key: value for key, value in pipeline.sweep.items() if key in own or key not in pipeline.zipped}
    drawn, zipped = dict[str, Any](), dict[str, Zip]()
    if asked is not None:
        asked = _in_units(asked, pipeline, registry)
        drawn, zipped = _drawn(asked, distributions(asked, pipeline, registry, faults))
    rows = {SAMPLE: asked.chosen} if asked is not None else {}
    new = [fault for fault in faults if fault not in pipeline.faults]
    return replace(
        pipeline,
        shared={**compared_of(pipeline, registry), **pipeline.shared},
        sweep={**drawn, **sweep},
        zipped={**zipped, **own},
        rows={**pipeline.rows, **rows},
        faults=(*pipeline.faults, *new),
    )


def compared_of(pipeline: PipelineFile, registry: Registry) -> Document:
    """Return the shared quantities that a design for Sobol' indices sets, unless the pipeline sets them, so that two
    rows differ only by their factors.
    """
    if pipeline.design.get("method") != "saltelli":
        return {}
    given = {*pipeline.shared, *pipeline.named, *pipeline.sweep, *factors_of(pipeline.design, pipeline)}
    found: Document = {}
    for kind in _kinds(pipeline.stages, pipeline, registry):
        for name, (parameter, *_) in parameters_of(kind).items():
            if isinstance(parameter, Quantity) and parameter.compared and name not in given:
                found[name] = parameter.compared
    return found


def _in_units(asked: Asked, pipeline: PipelineFile, registry: Registry) -> Asked:
    """Return a list with its numbers in the units of their parameters, so that 4 um and 4000 nm count as the same
    value.
    """
    found: Document = {}
    for key, values in asked.factors.items() if asked.method == "list" else ():
        parameter, kind = _parameter(key, pipeline, registry) or (Parameter(), str)
        try:
            numbers = [resolve(value, parameter, kind, pipeline.folder) for value in values if kind in (int, float)]
        except Unfit:
            numbers = []  # reported with the axis
        found[key] = [Decimal(f"{number:.12g}") for number in numbers] or values
    return replace(asked, factors=found) if found else asked


def distributions(
    asked: Asked, pipeline: PipelineFile, registry: Registry, faults: list[Fault]
) -> dict[str, Distribution]:
    """Return the distribution of every factor, except for lists and faulty factors."""
    found: dict[str, Distribution] = {}
    for key, written in asked.factors.items() if asked.method != "list" else ():
        parameter, kind = _parameter(key, pipeline, registry) or (Parameter(), float)
        try:
            found[key] = distribution_of(written, parameter, kind, pipeline.folder)
        except Unfit as error:
            faults.append(Fault(f"design.factors.{key}", str(error)))
    return found


def _drawn(asked: Asked, found: dict[str, Distribution]) -> tuple[Document, dict[str, Zip]]:
    """Return the distinct values of every factor, and for each row the index of its value."""
    values, zipped = dict[str, Any](), dict[str, Zip]()
    if asked.method == "list":
        for key, written in asked.factors.items():
            values[key], at = distinct(written)
            zipped[key] = Zip(SAMPLE, at, True)
        return values, zipped
    if len(found) < len(asked.factors):  # faults are reported; the axes exist, so that nothing else is
        return values, zipped
    shares = shares_of(asked)
    for column, (key, one) in enumerate(found.items()):
        drawn = [one.quantile(share) for share in shares[:, column].tolist()]
        if one.shape == "choices":
            places, at = distinct([int(place) for place in drawn])
            values[key] = [choices_of(asked.factors[key])[place] for place in places]
        else:
            values[key], at = distinct([Decimal(f"{value:.12g}") for value in drawn])
        mixed = asked.method == "saltelli"  # every value is in several rows
        zipped[key] = Zip(SAMPLE, at, mixed or bool(one.most), 0 if mixed else one.most)
    return values, zipped


def shares_of(asked: Asked) -> Array:
    """Return the cumulative probability, 0 to 1, at which each factor is drawn in each row, (row, factor)."""
    return unit_points(asked.method, asked.drawn, len(asked.factors), asked.seed, asked.correlated)


def _parameter(key: str, pipeline: PipelineFile, registry: Registry) -> tuple[Parameter, Any] | None:
    """Return the parameter that a factor sets, and its type; None if the factor is unknown or is not a parameter."""
    stage, dot, name = key.partition(".")
    entries = [entry for entry in pipeline.stages if not dot or entry.name == stage]
    for kind in _kinds(entries, pipeline, registry):
        found = parameters_of(kind).get(name or key)
        if found is not None and found[0].shared != bool(dot):
            return found[0], found[1]
    return None


def _kinds(entries: Iterable[StageEntry], pipeline: PipelineFile, registry: Registry) -> Iterable[Any]:
    for entry in entries:
        swapped = pipeline.sweep.get(f"{entry.name}.use", ())
        others = [str(one.get("use")) if isinstance(one, dict) else str(one) for one in swapped]
        for use in (entry.use, *others):
            try:
                if use in registry:
                    yield registry.load(use)
            except PluginError:
                continue  # a fault that the graph reports
