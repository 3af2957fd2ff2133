"""The ideal camera of the same scene: the same pipeline with a perfect lens, without noise, converter and mosaic.

In:  a pipeline as written.
Out: another pipeline, what was left out of it, and what a comparison with it should say.

Left out is what spreads or moves light in front of the pixel (blur, aberrations, distortion, glare, the low-pass filter), what
works on camera primaries behind the demosaicer (sharpening, denoising: the ideal picture needs none), and what finds white on
the mosaic or balances it there: the ideal camera knows the white of its light. The demosaicer becomes ``full_planes``; what it
alone read, from exposure to linearisation, is then not computed. What stays: the scene, how much light arrives where, the pixel
with its aperture and diffusion, crosstalk behind the filters, colour, encoding.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from etendue.errors import Fault, RequestError, nearest
from etendue.registry import Registry
from etendue.spec.capabilities import ends_in_sum, is_transfer
from etendue.spec.pipeline import Pipeline, StageEntry
from etendue.spec.stage import Stage, parameters_of, reads_of, writes_of

LIGHT = frozenset({"falloff", "vignetting", "angular_response", "optical_filter", "real_lens_illumination"})
"""Stages that change how much light arrives, not where: they stay."""
SENSOR = frozenset({"diffusion"})
"""Transfer functions in front of the pixel that belong to the sensor: they stay."""


@dataclass(frozen=True)
class Ideal:
    """The ideal camera of a pipeline."""

    pipeline: Pipeline
    left_out: tuple[str, ...]  # names of stages
    replaced: Mapping[str, str]  # name of the stage -> what stands there now
    notes: tuple[str, ...]


def ideal_of(pipeline: Pipeline, registry: Registry, without: Collection[str] = (), keep: Collection[str] = ()) -> Ideal:
    """Build the ideal camera of a pipeline.

    Parameters
    ----------
    pipeline : Pipeline
        As written; its faults are the planner's to find.
    registry : Registry
    without : names of stages
        Also left out, such as ``diffusion``.
    keep : names of stages
        Not left out, though they spread light.

    Raises
    ------
    RequestError
        The pipeline has no pixel stage or no demosaicer, or a name is none of its stages.
    """
    kinds = {entry.name: _kind(entry, registry) for entry in pipeline.stages}
    _check_names(pipeline, {"--without": without, "--keep": keep}, kinds)
    pixel = _first(pipeline, lambda e: "photon_rate" in _writes(kinds, e))
    demosaic = _first(pipeline, lambda e: "rgb_camera" in _writes(kinds, e) - _reads(kinds, e))
    if pixel is None or demosaic is None:
        lacking = "no stage that writes photon_rate" if pixel is None else "no demosaicer (nothing writes rgb_camera)"
        raise RequestError(f"the pipeline has {lacking}: there is no picture to compare with that of the ideal camera", pipeline.file)
    names = [entry.name for entry in pipeline.stages]
    shaded = _shading_corrected(pipeline, kinds)
    out: dict[str, str] = {}  # name -> why
    for entry in pipeline.stages:
        why = _why_out(entry, kinds, names, pixel, demosaic, shaded)
        if (why and entry.name not in keep) or entry.name in without:
            out[entry.name] = why or "asked for"
    replaced = _replaced(pipeline, kinds, demosaic)
    entries = tuple(
        replace(e, use=replaced[e.name], values={}, origin={}) if e.name in replaced else replace(e, origin=_origin(pipeline, e, out))
        for e in pipeline.stages
        if e.name not in out
    )
    ideal = replace(
        pipeline,
        stages=entries,
        camera=_asked_for(pipeline.camera, entries, registry),
        sweep=_asked_for(_still_there(pipeline.sweep, out, replaced), entries, registry),
        wanted=None,
        keep=None,
        lines={},
    )
    return Ideal(ideal, tuple(out), replaced, tuple(_notes(pipeline, kinds, out, shaded)))


def _why_out(entry: StageEntry, kinds: Mapping[str, Any], names: list[str], pixel: str, demosaic: str, shaded: bool) -> str:
    """The reason why a stage is none of the ideal camera's; '' where it is one."""
    kind, own = kinds[entry.name], _reads(kinds, entry) & _writes(kinds, entry)
    if kind is None:
        return ""
    before_pixel = names.index(entry.name) < names.index(pixel)
    if before_pixel and "irradiance" in own and entry.use not in SENSOR:
        gain_only = entry.use in LIGHT or "white_irradiance" in own
        if not gain_only and not (is_transfer(kind) and ends_in_sum(kind)):
            return "the lens"
        if shaded and entry.use in LIGHT and "white_irradiance" not in own:
            return "shading, which the camera corrects"
    if names.index(entry.name) > names.index(demosaic) and "rgb_camera" in own:
        return "work on the demosaiced picture"
    if "white" in _writes(kinds, entry) and "mosaic_linear" in _reads(kinds, entry) and any(_knows_white(kinds, n) for n in names):
        return "white found on the mosaic"
    return ""


