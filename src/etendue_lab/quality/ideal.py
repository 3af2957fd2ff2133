"""The ideal camera of the same scene: the same pipeline with a perfect lens, without noise, converter and mosaic.

In:  a pipeline as written.
Out: another pipeline, the omitted stages, and notes for the comparison.

These stages are omitted: stages that spread or move light before the pixel (blur, aberrations, distortion, glare, the
low-pass filter); shading that the camera corrects; stages that work on camera primaries after the demosaicer
(sharpening, denoising); and stages that estimate white from the mosaic or balance it there, because the ideal camera
uses the true white of its light. The demosaicer is replaced by three stages that work on every channel at every pixel:
no mask, an ideal exposure, no demosaicing; stages that only the demosaicer needed are not computed. The ideal camera
keeps the scene, transmission, uncorrected fall-off, the pixel with its aperture and diffusion, crosstalk behind the
filters, colour and encoding.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

from etendue.contract.capabilities import ends_in_sum, is_transfer
from etendue.contract.registry import Registry
from etendue.contract.stage import Stage, parameters_of, reads_of, writes_of
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.derived import origin_without, wanting, without_stages
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.types.documents import Document, DocumentView
from etendue_camera.roles import DISTORTION, LENS, RESTORING, SHADING, InSilicon
from etendue_lab.compare.axis import without_sweep
from etendue_lab.compare.branches import ReferenceBranch, nodes_of, writer

TIME = "integration_time"
# variables that replace the mosaic, written for all channels
PLANES = {"photocurrent", "mosaic_linear", "clipping_level"}
Kinds = Mapping[str, type[Stage] | None]


@dataclass(frozen=True)
class Ideal:
    """The ideal camera of a pipeline."""

    pipeline: PipelineFile
    left_out: tuple[str, ...]  # names of stages
    replaced: Mapping[str, str]  # name of the stage -> its replacement
    notes: tuple[str, ...]


def ideal_of(
    pipeline: PipelineFile, registry: Registry, without: Collection[str] = (), keep: Collection[str] = ()
) -> Ideal:
    """Build the ideal camera of a pipeline.

    Parameters
    ----------
    pipeline : Pipeline
        As written; the planner reports its faults.
    registry : Registry
    without : names of stages
        Additional stages to omit, such as ``diffusion``.
    keep : names of stages
        Stages to keep although they spread light.

    Raises
    ------
    RequestError
        The pipeline has no pixel stage or no demosaicer, or a name is not one of its stages.
    """
    kinds = {entry.name: _kind(entry, registry) for entry in pipeline.stages}
    _check_names(pipeline, {"--without": without, "--keep": keep}, kinds)
    pixel, demosaic = _pixel_and_demosaicer(pipeline, kinds)
    names = [entry.name for entry in pipeline.stages]
    correcting = [kinds[e.name] for e in pipeline.stages if "mosaic_linear" in _reads(kinds, e) & _writes(kinds, e)]
    shaded = any(kind is not None and kind.role == SHADING for kind in correcting)
    out: dict[str, str] = {}  # name -> reason
    for entry in pipeline.stages:
        why = _why_out(entry, kinds, names, pixel, demosaic, shaded)
        if (why and entry.name not in keep) or entry.name in without:
            out[entry.name] = why or "asked for"
    made = _planes(pipeline, kinds, out, demosaic, registry)
    last = made.added[-1]
    replaced = {demosaic: last.use} | made.stands
    entries: list[StageEntry] = []
    own: dict[str, str] = {}  # last stage of the camera that writes a variable of the planes
    for entry in (e for e in pipeline.stages if e.name not in out and e.name not in made.stands):
        if entry.name == demosaic:
            entries += [*made.added[:-1], replace(entry, use=last.use, values={}, origin=last.origin)]
            continue
        kind = kinds[entry.name]
        bound = {port: own[d.variable] for port, d in reads_of(kind).items() if d.variable in own} if kind else {}
        entries.append(replace(entry, origin=bound | origin_without(pipeline, entry, {*out, *made.stands})))
        own |= dict.fromkeys(_writes(kinds, entry) & PLANES, entry.name)
    ideal = replace(
        wanting(pipeline),
        stages=tuple(entries),
        shared=_asked_for(pipeline.shared, entries, registry),
        sweep=_asked_for(_still_there(pipeline.sweep, out, replaced), entries, registry),
        lines={},
    )
    return Ideal(ideal, tuple(out), replaced, (*_notes(pipeline, kinds, out, shaded), *made.notes))


def _pixel_and_demosaicer(pipeline: PipelineFile, kinds: Kinds) -> tuple[str, str]:
    pixel = _first(pipeline, lambda e: "photon_rate" in _writes(kinds, e))
    demosaic = _first(pipeline, lambda e: "rgb_camera" in _writes(kinds, e) - _reads(kinds, e))
    if pixel is None or demosaic is None:
        lacking = "no stage that writes photon_rate" if pixel is None else "no demosaicer (no stage writes rgb_camera)"
        raise RequestError(
            f"the pipeline has {lacking}: it has no picture to compare with the picture of the ideal camera",
            pipeline.file,
        )
    return pixel, demosaic


def _why_out(entry: StageEntry, kinds: Kinds, names: list[str], pixel: str, demosaic: str, shaded: bool) -> str:
    """Return the reason why a stage is omitted from the ideal camera; '' if it is kept."""
    kind, own = kinds[entry.name], _reads(kinds, entry) & _writes(kinds, entry)
    if kind is None:
        return ""
    before_pixel = names.index(entry.name) < names.index(pixel)
    if before_pixel and "irradiance" in own and not issubclass(kind, InSilicon):
        gain_only = kind.pointwise or "white_irradiance" in own
        if not gain_only and not (is_transfer(kind) and ends_in_sum(kind)):
            return "the lens"
        if shaded and kind.pointwise and "white_irradiance" not in own:
            return "shading, which the camera corrects"
    if names.index(entry.name) > names.index(demosaic) and "rgb_camera" in own and not _ends_a_dim(kind):
        return "work on the demosaiced picture"
    if (
        "white" in _writes(kinds, entry)
        and "mosaic_linear" in _reads(kinds, entry)
        and any(_knows_white(kinds, n) for n in names)
    ):
        return "white found on the mosaic"
    return ""


def _knows_white(kinds: Kinds, name: str) -> bool:
    """Return whether a stage writes the white without reading the mosaic or the raw frame."""
    kind = kinds[name]
    return (
        kind is not None
        and "white" in writes_of(kind)
        and not {"mosaic_linear", "raw"} & {d.variable for d in reads_of(kind).values()}
    )


def _ends_a_dim(kind: type[Stage]) -> bool:
    """Return whether a stage merges several frames into one picture, so that it cannot be left out."""
    reads, writes = ({d.variable: d.dims for d in of(kind).values()} for of in (reads_of, writes_of))
    return reads["rgb_camera"] != writes["rgb_camera"]


def _planes(
    pipeline: PipelineFile, kinds: Kinds, out: Collection[str], demosaic: str, registry: Registry
) -> ReferenceBranch:
    """Return the stages that give every channel at every pixel. They are made for the camera without the omitted stages
    and without its sweep.
    """
    there = without_stages(pipeline, out)
    alone, _ = without_sweep(replace(there, sweep=_still_there(pipeline.sweep, out, {})))
    nodes = nodes_of(replace(alone, lines={}), registry)
    swept = {key.rpartition(".")[0] for key in pipeline.sweep}
    needless = [
        name
        for name, kind in kinds.items()
        if name in swept or (kind is not None and kind.role in (SHADING, *RESTORING))
    ]
    made, light = ReferenceBranch(alone, nodes, "", registry), writer(nodes, "photon_rate")
    assert light is not None
    made.planes(light, next(node for node in nodes if node.name == demosaic), needless)
    return made


def _notes(pipeline: PipelineFile, kinds: Kinds, out: Mapping[str, str], shaded: bool) -> list[str]:
    notes = []
    roles = {name: kind.role for name, kind in kinds.items() if kind is not None}
    moved = [name for name in out if roles.get(name) == DISTORTION]
    if moved:
        notes.append(
            f"{', '.join(moved)} moves the picture, but the ideal camera does not: pixel-wise metrics count that as "
            f"error (--keep {moved[0]} gives the ideal camera the same geometry)"
        )
    if shaded:
        notes.append("the camera corrects shading, so the ideal camera has no shading")
    if _first(pipeline, lambda e: TIME in _writes(kinds, e) and _reads(kinds, e) and e.name not in out):
        notes.append("the ideal camera meters its own, sharper light")
    unknown = [name for name, why in out.items() if why == "the lens" and roles.get(name) not in LENS]
    if unknown:
        notes.append(f"{', '.join(unknown)} is treated as part of the lens; use --keep {unknown[0]} if it is not")
    return notes


# -- what stays as written ------------------------------------------------------------------------------------------


def _still_there(sweep: DocumentView, out: Collection[str], replaced: Mapping[str, str]) -> Document:
    return {
        key: value for key, value in sweep.items() if key.partition(".")[0] not in {*out, *replaced} or "." not in key
    }


def _asked_for(values: DocumentView, entries: list[StageEntry], registry: Registry) -> Document:
    """Return only the camera quantities that at least one stage uses. Values of single stages are kept."""
    kinds = [_kind(entry, registry) for entry in entries]
    taken = {
        name for kind in kinds if kind for name, (parameter, _, _) in parameters_of(kind).items() if parameter.shared
    }
    return {key: value for key, value in values.items() if "." in key or key in taken}


def _check_names(pipeline: PipelineFile, given: Mapping[str, Collection[str]], kinds: Kinds) -> None:
    faults = [
        Fault(f"{option} {name}", f"unknown stage{nearest(name, kinds)}")
        for option, names in given.items()
        for name in names
        if name not in kinds
    ]
    if faults:
        raise RequestError(faults, pipeline.file)


def _first(pipeline: PipelineFile, holds: Callable[[StageEntry], bool | set[str]]) -> str | None:
    return next((entry.name for entry in pipeline.stages if holds(entry)), None)


def _kind(entry: StageEntry, registry: Registry) -> type[Stage] | None:
    return registry.load(entry.use) if entry.use in registry else None


def _reads(kinds: Kinds, entry: StageEntry) -> set[str]:
    kind = kinds[entry.name]
    return {declaration.variable for declaration in reads_of(kind).values()} if kind else set()


def _writes(kinds: Kinds, entry: StageEntry) -> set[str]:
    kind = kinds[entry.name]
    return {declaration.variable for declaration in writes_of(kind).values()} if kind else set()
