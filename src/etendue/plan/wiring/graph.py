"""Turn a pipeline and the registry into a graph of nodes. All faults of a file are gathered and raised together.

In:  a ``Pipeline`` (values as written) and a ``Registry``.
Out: nodes in order, axes, shared quantities, wanted and kept variables; or one ``RequestError`` with all faults.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from etendue.contract.arrays import variables
from etendue.contract.arrays.dims import is_light
from etendue.contract.registry import Registry
from etendue.contract.stage import looks_at_stages, parameters_of, quantities_of, writes_of
from etendue.contract.values.names import LOOKS, OWN, beside
from etendue.errors import PluginError, RequestError, nearest
from etendue.pipeline.file import PipelineFile
from etendue.plan import stage_calls
from etendue.plan.designs.bundles import bundled
from etendue.plan.designs.drawing import with_design
from etendue.plan.model import Alternative, Axis, Node
from etendue.plan.wiring.alternatives import Entries, alternatives_of
from etendue.plan.wiring.automatic import settled
from etendue.plan.wiring.axes import resolve_axes
from etendue.plan.wiring.binding import link
from etendue.plan.wiring.missing import lacking
from etendue.plan.wiring.quantities import resolve_quantities, to_be_found
from etendue.plan.wiring.request import Request
from etendue.plan.wiring.swapped import fitted_to_overrides
from etendue.plugins import discovery
from etendue.telling import plain
from etendue.types.documents import Document, DocumentView


@dataclass
class Graph:
    """A checked pipeline, which the planner expands into cells."""

    nodes: tuple[Node, ...]
    axes: tuple[Axis, ...]
    shared: Document
    wanted: tuple[tuple[str, str], ...]
    keep: tuple[str, ...] | None
    warnings: tuple[str, ...]
    seen_only: frozenset[str] = frozenset()  # nodes whose stages alone are looked at: nobody needs their values
    derived: tuple[Axis, ...] = ()  # axes whose positions follow from positions on other axes
    factors: tuple[Axis, ...] = ()  # the axes that an axis of rows replaces

    @property
    def positioned(self) -> dict[str, Axis]:
        """All axes on which a cell has a position, by dim."""
        return {axis.dim: axis for axis in (*self.axes, *self.derived)}


def build_graph(pipeline: PipelineFile, registry: Registry) -> Graph:
    """Check the whole pipeline; raise ``RequestError`` with every fault."""
    pipeline, _ = fitted_to_overrides(pipeline, registry)
    pipeline, _ = settled(with_design(pipeline, registry), registry)
    request = Request(pipeline, registry)
    needed = lacking(pipeline, registry)
    if needed:  # stages of a missing distribution are unknown, and all further faults would only be consequences
        raise RequestError([*request.faults, *needed], pipeline.file)
    entries: dict[str, tuple[Alternative, ...]] = {}
    swapped: dict[str, Axis] = {}
    for entry in pipeline.stages:
        entries[entry.name], use_axis = alternatives_of(request, entry)
        if use_axis:
            swapped[entry.name] = use_axis
        request.whole = request.whole and bool(entries[entry.name])
    _check_vocabulary(request, entries)
    shared = resolve_quantities(request, entries)
    axes, direct = resolve_axes(request, entries, shared, list(swapped.values()))
    nodes = link(request, entries, swapped, axes, direct)
    _check_axis_names(request, nodes, axes)
    _check_found(request, nodes, axes)
    _try_values(request, nodes, axes, shared.values)
    wanted = _wanted_of(request, nodes)
    nodes = _as_asked(nodes, wanted)
    known = {LOOKS, *(pipeline.wanted or ())}  # unknown names under ``wanted`` have been reported
    for text in pipeline.keep or ():
        if text not in known:
            _find_variable(request, text, nodes, "keep")
    if wanted and request.whole:
        nodes = _prune(nodes, wanted)
        reached = {dim for node in nodes for dim in node.axes}
        for axis in axes:
            if axis.dim not in reached:
                request.warnings.append(f"sweep.{axis.key} is not swept: no wanted variable depends on it")
        axes = [axis for axis in axes if axis.dim in reached or axis.key in pipeline.zipped]
    if request.faults:
        raise RequestError(request.faults, pipeline.file)
    found = bundled(nodes, axes, pipeline)
    _check_axis_names(request, found.nodes, [*found.axes, *found.derived])
    if request.faults:
        raise RequestError(request.faults, pipeline.file)
    return Graph(
        tuple(found.nodes),
        tuple(found.axes),
        shared.values,
        wanted,
        pipeline.keep,
        tuple(request.warnings),
        _seen_only(nodes, wanted),
        tuple(found.derived),
        tuple(found.factors),
    )


def resolve_keep(nodes: tuple[Node, ...], keep: tuple[str, ...] | None) -> frozenset[tuple[str, str]]:
    """Return the (stage, variable) pairs to store. The name of a variable selects it in every stage, the name of a
    stage selects all its variables, and ``looks`` selects everything but light.
    """
    everything = [(n.name, v) for n in nodes for v in n.writes]
    if keep is None:
        return frozenset(everything)
    chosen = {
        (n.name, v) for n in nodes for v, written in n.writes.items() if LOOKS in keep and not is_light(written.dims)
    }
    for stage, variable in everything:
        if variable in keep or stage in keep or f"{stage}.{variable}" in keep:
            chosen.add((stage, variable))
    return frozenset(chosen)


def _check_vocabulary(request: Request, entries: Entries) -> None:
    """Report names in the pipeline that two distributions define differently, or whose definition is invalid."""
    quantities: dict[str, str] = {}
    written: dict[str, str] = {}
    for stage, alternatives in entries.items():
        for one in alternatives:
            quantities |= {
                name: one.use
                for name, (p, _, _) in parameters_of(one.kind).items()
                if p.shared and name not in quantities
            }
            written |= {d.variable: stage for d in writes_of(one.kind).values() if d.variable not in written}
    for name, use in quantities.items():
        if clash := discovery.installed().clash("quantities", name):
            request.fault(request.pipeline.table.place(name), f"{use} takes it, but it is {clash}")
    for name, stage in written.items():
        try:
            variables.variable(name)
        except PluginError as error:
            request.fault(f"stages.{stage}", str(error))
        if differ := variables.disagree(name):
            request.fault(
                f"stages.{stage}", f"{differ} define its variable {name!r} differently; uninstall one of them"
            )


def _check_axis_names(request: Request, nodes: list[Node], axes: list[Axis]) -> None:
    """Report an axis with the name of another axis, or of a dim of a variable: their values would overwrite each other
    in the archive.
    """
    by_dim: dict[str, Axis] = {}
    for axis in axes:
        other = by_dim.setdefault(axis.dim, axis)
        if other is not axis:
            both = f"it and sweep.{other.key} are both the dim {axis.dim!r}"
            request.fault(f"sweep.{axis.key}", f"{both}; give one of the stages another 'name'")
        dims = {
            dim for node in nodes if axis.dim in node.axes for written in node.writes.values() for dim in written.dims
        }
        if axis.dim in beside(dims) or axis.dim in OWN:
            why = f"{axis.dim!r} is a dim, or a coordinate, of an output of a stage"
            request.fault(f"sweep.{axis.key}", f"{why}; give the stage another 'name'")


def _check_found(request: Request, nodes: list[Node], axes: list[Axis]) -> None:
    """Report quantities that are given or swept although an earlier stage writes them for all stages that use them."""
    for name, finder in {name: finder for node in nodes for name, finder in node.found.items()}.items():
        takers = [
            n for n in nodes if any(name in quantities_of(one.kind) and name not in n.found for one in n.alternatives)
        ]
        if takers or not request.whole:
            continue
        if any(axis.key == name for axis in axes):
            request.fault(
                f"sweep.{name}",
                f"{finder!r} writes {name} for every stage that takes it; remove the axis or {finder!r}",
            )
        elif name in request.pipeline.shared:
            request.warnings.append(f"{request.pipeline.table.place(name)} is not used: {finder!r} finds it")


def _try_values(request: Request, nodes: list[Node], axes: list[Axis], given: DocumentView) -> None:
    """Report values that a stage itself refuses, for all stages at once; swept parameters are tried at their first
    value.
    """
    first = {axis.dim: axis for axis in axes if axis.values}
    for node in nodes:
        for one in node.alternatives:
            shared = {name: given.get(name) for name, (p, _, _) in parameters_of(one.kind).items() if p.shared}
            swept = {
                name: first[dim].value(name, 0)
                for dim, name in node.direct
                if dim in first and name in parameters_of(one.kind)
            }
            found = {
                name: to_be_found(name, quantities_of(one.kind)[name])
                for name in node.found
                if name in quantities_of(one.kind)
            }
            values = {**shared, **one.values, **swept, **found}
            if any(value is None for value in values.values()):
                continue  # already a fault
            try:
                stage_calls.made(one.kind, values)
            except ValueError as error:
                request.fault(node.place, f"{one.use}: {plain(str(error))}")
            except PluginError as error:
                request.fault(node.place, f"{one.use} of {one.distribution} {one.version}: {error}")


def _as_asked(nodes: list[Node], wanted: tuple[tuple[str, str], ...]) -> list[Node]:
    """Return the nodes without those optional variables that are not wanted and that no node reads or looks at."""
    asked = set(wanted) | {(source, variable) for n in nodes for bound in n.inputs for _, source, variable in bound}
    asked |= {(name, what) for n in nodes for _, what, names in n.looks_at for name in names}
    found = []
    for node in nodes:
        left = {v: d for v, d in node.writes.items() if d.optional and (node.name, v) not in asked}
        found.append(
            replace(node, writes={v: d for v, d in node.writes.items() if v not in left}, optional=left)
            if left
            else node
        )
    return found


def _wanted_of(request: Request, nodes: list[Node]) -> tuple[tuple[str, str], ...]:
    """Return the variables that the file wants; by default the outputs of probes, and all variables that no later stage
    reads or rewrites.
    """
    if request.pipeline.wanted is not None:
        found = [pair for text in request.pipeline.wanted for pair in _find_variable(request, text, nodes, "wanted")]
        if not request.pipeline.wanted:
            request.fault("wanted", "is empty: nothing would be computed")
        return tuple(dict.fromkeys(found))
    used = {(source, variable) for n in nodes for bound in n.inputs for _, source, variable in bound}
    last = {v: n.name for n in nodes for v in n.writes}
    return tuple(
        (n.name, v)
        for n in nodes
        for v, d in n.writes.items()
        if not d.optional and (n.is_probe or ((n.name, v) not in used and last[v] == n.name))
    )


def _find_variable(request: Request, text: str, nodes: list[Node], place: str) -> tuple[tuple[str, str], ...]:
    """Return the (stage, variable) pairs that a text under ``wanted`` or ``keep`` selects."""
    stage, dot, variable = text.partition(".")
    if dot:
        node = next((n for n in nodes if n.name == stage), None)
        if node is None and not request.whole:
            return ()
        if node is None:
            request.fault(place, f"the pipeline has no stage {stage!r}{nearest(stage, [n.name for n in nodes])}")
            return ()
        if variable not in node.writes:
            request.fault(place, f"{stage} does not write {variable!r}; it writes {', '.join(node.writes)}")
            return ()
        return ((stage, variable),)
    for node in reversed(nodes):
        if text in node.writes:
            return ((node.name, text),)
    for node in nodes:
        if node.name == text:  # a stage's name means all it writes
            return tuple((text, variable) for variable in node.writes)
    if not request.whole:
        return ()
    if any(text in node.optional for node in nodes):
        request.fault(place, f"{text} is optional: request it under 'wanted'")
        return ()
    known = sorted({v for n in nodes for v in n.writes} | {n.name for n in nodes})
    request.fault(place, f"no stage of this pipeline writes {text!r}{nearest(text, known)}")
    return ()


def _prune(nodes: list[Node], wanted: tuple[tuple[str, str], ...]) -> list[Node]:
    """Return only the nodes that a wanted variable depends on."""
    by_name = {node.name: node for node in nodes}
    needed: set[str] = set()
    open_ = [name for name, _ in wanted]
    while open_:
        name = open_.pop()
        if name in needed:
            continue
        needed.add(name)
        node = by_name[name]
        open_ += [source for bound in node.inputs for _, source, _ in bound]
        open_ += [n for _, _, names in node.looks_at for n in names]
    return [node for node in nodes if node.name in needed]


def _seen_only(nodes: list[Node], wanted: tuple[tuple[str, str], ...]) -> frozenset[str]:
    """Return the nodes whose values no wanted variable depends on: probes only look at their stages (a transfer
    function, a datasheet), which are known without running them.
    """
    by_name = {node.name: node for node in nodes}
    computed: set[str] = set()
    seen: set[str] = set()
    open_ = [name for name, _ in wanted]
    while open_:
        name = open_.pop()
        if name in computed:
            continue
        computed.add(name)
        node = by_name[name]
        open_ += [source for bound in node.inputs for _, source, _ in bound] + list(node.found.values())
        for _, what, names in node.looks_at:
            if looks_at_stages(what):
                seen |= set(names)
            else:
                open_ += names
        # A stage is known only if the values that other stages find for it are known: those of the stages looked at and
        # of all before them.
        open_ += [finder for other in _with_inputs(by_name, seen) for finder in by_name[other].found.values()]
    return frozenset(by_name) - computed


def _with_inputs(by_name: dict[str, Node], names: set[str]) -> set[str]:
    """Return some nodes and all nodes that they depend on."""
    found: set[str] = set()
    open_ = list(names)
    while open_:
        name = open_.pop()
        if name not in found:
            found.add(name)
            open_ += [source for bound in by_name[name].inputs for _, source, _ in bound]
    return found
