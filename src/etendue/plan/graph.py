"""Pipeline and registry to a graph of nodes. Every fault of the file is gathered before anything is raised.

In:  a ``Pipeline`` (values as written) and a ``Registry``.
Out: nodes in order, axes, camera values, wanted and kept variables; or one ``RequestError`` with all faults.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from etendue.errors import Fault, PluginError, RequestError, nearest
from etendue.plan.keys import code_digest
from etendue.plan.model import Alternative, Axis, Node
from etendue.plan.parameters import Unfit, axis_values, expected, resolve
from etendue.registry import Registry
from etendue.spec import camera as standard_camera
from etendue.spec.pipeline import Pipeline, StageEntry
from etendue.spec.stage import MISSING, Parameter, Probe, Stage, ends_in_sum, is_transfer, parameters_of, reads_of, writes_of
from etendue.spec.units import as_written
from etendue.spec.variables import Declaration


@dataclass
class Graph:
    """A checked pipeline: what the planner expands into cells."""

    nodes: tuple[Node, ...]
    axes: tuple[Axis, ...]
    camera: dict[str, Any]
    wanted: tuple[tuple[str, str], ...]
    keep: tuple[str, ...] | None
    warnings: tuple[str, ...]


def build_graph(pipeline: Pipeline, registry: Registry) -> Graph:
    """Check a pipeline wholly; raises ``RequestError`` with every fault."""
    return _Builder(pipeline, registry).build()


class _Builder:
    def __init__(self, pipeline: Pipeline, registry: Registry) -> None:
        self.pipeline = pipeline
        self.registry = registry
        self.faults: list[Fault] = list(pipeline.faults)
        self.whole = pipeline.whole  # whether what every stage writes is known: else nothing is concluded from a lack
        self.warnings: list[str] = []
        self.axes: list[Axis] = []
        self.camera: dict[str, Any] = {}

    def fault(self, place: str, message: str) -> None:
        self.faults.append(Fault(place, message))

    # -- stages and parameters ------------------------------------------------------------------------

    def no_stage(self, use: str) -> str:
        hint = nearest(use, self.registry.names()) or f"; {len(self.registry.names())} are installed, listed by: etendue stages"
        return f"there is no stage {use!r}{hint}"

    def load(self, use: str, place: str) -> type[Stage] | None:
        if use not in self.registry:
            self.fault(place, self.no_stage(use))
            return None
        clash = self.registry.clash(use)
        if clash:
            self.fault(place, f"the stage {use!r} is offered by {' and '.join(clash)}; uninstall one of them")
            return None
        try:
            return self.registry.load(use)
        except PluginError as error:
            self.fault(place, str(error))
            return None

    def alternative(self, stage: str, use: str, label: str, written: Mapping[str, Any], place: str) -> Alternative | None:
        kind = self.load(use, place)
        if kind is None:
            return None
        declared = parameters_of(kind)
        own = [name for name, (parameter, _, _) in declared.items() if not parameter.camera]
        values: dict[str, Any] = {}
        for name, value in written.items():
            if name not in declared:
                hint = nearest(name, own)
                if name in standard_camera.names():
                    hint = f"; {name} is a camera quantity: set it under [camera]"
                else:
                    hint = hint or ("; see: etendue stages " + use if own else "; it has none of its own")
                self.fault(f"{place}.{name}", f"{use} has no parameter {name!r}{hint}")
            elif declared[name][0].camera:
                self.fault(f"{place}.{name}", f"{name} is shared by several stages: set camera.{name} under [camera]")
            else:
                try:
                    values[name] = resolve(value, declared[name][0], declared[name][1], self.pipeline.folder)
                except Unfit as error:
                    self.fault(f"{place}.{name}", str(error))
                    values[name] = None
        swept = {key.partition(".")[2] for key in self.pipeline.sweep if key.partition(".")[0] == stage}
        for name in own:
            if name not in values:
                if declared[name][2] is MISSING and name not in swept:
                    self.fault(place, f"{use} needs {name!r}: {_meaning(declared[name][0])}")
                values[name] = None if declared[name][2] is MISSING else declared[name][2]
        installed = self.registry.installed(use)
        digest = code_digest(kind)
        return Alternative(use, label, kind, values, installed.distribution, installed.version, digest)

    def alternatives(self, entry: StageEntry) -> tuple[tuple[Alternative, ...], str | None]:
        key = f"{entry.name}.use"
        if key not in self.pipeline.sweep:
            one = self.alternative(entry.name, entry.use, entry.use, entry.values, entry.place)
            return ((one,) if one else ()), None
        place = f"sweep.{key}"
        values = self.pipeline.sweep[key]
        if entry.use not in self.registry:
            self.fault(entry.place, self.no_stage(entry.use))
        if isinstance(values, str) or not isinstance(values, list | tuple) or not values:
            self.fault(place, f"expected a list of stages, got {as_written(values)}")
            return (), None
        made, labels = [], []
        for value in values:
            table = {"use": value} if isinstance(value, str) else value
            if not isinstance(table, dict) or not isinstance(table.get("use"), str):
                self.fault(place, f"expected a stage's name or a table with 'use', got {as_written(value)}")
                continue
            label = str(table.get("label", table["use"]))
            own = {k: v for k, v in table.items() if k not in ("use", "label")}
            if label in labels:
                self.fault(place, f"{label!r} stands twice; give one of them another 'label'")
                continue
            labels.append(label)
            shared = entry.values if table["use"] == entry.use else {}  # the stage's own table belongs to its own 'use'
            one = self.alternative(entry.name, table["use"], label, {**shared, **own}, place)
            if one:
                made.append(one)
        if made:
            self.same_writes(made, place)
        self.axes.append(Axis(key, entry.name, tuple(labels)))
        return tuple(made), entry.name

    def same_writes(self, made: list[Alternative], place: str) -> None:
        first = {str(d) for d in writes_of(made[0].kind).values()}
        for other in made[1:]:
            own = {str(d) for d in writes_of(other.kind).values()}
            for one, has, another, lacks in ((other, own, made[0], first), (made[0], first, other, own)):
                if has - lacks:
                    self.fault(place, f"{one.use} writes {_some(has - lacks)}, which {another.use} does not; alternatives write the same")
            if own == first and is_transfer(other.kind) != is_transfer(made[0].kind):
                self.fault(place, f"of {other.use} and {made[0].use} only one is a transfer function; sweep them in two files")

    # -- camera and sweep -----------------------------------------------------------------------------

    def resolve_camera(self, stages: list[tuple[Alternative, ...]]) -> None:
        declared: dict[str, tuple[Any, Any, Any, str]] = {}
        for alternatives in stages:
            for one in alternatives:
                for name, (parameter, kind, default) in parameters_of(one.kind).items():
                    if not parameter.camera:
                        continue
                    if name in declared and declared[name][0].units != parameter.units:
                        self.fault(
                            f"camera.{name}",
                            f"{one.use} takes it in {parameter.units}, but {declared[name][3]} in {declared[name][0].units}",
                        )
                    declared.setdefault(name, (parameter, kind, default, one.use))
        given = {**self.pipeline.preset, **self.pipeline.camera}
        for name, value in given.items():
            if name not in declared:
                if name not in self.pipeline.camera:
                    continue  # a sensor has more sides than a pipeline may ask for
                if name in standard_camera.names():
                    self.warnings.append(f"camera.{name} is not used by any stage of this pipeline")
                else:
                    self.fault(f"camera.{name}", f"unknown camera quantity{nearest(name, ['sensor', *declared, *standard_camera.names()])}")
                continue
            parameter, kind, _, _ = declared[name]
            try:
                self.camera[name] = resolve(value, parameter, kind, self.pipeline.folder)
            except Unfit as error:
                self.fault(f"camera.{name}", str(error))
        for name, (_, _, default, use) in declared.items():
            if name not in given:
                if default is MISSING and name not in self.pipeline.sweep:
                    self.fault(f"camera.{name}", f"{use} needs it under [camera]: {_meaning(declared[name][0])}")
                self.camera[name] = None if default is MISSING else default
        self.camera_declared = declared
        self.found: dict[str, tuple[str, str]] = {}  # quantities that a stage finds itself: which stage, and what to do instead

    def check_found(self, entries: dict[str, tuple[Alternative, ...]]) -> None:
        """A camera quantity that one stage finds from the light cannot be given to another."""
        for name, made in entries.items():
            for one in made:
                self.found.update({quantity: (name, instead) for quantity, instead in one.kind.finds.items()})
        for name, made in entries.items():
            for one in made:
                for quantity in self.found.keys() & parameters_of(one.kind).keys():
                    finder, instead = self.found[quantity]
                    other = f"{one.use}_metered"
                    hint = f"; use {other}" if other in self.registry else ""
                    self.fault(
                        f"stages.{name}",
                        f"{one.use} takes camera.{quantity}, which {finder!r} finds: {instead.replace('<stage>', finder)}{hint}",
                    )

    def resolve_axes(self, entries: dict[str, tuple[Alternative, ...]]) -> dict[str, list[tuple[str, str]]]:
        """Axes besides ``.use``, and which parameters of which stage each of them sets."""
        direct: dict[str, list[tuple[str, str]]] = {}
        by_key = {axis.key: axis for axis in self.axes}
        ordered: list[Axis] = []
        for key, value in self.pipeline.sweep.items():
            if key in by_key:
                ordered.append(by_key[key])
                continue
            stage, dot, name = key.partition(".")
            place = f"sweep.{key}"
            if dot and stage == "camera" and name in self.camera_declared:
                self.fault(place, f"camera quantities are swept by their own name: sweep.{name}")
                continue
            if dot:
                if stage not in entries:
                    self.fault(place, f"there is no stage named {stage!r}{nearest(stage, entries)}")
                    continue
                if name == "use" or not entries[stage]:
                    continue
                holders = [one for one in entries[stage] if name in parameters_of(one.kind)]
                if not holders:
                    own = [n for n, (p, _, _) in parameters_of(entries[stage][0].kind).items() if not p.camera]
                    self.fault(place, f"{stage} has no parameter {name!r}{nearest(name, own)}")
                    continue
                parameter, kind, _ = parameters_of(holders[0].kind)[name]
                if parameter.camera:
                    self.fault(place, f"{name} is a camera quantity: sweep it by its own name")
                    continue
                dim, users = f"{stage}_{name}", [stage]
            else:
                if key in self.found:
                    finder, instead = self.found[key]
                    self.fault(place, f"{finder!r} finds {key} itself: {instead.replace('<stage>', finder)}")
                    continue
                if key not in self.camera_declared:
                    known = [*self.camera_declared, *(f"{s}.use" for s in entries)]
                    if not self.whole:
                        continue
                    if key in standard_camera.names():
                        self.fault(place, "an axis of nothing: no stage of this pipeline depends on it; leave it out")
                    else:
                        self.fault(place, f"there is nothing named {key!r} to sweep{nearest(key, known)}")
                    continue
                parameter, kind, _, _ = self.camera_declared[key]
                dim, name = key, key
                users = [s for s, made in entries.items() if any(key in parameters_of(o.kind) for o in made)]
            try:
                values = axis_values(value, parameter, kind, self.pipeline.folder)
            except Unfit as error:
                self.fault(place, str(error))
                continue
            if values and isinstance(values[0], tuple):
                values = tuple(" ".join(map(str, v)) for v in values)
                self.fault(place, "a list of several values per step cannot be an axis")
            ordered.append(Axis(key, dim, values, parameter.units))
            for user in users:
                direct.setdefault(user, []).append((dim, name))
        self.axes = ordered
        return direct

    # -- graph ----------------------------------------------------------------------------------------

    def bind(self, entry: StageEntry, one: Alternative, earlier: list[Node], all_names: list[str]) -> tuple[tuple[str, str, str], ...]:
        """Which earlier node writes each port of an alternative."""
        bound = []
        reads = reads_of(one.kind)
        for port in entry.origin:
            if port not in reads:
                self.fault(f"{entry.place}.from", f"{one.use} has no port {port!r}{nearest(port, reads)}")
        for port, declaration in reads.items():
            variable = declaration.variable
            if variable.startswith("*."):
                continue
            if port in entry.origin:
                source = entry.origin[port]
                node = next((n for n in earlier if n.name == source), None)
                if node is None:
                    if source not in all_names:
                        before = [n.name for n in earlier if variable in n.writes]
                        self.fault(f"{entry.place}.from.{port}", f"there is no stage {source!r}{nearest(source, before)}")
                    elif all_names.index(source) >= all_names.index(entry.name):
                        self.fault(
                            f"{entry.place}.from.{port}",
                            f"{source!r} stands {'later' if source != entry.name else 'here'}; a stage reads what an earlier one writes, "
                            "so there are no cycles",
                        )
                    continue
                if variable not in node.writes:
                    before = [n.name for n in earlier if variable in n.writes]
                    hint = f"; {variable} is written by {', '.join(before)}" if before else ""
                    self.fault(f"{entry.place}.from.{port}", f"{source!r} writes {', '.join(node.writes)}, not {variable}{hint}")
                    continue
            else:
                node = next((n for n in reversed(earlier) if variable in n.writes), None)
                if node is None:
                    if not self.whole:
                        continue
                    writers = self.writers_of(variable)
                    hint = f"; put one of these before it: {', '.join(writers)}" if writers else ""
                    self.fault(entry.place, f"{one.use} reads {variable}, but no earlier stage writes it{hint}")
                    continue
            written = node.writes[variable]
            if not declaration.accepts(written.dims) or declaration.unit != written.unit or declaration.dtype != written.dtype:
                self.fault(
                    entry.place,
                    f"{one.use} reads {variable} as '{declaration}', but {node.name!r} writes '{written}'; "
                    f"put a stage between them that converts it",
                )
            bound.append((port, node.name, variable))
        return tuple(bound)

    def writers_of(self, variable: str) -> list[str]:
        found = []
        for name in self.registry.names():
            try:
                if variable in writes_of(self.registry.load(name)) and variable not in {
                    d.variable for d in reads_of(self.registry.load(name)).values()
                }:
                    found.append(name)
            except PluginError:
                continue
        return found[:6]

    def build(self) -> Graph:
        pipeline = self.pipeline
        entries: dict[str, tuple[Alternative, ...]] = {}
        use_axes: dict[str, str | None] = {}
        for entry in pipeline.stages:
            entries[entry.name], use_axes[entry.name] = self.alternatives(entry)
            self.whole = self.whole and bool(entries[entry.name])
        self.resolve_camera(list(entries.values()))
        self.check_found(entries)
        direct = self.resolve_axes(entries)
        nodes = self.link(entries, use_axes, direct)
        self.try_values(nodes)
        wanted = self.wanted_of(nodes)
        self.check_keep(nodes)
        if wanted and self.whole:
            nodes = _prune(nodes, wanted)
            reached = {dim for node in nodes for dim in node.axes}
            for axis in self.axes:
                if axis.dim not in reached:
                    self.warnings.append(f"sweep.{axis.key} is not swept: nothing that is wanted depends on it")
            self.axes = [axis for axis in self.axes if axis.dim in reached]
        if self.faults:
            raise RequestError(self.faults, pipeline.file)
        return Graph(tuple(nodes), tuple(self.axes), self.camera, wanted, pipeline.keep, tuple(self.warnings))

    def try_values(self, nodes: list[Node]) -> None:
        """What a stage itself refuses about its values, for every stage at once; swept ones at their first value."""
        first = {axis.dim: axis.values[0] for axis in self.axes}
        for node in nodes:
            for one in node.alternatives:
                camera = {name: self.camera.get(name) for name, (p, _, _) in parameters_of(one.kind).items() if p.camera}
                swept = {name: first[dim] for dim, name in node.direct if dim in first and name in parameters_of(one.kind)}
                values = {**camera, **one.values, **swept}
                if any(value is None for value in values.values()):
                    continue  # already a fault
                try:
                    one.kind(**values)
                except (ValueError, TypeError) as error:
                    self.fault(node.place, f"{one.use}: {error}")

    def link(
        self,
        entries: dict[str, tuple[Alternative, ...]],
        use_axes: dict[str, str | None],
        direct: dict[str, list[tuple[str, str]]],
    ) -> list[Node]:
        nodes: list[Node] = []
        names = [entry.name for entry in self.pipeline.stages]
        order = [axis.dim for axis in self.axes]
        for number, entry in enumerate(self.pipeline.stages, 1):
            made = entries[entry.name]
            if not made:
                continue
            inputs = tuple(self.bind(entry, one, nodes, names) for one in made)
            looks_at = self.looks(made[0].kind, nodes)
            reach = {dim for dim, _ in direct.get(entry.name, [])} | ({entry.name} if use_axes[entry.name] else set())
            for source in {b[1] for bound in inputs for b in bound} | {n for _, what, ns in looks_at if what != "transfer" for n in ns}:
                reach |= set(next(n for n in nodes if n.name == source).axes)
            for looked in (n for n in nodes for _, what, ns in looks_at if what == "transfer" and n.name in ns):
                # a transfer function depends on its stage, and on the wavelengths of the scenes in front of it
                for n in [looked, *(s for s in _ancestors(looked, nodes) if s.is_source)]:
                    reach |= {dim for dim, _ in n.direct} | ({n.use_axis} if n.use_axis else set())
            node = Node(
                name=entry.name,
                number=number,
                place=entry.place,
                alternatives=made,
                direct=tuple(direct.get(entry.name, [])),
                use_axis=use_axes[entry.name],
                inputs=inputs,
                looks_at=looks_at,
                writes=self.resolved_writes(entry, made, inputs, nodes),
                axes=tuple(dim for dim in order if dim in reach),
            )
            nodes.append(replace(node, segment=_segment(node, nodes)))
        return nodes

    def resolved_writes(
        self, entry: StageEntry, made: tuple[Alternative, ...], inputs: tuple[tuple[tuple[str, str, str], ...], ...], earlier: list[Node]
    ) -> dict[str, Declaration]:
        """What a stage writes, ``...`` replaced by the leading dims of what it reads."""
        by_name = {node.name: node for node in earlier}
        found: list[dict[str, Declaration]] = []
        for one, bound in zip(made, inputs, strict=True):
            reads = reads_of(one.kind)
            leading = {reads[port].leading(by_name[source].writes[variable].dims) for port, source, variable in bound} - {()}
            if len(leading) > 1:
                self.fault(
                    entry.place, f"{one.use} reads {' and '.join(' '.join(dims) for dims in sorted(leading))}: the same dims must lead"
                )
            dims = min(leading, default=())
            found.append({d.variable: d.led_by(dims) for d in writes_of(one.kind).values()})
        return found[0]

    def looks(self, kind: type[Stage], earlier: list[Node]) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
        """What a probe looks at: (port, 'transfer' or variable, nodes in order)."""
        found = []
        for port, declaration in reads_of(kind).items():
            if not declaration.variable.startswith("*."):
                continue
            what = declaration.variable.removeprefix("*.")
            if not issubclass(kind, Probe):
                self.fault(port, f"{kind.__name__} reads {declaration.variable}; only a Probe may look at all stages")
            if what == "transfer":
                chosen = tuple(n.name for n in earlier if n.is_transfer)
            else:
                chosen = tuple(n.name for n in earlier if what in n.writes and not n.is_probe)
            found.append((port, what, chosen))
        return tuple(found)

    def find_variable(self, text: str, nodes: list[Node], place: str) -> tuple[tuple[str, str], ...]:
        stage, dot, variable = text.partition(".")
        if dot:
            node = next((n for n in nodes if n.name == stage), None)
            if node is None and not self.whole:
                return ()
            if node is None:
                self.fault(place, f"there is no stage {stage!r}{nearest(stage, [n.name for n in nodes])}")
                return ()
            if variable not in node.writes:
                self.fault(place, f"{stage} has no {variable!r}; it writes {', '.join(node.writes)}")
                return ()
            return ((stage, variable),)
        for node in reversed(nodes):
            if text in node.writes:
                return ((node.name, text),)
        for node in nodes:
            if node.name == text:  # a stage's name means all it writes
                return tuple((text, variable) for variable in node.writes)
        if not self.whole:
            return ()
        known = sorted({v for n in nodes for v in n.writes} | {n.name for n in nodes})
        self.fault(place, f"no stage of this pipeline writes {text!r}{nearest(text, known)}")
        return ()

    def wanted_of(self, nodes: list[Node]) -> tuple[tuple[str, str], ...]:
        if self.pipeline.wanted is not None:
            found = [pair for text in self.pipeline.wanted for pair in self.find_variable(text, nodes, "wanted")]
            if not self.pipeline.wanted:
                self.fault("wanted", "is empty: nothing would be computed")
            return tuple(dict.fromkeys(found))
        used = {(source, variable) for n in nodes for bound in n.inputs for _, source, variable in bound}
        last = {v: n.name for n in nodes for v in n.writes}
        return tuple((n.name, v) for n in nodes for v in n.writes if n.is_probe or ((n.name, v) not in used and last[v] == n.name))

    def check_keep(self, nodes: list[Node]) -> None:
        for text in self.pipeline.keep or ():
            self.find_variable(text, nodes, "keep")


def _some(declarations: set[str]) -> str:
    """The first of some declarations, and how many more there are."""
    ordered = sorted(declarations)
    more = f" and {len(ordered) - 1} more" if len(ordered) > 1 else ""
    return f"'{ordered[0]}'{more}"


def _meaning(parameter: Parameter) -> str:
    """What a value that is lacking must be: meaning, unit, range."""
    return f"{parameter.doc}{expected(parameter)}".removeprefix(", ").strip() or "it has no default"


def _segment(node: Node, earlier: list[Node]) -> tuple[str, ...]:
    """Names of the transfer nodes joined before this one, and itself; () where it is no transfer function."""
    if not node.is_transfer or not node.inputs[0]:
        return ()
    source = next(n for n in earlier if n.name == node.inputs[0][0][1])
    if source.is_transfer and not ends_in_sum(source.kind):
        return (*source.segment, node.name)
    return (node.name,)


def _ancestors(node: Node, nodes: list[Node]) -> list[Node]:
    """Every node that a node reads from, at any distance."""
    by_name = {n.name: n for n in nodes}
    found: dict[str, Node] = {}
    open_ = [node]
    while open_:
        for source in {s for bound in open_.pop().inputs for _, s, _ in bound} - set(found):
            found[source] = by_name[source]
            open_.append(by_name[source])
    return list(found.values())


def _prune(nodes: list[Node], wanted: tuple[tuple[str, str], ...]) -> list[Node]:
    """Only the nodes that a wanted variable depends on."""
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


def resolve_keep(nodes: tuple[Node, ...], keep: tuple[str, ...] | None) -> frozenset[tuple[str, str]]:
    """The (stage, variable) pairs to store. A bare variable means every stage's; a stage's name, all it writes."""
    everything = [(n.name, v) for n in nodes for v in n.writes]
    if keep is None:
        return frozenset(everything)
    chosen = set()
    for stage, variable in everything:
        if variable in keep or stage in keep or f"{stage}.{variable}" in keep:
            chosen.add((stage, variable))
    return frozenset(chosen)
