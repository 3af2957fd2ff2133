"""Pictures: every stage of one cell as it looks to the eye.

In:  the thumbnails of the shown cells.
Out: 8-bit sRGB frames fitted into 256 x 256, as a table of the archive, and the contact sheet that shows them in order.

A linear picture is scaled so that its 99.5th percentile is 0.9, the same for all stages of one kind, so that what gets
darker looks darker.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.drawn import Drawn, Pictured
from etendue.contract.ports import Sheet
from etendue.contract.quantities import declared
from etendue.contract.wording import first
from etendue.plan.drawn import drawn_of
from etendue.plan.model import Cell, CellRef, Plan
from etendue.present.pictures.appearance import as_bytes, seen, whites_of
from etendue.present.pictures.contact_sheet import contact_sheet, with_maps
from etendue.present.pictures.details import Window, limited, lines_of, part_of, side_of
from etendue.present.pictures.fitting import LARGEST
from etendue.present.pictures.thumbnails import Thumbnail, window_of
from etendue.types.arrays import Array


@dataclass
class Frame:
    """One picture: what it is of, (3, y, x) in 0..1 as encoded sRGB, and the true size; what is there of it sample
    by sample; a part.
    """

    stage: str
    variable: str
    picture: Array
    size: tuple[int, int]
    drawn: Drawn
    exact: Any = None  # (3, rows, x): the picture itself, or a band of a larger one, before it is scaled and encoded
    bright: float = 1.0  # what of it is shown as white
    first: int = 0  # row of the whole in which it begins
    part: Any = None  # (3, y, x) of it, the same place of the scene in all
    place: tuple[float, float, float, float] = (
        0.0,
        0.0,
        0.0,
        0.0,
    )  # of the part: top, left, height, width as shares of the whole


def render(plan: Plan, shown: Mapping[str, CellRef], small: Mapping[CellRef, Mapping[str, Thumbnail]]) -> list[Frame]:
    """A frame for every stage with a picture; linear pictures of one kind share one scale."""
    order: list[tuple[str, Pictured, Thumbnail]] = []
    for node in plan.nodes:
        cell = plan.cells[shown[node.name]]
        for variable, one in ((v, small.get(cell.ref, {}).get(v)) for v in node.writes):
            if one is not None and (drawn := drawn_of(plan, cell, variable)) is not None:
                order.append((node.name, Pictured(variable, node.writes[variable].dims, drawn, node.axes), one))
    whites = whites_of([(own, one.picture) for _, own, one in order])
    frames: list[Frame] = []
    for (stage, (variable, _, drawn, _), one), white in zip(order, whites, strict=True):
        frame = Frame(stage, variable, seen(drawn, one.picture, white), one.size, drawn=drawn)
        if drawn.shown != "map" and max(one.size) <= LARGEST:
            frame.exact, frame.bright = one.picture, white
        elif drawn.shown != "map" and one.band is not None:
            frame.exact, frame.bright, frame.first = one.band, white, one.first
        frames.append(frame)
    _with_parts(frames, {name: plan.cells[ref] for name, ref in shown.items()}, window_of(plan, shown.values()))
    return frames


def _with_parts(frames: list[Frame], cells: Mapping[str, Cell], band: Window | None) -> None:
    """The same place of the scene in every picture: where the last of the coarsest has its strongest edge between
    flat places.
    """
    lines: dict[int, Any] = {id(f): lines_of(cells[f.stage].grids[f.variable]) for f in frames}
    seen = [f for f in frames if f.exact is not None and lines[id(f)] is not None]
    if not seen:
        return
    coarse = min(reversed(seen), key=lambda f: f.size[0] * f.size[1])
    y, x = lines[id(coarse)]
    side = min(side_of(coarse.size), *coarse.exact.shape[-2:])
    whole = all(max(f.size) <= LARGEST for f in seen)
    first, last = (0, coarse.size[0]) if whole or band is None else band.rows(y)
    top, left = part_of(_encoded(coarse, coarse.exact[:, first - coarse.first : last - coarse.first]), side)
    (y0, dy), (x0, dx) = y.um(), x.um()
    row, column = top + first, left
    window = Window(
        y0 + (row - 0.5) * dy, y0 + (row + side - 0.5) * dy, x0 + (column - 0.5) * dx, x0 + (column + side - 0.5) * dx
    )
    for f in seen:
        own_y, own_x = lines[id(f)]
        rows, columns = window.rows(own_y), window.columns(own_x)
        part = f.exact[:, max(0, rows[0] - f.first) : rows[1] - f.first, columns[0] : columns[1]]
        if not part.size:
            continue
        f.part = limited(_encoded(f, part))
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
) -> Sheet | None:
    """The pictures of the shown cells, which stand at the axis values ``at``; None where there is nothing to be
    seen.
    """
    frames = render(plan, shown, small)
    if not frames:
        return None
    table, title = frames_table(frames), f"{plan.pipeline.name}{at}{_shared(plan)}"
    table["attrs"]["cell"] = {dim: value for ref in shown.values() for dim, value in plan.labels(ref).items()}
    return Sheet(table, lambda path: contact_sheet(table, path, title, maps()), tuple(shown.values()), at)


def same_pictures(folder: Path, maps: Callable[[], list[Array]]) -> Sheet | None:
    """The sheet of an earlier run, whose pictures are still those of the shown cells, with maps of what is known
    now.
    """
    before = folder / "contact_sheet.png"
    return Sheet({}, lambda path: with_maps(path, before, maps()), (), "") if before.is_file() else None


def _shared(plan: Plan) -> str:
    """What would go first along a side and is not swept, behind the axis values of a title."""
    swept, texts = (
        {axis.key for axis in plan.axes} | {name for node in plan.nodes for name in node.writes},
        [],
    )  # or found by a stage
    for name in first("sides"):
        value = plan.shared.get(name)
        if name not in swept and isinstance(value, int | float) and not isinstance(value, bool):
            unit = declared(name).units
            texts.append(f"{name} {value:.4g}{'' if unit == '1' else f' {unit}'}")
    return f"{',' if plan.axes else ' at'} {', '.join(texts)}" if texts else ""


def _encoded(frame: Frame, part: Array) -> Array:
    """Some of the exact picture as it is shown, 0 to 1."""
    return seen(frame.drawn, part, frame.bright)


def _parts(frames: list[Frame]) -> dict[str, Any]:
    """The parts as arrays beside the pictures."""
    sizes = [(0, 0) if f.part is None else f.part.shape[-2:] for f in frames]
    high, wide = (max(1, *(size[n] for size in sizes), 1) for n in (0, 1))
    detail = np.zeros((len(frames), 3, high, wide), np.uint8)
    for i, (frame, (y, x)) in enumerate(zip(frames, sizes, strict=True)):
        if frame.part is not None:
            detail[i, :, :y, :x] = as_bytes(frame.part)
    said = {"long_name": "a part of the picture, sample by sample: the same place of the scene in every stage"}
    place = {"long_name": "the part in the picture: top, left, height, width as shares", "units": "1"}
    return {
        "detail": (
            ("stage", "channel", "detail_y", "detail_x"),
            detail,
            {**said, "colour_space": "sRGB", "units": "1"},
        ),
        "detail_height": (
            ("stage",),
            np.array([s[0] for s in sizes]),
            {"units": "pixel", "long_name": "height of the part"},
        ),
        "detail_width": (
            ("stage",),
            np.array([s[1] for s in sizes]),
            {"units": "pixel", "long_name": "width of the part"},
        ),
        "detail_place": (("stage", "side"), np.array([f.place for f in frames]), place),
    }


def frames_table(frames: list[Frame]) -> dict[str, Any]:
    """The frames as a group of the archive: preview(stage, channel, y, x), 8 bit, zero beside smaller ones."""
    height, width = max(f.picture.shape[1] for f in frames), max(f.picture.shape[2] for f in frames)
    preview = np.zeros((len(frames), 3, height, width), np.uint8)
    for i, frame in enumerate(frames):
        _, y, x = frame.picture.shape
        preview[i, :, :y, :x] = as_bytes(frame.picture)
    names = [f.stage for f in frames]
    stage = [n if names.count(n) == 1 else f"{n}.{f.variable}" for n, f in zip(names, frames, strict=True)]
    dims = ("stage", "channel", "y", "x")
    return {
        "arrays": {
            "preview": (
                dims,
                preview,
                {
                    "long_name": "the stage as it looks",
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
                np.array([f.picture.shape[1] for f in frames]),
                {"units": "pixel", "long_name": "height of the preview"},
            ),
            "width": (
                ("stage",),
                np.array([f.picture.shape[2] for f in frames]),
                {"units": "pixel", "long_name": "width of the preview"},
            ),
            **_parts(frames),
        },
        "attrs": {"title": "one cell of every stage, in order"},
    }
