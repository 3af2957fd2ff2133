"""Take a picture after every stage that writes one: one exposure of shipped pipelines, and of one pipeline with each
remaining stage inserted.

In:  the registry and the shipped pipelines.
Out: true-colour PNG by stage, drawn as by ``etendue.show``, samples as squares.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import etendue
from etendue.builder.stages import Placed
from etendue.contract.arrays.variables import variable
from etendue.contract.listing import stage_document
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of, reads_of, writes_of
from etendue.contract.values.parameter import MISSING
from etendue.errors import EtendueError
from etendue.present.plots import pictures
from etendue.present.terminal.catalogue import first_sentence
from making.markdown import shown
from making.stages import roles

WIDE = 320  # width of a picture in dots
ENLARGED = 4  # magnification of the detail below a picture
SHIPPED: dict[str, dict[str, dict[str, str]]] = {  # with parameters that make their stages fast
    "paper": {},
    "burst": {},
    "raw_corrections": {},
    "paper_order": {},
    "colour": {"scene": {"bin_width": "20 nm"}},
}
BASE = "smallest"  # the camera into which stages are inserted that none of these uses
UNTELLING = {
    "radiance_cube",
    "real_lens",
    "real_lens_distortion",
    "real_lens_illumination",
}  # the example cube is noise; ray tracing takes seconds
TOLD = {"lens_psf_field": {"tolerance": 0.1}}
CHART = {
    "white_luminance": "250 cd m-2",
    "width": "700 um",
    "height": "560 um",
    "spacing": "1 um",
    "wavelength_from": "400 nm",
    "wavelength_to": "700 nm",
    "bin_width": "50 nm",
}
PIXELS = {"rows": 128, "columns": 160}
PITCH = "4 um"
LOOKED_AT = {"photograph": (0.31, 0.5), "composite": (0.18, 0.44)}  # centre of the enlarged detail, by scene


@dataclass(frozen=True)
class Picture:
    """The output of a stage, and the camera it comes from."""

    stage: str
    variable: str
    pipeline: str
    middle: tuple[float, float]
    pixels: Any  # (y, x, 3) uint8

    def save(self, path: Path) -> None:
        """Save a true-colour PNG: the picture, and below it an enlarged detail, samples as squares."""
        rows, columns = self.pixels.shape[:2]
        whole = Image.fromarray(self.pixels)
        times = WIDE / columns
        size = (WIDE, round(rows * times))
        whole = whole.resize(
            size,
            Image.Resampling.NEAREST
            if times.is_integer()
            else Image.Resampling.BOX
            if times < 1
            else Image.Resampling.BICUBIC,
        )
        wide = max(1, min(columns, round(columns / ENLARGED)))
        high = max(1, min(rows, round(0.45 * wide)))
        top, left = (
            min(max(0, round(m * n - 0.5 * part)), n - part)
            for m, n, part in zip(self.middle, (rows, columns), (high, wide), strict=True)
        )
        part = Image.fromarray(self.pixels[top : top + high, left : left + wide])
        part = part.resize((WIDE, round(high * WIDE / wide)), Image.Resampling.NEAREST)
        both = Image.new("RGB", (WIDE, size[1] + 6 + part.height), "white")
        both.paste(whole, (0, 0))
        both.paste(part, (0, size[1] + 6))
        both.save(path)


def pictured(kind: Any) -> list[str]:
    """Return the variables of a stage that are drawn as pictures."""
    return [d.variable for d in writes_of(kind).values() if {"y", "x"} <= set(d.dims) and variable(d.variable).shown]


def taken(root: Path) -> dict[str, Picture]:
    """Return one picture per stage, preferably from a shipped pipeline."""
    registry = installed_stages()
    kinds = {name: registry.load(name) for name in registry.names()}
    wanted = {name: pictured(kind)[0] for name, kind in kinds.items() if name not in UNTELLING and pictured(kind)}
    found: dict[str, Picture] = {}
    for name, changes in SHIPPED.items():
        camera = still(etendue.Pipeline.read(root / "pipelines" / f"{name}.toml"))
        for stage, values in changes.items():
            camera = camera.stage(stage, **values)
        found = {**_seen(camera, name, [p for p in camera.stages if p.use in wanted], wanted), **found}
    base = still(etendue.Pipeline.read(root / "pipelines" / f"{BASE}.toml")).camera(pixel_pitch=PITCH)
    base = base.stage("scene", **CHART).stage("pixel", **PIXELS)
    for name in wanted.keys() - found.keys():
        camera = in_place(base, name)
        if camera is not None:
            found.update(_seen(camera, BASE, [p for p in camera.stages if p.use == name], wanted))
    return dict(sorted(found.items()))


def still(camera: Any) -> Any:
    """Return the camera at the first value of every axis of its sweep."""
    for axis, values in camera.axes.items():
        first = values[0] if isinstance(values, list | tuple) else values["from"]
        stage, _, parameter = axis.rpartition(".")
        camera = camera.stage(stage, **{parameter: first}) if stage else camera.camera(**{parameter: first})
    return camera._with(axes={})


def in_place(base: Any, name: str) -> Any:
    """Return the camera with this stage in place of one with the same role and output, or after the one that makes its
    input; None if there is neither.
    """
    kind = installed_stages().load(name)
    reads, writes = ({d.variable for d in of(kind).values()} for of in (reads_of, writes_of))
    kinds = [(placed, installed_stages().load(placed.use)) for placed in base.stages]
    stage = Placed(name, {**_values(kind), **TOLD.get(name, {})}, name, {})
    alike = [
        p.name
        for p, own in kinds
        if own.role == kind.role and kind.role and {d.variable for d in writes_of(own).values()} & writes
    ]
    if alike:
        return base.swap(alike[0], stage)
    makers = [
        at
        for at, (_, own) in enumerate(kinds)
        if {d.variable for d in writes_of(own).values()} & reads & set(pictured(own))
    ]
    if not makers:
        return None
    behind = [placed.name for placed in base.stages][makers[0] + 1 :]
    return base.insert(behind[0], stage) if behind else base.add(stage)


def _values(kind: Any) -> dict[str, Any]:
    """Return the parameters of a stage: the chart's size if it draws one, an example if it has no default."""
    own = {
        name: (parameter, default)
        for name, (parameter, _, default) in parameters_of(kind).items()
        if not parameter.shared
    }
    own_chart = {name: value for name, value in CHART.items() if name in own}
    values = {
        name: parameter.example
        for name, (parameter, default) in own.items()
        if default is MISSING and parameter.example is not None
    }
    return {**values, **(own_chart if kind.role == "scene" else {})}