def _knows_white(kinds: Mapping[str, Any], name: str) -> bool:
    """Whether a stage finds white without looking at the picture."""
    kind = kinds[name]
    return kind is not None and "white" in writes_of(kind) and not {"mosaic_linear", "raw"} & {d.variable for d in reads_of(kind).values()}


def _replaced(pipeline: Pipeline, kinds: Mapping[str, Any], demosaic: str) -> dict[str, str]:
    metered = _first(pipeline, lambda e: "exposure_time" in _writes(kinds, e))
    replaced = {demosaic: "full_planes_metered" if metered else "full_planes"}
    names = [entry.name for entry in pipeline.stages]
    for entry in pipeline.stages[: names.index(demosaic)]:
        if entry.use == "crosstalk":
            replaced[entry.name] = "crosstalk_planes"
    return replaced


def _notes(pipeline: Pipeline, kinds: Mapping[str, Any], out: Mapping[str, str], shaded: bool) -> list[str]:
    notes = []
    moved = [e.name for e in pipeline.stages if e.name in out and "distortion" in e.use]
    if moved:
        notes.append(
            f"{', '.join(moved)} moves the picture and the ideal camera does not: figures pixel by pixel count that as error "
            f"(--keep {moved[0]} gives the ideal camera the same geometry)"
        )
    if shaded:
        notes.append("the camera corrects shading, so the ideal one has none")
    if _first(pipeline, lambda e: "exposure_time" in _writes(kinds, e)):
        notes.append("the ideal camera meters for itself, on its own sharper light")
    unknown = [e.name for e in pipeline.stages if out.get(e.name) == "the lens" and not _built_in(kinds[e.name]) and "lens" not in e.use]
    if unknown:
        notes.append(f"{', '.join(unknown)} is taken for a part of the lens; --keep {unknown[0]} where it is not")
    return notes


def _shading_corrected(pipeline: Pipeline, kinds: Mapping[str, Any]) -> bool:
    return any("shading" in e.use and "mosaic_linear" in _reads(kinds, e) & _writes(kinds, e) for e in pipeline.stages)


# -- what stays as it was written ---------------------------------------------------------------------------------


def _origin(pipeline: Pipeline, entry: StageEntry, out: Mapping[str, str]) -> dict[str, str]:
    """``from`` without the stages that are gone: what those read, or the nearest writer."""
    by_name = {e.name: e for e in pipeline.stages}
    found = {}
    for port, source in entry.origin.items():
        while source in out:
            source = by_name[source].origin.get(port, "")
        if source:
            found[port] = source
    return found


def _still_there(sweep: Mapping[str, Any], out: Collection[str], replaced: Mapping[str, str]) -> dict[str, Any]:
    return {key: value for key, value in sweep.items() if key.partition(".")[0] not in {*out, *replaced} or "." not in key}


def _asked_for(values: Mapping[str, Any], entries: tuple[StageEntry, ...], registry: Registry) -> dict[str, Any]:
    """Of camera quantities those that a stage takes; keys of stages as they are."""
    kinds = [_kind(entry, registry) for entry in entries]
    taken = {name for kind in kinds if kind for name, (parameter, _, _) in parameters_of(kind).items() if parameter.camera}
    return {key: value for key, value in values.items() if "." in key or key in taken}


def _check_names(pipeline: Pipeline, given: Mapping[str, Collection[str]], kinds: Mapping[str, Any]) -> None:
    faults = [
        Fault(f"{option} {name}", f"there is no stage of this name{nearest(name, kinds)}")
        for option, names in given.items()
        for name in names
        if name not in kinds
    ]
    if faults:
        raise RequestError(faults, pipeline.file)


def _first(pipeline: Pipeline, holds: Any) -> str | None:
    return next((entry.name for entry in pipeline.stages if holds(entry)), None)


def _kind(entry: StageEntry, registry: Registry) -> type[Stage] | None:
    return registry.load(entry.use) if entry.use in registry else None


def _built_in(kind: type[Stage] | None) -> bool:
    return kind is not None and kind.__module__.startswith("etendue.")


def _reads(kinds: Mapping[str, Any], entry: StageEntry) -> set[str]:
    kind = kinds[entry.name]
    return {declaration.variable for declaration in reads_of(kind).values()} if kind else set()


def _writes(kinds: Mapping[str, Any], entry: StageEntry) -> set[str]:
    kind = kinds[entry.name]
    return {declaration.variable for declaration in writes_of(kind).values()} if kind else set()
