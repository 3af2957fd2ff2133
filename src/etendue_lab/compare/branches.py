"""A pipeline extended by a reference: the same light, noise-free and at every pixel, through the same later stages.

In:  a pipeline without a sweep, its nodes, the compared stage.
Out: the pipeline with the reference's stages appended, and the pairs of variables to compare.

The reference branches off at ``photon_rate`` and has every channel at every pixel: no mask, an ideal exposure, no
demosaicing; every later stage is duplicated. Before the demosaicer, corrections of the mosaic are applied to each full
plane separately, as if it were the mosaic of a sensor with one filter. Stages that move charge behind the mask are
replaced by a stage of the same role on ``photon_rate``. Both branches read the same light, white and colour matrix,
computed once. If the compared stage is in both branches, its axis also drives the reference's stage.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of, quantities_of, reads_of
from etendue.errors import PluginError, RequestError
from etendue.pipeline.derived import each, free_name
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.plan import stage_calls
from etendue.plan.model import Node, StageVariable
from etendue.plan.wiring.graph import Graph, build_graph
from etendue.plan.wiring.quantities import to_be_found
from etendue.types.documents import Document, DocumentView
from etendue_camera.roles import REFERENCE, RESTORING
from etendue_camera.sensor import cfa
from etendue_lab.compare import installed

CAMERA, TRISTIMULUS = "rgb_camera", "xyz_scene"
LIGHT, CHARGE, MOSAIC = "photon_rate", "photocurrent", "mosaic_linear"
PLANE = (MOSAIC, "clipping_level")  # variables that differ between planes: values and clipping level
PICTURES = (CAMERA, TRISTIMULUS, "rgb_linear", "xyz_display", "rgb_display")


@dataclass(frozen=True)
class Pair:
    """A variable of the pipeline, and its counterpart in the reference."""

    ours: StageVariable
    reference: StageVariable


@dataclass(frozen=True)
class Branched:
    """The extended pipeline, and the measurement at each stage."""

    pipeline: PipelineFile
    nodes: tuple[Node, ...]  # of the original pipeline
    linear: Pair  # the result of the alternatives
    display: Pair | None  # the encoded picture
    colour: Pair | None  # tristimulus values after white balance
    without: str  # the compared stage, if the reference omits it
    counterpart: str  # the reference's copy of the compared stage; '' if both branches share it, or there is none
    notes: tuple[str, ...]

    def axes(self, key: str, values: Sequence[object] | None) -> Document:
        """Return the sweep entries that apply an axis to both branches: one for the compared stage and one for its copy
        in the reference, if there is one.
        """
        name = key.rpartition(".")[2]
        return {key: values} | ({f"{self.counterpart}.{name}": values} if self.counterpart else {})

    def places(self) -> tuple[StageVariable, ...]:
        pairs = [pair for pair in (self.linear, self.display, self.colour) if pair]
        return tuple(dict.fromkeys(place for pair in pairs for place in (pair.ours, pair.reference)))


def nodes_of(pipeline: PipelineFile, registry: Registry) -> tuple[Node, ...]:
    """Return the stages of a pipeline as the planner binds them; raises with every fault of the file."""
    return graph_of(pipeline, registry).nodes


def graph_of(pipeline: PipelineFile, registry: Registry) -> Graph:
    """Check the pipeline and return its graph; faults carry their lines."""
    try:
        return build_graph(pipeline, registry)
    except RequestError as error:
        raise RequestError(pipeline.located(error.faults), pipeline.file) from None


def writer(nodes: tuple[Node, ...], variable: str) -> Node | None:
    """Return the last stage that writes a variable."""
    return next((node for node in reversed(nodes) if variable in node.writes and not node.is_probe), None)


def makes(nodes: tuple[Node, ...], variable: str) -> Node | None:
    """Return the last stage that writes a variable without reading it."""
    return next((n for n in reversed(nodes) if variable in n.writes and variable not in _read(n)), None)


def _read(node: Node) -> set[str]:
    return {variable for _, _, variable in node.inputs[0]}


def noise_free(pipeline: PipelineFile, nodes: tuple[Node, ...], registry: Registry) -> PipelineFile:
    """Return a pipeline that computes expected values. The stage that makes ``mosaic_linear`` is replaced by an ideal
    exposure that reads ``photocurrent`` directly and so bypasses noise and converter.
    """
    linear = makes(nodes, MOSAIC)
    if linear is None or writer(nodes, CHARGE) is None or linear.kind.role == REFERENCE:
        return pipeline
    use = installed.reference(registry, CHARGE, MOSAIC, ("y", "x"))
    return each(pipeline, lambda e: StageEntry(e.name, use, {}, {}, e.place) if e.name == linear.name else e)


def with_reference(pipeline: PipelineFile, nodes: tuple[Node, ...], key: str, registry: Registry) -> Branched:
    """Add the reference's stages for a comparison along the axis ``key``.

    Raises
    ------
    RequestError
        The pipeline has no ``photon_rate``, or no stage makes ``rgb_camera`` from it.
    """
    demosaic, light = makes(nodes, CAMERA), writer(nodes, LIGHT)
    if demosaic is None or light is None:
        lacking = LIGHT if light is None else CAMERA
        raise RequestError(
            f"no stage writes {lacking}: the reference needs a pixel stage and a demosaicer",
            pipeline.file,
        )
    made = ReferenceBranch(pipeline, nodes, key, registry)
    made.planes(light, demosaic)
    made.behind(demosaic)
    twin, compared = made.twin, key.rpartition(".")[0]

    def pair(node: Node | None, variable: str) -> Pair | None:
        return (
            Pair((node.name, variable), (twin[node.name], variable)) if node is not None and node.name in twin else None
        )

    at = next((n for n in nodes if n.name == compared and n.name in twin), None)
    own = next((v for v in PICTURES if at is not None and v in at.writes), None)
    if at is not None and own == CAMERA and made.without:
        linear = Pair((at.name, CAMERA), (twin[at.name], CAMERA))
    else:
        last = pair(at, own) if own else pair(writer(nodes, CAMERA), CAMERA)
        assert last is not None  # the demosaicer writes rgb_camera and has a twin
        linear = last
    branched = replace(pipeline, stages=(*pipeline.stages, *made.added))
    display, colour = (pair(writer(nodes, variable), variable) for variable in ("rgb_display", TRISTIMULUS))
    return Branched(branched, nodes, linear, display, colour, made.without, made.counterpart, tuple(made.notes))


class ReferenceBranch:
    """The stages of a reference under construction."""

    def __init__(self, pipeline: PipelineFile, nodes: tuple[Node, ...], key: str, registry: Registry) -> None:
        self.pipeline, self.nodes, self.key, self.registry = pipeline, nodes, key, registry
        self.compared, _, self.parameter = key.rpartition(".")
        self.entries = {entry.name: entry for entry in pipeline.stages}
        self.added: list[StageEntry] = []
        self.stands: dict[str, str] = {}  # stage behind the mask -> its replacement before the mask
        self.twin: dict[str, str] = {}  # from the demosaicer on
        self.without, self.counterpart = "", ""
        self.notes: list[str] = []

    def add(self, node: Node, use: str, origin: Mapping[str, str]) -> str:
        """Add a stage to the reference; parameters that the replaced stage also has are copied from it."""
        own = parameters_of(self.registry.load(use))
        values = {k: v for k, v in self.entries[node.name].values.items() if k in own}
        return self.put(f"reference_{node.name}", use, origin, values)

    def put(self, name: str, use: str, origin: Mapping[str, str], values: DocumentView) -> str:
        name = free_name(name, {*self.entries, *(entry.name for entry in self.added)})
        self.added.append(StageEntry(name, use, dict(values), dict(origin), f"the reference's {name}"))
        return name

    def follow(self, node: Node, use: str, name: str) -> None:
        """If a copy of the compared stage was added to the reference and has the parameter of the axis, record the
        copy, so that the axis also sets the parameter of the copy.
        """
        if node.name == self.compared and self.parameter in parameters_of(self.registry.load(use)):
            self.counterpart = name
        elif node.name == self.compared:
            self.notes.append(f"the reference uses {use} as in the file, for all values of {self.key}")

    def planes(self, light: Node, demosaic: Node, needless: Collection[str] = ()) -> None:
        """Add the reference's stages from the light to the camera channels, with every channel at every pixel.
        Corrections of the mosaic are applied plane by plane, except the stages in ``needless``.
        """
        before = self.nodes[: self.nodes.index(demosaic)]
        source = self.in_front_of_mask(before[self.nodes.index(light) :], light.name)
        no_mask = installed.reference(self.registry, LIGHT, CHARGE, ("channel", "y", "x"))
        source = self.put("reference_planes", no_mask, {LIGHT: source}, {})
        ideal = installed.reference(self.registry, CHARGE, MOSAIC, ("y", "x"))
        found = {name: n.name for n in before for name in quantities_of(self.registry.load(ideal)) if name in n.writes}
        source = self.put("reference_exposure", ideal, {CHARGE: source, **found}, {"clip": False})
        linear = makes(before, MOSAIC)
        at = {(linear.name, variable): source for variable in PLANE if variable in linear.writes} if linear else {}
        for node in before:
            if not _changes(node, MOSAIC):
                continue
            why = "" if node.name in needless else self.why_not(node, light)
            if not why and node.name not in needless:
                bound = {port: at.get((s, v), s) for port, s, v in node.inputs[0]}
                source = self.add(node, node.alternatives[0].use, bound)
                self.follow(node, node.alternatives[0].use, source)
                at |= {(node.name, variable): source for variable in PLANE if variable in node.writes}
                continue
            self.without = node.name if node.name == self.compared else self.without
            self.notes += [f"the reference omits {node.name}, {why}"] if why else []
            at |= {(node.name, v): at[s, v] for _, s, v in node.inputs[0] if v in node.writes and (s, v) in at}
        end = installed.reference(self.registry, MOSAIC, CAMERA, ("channel", "y", "x"))
        self.twin[demosaic.name] = self.put("reference", end, {MOSAIC: source}, {})

    def in_front_of_mask(self, nodes: Sequence[Node], source: str) -> str:
        """Add replacements for stages that move charge behind the mask. Return the last stage added, or the ``source``
        of the light if none is added.
        """
        for node in nodes:
            if not (node.kind.role and _changes(node, CHARGE)):
                continue
            if use := installed.serving(self.registry, node.kind.role, LIGHT, LIGHT):
                source, self.stands[node.name] = self.add(node, use, {LIGHT: source}), use
                self.follow(node, use, source)
        return source

    def why_not(self, node: Node, light: Node) -> str:
        """Return why a correction of the mosaic cannot be run plane by plane; '' if it can."""
        if node.name == self.compared and node.kind.role in RESTORING:
            return "whose effect the reference picture does not need"
        behind = [n for n in self.nodes[self.nodes.index(light) :] if n is not light]
        maps = [
            v
            for _, s, v in node.inputs[0]
            if v != MOSAIC
            for n in behind
            if n.name == s and {"y", "x"} <= set(n.writes[v].dims)
        ]
        if maps:
            return f"which reads {maps[0]}, a picture of the mosaic"
        one, graph = node.alternatives[0], graph_of(self.pipeline, self.registry)
        along = [name for name, p in quantities_of(one.kind).items() if p.along == "channel"]
        values = {name: graph.shared.get(name) for name in quantities_of(one.kind)} | dict(one.values)
        values |= {name: to_be_found(name, quantities_of(one.kind)[name]) for name in node.found}
        for channel in cfa.read(str(graph.shared["pattern"])).channels if along else ():
            try:
                stage_calls.made(one.kind, values | dict.fromkeys(along, channel))
            except (ValueError, PluginError) as error:
                return f"which cannot be run plane by plane: {error}"
        return ""

    def behind(self, demosaic: Node) -> None:
        """Duplicate every stage that works on the output of the demosaicer."""
        for node in self.nodes[self.nodes.index(demosaic) + 1 :]:
            if node.is_probe or not any(s in self.twin for _, s, _ in node.inputs[0]):
                continue
            reads = {d.variable for d in reads_of(node.kind).values() if not d.variable.startswith("*.")}
            restores = reads == {CAMERA} and CAMERA in node.writes and node.kind.role in RESTORING
            if (
                node.name == self.compared and restores
            ):  # a restored picture is compared with a reference that needs no restoration
                self.twin[node.name] = next(self.twin[s] for _, s, v in node.inputs[0] if v == CAMERA)
                self.without = node.name
                self.notes.append(
                    f"the reference omits {node.name} and is as blurred as the light on the pixels: removed blur "
                    "counts as an "
                    f"error here. Gain and cost of a restoration are in mtf50_gain and noise_gain, if its stage writes "
                    "them"
                )
                continue
            origin = {port: self.twin.get(s, s) for port, s, _ in node.inputs[0]}
            self.twin[node.name] = self.add(node, node.alternatives[0].use, origin)
            self.counterpart = self.twin[node.name] if node.name == self.compared else self.counterpart


def _changes(node: Node, variable: str) -> bool:
    return variable in node.writes and variable in _read(node)
