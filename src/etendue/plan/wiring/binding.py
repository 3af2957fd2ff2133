"""Bind ports to the stages that write them: find the variables that a node reads, writes and looks at, and the axes
that affect it.

In:  the alternatives at every stage, the axes, and the parameters that each axis sets.
Out: nodes in the order of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import Datasheet, Probe, Tinting, ends_in_sum, is_seen_as_transfer, is_transfer
from etendue.contract.stage import (
    looks,
    looks_at_stages,
    optional_ports,
    parameters_of,
    quantities_of,
    reads_of,
    writes_of,
)
from etendue.contract.values.units import same_unit
from etendue.errors import nearest
from etendue.pipeline.file import StageEntry
from etendue.plan.model import Alternative, Axis, Node
from etendue.plan.wiring.alternatives import Entries
from etendue.plan.wiring.request import Request

Bound = tuple[tuple[str, str, str], ...]  # (port, node, variable)
Looks = tuple[tuple[str, str, tuple[str, ...]], ...]  # (port, 'transfer', 'datasheet' or variable, nodes in order)


def link(
    request: Request,
    entries: Entries,
    swapped: Mapping[str, Axis],
    axes: list[Axis],
    direct: Mapping[str, list[tuple[str, str]]],
) -> list[Node]:
    """Return one node for every stage of the file that could be loaded."""
    nodes: list[Node] = []
    for number, entry in enumerate(request.pipeline.stages, 1):
        made = entries[entry.name]
        if not made:
            continue
        inputs = tuple(_bind(request, entry, one, nodes) for one in made)
        mapped = _mapped(request, entry, made, inputs, nodes)
        looks_at = _looks(request, made, inputs, nodes)
        use_axis = swapped[entry.name].dim if entry.name in swapped else None
        # An earlier stage writes a parameter that is bound; an axis over it, if there is one, belongs to that stage.
        taken = {
            name
            for one, bound in zip(made, inputs, strict=True)
            for name in parameters_of(one.kind).keys() - {port for port, _, _ in bound}
        }
        own_direct = tuple((dim, name) for dim, name in direct.get(entry.name, []) if name in taken)
        node = Node(
            name=entry.name,
            number=number,
            place=entry.place,
            alternatives=made,
            direct=own_direct,
            use_axis=use_axis,
            inputs=inputs,
            looks_at=looks_at,
            writes={
                d.variable: d if set(mapped) & set(d.dims) else replace(d, dims=(*mapped, *d.dims))
                for d in _written(made)
            },
            axes=(),
            mapped=mapped,
        )
        reach = _own_axes(node) | _reach(node, nodes)
        reached = tuple(axis.dim for axis in axes if axis.dim in reach)
        nodes.append(replace(node, axes=reached, segment=_segment(node, nodes)))
    return nodes


def _bind(request: Request, entry: StageEntry, one: Alternative, earlier: list[Node]) -> Bound:
    """Return the earlier node that writes each port of an alternative."""
    bound = []
    reads, quantities = reads_of(one.kind), quantities_of(one.kind)
    for port in entry.origin:
        if port not in reads and port not in quantities:
            request.fault(f"{entry.place}.from", f"{one.use} has no port {port!r}{nearest(port, reads)}")
    for port, declaration in reads.items():
        variable = declaration.variable
        if looks(declaration):
            continue
        node = (
            _named_writer(request, entry, port, variable, earlier)
            if port in entry.origin
            else _nearest_writer(request, entry, one, port, variable, earlier)
        )
        if node is None:
            continue
        written = node.writes[variable]
        if (
            declaration.mapped(written.dims) is None
            or not same_unit(declaration.unit, written.unit)
            or declaration.dtype != written.dtype
        ):
            request.fault(
                entry.place,
                f"{one.use} reads {variable} as '{declaration}', but {node.name!r} writes '{written}'; "
                f"put a converting stage between them",
            )
        bound.append((port, node.name, variable))
    for name, parameter in quantities.items():
        last = next((n for n in reversed(earlier) if name in n.writes), None)
        writer = _named_writer(request, entry, name, name, earlier) if name in entry.origin else last
        if writer is None:
            continue
        if not same_unit(writer.writes[name].unit, parameter.units) or writer.writes[name].dtype != "float":
            text = f"{one.use} takes {name} in {parameter.units}, but {writer.name!r} writes '{writer.writes[name]}'"
            request.fault(entry.place, text)
        bound.append((name, writer.name, name))
    return tuple(bound)


def _written(made: tuple[Alternative, ...]) -> list[Declaration]:
    """Return the variables that all alternatives write; an optional variable counts if every alternative has it."""
    every = [set(writes_of(one.kind).values()) for one in made]
    return [d for d in writes_of(made[0].kind).values() if not d.optional or all(d in own for own in every)]


def _mapped(
    request: Request, entry: StageEntry, made: tuple[Alternative, ...], inputs: tuple[Bound, ...], earlier: list[Node]
) -> tuple[str, ...]:
    """Return the leading dims of a stage's inputs over which the stage is run slice by slice."""
    by_name = {node.name: node for node in earlier}
    every = [_mapped_over(request, entry, one, bound, by_name) for one, bound in zip(made, inputs, strict=True)]
    if len(set(every)) > 1:
        request.fault(
            entry.place,
            f"alternatives loop over different dims: {' and '.join(' '.join(d) or 'none' for d in set(every))}",
        )
    return every[0]


