"""Turn a pipeline into a plan: check it, describe its cells, and decide how each cell is computed. No array is made
here.

plan = make_plan(read_pipeline(path), installed_stages())
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial

from etendue.contract.registry import Registry
from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.names import LOOKS
from etendue.errors import Fault, PluginError, RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan import cost, omissions, stage_calls
from etendue.plan.agreement import met_twice, taken_differently
from etendue.plan.designs.drawing import with_design
from etendue.plan.designs.summary import axis_said, design_said
from etendue.plan.expansion.cells import Told, expand
from etendue.plan.expansion.digits import stored_bytes
from etendue.plan.expansion.fields import notes_on_the_scene
from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, CellRef, Node, Plan
from etendue.plan.wiring.automatic import settled
from etendue.plan.wiring.graph import build_graph, resolve_keep
from etendue.plan.wiring.request import Choice
from etendue.plan.wiring.swapped import fitted_to_overrides
from etendue.plugins.guests import Guest
from etendue.process import NOT_COLLECTING
from etendue.telling import plain
from etendue.types.documents import Document

TOLD = 10.0  # smallest growth that is worth a warning; the tolerance itself refers to the output of each stage
INSTALLED: Mapping[str, str] = {}  # never written to; a plan can be pickled with it


@contextmanager
def asked_of_stages() -> Iterator[None]:
    """Convert errors in calls of stages, some of which belong to other distributions, to faults of the request."""
    with Guest("a stage, when it was planned,"):
        yield


def make_plan(
    pipeline: PipelineFile,
    registry: Registry,
    leave_out_allowed: bool = True,
    told: Told = lambda done, total: None,
    expected: bool = False,
    computed: frozenset[str] = frozenset(),
    versions: Mapping[str, str] = INSTALLED,
) -> Plan:
    """Check a pipeline and expand it into cells.

    Parameters
    ----------
    told
        Called with the number of cells planned so far and the total.
    expected
        Replace random draws by their mean and rounding by the identity.
    computed
        Names of stages that are not left out in any cell.
    versions
        Library versions to put into the keys instead of the installed versions; this gives the keys of an earlier
        environment.

    Raises
    ------
    RequestError
        The file is invalid or a grid is impossible; the message lists every fault.
    """
    choice = Choice(
        pipeline.tolerance,
        leave_out_allowed and pipeline.leave_out,
        pipeline.precision,
        pipeline.norm,
        expected,
        versions,
        computed,
        digits=pipeline.digits_left,
    )
    return plan_as(pipeline, registry, choice, told)


def plan_again(pipeline: PipelineFile, registry: Registry, leave_out_allowed: bool, earlier: Sequence[Plan]) -> Plan:
    """Return the plan that ``make_plan`` makes. Cells that cannot differ from the cells of an earlier plan are taken
    from it, so that only changes are planned again.
    """
    leave_out_allowed = leave_out_allowed and pipeline.leave_out
    norm = pipeline.norm
    digits, before = pipeline.digits_left, tuple(earlier)
    choice = Choice(pipeline.tolerance, leave_out_allowed, pipeline.precision, norm, digits=digits, earlier=before)
    return plan_as(pipeline, registry, choice)


@NOT_COLLECTING
@asked_of_stages()
def plan_as(pipeline: PipelineFile, registry: Registry, choice: Choice, told: Told = lambda done, total: None) -> Plan:
    """Return the plan of a pipeline, with the requested kind of decisions."""
    # Order: the graph before cells (a file with faults must not be expanded), cells before warnings (most warnings need
    # the facts of a cell).
    # Swapped stages come before automatic values, because these are chosen by the stages that are finally used.
    pipeline, swapped = fitted_to_overrides(pipeline, registry)
    pipeline, chosen = settled(with_design(pipeline, registry), registry)
    try:
        graph = build_graph(pipeline, registry)
        cells, precision, looked = expand(graph, pipeline, choice, told)
    except RequestError as error:
        raise RequestError(pipeline.located(error.faults), error.file) from None
    # Stages that others only look at are not run, so they have no arrays to keep.
    kept = frozenset(one for one in resolve_keep(graph.nodes, graph.keep) if one[0] not in graph.seen_only)
    try:
        sampled = notes_on_the_scene(graph.nodes, cells, graph.positioned)
        warnings = (*_warnings(graph.nodes, cells, pipeline.tolerance), *sampled)
    except RequestError as error:
        raise RequestError(pipeline.located(error.faults), pipeline.file) from None
    return Plan(
        pipeline=pipeline,
        axes=graph.axes,
        derived=graph.derived,
        nodes=graph.nodes,
        cells=cells,
        wanted=graph.wanted,
        kept=kept,
        copied=frozenset((node, v) for node, v in kept if {v, f"{node}.{v}"} & {*(graph.keep or ())}),
        seen_only=graph.seen_only,
        precision=precision,
        shared=graph.shared,
        leaves_out=choice.leave_out,
        digits=choice.digits,
        looked=looked,
        expected=choice.expected,
        warnings=(*swapped, *chosen, *graph.warnings, *warnings),
    )


def _warnings(nodes: Sequence[Node], cells: Mapping[CellRef, Cell], tolerance: float) -> tuple[str, ...]:
    """Return the warnings that stages give about their own cells, each text once."""
    places = {node.name: node.place for node in nodes}
    uses = {one.use: one.kind for node in nodes for one in node.alternatives}
    notes = (
        _rewritten_in_vain(nodes),
        met_twice(nodes),
        taken_differently(nodes, cells),
        _beyond_tolerance(cells, tolerance),
        _grown(cells, tolerance),
    )
    # A dict removes duplicates and, unlike a set, keeps the order of the warnings the same in every process.
    texts = dict.fromkeys(itertools.chain(*notes))
    among: Once[list[str]] = Once()
    said: Once[list[str]] = Once()
    for cell in cells.values():
        stage, kind = cell.stage, type(cell.stage)
        if kind.warn is Stage.warn and kind.warn_among is Stage.warn_among:
            continue
        warn = partial(stage_calls.texts, stage, "warn", cell.facts, cell.input_grids)
        try:
            found = [] if kind.warn is Stage.warn else said((stage, cell.facts, cell.input_grids), warn)
            if kind.warn_among is not Stage.warn_among:
                found = found + among((stage,), partial(stage_calls.texts, stage, "warn_among", uses))
        except ValueError as error:
            raise RequestError([Fault(places[cell.node], plain(str(error)))]) from None
        except PluginError as error:
            raise RequestError([Fault(places[cell.node], f"{cell.use}: {error}")]) from None
        texts |= dict.fromkeys(f"{cell.node}: {text}" for text in found)
    return tuple(texts)


def _beyond_tolerance(cells: Mapping[CellRef, Cell], tolerance: float) -> list[str]:
    """Return a warning for every stage whose stated error exceeds the tolerance, because its finer settings are
    ``dear`` and the plan does not choose such settings by itself.
    """
    worst: dict[tuple[str, str, Hashable], float] = {}
    for cell, _ in cost.counted(cells.values()):
        dear = next((name for name, (p, _, _) in parameters_of(type(cell.stage)).items() if p.dear), None)
        error = cell.error[0]
        if dear is not None and cell.left_out is None and error is not None and error > tolerance:
            key = (cell.node, dear, vars(cell.stage)[dear])
            worst[key] = max(worst.get(key, 0.0), error)
    return [
        f"{stage}: states an error of {error:.2g}, above the tolerance of {tolerance:g}; the plan does not choose a "
        f"{name} finer than {value} unless the file sets it"
        for (stage, name, value), error in worst.items()
    ]


def _grown(cells: Mapping[CellRef, Cell], tolerance: float) -> list[str]:
    """Return a warning for every stage whose decisions are within the tolerance at its own output but may exceed it at
    the wanted variables, because later stages meter, clip or amplify the light.
    """
    worst: dict[str, float] = {}
    for cell in cells.values():
        if cell.growth <= TOLD:
            continue
        bounds = [one.bound for one in cell.approximated] + ([cell.left_out.bound] if cell.left_out else [])
        most = cell.at_wanted(max(bounds, default=0.0))
        if most > tolerance:
            worst[cell.node] = max(worst.get(cell.node, 0.0), most)
    return [
        f"{stage}: its omissions and coarser settings are within the tolerance there, but after a meter, a gain or "
        f"clipped light they may cause an error of {most:.2g}; lower the tolerance of {tolerance:g}, or compare with "
        "--nothing-left-out"
        for stage, most in worst.items()
    ]


def _rewritten_in_vain(nodes: Sequence[Node]) -> list[str]:
    """Return a warning for every stage that changes a variable after its only reader: the stage is probably
    misplaced.
    """
    written = {(node.name, variable): declared.dims for node in nodes for variable, declared in node.writes.items()}
    readers: dict[tuple[str, str], list[tuple[int, Node]]] = {}  # readers of each (stage, variable), with their numbers
    for number, node in enumerate(nodes):
        for _, source, variable in itertools.chain(*node.inputs):
            readers.setdefault((source, variable), []).append((number, node))
    notes = []
    for number, node in enumerate(nodes):
        own = {variable: source for _, source, variable in itertools.chain(*node.inputs) if variable in node.writes}
        for variable, source in own.items():
            if written[source, variable] != node.writes[variable].dims:
                # The stage removes a dim, for example merges frames: this gives a new result rather than a rewrite.
                continue
            before = [reader for at, reader in readers[source, variable] if at < number]
            if before and (node.name, variable) not in readers and not any(variable in r.writes for r in before):
                notes.append(
                    f"{node.name}: nothing reads its {variable}; {before[0].name} comes earlier and reads the "
                    f"{variable} of {source}; move {node.name} up"
                )
    return notes


def summary(plan: Plan, peak_memory: int | None = None) -> Document:
    """Return the plan as JSON for ``etendue plan --json``; ``peak_memory`` bounds the memory of a run, in bytes."""
    rates = cost.Rates()
    stages = [_stage(plan, node, rates) for node in plan.nodes]
    written = {(s["name"], v): one["bytes"] for s in stages for v, one in s["variables"].items()}
    return {
        "name": plan.pipeline.name,
        "stages": stages,
        "cells": sum(s["cells"] for s in stages),
        "naive_cells": len(plan.nodes) * math.prod(len(a.values) for a in plan.axes),
        "bytes": sum(s["bytes"] for s in stages),
        "keep": {
            word: sum(written[place] for place in resolve_keep(plan.nodes, chosen) if place[0] not in plan.seen_only)
            for word, chosen in (("all", None), (LOOKS, (LOOKS,)))
        },
        "seconds": sum(s["seconds"] for s in stages),
        "seconds_known": all(s["seconds_known"] for s in stages),
        "peak_memory": peak_memory,
        "precision": plan.precision,
        "digits": {"tolerance": plan.digits, "bytes": stored_bytes(plan)} if plan.digits else None,
        "tolerance": plan.pipeline.tolerance if plan.leaves_out else None,
        "norm": plan.pipeline.norm,
        "scene_seconds": plan.looked,
        "axes": [axis_said(axis) for axis in plan.positioned],
        "design": design_said(plan),
        "warnings": list(plan.warnings),
    }


def _stage(plan: Plan, node: Node, rates: cost.Rates) -> Document:
    """Return the summary of one stage."""
    cells, precision = [] if node.name in plan.seen_only else plan.of(node.name), plan.precision
    counted = cost.alike(cells)
    sizes = {v: sum(count * cost.cell_bytes(node, c, precision, [v]) for c, count in counted) for v in node.writes}
    same_as = {v: f"{plan.same_as[node.name, v]}.{v}" for v in node.writes if (node.name, v) in plan.same_as}
    sizes |= dict.fromkeys(same_as, 0)
    kept = {v: (node.name, v) in plan.kept for v in node.writes}
    uses = [one.use for one in node.alternatives]
    stored = sum(size for v, size in sizes.items() if kept[v])
    seconds, known = cost.with_writing(node, cells, precision, stored, rates)
    return {
        "name": node.name,
        "use": uses[0] if len(uses) == 1 else uses,
        "distribution": node.alternatives[0].distribution,
        "axes": [plan.axis(dim).key for dim in node.axes],
        "cells": len(cells),
        "found": node.found or None,
        "one_by_one": list(node.mapped) or None,
        "left_out": omissions.left_out(
            node, cells, precision, [v for v in node.writes if (node.name, v) in plan.with_arrays], rates
        ),
        "approximated": omissions.approximated(node, cells, precision, rates),
        "bytes": stored,
        "variables": {
            v: {"bytes": size, "kept": kept[v]} | ({"same_as": same_as[v]} if v in same_as else {})
            for v, size in sizes.items()
        },
        "seconds": seconds,
        "seconds_known": known,
    }
