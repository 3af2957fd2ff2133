"""The alternatives of a comparison, and the plan of the compatible alternatives.

In:  a camera without a sweep, the compared axis.
Out: the camera as compared, values for the axis, the plan of all compatible values, a row for each incompatible one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from etendue.contract.registry import Registry
from etendue.errors import Fault, RequestError
from etendue.pipeline.derived import wanting
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.presets import preset_names
from etendue.plan.model import Node, Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue_lab.compare.axis import SENSOR, AxisRequest, candidates, check_writes
from etendue_lab.compare.branches import Branched, nodes_of, noise_free, writer
from etendue_lab.compare.compared import ComparedRow


def camera_of(
    base: PipelineFile, asked: AxisRequest, expected: bool, registry: Registry
) -> tuple[PipelineFile, tuple[Node, ...]]:
    """Return the pipeline from which the alternatives are made, and its nodes.

    Raises
    ------
    RequestError
        The file is invalid, or nothing depends on the axis.
    """
    nodes = nodes_of(base, registry)
    if expected:
        base = noise_free(base, nodes, registry)
        nodes = nodes_of(base, registry)
    if asked.stage and asked.stage not in [n.name for n in nodes]:
        what = "expected values do not use it" if expected else "no computed variable depends on it"
        raise RequestError([Fault(f"--axis {asked.key}", f"{asked.stage} has no effect: {what}")], base.file)
    return base, nodes


def values_of(asked: AxisRequest, nodes: Sequence[Node], registry: Registry) -> tuple[Any, list[str]]:
    """Return the values of the axis: the requested values or, if there are none, all installed alternatives. Also
    return notes on alternatives that cannot be used.
    """
    if asked.values is None and asked.key == SENSOR:
        return preset_names(), []
    node = next((n for n in nodes if n.name == asked.stage), None)
    if node is None or asked.values is not None:
        if node is not None:
            check_writes(asked, node, registry)
        return asked.values, []
    found, broken = candidates(node, registry)
    notes = [f"skipped: {text}" for text in broken]
    if len(found) == 1:
        notes.append(
            f"no other installed stage writes the outputs of {asked.stage} and reads no more; see etendue stages"
        )
    return tuple(found), notes


def wanted_of(branched: Branched) -> tuple[StageVariable, ...]:
    """Return the variables to measure, and the white points that colour differences need."""
    places = [*branched.places()]
    for variable in ("white_xyz", "white"):
        node = writer(branched.nodes, variable)
        if node is not None:
            places.append((node.name, variable))
    return tuple(dict.fromkeys(places))


def planned(
    branched: Branched, wanted: tuple[StageVariable, ...], asked: AxisRequest, values: Any, registry: Registry
) -> tuple[Plan, Any, list[ComparedRow]]:
    """Return the plan of all compatible alternatives, their values on the axis, and a ``refused`` row for each
    incompatible alternative.
    """
    pipeline = wanting(branched.pipeline, wanted, kept=True)

    def plan_of(chosen: Any) -> Plan:
        return make_plan(replace(pipeline, sweep=branched.axes(asked.key, chosen)), registry, False)

    try:
        return plan_of(values), values, []
    except RequestError as whole:
        asked_wrongly = (
            asked.values is not None
            and any(  # the request itself is invalid, not only one of the alternatives
                fault.place.startswith(f"sweep.{asked.key}") for fault in whole.faults
            )
        )
        if not isinstance(values, tuple) or asked_wrongly:
            raise _as_asked(whole, asked) from None
        good, refused, last = [], [], whole
        for value in values:
            try:
                plan_of((value,))
                good.append(value)
            except RequestError as error:
                last = error
                refused.append(
                    _refused(value, asked, registry, "; ".join(dict.fromkeys(f.message for f in error.faults)))
                )
        if not good:
            raise _as_asked(last, asked) from None
        return plan_of(tuple(good)), tuple(good), refused


def keeping_inputs(plan: Plan, asked: AxisRequest) -> Plan:
    """Keep the inputs of the compared stage in memory, so that the stage can be run again for timing."""
    node = next((n for n in plan.nodes if n.name == asked.stage), None)
    if node is None or node.is_transfer:
        return plan
    return replace(
        plan, kept=plan.kept | {(source, variable) for bound in node.inputs for _, source, variable in bound}
    )


def _as_asked(error: RequestError, asked: AxisRequest) -> RequestError:
    """Return the same faults, located at the option ``--axis`` where they concern the axis."""
    key = f"sweep.{asked.key}"
    own = f"--axis {asked.key}"
    wrong = [f for f in error.faults if f.place.startswith(key)]
    faults = [replace(f, place=f.place.replace(key, own, 1), line=None) for f in wrong] or list(error.faults)
    return RequestError(faults, "" if all(f.place.startswith("--axis") for f in faults) else error.file)


def _refused(value: Any, asked: AxisRequest, registry: Registry, reason: str) -> ComparedRow:
    table = value if isinstance(value, dict) else {"use": value}
    use = str(table.get("use", "")) if asked.swaps else ""
    row = ComparedRow(
        use or value, str(table.get("label", use)) if asked.swaps else str(value), use, status="refused", reason=reason
    )
    if use in registry:
        row.distribution, row.version = registry.installed(use).distribution, registry.installed(use).version
    return row
