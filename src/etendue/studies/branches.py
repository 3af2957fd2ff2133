"""A pipeline with a reference beside it: the same light, noise-free and at every pixel, through the same later stages.

In:  a pipeline without a sweep, the nodes it becomes, the stage that is compared.
Out: the pipeline with the reference's stages behind its own, and what is to be measured against what.

The reference branches off at ``photon_rate``: `full_planes` stands for everything from the exposure to the demosaicer, and each
stage behind that is there twice. What corrects the mosaic in front of the demosaicer (``X`` or ``X_mosaic``) is replaced by
``X_planes``, where that is installed, and so is what wanders in it. Both branches read one and the same light, white and colour
matrix, computed once. Where the compared stage stands in both branches, its axis reaches the reference's stage too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from etendue.errors import RequestError
from etendue.plan.graph import build_graph
from etendue.plan.model import Node
from etendue.registry import Registry
from etendue.spec.pipeline import Pipeline, StageEntry
from etendue.spec.stage import parameters_of, reads_of

CAMERA, TRISTIMULUS = "rgb_camera", "xyz_scene"
RESTORING = ("", "sharpening", "denoising")  # roles of stages that the reference does without when they are compared
PICTURES = (CAMERA, TRISTIMULUS, "rgb_linear", "xyz_display", "rgb_display")
Place = tuple[str, str]  # stage and variable


@dataclass(frozen=True)
class Pair:
    """A variable of the pipeline, and the same of the reference."""

    ours: Place
    reference: Place


@dataclass(frozen=True)
class Branched:
    """What is measured where."""

    pipeline: Pipeline
    nodes: tuple[Node, ...]  # of the pipeline alone
    linear: Pair  # where the alternatives give their result
    display: Pair | None  # the encoded picture
    colour: Pair | None  # tristimulus values behind the balance
    without: str  # the compared stage, where the reference does without it
    counterpart: str  # what stands for the compared stage in the reference; '' where the two branches share it, or nothing does
    notes: tuple[str, ...]

    def axes(self, key: str, values: Any) -> dict[str, Any]:
        """The lines of a sweep that give an axis to both branches. Nothing depends on more than one of them."""
        name = key.rpartition(".")[2]
        return {key: values} | ({f"{self.counterpart}.{name}": values} if self.counterpart else {})

    def places(self) -> tuple[Place, ...]:
        pairs = [pair for pair in (self.linear, self.display, self.colour) if pair]
        return tuple(dict.fromkeys(place for pair in pairs for place in (pair.ours, pair.reference)))


def nodes_of(pipeline: Pipeline, registry: Registry) -> tuple[Node, ...]:
    """The stages of a pipeline as the planner binds them; raises with every fault of the file."""
    try:
        return build_graph(pipeline, registry).nodes
    except RequestError as error:
        raise RequestError(pipeline.located(error.faults), pipeline.file) from None


def writer(nodes: tuple[Node, ...], variable: str) -> Node | None:
    """The last stage that writes a variable."""
    return next((node for node in reversed(nodes) if variable in node.writes and not node.is_probe), None)


def makes(nodes: tuple[Node, ...], variable: str) -> Node | None:
    """The last stage that writes a variable without reading it."""
    return next((n for n in reversed(nodes) if variable in n.writes and variable not in _read(n)), None)


def _read(node: Node) -> set[str]:
    return {variable for _, _, variable in node.inputs[0]}


def metered(nodes: tuple[Node, ...], use: str) -> str:
    """The form of an ideal stage that goes with a pipeline: ``use``, or the one that reads the time which a metering has found."""
    finds = any("exposure_time" in n.writes and n.writes["exposure_time"].dims == () for n in nodes)
    return f"{use}_metered" if finds else use


def noise_free(pipeline: Pipeline, nodes: tuple[Node, ...]) -> Pipeline:
    """Expected values: what makes ``mosaic_linear`` is replaced, and with it all that stands before it up to the mosaic."""
    linear = makes(nodes, "mosaic_linear")
    if linear is None or writer(nodes, "photocurrent") is None or linear.alternatives[0].use.startswith("ideal_mosaic"):
        return pipeline
    stages = tuple(
        StageEntry(e.name, metered(nodes, "ideal_mosaic"), {}, {}, e.place) if e.name == linear.name else e for e in pipeline.stages
    )
    return replace(pipeline, stages=stages)


def for_planes(node: Node, registry: Registry) -> str:
    """The stage that does to full planes what a stage does to a mosaic, by its name: lens_shading_planes, balance_planes; '' if none."""
    use = node.alternatives[0].use.removesuffix("_mosaic") + "_planes"
    return use if use in registry else ""


def with_reference(pipeline: Pipeline, nodes: tuple[Node, ...], key: str, registry: Registry) -> Branched:
    """Add the reference's stages, where ``key`` is the axis that is compared.

    Raises
    ------
    RequestError
        The pipeline has no ``photon_rate``, or nothing makes ``rgb_camera`` of it.
    """
    demosaic, light = makes(nodes, CAMERA), writer(nodes, "photon_rate")
    if demosaic is None or light is None:
        lacking = "photon_rate" if light is None else CAMERA
        raise RequestError(f"no stage writes {lacking}: the reference needs a pixel stage, and a demosaicer to stand for", pipeline.file)
    compared, _, parameter = key.rpartition(".")
    entries = {entry.name: entry for entry in pipeline.stages}
    added: list[StageEntry] = []
    twin: dict[str, str] = {}
    without, counterpart, notes = "", "", list[str]()

    def add(node: Node | None, use: str, origin: dict[str, str]) -> str:
        """A stage of the reference, with those parameters of the stage that it stands for which it has too."""
        name = _free(entries, f"reference_{node.name}" if node else "reference")
        own = parameters_of(registry.load(use))
        values = {k: v for k, v in entries[node.name].values.items() if k in own} if node else {}
        added.append(StageEntry(name, use, values, origin, f"the reference's {name}"))
        return name

    def corrected(node: Node, name: str) -> str:
        """The reference's stage for planes, where the axis is a parameter that it has too."""
        if node.name != compared:
            return ""
        if parameter in parameters_of(registry.load(for_planes(node, registry))):
            return name
        notes.append(f"in the reference stands {for_planes(node, registry)} as the file says, whatever the value of {key}")
        return ""

    source = light.name
    for node in nodes[nodes.index(light) : nodes.index(demosaic)]:
        if "photocurrent" in node.writes and "photocurrent" in _read(node) and for_planes(node, registry):
            source = add(node, for_planes(node, registry), {"photon_rate": source})
            counterpart = corrected(node, source) or counterpart
    twin[demosaic.name] = add(None, metered(nodes, "full_planes"), {"photon_rate": source})
    for node in nodes[: nodes.index(demosaic)]:
        if "mosaic_linear" not in node.writes or "mosaic_linear" not in _read(node):
            continue
        if for_planes(node, registry):
            twin[demosaic.name] = add(node, for_planes(node, registry), {CAMERA: twin[demosaic.name]})
            counterpart = corrected(node, twin[demosaic.name]) or counterpart
        else:
            notes.append(f"the reference does without {node.name}, which works on the mosaic")
    for node in nodes[nodes.index(demosaic) + 1 :]:
        if node.is_probe or not any(s in twin for _, s, _ in node.inputs[0]):
            continue
        if node.name == compared and _restores(node):
            twin[node.name] = next(twin[s] for _, s, v in node.inputs[0] if v == CAMERA)
            without = node.name
            notes.append(
                f"the reference does without {node.name} and is as blurred as the light on the pixels: what undoes blur counts as an error "
                "here. The stages restore_* write what they gain in mtf50_gain and what it costs in noise_gain"
            )
            continue
        twin[node.name] = add(node, node.alternatives[0].use, {port: twin.get(s, s) for port, s, _ in node.inputs[0]})
        counterpart = twin[node.name] if node.name == compared else counterpart

    def pair(node: Node | None, variable: str) -> Pair | None:
        return Pair((node.name, variable), (twin[node.name], variable)) if node is not None and node.name in twin else None

    at = next((n for n in nodes if n.name == compared and n.name in twin), None)
    own = next((v for v in PICTURES if at is not None and v in at.writes), None)
    if at is not None and own == CAMERA and without:
        linear = Pair((at.name, CAMERA), (twin[at.name], CAMERA))
    else:
        last = pair(at, own) if own else pair(writer(nodes, CAMERA), CAMERA)
        assert last is not None  # the demosaicer writes rgb_camera, and has a twin
        linear = last
    branched = replace(pipeline, stages=(*pipeline.stages, *added))
    display = pair(writer(nodes, "rgb_display"), "rgb_display")
    return Branched(branched, nodes, linear, display, pair(writer(nodes, TRISTIMULUS), TRISTIMULUS), without, counterpart, tuple(notes))


def _restores(node: Node) -> bool:
    """Whether a stage betters camera values and looks at nothing else: the truth it aims at is what it was not needed for."""
    reads = {d.variable for d in reads_of(node.kind).values() if not d.variable.startswith("*.")}
    return reads == {CAMERA} and CAMERA in node.writes and node.kind.role in RESTORING


def _free(entries: dict[str, StageEntry], name: str) -> str:
    while name in entries:
        name += "_"
    return name
