"""What is compared: one axis of a pipeline, and what may stand on it.

In:  ``demosaic.use``, ``demosaic.use=a,b,{ use = "c", iterations = 5 }`` or ``sharpen.strength=0,0.1``; a pipeline.
Out: the axis with its values, or the installed alternatives of a stage; faults that name the nearest word.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

from etendue.contract import quantities as camera
from etendue.contract.capabilities import Probe
from etendue.contract.registry import Registry
from etendue.contract.stage import reads_of
from etendue.errors import Fault, PluginError, RequestError, nearest
from etendue.pipeline.derived import at_value, wanting
from etendue.pipeline.file import Pipeline
from etendue.pipeline.overrides import axis_name
from etendue.plan.alternatives import unlike
from etendue.plan.model import Node
from etendue.types.documents import AxisValue, Document
from etendue_camera.roles import REFERENCE

SENSOR = "sensor"  # the word for presets of a camera


@dataclass(frozen=True)
class Asked:
    """``values`` None: whatever is installed."""

    key: str
    values: tuple[Any, ...] | Document | None

    @property
    def stage(self) -> str:
        """Name of the stage, '' where a camera quantity is the axis."""
        return self.key.rpartition(".")[0]

    @property
    def named(self) -> bool:
        """Whether its values are names, of stages or sensors."""
        return self.swaps or self.key == SENSOR

    @property
    def swaps(self) -> bool:
        return self.key.endswith(".use")


def parse_axis(text: str, value_of: Callable[[str], Any]) -> Asked:
    """``NAME`` or ``NAME=V,V,..``; commas inside brackets, braces and quotes do not separate."""
    key, equals, rest = text.partition("=")
    key = key.strip()
    if not key or (equals and not rest.strip()):
        raise RequestError([Fault(f"--axis {text}", "expected NAME or NAME=VALUE,VALUE,.. such as demosaic.use")])
    if not equals:
        return Asked(key, None)
    parts = _split(rest)
    values = tuple(value_of(part) for part in parts)
    for part, value in zip(parts, values, strict=True):
        if part.startswith(("{", "[")) and isinstance(value, str):
            raise RequestError(
                [Fault(f"--axis {key}", f'{part} is no TOML; a table is written {{ use = "NAME", iterations = 5 }}')]
            )
    if len(values) == 1 and isinstance(values[0], list):
        return Asked(key, tuple(values[0]))
    if len(values) == 1 and isinstance(values[0], dict) and "from" in values[0]:
        return Asked(key, values[0])
    return Asked(key, values)


def labels_of(values: Sequence[Any], units: str) -> list[str]:
    """What is written beside each of some values of a parameter: as they were given, with the unit, no two alike."""
    unit = "" if units in ("", "1") else f" {units}"
    labels: list[str] = []
    for value in values:
        if isinstance(value, str):
            number = re.fullmatch(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*?)\s*", value)
            text = f"{number[1]} {number[2]}" if number and number[2] else f"{number[1]}{unit}" if number else value
        elif isinstance(value, bool):
            text = str(value).lower()
        elif isinstance(value, float):
            text = f"{value:.12g}{unit}"  # as exact as an axis is
        else:
            text = f"{value}{unit}" if isinstance(value, int | Decimal) else str(value)
        labels.append(text if text not in labels else f"{text} ({len(labels) + 1})")
    return labels


def _split(text: str) -> list[str]:
    parts, depth, quote, start = [], 0, "", 0
    for place, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in "[{":
            depth += 1
        elif letter in "]}":
            depth -= 1
        elif letter == "," and depth == 0:
            parts.append(text[start:place])
            start = place + 1
    return [part.strip() for part in (*parts, text[start:])]


def check_axis(asked: Asked, pipeline: Pipeline) -> Asked:
    """The axis by its name, and what can be said of it without planning: the stage is there, and there are values
    where they are needed.
    """
    names = [entry.name for entry in pipeline.stages]
    place = f"--axis {asked.key}"
    asked = replace(asked, key=axis_name(asked.key, pipeline.document()))
    if not asked.stage and asked.key in names and asked.values is None:
        raise RequestError(
            [Fault(place, f"{asked.key} is a stage: its alternatives are {asked.key}.use")], pipeline.file
        )
    if asked.stage and asked.stage not in names:
        uses = {entry.use: entry.name for entry in pipeline.stages}
        hint = (
            f"; {asked.stage} is named {uses[asked.stage]!r} here"
            if asked.stage in uses
            else nearest(asked.stage, names)
        )
        raise RequestError([Fault(place, f"there is no stage named {asked.stage!r}{hint}")], pipeline.file)
    if asked.values is None and not asked.swaps and asked.key != SENSOR:
        known = (
            ""
            if asked.stage or asked.key in camera.names()
            else nearest(asked.key, [*camera.names(), *(f"{n}.use" for n in names)])
        )
        raise RequestError([Fault(place, f"needs values: --axis {asked.key}=VALUE,VALUE,..{known}")], pipeline.file)
    return asked


def check_writes(asked: Asked, node: Node, registry: Registry) -> None:
    """Alternatives that are named write what the stage of the file writes."""
    faults = []
    for value in asked.values if asked.swaps and isinstance(asked.values, tuple) else ():
        use = value.get("use") if isinstance(value, dict) else value
        if not isinstance(use, str) or use not in registry:
            continue  # a fault that the planner names
        try:
            texts = unlike((use, registry.load(use)), (node.alternatives[0].use, node.kind))
        except PluginError as error:
            texts = [str(error)]
        faults += [Fault(f"--axis {asked.key}", text) for text in texts]
    if faults:
        raise RequestError(faults)


def candidates(node: Node, registry: Registry) -> tuple[list[str], list[str]]:
    """Installed stages that write what a stage writes and read no more than it does; and what could not be looked at.

    Transfer functions of earlier stages may always be read. The stage itself comes first. Those that say that they
    serve another role (``Stage.role``) and those that only stand in references are none.
    """
    own = node.alternatives[0]
    reads = {str(d) for d in reads_of(own.kind).values() if not d.optional}
    chosen, broken = [own.use], []
    for name in registry.names():
        if name == own.use:
            continue
        try:
            kind = registry.load(name)
        except PluginError as error:
            broken.append(str(error))
            continue
        needed = {str(d) for d in reads_of(kind).values() if not d.variable.startswith("*.")}
        fits = not unlike((name, kind), (own.use, own.kind)) and needed <= reads and (needed or not reads)
        same = kind.role == own.kind.role or (kind.role != REFERENCE and not (kind.role and own.kind.role))
        if fits and same and not issubclass(kind, Probe):
            chosen.append(name)
    return chosen, broken


def without_sweep(pipeline: Pipeline) -> tuple[Pipeline, dict[str, Any]]:
    """The camera alone, and what of it the sweep of its file would have changed.

    Where the file gives a value beside the sweep (under ``[camera]``, by the sensor, in the stage's own table) it
    holds; where it gives none, the first value of the sweep does.
    """
    at: dict[str, AxisValue] = {}
    for key in sorted(pipeline.sweep, key=lambda key: key != SENSOR):  # a sensor gives values to the others
        own = own_value(pipeline, key)
        value = _first(pipeline.sweep[key]) if own is None else own
        if value is None:
            continue  # a fault, which the planner reports
        named = key == SENSOR and isinstance(value, Mapping)
        at[key] = str(value.get("label", value.get(SENSOR, ""))) if named else value
        if own is None:
            pipeline = at_value(pipeline, key, value)
    return wanting(replace(pipeline, sweep={})), at


def _first(written: Any) -> Any:
    """The first value of an axis as written; None where there is none."""
    if isinstance(written, Mapping):
        return written.get("from")
    return written[0] if isinstance(written, list | tuple) and written else None


def one_camera(pipeline: Pipeline) -> tuple[Pipeline, list[str]]:
    """The camera alone, and a note that says what stands for its sweep, if it has one."""
    alone, taken = without_sweep(pipeline)
    return alone, [f"instead of a sweep: {', '.join(f'{key} = {value}' for key, value in taken.items())}"] * bool(taken)


def own_value(pipeline: Pipeline, key: str) -> Any:
    """What a file gives for an axis beside its sweep, as written; None where it gives nothing."""
    stage, _, name = key.rpartition(".")
    if not stage:
        return pipeline.preset_name or None if key == SENSOR else pipeline.shared.get(name, pipeline.preset.get(name))
    entry = next((e for e in pipeline.stages if e.name == stage), None)
    return None if entry is None else entry.use if name == "use" else entry.values.get(name)
