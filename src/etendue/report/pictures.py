"""Pictures: every stage of one cell as it looks to the eye, and the contact sheet that shows them in order.

In:  the arrays of the shown cells.
Out: 8-bit sRGB frames fitted into 256 x 256, and a PNG.

Which variables are shown, and how, distributions say (``spec.variables.Variable``). Light is shown through the CIE 1931
observer; a mosaic through its own filters; camera channels as they are; tristimulus values through sRGB. A linear picture
is scaled so that its 99.5th percentile is 0.9, the same for all stages of one kind, so that what gets darker looks darker.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from etendue import spectra
from etendue.physics.colour import matrices
from etendue.physics.colour.encoding import srgb_encode
from etendue.physics.scene.resampling import area_weights
from etendue.physics.sensor import cfa
from etendue.plan.model import Cell, CellRef, Plan
from etendue.spec.capabilities import Viewed
from etendue.spec.ports import Sheet
from etendue.spec.variables import Variable
from etendue.spec.variables import variable as known

LARGEST = 256


@dataclass
class Frame:
    """One picture: what it is of, (3, y, x) in 0..1 as encoded sRGB, and the true size."""

    stage: str
    variable: str
    picture: Any
    size: tuple[int, int]


def _linear_rgb(plan: Plan, cell: Cell, variable: str, array: Any) -> Any | None:
    grid = cell.grids[variable]
    if "y" not in grid or "x" not in grid:
        return None
    dims = plan.node(cell.node).writes[variable].dims
    dims = dims[len(dims) - array.ndim :]
    if dims == ("wavelength", "y", "x"):
        edges = grid.bands().edges
        observer = (spectra.colour_matching(edges) * np.diff(edges)[:, None]).T.astype(np.float32)
        if isinstance(array, np.ndarray):
            xyz = _fitted(np.tensordot(observer, np.asarray(array, dtype=np.float32), axes=1))
        else:  # stored by band, as it is too large to be held
            small = np.stack([_fitted(np.asarray(array[band], dtype=np.float32)) for band in range(array.shape[0])])
            xyz = np.tensordot(observer, small, axes=1)
        return matrices.apply_matrix(np.linalg.inv(matrices.RGB_TO_XYZ_SRGB), xyz)
    if dims == ("channel", "y", "x"):
        planes = _fitted(np.asarray(array, dtype=np.float32)).astype(np.float32)
        if grid["channel"].values() == ["X", "Y", "Z"]:
            matrix = np.linalg.inv(matrices.RGB_TO_XYZ_SRGB)
            white = cell.stage.viewing_white() if isinstance(cell.stage, Viewed) else None
            if white is not None:  # shown as its viewer sees it, not as it would look beside a D65 white
                seen = matrices.von_kries_matrix(white, matrices.xyz_from_xy(matrices.D65_XY), matrices.TRANSFORMS["bradford"])
                matrix = matrix @ seen
            planes = matrices.apply_matrix(matrix, planes)
        if grid["channel"].values()[:3] in (["R", "G", "B"], ["X", "Y", "Z"]):
            return planes[:3]
        return np.repeat(planes.mean(axis=0, keepdims=True), 3, axis=0)
    if dims == ("y", "x"):
        plane = np.asarray(array, dtype=np.float32)
        if black := known(variable).black:
            plane = np.maximum(plane - float(plan.camera.get(black, 0) or 0), 0)
        pattern = plan.camera.get("pattern")
        if pattern is None:
            return np.repeat(plane[None], 3, axis=0)
        mask = cfa.read(str(pattern))
        index = cfa.channel_index(mask, plane.shape[0], plane.shape[1], round(grid.line("y").start), round(grid.line("x").start))
        tints = np.array([cfa.tint(channel) for channel in mask.channels], dtype=np.float32)
        return np.stack([_fitted(tints[:, k][index] * plane) for k in range(3)])
    return None


def render(plan: Plan, shown: Mapping[str, CellRef], arrays: Mapping[CellRef, Mapping[str, Any]]) -> list[Frame]:
    """A frame for every stage with a picture; linear pictures of one kind share one scale."""
    kinds: dict[str, list[tuple[Cell, str, Any]]] = {}
    order: list[tuple[Cell, str, Any, str]] = []
    for node in plan.nodes:
        cell = plan.cells[shown[node.name]]
        for variable in node.writes:
            if not known(variable).shown or variable not in arrays.get(cell.ref, {}):
                continue
            if getattr(arrays[cell.ref][variable], "on_demand", False):  # a large variable that is not stored would be made again
                continue
            kind = known(variable).scale or variable
            array = arrays[cell.ref][variable]
            for _ in [dim for dim in node.mapped if dim != "channel"]:  # of several frames the one in the middle; planes are a picture
                array = array[len(array) // 2]
            kinds.setdefault(kind, []).append((cell, variable, array))
            order.append((cell, variable, array, kind))
    frames = []
    scales: dict[str, float] = {}
    for cell, variable, array, kind in order:
        how = known(variable)
        if how.shown == "encoded":
            picture = _fitted(np.asarray(array, dtype=np.float32))
        elif how.shown == "map":
            if array.ndim != 2:
                continue
            picture = _map(np.asarray(array, dtype=np.float64), how)
        else:
            linear = _linear_rgb(plan, cell, variable, array)
            if linear is None:
                continue
            if kind not in scales:
                bright = how.white
                if bright is None:
                    # where several variables share a scale the last picture says what is bright: what a well cannot hold is no brightness
                    by = _linear_rgb(plan, *kinds[kind][-1]) if how.scale else linear
                    peaks = (linear if by is None else by).max(axis=0)
                    # a thousandth of the brightest at least: beside a point all else may be next to nothing
                    bright = max(float(np.quantile(peaks, 0.995)), 1e-3 * float(peaks.max())) / 0.9
                scales[kind] = bright if bright > 0 else 1.0
            picture = srgb_encode(np.clip(linear / scales[kind], 0, 1))
        size = (array.shape[-2], array.shape[-1])
        frames.append(Frame(cell.node, variable, np.clip(picture, 0, 1), size))
    return frames


def _map(plane: Any, shown: Variable) -> Any:
    """Numbers over y and x as grey, from the lower end of their range to the upper one; what is undefined is black."""
    with np.errstate(divide="ignore", invalid="ignore"):
        plane, ends = (np.log(plane), np.log(shown.range or ())) if shown.log else (plane, np.array(shown.range or ()))
    finite = np.isfinite(plane)
    low, high = ends if ends.size else (plane[finite].min(initial=np.inf), plane[finite].max(initial=-np.inf))
    grey = np.where(finite, (plane - low) / (high - low) if high > low else 0.5, 0.0)
    return np.repeat(_fitted(np.clip(grey, 0, 1).astype(np.float32))[None], 3, axis=0)


def _fitted(picture: Any) -> Any:
    """Area-averaged until it fits; smaller pictures stay as they are."""
    y, x = picture.shape[-2:]
    if max(y, x) <= LARGEST:
        return picture
    scale = LARGEST / max(y, x)
    down = area_weights(y, max(1, round(y * scale))).astype(picture.dtype)
    across = area_weights(x, max(1, round(x * scale))).T.astype(picture.dtype)
    return down @ picture @ across


def sheet(plan: Plan, shown: Mapping[str, CellRef], arrays: Mapping[CellRef, Mapping[str, Any]], at: str) -> Sheet | None:
    """The pictures of the shown cells, which stand at the axis values ``at``; None where there is nothing to be seen."""
    frames = render(plan, shown, arrays)
    if not frames:
        return None
    return Sheet(frames_table(frames), lambda path: contact_sheet(frames, path, f"{plan.pipeline.name}{at}"), tuple(shown.values()), at)


def frames_table(frames: list[Frame]) -> dict[str, Any]:
    """The frames as a group of the archive: preview(stage, channel, y, x), 8 bit, zero beside smaller ones."""
    height, width = max(f.picture.shape[1] for f in frames), max(f.picture.shape[2] for f in frames)
    preview = np.zeros((len(frames), 3, height, width), np.uint8)
    for i, frame in enumerate(frames):
        _, y, x = frame.picture.shape
        preview[i, :, :y, :x] = np.round(frame.picture * 255)
    names = [f.stage for f in frames]
    stage = [n if names.count(n) == 1 else f"{n}.{f.variable}" for n, f in zip(names, frames, strict=True)]
    dims = ("stage", "channel", "y", "x")
    return {
        "arrays": {
            "preview": (
                dims,
                preview,
                {"long_name": "the stage as it looks", "colour_space": "sRGB", "transfer_function": "sRGB", "units": "1"},
            ),
            "stage": (("stage",), np.array(stage, dtype=object), {"long_name": "stage"}),
            "channel": (("channel",), np.array(["R", "G", "B"], dtype=object), {"long_name": "channel"}),
            "variable": (("stage",), np.array([f.variable for f in frames], dtype=object), {"long_name": "variable"}),
            "true_height": (("stage",), np.array([f.size[0] for f in frames]), {"units": "pixel", "long_name": "true height"}),
            "true_width": (("stage",), np.array([f.size[1] for f in frames]), {"units": "pixel", "long_name": "true width"}),
            "height": (
                ("stage",),
                np.array([f.picture.shape[1] for f in frames]),
                {"units": "pixel", "long_name": "height of the preview"},
            ),
            "width": (("stage",), np.array([f.picture.shape[2] for f in frames]), {"units": "pixel", "long_name": "width of the preview"}),
        },
        "attrs": {"title": "one cell of every stage, in order"},
    }


def contact_sheet(frames: list[Frame], path: Path, title: str) -> None:
    """All frames in order, each with its stage, variable and true size, as one PNG. Written whole or not at all.

    Frames stand at a whole number of screen pixels per sample: a mosaic resampled by anything else shows a moire that
    is not in it.
    """
    import os

    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(5, len(frames))
    rows = -(-len(frames) // columns)
    box, label, gap, head = LARGEST, 34, 10, 34
    width, height = columns * (box + gap) + gap, head + rows * (box + label + gap) + gap
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(0.5, 1 - 0.55 * head / height, title, ha="center", va="center", fontsize=13)
    for number, frame in enumerate(frames):
        picture = np.moveaxis(frame.picture, 0, -1)
        scale = max(1, box // max(picture.shape[:2]))
        picture = np.repeat(np.repeat(picture, scale, axis=0), scale, axis=1)
        row, column = divmod(number, columns)
        left = gap + column * (box + gap)
        top = height - head - row * (box + label + gap) - label
        figure.text(
            (left + box / 2) / width, (top + 4) / height,
            f"{number + 1}. {frame.stage}\n{frame.variable}  {frame.size[1]} x {frame.size[0]}",
            ha="center", va="bottom", fontsize=8,
        )  # fmt: skip
        figure.figimage(picture, xo=left + (box - picture.shape[1]) // 2, yo=top - picture.shape[0], origin="upper")
    temporary = path.with_name(path.name + ".partial")
    figure.savefig(temporary, format="png")
    os.replace(temporary, path)