def _seen(camera: Any, name: str, placed: Iterable[Placed], wanted: Mapping[str, str]) -> dict[str, Picture]:
    """Return the pictures of one run by stage; none if the camera is refused."""
    by_use = {p.use: p.name for p in reversed(list(placed))}
    try:
        tree = camera.run(
            want=[f"{own}.{wanted[use]}" for use, own in by_use.items()],
            progress=False,
            scheduler="serial",
            leave_out=False,
        ).tree
    except EtendueError:  # the stage does not fit there
        return {}
    middle = LOOKED_AT.get(camera.stages[0].use, (0.5, 0.5))
    arrays = {use: _middle(tree[own][wanted[use]]) for use, own in by_use.items()}
    seen = {use: array for use, array in arrays.items() if np.isfinite(array.values.astype(float)).any()}
    return {use: Picture(use, wanted[use], name, middle, pictures.drawn(array)) for use, array in seen.items()}


def _middle(array: Any) -> Any:
    """Return the middle one of several frames."""
    return array.isel(
        {dim: array.sizes[dim] // 2 for dim in array.dims if dim not in ("wavelength", "channel", "y", "x")}
    )


def page(found: Mapping[str, Picture]) -> str:
    """Return the gallery page, in light order."""
    registry = installed_stages()
    documents = [stage_document(registry, name) for name in found]
    parts = [
        "# Gallery",
        "The output of each stage that writes a picture, in light order. The pictures are made when "
        "this page is built, "
        + "from "
        + ", ".join(f"`{name}.toml`" for name in SHIPPED)
        + f", and from `{BASE}.toml` with a larger frame for stages that none of these uses. "
        + "Light is shown as the eye sees it, a mosaic in the colours of its filters. "
        + "Below each picture is an enlarged detail, with every sample as a square.",
    ]
    for subject, own in _subjects(documents).items():
        cards = [_card(found[d["name"]], first_sentence(d["doc"])) for d in own]
        parts += [f"## {subject.capitalize()}", "\n".join(["::::{grid} 1 2 3 4", ":gutter: 2", "", *cards, "::::"])]
    return "\n\n".join(parts)


def _subjects(documents: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return stages in light order, by the subject of the built-in stages of their role."""
    found: dict[str, list[dict[str, Any]]] = {}
    for own in roles(documents).values():
        modules = [installed_stages().load(d["name"]).__module__.split(".") for d in own]
        subject = next((module[1] for module in modules if module[0] == "etendue_camera"), "other distributions")
        found.setdefault(subject, []).extend(own)
    return found


def _card(picture: Picture, said: str) -> str:
    return "\n".join(
        [
            f":::{{grid-item-card}} {shown(picture.stage)}",
            f":link: stages/{picture.stage}",
            ":link-type: doc",
            f":img-top: pictures/{picture.stage}.png",
            f":img-alt: {picture.variable} after {picture.stage}",
            "",
            shown(said),
            "",
            f"`{picture.variable}`, {picture.pipeline}.toml",
            ":::",
        ]
    )