def _mapped_over(
    request: Request, entry: StageEntry, one: Alternative, bound: Bound, by_name: Mapping[str, Node]
) -> tuple[str, ...]:
    """Return the dims over which one alternative is run slice by slice."""
    reads = reads_of(one.kind)
    found = [reads[port].mapped(by_name[source].writes[v].dims) for port, source, v in bound if port in reads]
    leading = sorted({dims for dims in found if dims}, key=len)
    longest = leading[-1] if leading else ()
    # A quantity with a value per frame adds the dim of frames to the planes that are read with it.
    own = {dim: None for port, source, v in bound if port not in reads for dim in by_name[source].writes[v].dims}
    dims = (*(dim for dim in own if dim not in longest), *longest)
    if any([dim for dim in dims if dim in few] != list(few) for few in leading):
        shown = " and ".join(" ".join(dims) for dims in leading)
        request.fault(entry.place, f"{one.use} reads {shown}: the same dims must lead")
    worked_on = {dim for d in reads.values() for dim in d.dims}
    for d in writes_of(one.kind).values():
        for dim in set(d.dims) & set(dims) - worked_on:
            text = f"{one.use} is run for each {dim} of its inputs, but writes {d.variable} with another {dim}"
            request.fault(entry.place, text)
    return dims


def _named_writer(request: Request, entry: StageEntry, port: str, variable: str, earlier: list[Node]) -> Node | None:
    """Return the node that ``from`` names for a port."""
    source, place = entry.origin[port], f"{entry.place}.from.{port}"
    node = next((n for n in earlier if n.name == source), None)
    before = [n.name for n in earlier if variable in n.writes]
    if node is None:
        names = [each.name for each in request.pipeline.stages]
        if source not in names:
            request.fault(place, f"the pipeline has no stage {source!r}{nearest(source, before)}")
        elif names.index(source) >= names.index(entry.name):
            request.fault(
                place,
                f"{source!r} is {'later in the file' if source != entry.name else 'this stage'}; "
                f"a stage can read only "
                "from earlier stages",
            )
        return None
    if variable not in node.writes:
        hint = f"; {variable} is written by {', '.join(before)}" if before else ""
        request.fault(place, f"{source!r} writes {', '.join(node.writes)}, not {variable}{hint}")
        return None
    return node


def _nearest_writer(
    request: Request, entry: StageEntry, one: Alternative, port: str, variable: str, earlier: list[Node]
) -> Node | None:
    """Return the last node that precedes a stage and writes a variable which that stage reads."""
    node = next((n for n in reversed(earlier) if variable in n.writes), None)
    if node is None and request.whole and port not in optional_ports(one.kind):
        writers = list(request.registry.makers(variable))[:6]
        hint = f"; put one of these before it: {', '.join(writers)}" if writers else ""
        request.fault(entry.place, f"{one.use} reads {variable}, but no earlier stage writes it{hint}")
    return node


