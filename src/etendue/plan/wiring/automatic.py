"""Parameters that a pipeline leaves open (``spacing = "auto"``). Each is given one number for the whole pipeline.

In:  a pipeline as written, the registry.
Out: the parameters that are left open; the pipeline with the numbers that their stages choose.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from etendue.contract.discretised import AUTO, Discretised
from etendue.contract.registry import Registry
from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.errors import PluginError, RequestError
from etendue.pipeline.derived import with_values
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.pipeline.presets import preset_at
from etendue.plan.wiring.parameters import Unfit, axis_values, resolve
from etendue.types.documents import Document, DocumentView

Open = Mapping[str, Mapping[str, str]]  # by stage and parameter, its discretisation


def left_open(pipeline: PipelineFile, registry: Registry) -> Open:
    """Return the parameters that a pipeline leaves open."""
    found: dict[str, dict[str, str]] = {}
    for entry in pipeline.stages:
        open_ = any(isinstance(value, str) and value == AUTO for value in entry.values.values())
        kind = _kind(entry, registry) if open_ else None
        if kind is not None and issubclass(kind, Discretised):
            written = {name: entry.values.get(name) for name in kind.automatic}
            own = {n: of for n, of in kind.automatic.items() if isinstance(written[n], str) and written[n] == AUTO}
            if own:
                found[entry.name] = own
    return found


def settled(pipeline: PipelineFile, registry: Registry) -> tuple[PipelineFile, list[str]]:
    """Return the pipeline with a number for every value that it leaves open, and a note on each."""
    open_ = left_open(pipeline, registry)
    notes: list[str] = []
    shared = _shared_values(pipeline, registry) if open_ else {}
    for entry in pipeline.stages:
        own = open_.get(entry.name, {})
        kind = _kind(entry, registry) if own else None
        if kind is None or not issubclass(kind, Discretised):
            continue
        declared = parameters_of(kind)
        known = dict(_known(entry, declared, pipeline))
        for name in own:
            known[name] = value = kind.chosen(name, {k: v for k, v in known.items() if k not in own}, shared)
            unit = declared[name][0].units
            notes.append(f"{entry.name}.{name}: {value:.6g}{'' if unit == '1' else f' {unit}'}, chosen automatically")
        pipeline = with_values(pipeline, entry.name, {name: known[name] for name in own})
    return pipeline, notes


def _kind(entry: StageEntry, registry: Registry) -> type[Stage] | None:
    try:
        return registry.load(entry.use) if entry.use in registry else None
    except PluginError:
        return None  # the graph reports this fault


def _known(entry: StageEntry, declared: DocumentView, pipeline: PipelineFile) -> Iterator[tuple[str, Any]]:
    """Yield (name, value) of a stage's parameters whose values are known; ``build_graph`` reports faulty values."""
    for name, (parameter, type_, default) in declared.items():
        if parameter.shared or parameter.file:
            continue
        if name not in entry.values:
            yield from () if default is MISSING else ((name, default),)
        elif not (isinstance(entry.values[name], str) and entry.values[name] == AUTO):
            yield from ((name, one) for one in _values([entry.values[name]], parameter, type_, pipeline))


def _shared_values(pipeline: PipelineFile, registry: Registry) -> dict[str, tuple[Any, ...]]:
    """Return all values of every shared quantity of the pipeline."""
    declared: dict[str, tuple[Parameter, Any, Any]] = {}
    for entry in pipeline.stages:
        kind = _kind(entry, registry)
        declared |= {name: one for name, one in parameters_of(kind).items() if one[0].shared} if kind else {}
    written: dict[str, list[Any]] = {}
    tables: list[DocumentView] = [pipeline.preset]
    for word in pipeline.presets_swept:
        axis = pipeline.sweep[word]
        tables += [_preset(one, pipeline, word) for one in axis] if isinstance(axis, list | tuple) else []
    for table in tables:
        for name, value in {**table, **pipeline.shared}.items():
            written.setdefault(name, []).append(value)
    found = {}
    for name, (parameter, type_, default) in declared.items():
        if name in pipeline.sweep:
            found[name] = _axis(pipeline.sweep[name], parameter, type_, pipeline)
        elif name in written:
            found[name] = _values(written[name], parameter, type_, pipeline)
        elif default is not MISSING:
            found[name] = (default,)
    return {name: values for name, values in found.items() if values}


def _preset(one: Any, pipeline: PipelineFile, word: str) -> DocumentView:
    own: Document = {word: one} if isinstance(one, str) else dict(one) if isinstance(one, Mapping) else {}
    try:
        named = preset_at(str(own[word]), pipeline.table.kind_of(word), pipeline.folder).values() if word in own else {}
    except RequestError:
        named = {}
    return {**named, **own}


def _values(written: list[Any], parameter: Parameter, type_: Any, pipeline: PipelineFile) -> tuple[Any, ...]:
    try:
        return tuple(resolve(one, parameter, type_, pipeline.folder) for one in written)
    except Unfit:
        return ()


def _axis(written: Any, parameter: Parameter, type_: Any, pipeline: PipelineFile) -> tuple[Any, ...]:
    try:
        return axis_values(written, parameter, type_, pipeline.folder)
    except Unfit:
        return ()


def with_chosen(pipeline: PipelineFile, values: Mapping[str, DocumentView]) -> PipelineFile:
    """Return the pipeline with these values of its stages as if they had been set on the command line. The record of a
    run then distinguishes them from the values of the file.
    """
    overrides = dict(pipeline.overrides)
    for stage, own in values.items():
        pipeline = with_values(pipeline, stage, own)
        overrides |= {f"{stage}.{name}": value for name, value in own.items()}
    return replace(pipeline, overrides=tuple(overrides.items()))
