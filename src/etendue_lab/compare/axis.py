"""The compared axis of a pipeline, and its possible values.

In:  ``demosaic.use``, ``demosaic.use=a,b,{ use = "c", iterations = 5 }`` or ``sharpen.strength=0,0.1``; a pipeline.
Out: the axis with its values, or the installed alternatives of a stage; faults that suggest the nearest name.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

from etendue.contract.capabilities import Probe
from etendue.contract.registry import Registry, installed_stages
from etendue.contract.stage import reads_of
from etendue.contract.values import quantities as camera
from etendue.contract.values.tables import preset_keys
from etendue.errors import Fault, PluginError, RequestError, nearest
from etendue.pipeline.derived import at_value, unswept, wanting
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.overrides import axis_name
from etendue.plan.designs.drawing import with_design
from etendue.plan.model import Node
from etendue.plan.wiring.alternatives import unlike
from etendue.types.documents import AxisValue, Document
from etendue_camera.roles import REFERENCE

SENSOR = "sensor"  # the name of the axis of camera presets


@dataclass(frozen=True)
class AxisRequest:
    """A requested axis. ``values`` is None for all installed alternatives."""

    key: str
    values: tuple[Any, ...] | Document | None

    @property
    def stage(self) -> str:
        """Name of the stage, '' if a camera quantity is the axis."""
        return self.key.rpartition(".")[0]

    @property
    def named(self) -> bool:
        """Whether the values of the axis are names of stages, sensors, bodies or lenses."""
        return self.swaps or self.key in preset_keys()

    @property
    def swaps(self) -> bool:
        return self.key.endswith(".use")


def parse_axis(text: str, value_of: Callable[[str], Any]) -> AxisRequest:
    """Parse ``NAME`` or ``NAME=V,V,..``; commas inside brackets, braces and quotes do not separate."""
    key, equals, rest = text.partition("=")
    key = key.strip()
    if not key or (equals and not rest.strip()):
        raise RequestError([Fault(f"--axis {text}", "expected NAME or NAME=VALUE,VALUE,.. such as demosaic.use")])
    if not equals:
        return AxisRequest(key, None)
    parts = _split(rest)
    values = tuple(value_of(part) for part in parts)
    for part, value in zip(parts, values, strict=True):
        if part.startswith(("{", "[")) and isinstance(value, str):
            raise RequestError(
                [
                    Fault(
                        f"--axis {key}",
                        f'{part} is not valid TOML; write a table as {{ use = "NAME", iterations = 5 }}',
                    )
                ]
            )
    if len(values) == 1 and isinstance(values[0], list):
        return AxisRequest(key, tuple(values[0]))
    if len(values) == 1 and isinstance(values[0], dict) and "from" in values[0]:
        return AxisRequest(key, values[0])
    return AxisRequest(key, values)


def labels_of(values: Sequence[Any], units: str) -> list[str]:
    """Return a different label for each value of a parameter: the value as written, with its unit."""
    unit = "" if units in ("", "1") else f" {units}"
    labels: list[str] = []
    for value in values:
        if isinstance(value, str):
            number = re.fullmatch(r"\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*(.*?)\s*", value)
            text = f"{number[1]} {number[2]}" if number and number[2] else f"{number[1]}{unit}" if number else value
        elif isinstance(value, bool):
            text = str(value).lower()
        elif isinstance(value, float):
            text = f"{value:.12g}{unit}"  # the number of digits with which an axis is stored
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


def check_axis(asked: AxisRequest, pipeline: PipelineFile) -> AxisRequest:
    """Check what can be checked without a plan: that the stage exists, and that values are given where needed. Return
    the axis under its full name.
    """
    names = [entry.name for entry in pipeline.stages]
    place = f"--axis {asked.key}"
    asked = replace(asked, key=axis_name(asked.key, pipeline.document()))
    if not asked.stage and asked.key in names and asked.values is None:
        raise RequestError(
            [Fault(place, f"{asked.key} is a stage; use {asked.key}.use to compare its alternatives")], pipeline.file
        )
    if asked.stage and asked.stage not in names:
        uses = {entry.use: entry.name for entry in pipeline.stages}
        hint = (
            f"; here {asked.stage} is named {uses[asked.stage]!r}"
            if asked.stage in uses
            else nearest(asked.stage, names)
        )
        raise RequestError([Fault(place, f"unknown stage {asked.stage!r}{hint}")], pipeline.file)
    if asked.values is None and not asked.swaps and asked.key != SENSOR:
        known = (
            ""
            if asked.stage or asked.key in camera.names()
            else nearest(asked.key, [*camera.names(), *(f"{n}.use" for n in names)])
        )
        raise RequestError(
            [Fault(place, f"values are required: --axis {asked.key}=VALUE,VALUE,..{known}")], pipeline.file
        )
    return asked


def check_writes(asked: AxisRequest, node: Node, registry: Registry) -> None:
    """Check that named alternatives write the same variables as the stage of the file."""
    faults = []
    for value in asked.values if asked.swaps and isinstance(asked.values, tuple) else ():
        use = value.get("use") if isinstance(value, dict) else value
        if not isinstance(use, str) or use not in registry:
            continue  # the planner reports this fault
        try:
            texts = unlike((use, registry.load(use)), (node.alternatives[0].use, node.kind))
        except PluginError as error:
            texts = [str(error)]
        faults += [Fault(f"--axis {asked.key}", text) for text in texts]
    if faults:
        raise RequestError(faults)


def candidates(node: Node, registry: Registry) -> tuple[list[str], list[str]]:
    """Return the installed stages that can replace a stage, and the errors of stages that cannot be loaded. A
    replacement writes the same variables and reads no variable that the stage does not read.

    Transfer functions of earlier stages may always be read. The stage itself comes first. Stages that declare another
    role (``Stage.role``) and those that only serve in references are excluded.
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


