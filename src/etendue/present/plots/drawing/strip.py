"""Strips: every stage of one cell as a picture, in order, each with an enlarged detail; and single pictures.

In:  holdings; the cell by axis values, by default the cell of which the archive has pictures of all stages.
Out: a ``Plot``: a sample takes a whole number of dots if possible, the first row of an array is on top, the aspect
     ratio is kept.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray

from etendue.contract.arrays.drawn import Drawn, Pictured, read
from etendue.contract.wording import first
from etendue.errors import RequestError, nearest
from etendue.present.pictures.appearance import white_among
from etendue.present.pictures.details import part_of, side_of
from etendue.present.plots import pictures
from etendue.present.plots.arrangement import dims_of
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import places_text, value_text
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot, new_figure
from etendue.types.arrays import Array
from etendue.types.documents import AxisValues

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 100
# dots: sides of a picture and of its detail, gap, room above a picture, room above all
BOX, INSET, GAP, LABEL, HEAD = (260, 132, 12, 34, 40)
COLUMNS = 6
MOST_SAID = 5  # values of an axis listed in a message


@dataclass(frozen=True)
class Tile:
    """One picture, (y, x, 3) bytes, and a detail of it: the same place of the scene in every stage."""

    stage: str
    variable: str
    picture: Array
    size: tuple[int, int]  # of the array, before it was made small
    part: Array | None = None
    where: tuple[float, float, float, float] | None = (
        None  # of the detail: top, left, height, width as fractions of the picture
    )


def strip(holdings: Holdings, variable: str = "", stage: str = "", at: AxisValues | None = None) -> Plot:
    """Plot all stages of one cell; or one ``variable`` along the only axis that ``at`` does not fix.

    Raises
    ------
    RequestError
        No pictures, or no such axis value.
    """
    tiles, said = (_of_variable if variable else _of_stages)(holdings, variable, stage, at or {})
    if not tiles:
        raise RequestError("no pictures stored: keep a stage that makes some, such as 'encode'")
    figure = _draw(tiles, f"{holdings.pipeline}{': ' if holdings.pipeline and said else ''}{said}")
    rows = [[one.stage, one.variable, *one.size] for one in tiles]
    return Plot(figure, ("stage", "variable", "height", "width"), rows, [], DPI)


def _of_stages(holdings: Holdings, variable: str, stage: str, at: AxisValues) -> tuple[list[Tile], str]:
    frames = holdings.table("frames")
    kept = [one for one in holdings.of_kind("picture") if drawn_of(one).shown]
    if not at and frames is not None:
        return of_frames(frames), str(frames.attrs.get("at", "")).removeprefix(" at ").strip()
    asked = resolved(kept, at) if kept else {}
    cell = {dim: asked.get(dim, values[len(values) // 2]) for dim, values in holdings.axes.items()}
    found = []
    for one in kept:
        place = {dim: cell[dim] for dim in one.axes}
        picture = _picture(one, place)
        if picture is not None:
            found.append((one.stage, one.variable, *picture, white_of(holdings, one, place)))
    units = {dim.name: dim.units for dim in dims_of(kept)}
    return _with_parts(found), places_text(cell, units)


def _of_variable(holdings: Holdings, variable: str, stage: str, at: AxisValues) -> tuple[list[Tile], str]:
    held = holdings.find(f"{stage}.{variable}" if stage else variable, "picture")
    asked = resolved([held], at)
    swept = [dim for dim in held.axes if len(held.values_of(dim)) > 1]
    open_ = _one_open(held, [dim for dim in swept if dim not in asked])
    fixed = {dim: asked.get(dim, held.values_of(dim)[0]) for dim in held.axes if dim not in open_}
    units = {dim: held.units_of(dim) for dim in held.axes}
    found: list[tuple[str, str, xarray.DataArray, bool, float]] = []
    for value in held.values_of(open_[0]) if open_ else [None]:
        place = {**fixed, **({open_[0]: value} if open_ else {})}
        picture = _picture(held, place)
        if picture is not None:
            label = value_text(value, units[open_[0]], open_[0]) if open_ else held.stage
            found.append((label, held.variable, *picture, 0.0 if picture[1] else white_of(holdings, held, place)))
    bright = max((white for *_, white in found), default=1.0)  # one white for all, so that darker pictures look darker
    found = [(*one[:-1], bright) for one in found]
    said = places_text({dim: v for dim, v in fixed.items() if dim in swept}, units)
    return _with_parts(found), f"{held.caption}{', ' + said if said else ''}"


def _one_open(held: HeldVariable, open_: list[str]) -> list[str]:
    if len(open_) > 1:
        chosen = _words_at(held, open_[1:])
        raise RequestError(f"{held.name} varies over {' and '.join(open_)}: fix all but one, such as {chosen}")
    return open_


def picture_of(held: HeldVariable, at: AxisValues) -> tuple[xarray.DataArray, bool]:
    """Return the array of one cell and whether the cell has failed.

    Raises
    ------
    RequestError
        An axis, or a leading dim such as ``frame``, has several values and none is chosen.
    """
    open_ = [dim for dim in held.axes if dim not in at and len(held.values_of(dim)) > 1]
    if open_:
        raise RequestError(_open_text(held, open_))
    at = {**{dim: held.values_of(dim)[0] for dim in held.axes}, **at}
    found = _picture(held, at)
    if found is None:
        raise RequestError(
            f"{held.name} was not computed at {places_text(dict(at), {dim: held.units_of(dim) for dim in held.axes})}"
        )
    return found


def _open_text(held: HeldVariable, open_: list[str]) -> str:
    """Return a message that asks to choose one value of each open axis, and gives the command that shows all values of
    the first.
    """
    said = []
    for dim in open_:
        values = held.values_of(dim)
        more = f", ... ({len(values)})" if len(values) > MOST_SAID else ""
        said.append(f"{dim}: {', '.join(value_text(v, held.units_of(dim), dim) for v in values[:MOST_SAID])}{more}")
    chosen, others = _words_at(held, open_), _words_at(held, open_[1:])
    shapes = (
        ", with pictures of several sizes"
        if len({tuple(g.sizes[d] for d in ("y", "x")) for g in held.groups}) > 1
        else ""
    )
    return (
        f"{held.name} is swept over {' and '.join(open_)}{shapes}: choose one value each with {chosen} "
        f"({'; '.join(said)}); "
        f"or show all of {open_[0]} side by side: strip {held.name}{f' {others}' if others else ''}"
    )


def _words_at(held: HeldVariable, dims: Sequence[str]) -> str:
    """Return command-line options that choose the first value of each of these axes."""
    first = {dim: held.values_of(dim)[0] for dim in dims}
    typed = {dim: f"{value:.6g}" if isinstance(value, float) else str(value) for dim, value in first.items()}
    return " ".join(f"--at {dim}={shlex.quote(text)}" for dim, text in typed.items())


def _picture(held: HeldVariable, at: AxisValues) -> tuple[xarray.DataArray, bool] | None:
    """Return the array of a variable in one cell, and whether the cell failed; None if no group has the cell."""
    values = {dim: value for dim, value in at.items() if dim in held.axes}
    inner = {dim: value for dim, value in at.items() if dim in held.dims}
    for group in held.groups_at(at):
        one = group[[held.variable, *(["status"] if "status" in group else [])]].sel(values)
        status = int(one["status"]) if "status" in one else 0
        if status == 4 and group is not held.groups[-1]:  # another shape has it
            continue
        array = pictures.with_bands(one[held.variable], group)
        array = array.sel({dim: value for dim, value in inner.items() if dim in array.coords})
        return pictures.one_frame(array), status not in (0, 1)
    return None


def drawn_of(held: HeldVariable) -> Drawn:
    """Return the drawing properties of a variable that are the same for all cells; ``shown`` is '' if it is not shown
    by default.
    """
    return read(held.variable, held.groups[0].variables[held.variable].attrs, {})


def white_of(holdings: Holdings, held: HeldVariable, at: AxisValues) -> float:
    """Return the linear value shown as white in the picture of a cell; all pictures of the same kind in this cell share
    it.
    """
    kept = [one for one in holdings.of_kind("picture") if drawn_of(one).shown or one is held]

    def bright_of(number: int) -> float | None:
        one = kept[number]
        place = {dim: at[dim] for dim in one.axes}
        key = one.name, *place.values()
        if key not in holdings.whites:
            found = _picture(one, place)
            holdings.whites[key] = None if found is None or found[1] else pictures.bright_in(found[0])
        return holdings.whites[key]

    order = [Pictured(one.variable, one.dims, drawn_of(one), one.axes) for one in kept]
    return white_among(order, kept.index(held), bright_of)


def of_frames(frames: xarray.Dataset) -> list[Tile]:
    """Return the pictures of one cell that a run has stored."""
    tiles = []
    preview = frames["preview"].values
    detail = frames["detail"].values if "detail" in frames else None
    for number, name in enumerate(frames["stage"].values.tolist()):
        one = frames.isel(stage=number)
        picture = np.moveaxis(preview[number][:, : int(one["height"]), : int(one["width"])], 0, -1)
        part, where = None, None
        if detail is not None and int(one["detail_height"]):
            part = np.moveaxis(detail[number][:, : int(one["detail_height"]), : int(one["detail_width"])], 0, -1)
            top, left, high, wide = (float(value) for value in one["detail_place"].values)
            where = (top, left, high, wide)
        variable = str(one["variable"].values)
        size = (int(one["true_height"]), int(one["true_width"]))
        tiles.append(Tile(str(name).removesuffix(f".{variable}"), variable, picture, size, part, where))
    return tiles


def _with_parts(found: list[tuple[str, str, xarray.DataArray, bool, float]]) -> list[Tile]:
    """Return tiles of stored arrays, drawn with their values of white, each with a detail at the same strong edge."""
    drawn = [
        (stage, variable, pictures.drawn(array, white, failed), failed)
        for stage, variable, array, failed, white in found
    ]
    there = [picture for *_, picture, failed in drawn if not failed]
    if not there:
        return [Tile(stage, variable, picture, picture.shape[:2]) for stage, variable, picture, _ in drawn]
    coarse = min(there, key=lambda picture: picture.shape[0] * picture.shape[1])
    side = side_of(coarse.shape[:2])
    top, left = part_of(coarse / 255.0, side)
    rows, columns = coarse.shape[:2]
    where = (top / rows, left / columns, side / rows, side / columns)
    tiles = []
    for stage, variable, picture, failed in drawn:
        rows, columns = picture.shape[:2]
        top, left, high, wide = (round(s * n) for s, n in zip(where, (rows, columns, rows, columns), strict=True))
        tiles.append(
            Tile(
                stage,
                variable,
                picture,
                (rows, columns),
                None if failed else picture[top : top + high, left : left + wide],
                where,
            )
        )
    return tiles


def _draw(tiles: list[Tile], title: str) -> Any:
    largest = max(max(one.picture.shape[:2]) for one in tiles)
    box = max(BOX, largest) if largest <= 512 and len(tiles) <= 12 else BOX
    across = min(COLUMNS if len(tiles) > 8 else 4, len(tiles))
    down = -(-len(tiles) // across)
    sizes = [_fitted(one.picture.shape[:2], box) for one in tiles]
    wide, high = max(size[1] for size in sizes), max(size[0] for size in sizes)
    inset = INSET if any(one.part is not None for one in tiles) else 0
    width, height = GAP + across * (wide + GAP), HEAD + down * (LABEL + high + (inset + 6 if inset else 0) + GAP) + GAP
    width = max(width, 9 * len(title) // 2)
    figure = new_figure(width / DPI, height / DPI, layout=None)
    figure.text(0.5, 1 - 0.5 * HEAD / height, title, ha="center", va="center", fontsize=10)
    for number, (one, size) in enumerate(zip(tiles, sizes, strict=True)):
        row, column = divmod(number, across)
        left, top = GAP + column * (wide + GAP), HEAD + row * (LABEL + high + (inset + 6 if inset else 0) + GAP) + LABEL
        text = (
            f"{number + 1}. {one.stage}\n{one.variable}  {one.size[1]} × {one.size[0]}"
            if len(tiles) > 1
            else f"{one.stage}.{one.variable}  {one.size[1]} × {one.size[0]}"
        )
        figure.text(
            (left + wide / 2) / width,
            1 - (top - 4) / height,
            text,
            ha="center",
            va="bottom",
            fontsize=7.5,
            linespacing=1.1,
        )
        indent = left + (wide - size[1]) // 2
        axes = _placed(figure, one.picture, indent, top, size)
        if one.part is not None and one.where is not None:
            from matplotlib.patches import Rectangle

            rows, columns = one.picture.shape[:2]
            y, x, h, w = (s * n for s, n in zip(one.where, (rows, columns, rows, columns), strict=True))
            axes.add_patch(Rectangle((x - 0.5, y - 0.5), w, h, fill=False, edgecolor="#ff2222", linewidth=0.8))
            side = _fitted(one.part.shape[:2], inset)
            _placed(figure, one.part, left + (wide - side[1]) // 2, top + high + 6, side, "#ff2222")
    return figure


def _fitted(shape: tuple[int, int], box: int) -> tuple[int, int]:
    """Return the height and width of a picture in dots; a sample takes a whole number of dots if the array fits into
    the box.
    """
    largest = max(shape)
    scale = box // largest if box >= largest else box / largest
    return max(1, round(shape[0] * scale)), max(1, round(shape[1] * scale))


def _placed(figure: Figure, picture: Array, left: int, top: int, size: tuple[int, int], edge: str = "") -> Axes:
    """Draw a picture at its place in dots, upright, with square samples."""
    width, height = (round(DPI * length) for length in figure.get_size_inches())
    axes = figure.add_axes((left / width, 1 - (top + size[0]) / height, size[1] / width, size[0] / height))
    small = size[0] < picture.shape[0]
    axes.imshow(picture, origin="upper", interpolation="antialiased" if small else "none", aspect="auto")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(bool(edge))
        spine.set_color(edge or "black")
        spine.set_linewidth(0.8)
    return axes


def show(holdings: Holdings, variable: str, stage: str = "", at: AxisValues | None = None) -> Plot:
    """Show one picture of one cell, upright, with its true aspect and colours.

    Raises
    ------
    RequestError
        No such picture; an axis has several values and none is chosen.
    """
    names = [one.variable for one in holdings.of_kind("picture")]
    if not variable:
        if not names:
            raise RequestError("no pictures stored")
        variable = next((name for name in first("picture") if name in names), names[-1])
    if variable not in names and "." not in variable and not any(one.variable == variable for one in holdings):
        raise RequestError(f"unknown picture {variable!r}{nearest(variable, names)}")
    held = holdings.find(f"{stage}.{variable}" if stage and "." not in variable else variable, "picture")
    asked = resolved([held], at or {})
    array, failed = picture_of(held, asked)
    where = {dim: asked.get(dim, held.values_of(dim)[0]) for dim in held.axes}
    white = 1.0 if failed else white_of(holdings, held, where)
    units = {dim: held.units_of(dim) for dim in held.axes}
    return show_array(array, failed, f"{held.name} {places_text(where, units)}".strip(), white)


def show_array(array: xarray.DataArray, failed: bool = False, title: str = "", white: float | None = None) -> Plot:
    """Show one array as a picture, striped where it has no values. ``white``: the linear value shown as white; None:
    derive it from the array alone.
    """
    picture = pictures.drawn(array, white, failed)
    rows, columns = picture.shape[:2]
    scale = max(1, 480 // max(rows, columns))
    size = rows * scale, columns * scale
    lost = bool(np.isnan(np.asarray(array.values, float)).all()) if array.dtype.kind == "f" else False
    words = [
        title or str(array.name or ""),
        "the cell failed: no picture" if failed else "no values: not computed, or the cell failed" if lost else "",
    ]
    text = "\n".join(word for word in words if word)
    width, head = max(size[1] + 2 * GAP, 220), 22 + 14 * text.count("\n")
    height = size[0] + GAP + head
    figure = new_figure(width / DPI, height / DPI, layout=None)
    figure.text(
        0.5,
        1 - 0.5 * head / height,
        text,
        ha="center",
        va="center",
        fontsize=min(8, 1.55 * width / max(len(t) for t in text.split("\n")) if text else 8),
    )
    _placed(figure, picture, (width - size[1]) // 2, head, size)
    return Plot(figure, ("height", "width"), [[rows, columns]], [text] if failed or lost else [], DPI)
