"""The reference of a pipeline: every knob at its best setting, no stage left out, 64 bits.

In:  a pipeline, the registry.
Out: the same pipeline with the knobs written in; the setting of each knob, and the knobs whose best setting is finite.

Values that are written in the file (or set, or swept) belong to the model and are not knobs. The drawing of the scene
(``Parameter.studied``) is not a knob either: its samples and bands are the samples and bands of the stored light.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.errors import PluginError
from etendue.pipeline.derived import each, given
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.pipeline.form import DIGITS
from etendue.plan.expansion.search import Knob, Value
from etendue.types.documents import Document, DocumentView

Name = tuple[str, str]  # stage of the pipeline, parameter


@dataclass(frozen=True, kw_only=True)
class PipelineKnob(Knob):
    """A knob of a pipeline: a fidelity parameter of one of its stages, or its precision."""

    use: str
    closed_form: bool  # the reference is not a finite setting
    value: Value  # from the file, else its default
    written: bool  # in the file, by --set, or swept
    # Plans never choose it: it changes a grid or the content of a scene, or finer settings are too costly.
    studied: bool
    # The discretisation that it sets, if any; other knobs are tried at its ``value`` rather than at its finest setting.
    discretisation: str = ""

    @property
    def reference(self) -> Value:
        return self.settings[-1] if self.settings and not self.discretisation else self.value

    @property
    def before_reference(self) -> Value:
        """The setting one refinement coarser than the reference if the reference is finite; else the reference."""
        return self.settings[-2] if len(self.settings) > 1 and not self.closed_form else self.reference

    def finer_than(self, setting: Value) -> Value:
        """Return the next setting towards the reference; the reference if ``setting`` is not among the settings."""
        later = self.settings[self.settings.index(setting) + 1 :] if setting in self.settings else ()
        return (*later, self.reference)[0]


@dataclass(frozen=True)
class ReferencePipeline:
    """``pipeline`` with the knobs written in; ``coarser``: the same pipeline with settings one refinement coarser; None
    if every reference is a closed form.
    """

    pipeline: PipelineFile
    knobs: tuple[PipelineKnob, ...]
    coarser: PipelineFile | None


def knobs_of(pipeline: PipelineFile, registry: Registry) -> tuple[PipelineKnob, ...]:
    """Return every fidelity parameter of every stage, including stages that a sweep swaps in."""
    found = []
    for entry in pipeline.stages:
        for use, values in _uses(pipeline, entry):
            if use not in registry:
                continue  # a fault that the planner reports
            try:
                declared = parameters_of(registry.load(use))
            except PluginError:
                continue
            for name, (parameter, _, default) in declared.items():
                if parameter.fidelity and not parameter.shared and default is not MISSING:
                    knob = PipelineKnob(
                        entry.name,
                        name,
                        ladder(parameter, default),
                        parameter.units,
                        use=use,
                        closed_form=parameter.closed_form if parameter.settings else isinstance(default, str),
                        value=values.get(name, default),
                        written=name in values or f"{entry.name}.{name}" in pipeline.sweep,
                        studied=parameter.studied or parameter.dear,
                    )
                    found.append(knob)
    return tuple(found)


def ladder(parameter: Parameter, default: Any) -> tuple[Any, ...]:
    """Return settings from the cheapest to the reference. If none are declared, counts are doubled and other numbers
    halved in steps, from two below to two above the default.
    """
    if parameter.settings or isinstance(default, str | bool) or not isinstance(default, int | float):
        return parameter.settings
    if isinstance(default, int):
        steps: list[Any] = [max(default // 4, 1), max(default // 2, 1), default, 2 * default, 4 * default]
    else:
        steps = [4 * default, 2 * default, default, default / 2, default / 4]
    low, high = parameter.held or (-math.inf, math.inf)
    return tuple(dict.fromkeys(step for step in steps if parameter.allows(step) and low <= step <= high))


def within(knob: PipelineKnob, takes: Callable[[Value], bool]) -> PipelineKnob:
    """Return a knob with the settings up to the best setting that its stage accepts. If this removes settings, the
    reference counts as finite.
    """
    for count in range(len(knob.settings), 0, -1):
        if takes(knob.settings[count - 1]):
            whole = count == len(knob.settings)
            return knob if whole else replace(knob, settings=knob.settings[:count], closed_form=False)
    return replace(knob, settings=())


def reference_of(
    pipeline: PipelineFile, registry: Registry, knobs: Iterable[PipelineKnob] | None = None
) -> ReferencePipeline:
    """Return the reference of a pipeline, for ``knobs`` if given, else for all knobs that the file does not set."""
    chosen = (
        tuple(k for k in knobs_of(pipeline, registry) if not (k.written or k.studied))
        if knobs is None
        else tuple(knobs)
    )
    exact = replace(pipeline, precision="float64", leave_out=False, digits=DIGITS[0])
    moved = [k for k in chosen if k.settings and k.before_reference != k.reference]
    best = {(k.stage, k.use, k.name): k.reference for k in chosen if k.settings}
    coarser = best | {(k.stage, k.use, k.name): k.before_reference for k in moved}
    return ReferencePipeline(with_settings(exact, best), chosen, with_settings(exact, coarser) if moved else None)


def reference_overrides(pipeline: PipelineFile, registry: Registry) -> Document:
    """Return the overrides that make a pipeline its reference, as an archive records them."""
    found = reference_of(pipeline, registry)
    entries = {entry.name: entry for entry in pipeline.stages}
    given: Document = {"precision": "float64", "leave_out": False}
    if pipeline.digits != DIGITS[0]:
        given["archive.digits"] = DIGITS[0]
    for knob in found.knobs:
        if knob.settings and entries[knob.stage].use == knob.use:
            given[f"{knob.stage}.{knob.name}"] = knob.reference
    swapped = {key: own for key, own in found.pipeline.sweep.items() if own != pipeline.sweep[key]}
    return given | {f"sweep.{key}": own for key, own in swapped.items()}


def with_settings(pipeline: PipelineFile, settings: Mapping[tuple[str, str, str], Any]) -> PipelineFile:
    """Return the pipeline with values for (stage, use, parameter) written in, also in a sweep that swaps stages."""

    def own(stage: str, use: Any, but: Collection[str] = ()) -> Document:
        return {name: v for (at, of, name), v in settings.items() if (at, of) == (stage, use) and name not in but}

    def alternative(stage: str, one: Any) -> Any:
        table = {"use": one} if isinstance(one, str) else one
        values = own(stage, table.get("use"), table) if isinstance(table, dict) else {}
        return {**table, **values, "label": table.get("label", table["use"])} if values else one

    sweep = dict(pipeline.sweep)
    for entry in pipeline.stages:
        key = f"{entry.name}.use"
        if isinstance(sweep.get(key), list | tuple):
            sweep[key] = [alternative(entry.name, one) for one in sweep[key]]
    return replace(each(pipeline, lambda entry: given(entry, own(entry.name, entry.use))), sweep=sweep)


def _uses(pipeline: PipelineFile, entry: StageEntry) -> Iterator[tuple[str, DocumentView]]:
    """Yield each stage class that may be used at an entry, once, with the values written for it."""
    swapped = pipeline.sweep.get(f"{entry.name}.use")
    if not isinstance(swapped, list | tuple):
        yield entry.use, entry.values
        return
    found: dict[str, Document] = {}
    for one in swapped:
        table = {"use": one} if isinstance(one, str) else one
        if isinstance(table, dict) and isinstance(table.get("use"), str):
            shared = entry.values if table["use"] == entry.use else {}
            found.setdefault(table["use"], {}).update({**shared, **table})
    yield from found.items()