def without_sweep(pipeline: PipelineFile) -> tuple[PipelineFile, Document]:
    """Return the pipeline without its sweep, and the value that replaces each axis.

    For each axis this is the value that the file gives outside its sweep (under ``[camera]``, in the sensor file, or in
    the table of the stage), otherwise the first value of the sweep.
    """
    at: dict[str, AxisValue] = {}
    pipeline = with_design(pipeline, installed_stages())  # of a design, the first row
    words = pipeline.table.words()
    # The value of a sensor axis determines those of other axes.
    for key in sorted(pipeline.sweep, key=lambda key: key not in words):
        own = own_value(pipeline, key)
        value = _first(pipeline.sweep[key]) if own is None else own
        if value is None:
            continue  # the planner reports this fault
        named = key in words and isinstance(value, Mapping)
        at[key] = str(value.get("label", value.get(key, ""))) if named else value
        if own is None or key in words:
            pipeline = at_value(pipeline, key, value)
    return wanting(unswept(pipeline)), at


def _first(written: Any) -> Any:
    """Return the first value of a sweep axis as the file writes it; None if there is none."""
    if isinstance(written, Mapping):
        return written.get("from")
    return written[0] if isinstance(written, list | tuple) and written else None


def one_camera(pipeline: PipelineFile) -> tuple[PipelineFile, list[str]]:
    """Return the pipeline without its sweep and, if it had one, a note with the values that replace the sweep."""
    alone, taken = without_sweep(pipeline)
    used = "value used instead" if len(taken) == 1 else "values used instead"
    return alone, [
        f"the sweep is ignored; {used}: {', '.join(f'{key} = {value}' for key, value in taken.items())}"
    ] * bool(taken)


def own_value(pipeline: PipelineFile, key: str) -> Any:
    """Return the value that a file gives for an axis outside its sweep, as written; None if it gives none."""
    stage, _, name = key.rpartition(".")
    if not stage:
        if key in pipeline.table.words():
            return pipeline.named.get(key) or None
        return pipeline.shared.get(name, pipeline.preset.get(name))
    entry = next((e for e in pipeline.stages if e.name == stage), None)
    return None if entry is None else entry.use if name == "use" else entry.values.get(name)