def _looks(request: Request, made: tuple[Alternative, ...], inputs: tuple[Bound, ...], earlier: list[Node]) -> Looks:
    """Return the stages that a node looks at: a probe looks at all stages, other stages at the transfer functions that
    their input has passed.

    Datasheets are taken from the stages that the input has passed or, if there are no such stages, from all stages.
    """
    found: dict[tuple[str, str], dict[str, None]] = {}
    for one, bound in zip(made, inputs, strict=True):
        for port, declaration in reads_of(one.kind).items():
            what = looks(declaration)
            if not what:
                continue
            probe = issubclass(one.kind, Probe)
            if not probe and not looks_at_stages(what):
                request.fault(
                    port,
                    f"{one.kind.__name__} reads {declaration.variable}; only a Probe may look at the variables of all "
                    f"stages",
                )
            chosen = _looked_at(what, probe, {source for _, source, _ in bound}, earlier)
            found.setdefault((port, what), {}).update(dict.fromkeys(chosen))
    order = [n.name for n in earlier]
    return tuple((port, what, tuple(sorted(chosen, key=order.index))) for (port, what), chosen in found.items())


def _looked_at(what: str, probe: bool, read: set[str], earlier: list[Node]) -> list[str]:
    """Return the nodes that a port of one alternative looks at."""
    before = _before(read, earlier)
    if what == "transfer":
        looked = [n.name for n in earlier if any(is_seen_as_transfer(a.kind) for a in n.alternatives)]
        return [name for name in looked if probe or name in before]
    if what == "datasheet":
        looked = [n.name for n in earlier if any(issubclass(a.kind, Datasheet) for a in n.alternatives)]
        return [name for name in looked if name in before] or looked
    return [n.name for n in earlier if what in n.writes and not n.is_probe]


def _own_axes(node: Node) -> set[str]:
    """Return the dims that change a node itself."""
    return {dim for dim, _ in node.direct} | ({node.use_axis} if node.use_axis else set())


def _reach(node: Node, earlier: list[Node]) -> set[str]:
    """Return the dims that affect a node through its inputs and the stages that it looks at."""
    read = {source for bound in node.inputs for _, source, _ in bound}
    seen: dict[str, set[str]] = {}
    for _, what, names in node.looks_at:
        seen.setdefault(what if looks_at_stages(what) else "variable", set()).update(names)
    reach: set[str] = set()
    for other in earlier:
        if other.name in read | seen.get("variable", set()):
            reach |= set(other.axes)
        if other.name in seen.get("datasheet", ()):
            reach |= _own_axes(other)
        if other.name in seen.get("transfer", ()):
            reach |= _reach_of_transfer(other, earlier)
    return reach


def _reach_of_transfer(looked: Node, earlier: list[Node]) -> set[str]:
    """Return the dims that a transfer function depends on: the dims of its stage, and the dims of the scenes and
    filters before it, which weight its mean over bands.
    """
    names = _before({source for bound in looked.inputs for _, source, _ in bound}, earlier)
    reach = _own_axes(looked)
    for node in (n for n in earlier if n.name in names):
        if node.is_source or any(issubclass(one.kind, Tinting) for one in node.alternatives):
            reach |= _own_axes(node)
        # It also depends on an axis that chooses among alternatives some of which move light, because for those no
        # product of transfer functions is valid.
        if node.use_axis and len({one.kind.pointwise or is_transfer(one.kind) for one in node.alternatives}) > 1:
            reach.add(node.use_axis)
    return reach


def _before(names: set[str], nodes: list[Node]) -> set[str]:
    """Return these nodes and all nodes that they read from, directly or indirectly."""
    by_name = {n.name: n for n in nodes}
    found: set[str] = set()
    open_ = set(names)
    while open_:
        name = open_.pop()
        found.add(name)
        open_ |= {source for bound in by_name[name].inputs for _, source, _ in bound} - found
    return found


def _segment(node: Node, earlier: list[Node]) -> tuple[str, ...]:
    """Return the names of the transfer nodes joined up to this one, itself last; () if it is not a transfer
    function.
    """
    if not node.is_transfer or not node.inputs[0]:
        return ()
    source = next(n for n in earlier if n.name == node.inputs[0][0][1])
    if source.is_transfer and not ends_in_sum(source.kind) and not node.mapped:
        return (*source.segment, node.name)
    return (node.name,)
