"""Pictures: every stage of one cell, drawn in the colours that the eye sees.

In:  the thumbnails of the shown cells.
Out: 8-bit sRGB frames fitted into 256 x 256, as a table of the archive, and the contact sheet that shows them in order.

A linear picture is scaled so that its 99.5th percentile is 0.9. The scale is the same for all stages of one kind, so
that a picture that gets darker looks darker.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.arrays.drawn import Drawn, Pictured
from etendue.contract.ports import ContactSheet
from etendue.contract.values.quantities import declared
from etendue.contract.wording import first
from etendue.pipeline.stand_ins import standing_in
from etendue.plan.drawn import drawn_of
from etendue.plan.model import Cell, CellRef, Plan
from etendue.present.pictures.appearance import brightness, rendered, white_among
from etendue.present.pictures.contact_sheet import contact_sheet, with_maps
from etendue.present.pictures.details import PlaneWindow, limited, lines_of, part_of, side_of
from etendue.present.pictures.fitting import LARGEST
from etendue.present.pictures.thumbnails import Thumbnail, drawn_before, window_of
from etendue.types.arrays import Array
from etendue.types.documents import Document


@dataclass
class Frame:
    """One picture: its stage and variable, (y, x, 3) bytes of encoded sRGB, the true size, the rows kept at full
    resolution, and a detail.
    """

    stage: str
    variable: str
    picture: Array
    size: tuple[int, int]
    drawn: Drawn
    exact: Any = None  # (3, y, x): the picture itself, or a window of a larger one, before scaling and encoding
    bright: float = 1.0  # value shown as white
    first: tuple[int, int] = (0, 0)  # row and column of the whole picture at which ``exact`` starts
    part: Any = None  # (y, x, 3) detail; all show the same place of the scene
    # of the detail: top, left, height, width as fractions of the whole
    place: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def render(plan: Plan, shown: Mapping[str, CellRef], small: Mapping[CellRef, Mapping[str, Thumbnail]]) -> list[Frame]:
    """Return a frame for every stage with a picture; linear pictures of one kind share one scale."""
    order: list[tuple[str, Pictured, Thumbnail]] = []
    refs = set(shown.values())
    for node in plan.nodes:
        if node.name not in shown:
            continue  # it is not computed
        cell = plan.cells[shown[node.name]]
        for variable in node.writes:
            one = small.get(drawn_before(plan, cell, variable, refs) or cell.ref, {}).get(variable)
            if one is not None and (drawn := drawn_of(plan, cell, variable)) is not None:
                order.append((node.name, Pictured(variable, node.writes[variable].dims, drawn, node.axes), one))
    bright_of = cache(lambda number: brightness(order[number][1].drawn, order[number][2].picture))
    frames: list[Frame] = []
    for number, (stage, (variable, _, drawn, _), one) in enumerate(order):
        white = white_among([own for _, own, _ in order], number, bright_of)
        frame = Frame(stage, variable, rendered(drawn, one.picture, white), one.size, drawn=drawn)
        if drawn.shown != "map" and max(one.size) <= LARGEST:
            frame.exact, frame.bright = one.picture, white
        elif drawn.shown != "map" and one.window is not None:
            frame.exact, frame.bright, frame.first = one.window, white, one.first
        frames.append(frame)
    _with_parts(frames, {name: plan.cells[ref] for name, ref in shown.items()}, window_of(plan, shown.values()))
    return frames


def _with_parts(frames: list[Frame], cells: Mapping[str, Cell], kept: PlaneWindow | None) -> None:
    """Add a detail to every picture, at the same place of the scene: where the coarsest picture (the last of equals)
    has its strongest edge between flat areas.
    """
    placed = [(f, lines_of(cells[f.stage].grids[f.variable])) for f in frames if f.exact is not None]
    seen = [(f, lines) for f, lines in placed if lines is not None]
    if not seen:
        return
    coarse, (y, x) = min(reversed(seen), key=lambda one: one[0].size[0] * one[0].size[1])
    side = min(side_of(coarse.size), *coarse.exact.shape[-2:])
    whole = all(max(f.size) <= LARGEST for f, _ in seen)
    first, last = (0, coarse.size[0]) if whole or kept is None else kept.rows(y)
    exact = coarse.exact[:, first - coarse.first[0] : last - coarse.first[0]]
    top, left = part_of(rendered(coarse.drawn, exact, coarse.bright) / 255.0, side)
    (y0, dy), (x0, dx) = y.um(), x.um()
    row, column = top + first, left + coarse.first[1]
    window = PlaneWindow(
        y0 + (row - 0.5) * dy, y0 + (row + side - 0.5) * dy, x0 + (column - 0.5) * dx, x0 + (column + side - 0.5) * dx
    )
    for f, (own_y, own_x) in seen:
        rows, columns = window.rows(own_y), window.columns(own_x)
        (top, bottom), (left, right) = (
            (max(0, low - own), max(0, high - own)) for (low, high), own in zip((rows, columns), f.first, strict=True)
        )
        part = f.exact[:, top:bottom, left:right]
        if not part.size:
            continue
        f.part = rendered(f.drawn, limited(part), f.bright)
        f.place = (
            rows[0] / f.size[0],
            columns[0] / f.size[1],
            (rows[1] - rows[0]) / f.size[0],
            (columns[1] - columns[0]) / f.size[1],
        )


def sheet(
    plan: Plan,
    shown: Mapping[str, CellRef],
    small: Mapping[CellRef, Mapping[str, Thumbnail]],
    at: str,
    maps: Callable[[], list[Array]] = list,
) -> ContactSheet | None:
    """Return the contact sheet of the shown cells; ``at``: their axis values as text; None if there is no picture."""
    frames = render(plan, shown, small)
    if not frames:
        return None
    standing = [len(names) for names in standing_in(plan.pipeline, plan.shared).values()]
    marked = f"; {'up to ' * (len(standing) > 1)}{max(standing)} stand-ins without a source" if standing else ""
    table, title = frames_table(frames), f"{plan.pipeline.name}{at}{_shared(plan)}{marked}"
    table["attrs"]["cell"] = {dim: value for ref in shown.values() for dim, value in plan.labels(ref).items()}
    return ContactSheet(table, lambda path: contact_sheet(table, path, title, maps()), tuple(shown.values()), at)


def same_pictures(folder: Path, maps: Callable[[], list[Array]]) -> ContactSheet | None:
    """Return the contact sheet of an earlier run if its pictures still belong to the shown cells, with maps of the
    current values.
    """
    before = folder / "contact_sheet.png"
    return ContactSheet({}, lambda path: with_maps(path, before, maps()), (), "") if before.is_file() else None


def _shared(plan: Plan) -> str:
    """Return a text with the preferred quantities that are not swept, to be added to the axis values in a title."""
    # swept, or computed by a stage
    swept, texts = ({axis.key for axis in plan.axes} | {name for node in plan.nodes for name in node.writes}, [])
    for name in first("sides"):
        value = plan.shared.get(name)
        if name not in swept and isinstance(value, int | float) and not isinstance(value, bool):
            unit = declared(name).units
            texts.append(f"{name} {value:.4g}{'' if unit == '1' else f' {unit}'}")
    return f"{',' if plan.axes else ' at'} {', '.join(texts)}" if texts else ""


def _parts(frames: list[Frame]) -> Document:
    """Return the details as arrays, to be stored with the pictures."""
    sizes = [(0, 0) if f.part is None else f.part.shape[:2] for f in frames]
    high, wide = (max(1, *(size[n] for size in sizes), 1) for n in (0, 1))
    detail = np.zeros((len(frames), 3, high, wide), np.uint8)
    for i, (frame, (y, x)) in enumerate(zip(frames, sizes, strict=True)):
        if frame.part is not None:
            detail[i, :, :y, :x] = np.moveaxis(frame.part, -1, 0)
    said = {"long_name": "detail at full resolution: the same place of the scene in every stage"}
    place = {"long_name": "position of the detail: top, left, height, width as fractions of the picture", "units": "1"}
    return {
        "detail": (
            ("stage", "channel", "detail_y", "detail_x"),
            detail,
            {**said, "colour_space": "sRGB", "units": "1"},
        ),
        "detail_height": (
            ("stage",),
            np.array([s[0] for s in sizes]),
            {"units": "pixel", "long_name": "height of the detail"},
        ),
        "detail_width": (
            ("stage",),
            np.array([s[1] for s in sizes]),
            {"units": "pixel", "long_name": "width of the detail"},
        ),
        "detail_place": (("stage", "side"), np.array([f.place for f in frames]), place),
    }


def frames_table(frames: list[Frame]) -> Document:
    """Return the frames as a group of the archive: preview(stage, channel, y, x), 8 bit, padded with zeros."""
    height, width = (max(f.picture.shape[side] for f in frames) for side in (0, 1))
    preview = np.zeros((len(frames), 3, height, width), np.uint8)
    for i, frame in enumerate(frames):
        y, x, _ = frame.picture.shape
        preview[i, :, :y, :x] = np.moveaxis(frame.picture, -1, 0)
    names = [f.stage for f in frames]
    stage = [n if names.count(n) == 1 else f"{n}.{f.variable}" for n, f in zip(names, frames, strict=True)]
    dims = ("stage", "channel", "y", "x")
    return {
        "arrays": {
            "preview": (
                dims,
                preview,
                {
                    "long_name": "picture of the stage",
                    "colour_space": "sRGB",
                    "transfer_function": "sRGB",
                    "units": "1",
                },
            ),
            "stage": (("stage",), np.array(stage, dtype=object), {"long_name": "stage"}),
            "channel": (("channel",), np.array(["R", "G", "B"], dtype=object), {"long_name": "channel"}),
            "variable": (("stage",), np.array([f.variable for f in frames], dtype=object), {"long_name": "variable"}),
            "true_height": (
                ("stage",),
                np.array([f.size[0] for f in frames]),
                {"units": "pixel", "long_name": "true height"},
            ),
            "true_width": (
                ("stage",),
                np.array([f.size[1] for f in frames]),
                {"units": "pixel", "long_name": "true width"},
            ),
            "height": (
                ("stage",),
                np.array([f.picture.shape[0] for f in frames]),
                {"units": "pixel", "long_name": "height of the preview"},
            ),
            "width": (
                ("stage",),
                np.array([f.picture.shape[1] for f in frames]),
                {"units": "pixel", "long_name": "width of the preview"},
            ),
            **_parts(frames),
        },
        "attrs": {"title": "one cell of every stage, in order"},
    }
