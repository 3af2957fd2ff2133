"""The picture of an array at a position on the axes, made by ``plots.pictures``, and its place on the image plane.

In:  an archive opened for display; a stage, a variable, positions on the axes.
Out: ``Picture``: the stored array, its place on the image plane, and its 8-bit sRGB rendering.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray

from etendue.contract.arrays import colouring as seen_as
from etendue.contract.arrays.drawn import Drawn, Pictured, read
from etendue.errors import ArchiveError
from etendue.present.page.opened import PLANE, Opened, ShownGroup
from etendue.present.pictures.appearance import rendered, white_among
from etendue.present.plots import pictures
from etendue.types.arrays import Array

LARGEST = 64 * 2**20  # largest number of elements of an array that is shown


def pictured(opened: Opened) -> list[tuple[str, str]]:
    """Return every (stage, variable) that is a picture, in the order of the stages."""
    found: dict[tuple[str, str], None] = {}
    for stage in opened.stages:
        for group in opened.groups.get(stage, []):
            for name, dims in group.variables.items():
                if dims[-2:] == PLANE and (len(dims) <= 3 or drawn_of(opened, stage, name).shown):
                    found[stage, name] = None
    return list(found)


@dataclass(frozen=True)
class Picture:
    """One variable of one cell over y and x."""

    opened: Opened
    group: ShownGroup
    variable: str
    places: Mapping[str, int]  # positions on the axes of the sweep
    array: Array  # (..., y, x) as stored
    origin: tuple[float, float]  # y, x of the first sample
    step: tuple[float, float]
    on_plane: bool  # True: um on the image plane; False: samples

    @property
    def size(self) -> tuple[int, int]:
        return int(self.array.shape[-2]), int(self.array.shape[-1])

    @property
    def units(self) -> str:
        units = str(self.group.data[self.variable].attrs.get("units", "1"))
        return "" if units == "1" else units

    @property
    def dims(self) -> tuple[str, ...]:
        return self.group.variables[self.variable][:-2]

    def labels(self, dim: str) -> list[str]:
        """Return the labels along a leading dim."""
        if dim not in self.group.data.coords:
            return [str(i) for i in range(int(self.group.data.sizes[dim]))]
        units = str(self.group.data[dim].attrs.get("units", "1"))
        return [
            f"{v:g} {units}".removesuffix(" 1") if isinstance(v, float) else str(v)
            for v in self.group.data[dim].to_numpy().tolist()
        ]

    @cached_property
    def one(self) -> xarray.DataArray:
        """The array with its coordinates and attributes; for several frames, the middle frame."""
        data, dims = self.group.data, self.group.variables[self.variable]
        coords = {dim: data[dim].variable for dim in dims if dim in data.coords}
        at = {dim: self.opened.axis(dim).values[self.places.get(dim, 0)] for dim in self.group.axes}
        own = xarray.DataArray(self.array, {**coords, **at}, dims, self.variable, data[self.variable].attrs)
        return pictures.one_frame(pictures.with_bands(own, data))

    @cached_property
    def drawn(self) -> Drawn:
        return pictures.drawn_as(self.one)

    @cached_property
    def linear(self) -> Array:
        """The picture as (3, y, x) float32: linear sRGB, or the displayed values if it is encoded or a map."""
        return pictures.appearance_of(self.one).rgb(self.one.values)

    @property
    def scaled(self) -> bool:
        """Whether the brightness of the picture is adapted for viewing."""
        return self.drawn.scaled

    @cached_property
    def bright(self) -> float:
        """The linear value shown as white; pictures of the same kind share it."""
        opened, stages = self.opened, pictured(self.opened)
        order = [
            Pictured(
                name, opened.groups[stage][0].variables[name], drawn_of(opened, stage, name), opened.reaching(stage)
            )
            for stage, name in stages
        ]
        number = stages.index((self.group.stage, self.variable))

        def bright_of(other: int) -> float | None:
            key = (*stages[other], *(self.places.get(dim, 0) for dim in order[other].axes))
            if key not in opened.whites:
                try:
                    found = self if other == number else picture(opened, *stages[other], self.places)
                except ArchiveError:
                    return None
                if found is None:
                    return None
                opened.whites[key] = pictures.bright_in(found.one)
            return opened.whites[key]

        return white_among(order, number, bright_of)

    def eight_bit(self, gain: float = 1.0) -> Array:
        """Return the picture as (y, x, 3) uint8. ``gain``: factor by which linear values are brightened."""
        return rendered(self.drawn, self.linear, self.bright / gain)

    def small(self) -> Array:
        """Return the picture, averaged over areas until it fits."""
        return pictures.drawn(self.one, self.bright, small=True)

    # -- places -----------------------------------------------------------------------------------------

    def sample(self, y: float, x: float) -> tuple[int, int] | None:
        """Return row and column of the sample at a place (um, or samples); None outside the picture."""
        row, column = (
            int(np.floor((at - origin) / step + 0.5))
            for at, origin, step in zip((y, x), self.origin, self.step, strict=True)
        )
        return (row, column) if 0 <= row < self.size[0] and 0 <= column < self.size[1] else None

    def filter_letters(self) -> Any:
        """Return the (y, x) array of filter letters if the picture has a pattern, else None."""
        if not self.drawn.pattern:
            return None
        first = [round(float(self.one[dim].values[0])) if dim in self.one.coords else 0 for dim in PLANE]
        tile = np.array([list(row) for row in seen_as.pattern(self.drawn.pattern).moved(*first)])
        return tile[np.arange(self.size[0])[:, None] % tile.shape[0], np.arange(self.size[1])[None, :] % tile.shape[1]]


def drawn_of(opened: Opened, stage: str, variable: str) -> Drawn:
    """Return the drawing properties of a variable that are the same for all cells."""
    return read(variable, opened.groups[stage][0].data.variables[variable].attrs, {})


def picture(opened: Opened, stage: str, variable: str, at: Mapping[str, int]) -> Picture | None:
    """Return a variable of the cell at positions on the axes; None if there is none.

    Raises
    ------
    ArchiveError
        It is damaged.
    """
    found = opened.find(stage, at)
    if found is None or not opened.has(found[1]):
        return None
    group, name = found
    if variable not in group.variables or group.variables[variable][-2:] != PLANE:
        return None
    if int(np.prod([int(group.data.sizes[dim]) for dim in group.variables[variable]])) > LARGEST:
        return None
    array = opened.read(name, variable)
    (y, dy, on_y), (x, dx, on_x) = (_line(opened, group, dim, at) for dim in PLANE)
    return Picture(opened, group, variable, dict(at), array, (y, x), (dy, dx), on_y and on_x)


def _line(opened: Opened, group: ShownGroup, dim: str, at: Mapping[str, int]) -> tuple[float, float, bool]:
    """Return the first position and the step along a dim, and whether both are in um on the image plane."""
    own = group.data.coords.get(f"{dim}_um")
    if own is None and dim in group.data.coords and group.data[dim].attrs.get("units") == "um":
        own = group.data[dim]
    if own is None:
        return 0.0, 1.0, False
    place = {}
    for axis in (str(one) for one in own.dims[:-1]):
        place[axis] = group.axes[axis].index(opened.axis(axis).values[at.get(axis, 0)])
    values = own.isel(place).to_numpy()
    if not np.isfinite(values).all():
        return 0.0, 1.0, False
    return float(values[0]), float(values[1] - values[0]) if len(values) > 1 else 1.0, True
