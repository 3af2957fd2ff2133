"""How an array of an archive looks on the page: ``plots.pictures`` asked at a place on the axes, and where it lies on
the image plane.

In:  an archive opened to be shown; a stage, a variable, places on the axes.
Out: ``Picture``: the array as it was stored, where it lies on the image plane, and itself in 8-bit sRGB.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray

from etendue.contract import seen as seen_as
from etendue.contract.drawn import Drawn, Pictured, read
from etendue.errors import ArchiveError
from etendue.present.page.opened import PLANE, Group, Opened
from etendue.present.pictures.appearance import as_bytes, seen
from etendue.present.plots import pictures
from etendue.types.arrays import Array

LARGEST = 64 * 2**20  # numbers of an array that is shown


def pictured(opened: Opened) -> list[tuple[str, str]]:
    """Every (stage, variable) that is a picture, in the order of the stages."""
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
    group: Group
    variable: str
    places: Mapping[str, int]  # on the axes of the sweep
    array: Array  # (..., y, x) as stored
    origin: tuple[float, float]  # y, x of the first sample
    step: tuple[float, float]
    on_plane: bool  # whether they are um on the image plane; else samples

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
        """What stands along a leading dim."""
        if dim not in self.group.data.coords:
            return [str(i) for i in range(int(self.group.data.sizes[dim]))]
        units = str(self.group.data[dim].attrs.get("units", "1"))
        return [
            f"{v:g} {units}".removesuffix(" 1") if isinstance(v, float) else str(v)
            for v in self.group.data[dim].to_numpy().tolist()
        ]

    @cached_property
    def one(self) -> xarray.DataArray:
        """The array with all that its archive says of it; of several frames the one in the middle."""
        data, dims = self.group.data, self.group.variables[self.variable]
        coords = {dim: data[dim].variable for dim in dims if dim in data.coords}
        at = {dim: self.opened.axis(dim).values[self.places.get(dim, 0)] for dim in self.group.axes}
        own = xarray.DataArray(self.array, {**coords, **at}, dims, self.variable, data[self.variable].attrs)
        return pictures.one_frame(pictures.with_bands(own, data))

    @cached_property
    def drawn(self) -> Drawn:
        return pictures.drawn_as(self.one)

    @cached_property
    def linear(self) -> Any:
        """(3, y, x) float32: linear sRGB, or, where it is encoded or a map, what is shown as it is."""
        return pictures.appearance_of(self.one).rgb(self.one.values)

    @property
    def scaled(self) -> bool:
        """Whether its brightness is chosen for the eye."""
        return self.drawn.scaled

    @cached_property
    def bright(self) -> float:
        """The linear value that is shown as white: the same for all stages of a kind, as far as they are there."""
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

        return pictures.bright_among(order, number, bright_of)

    def eight_bit(self, gain: float = 1.0) -> Any:
        """(y, x, 3) uint8. ``gain``: times brighter than it would be."""
        return _bytes(seen(self.drawn, self.linear, self.bright / gain))

    def small(self) -> Any:
        """The same, averaged over areas until it fits."""
        return _bytes(seen(self.drawn, pictures.appearance_of(self.one).small(self.one.values), self.bright))

    # -- places -----------------------------------------------------------------------------------------

    def sample(self, y: float, x: float) -> tuple[int, int] | None:
        """Row and column of the sample at a place (um, or samples); None beside the picture."""
        row, column = (
            int(np.floor((at - origin) / step + 0.5))
            for at, origin, step in zip((y, x), self.origin, self.step, strict=True)
        )
        return (row, column) if 0 <= row < self.size[0] and 0 <= column < self.size[1] else None

    def filter_letters(self) -> Any:
        """(y, x) letters of what is in front of the pixels of a pattern; None of any other picture."""
        if not self.drawn.pattern:
            return None
        first = [round(float(self.one[dim].values[0])) if dim in self.one.coords else 0 for dim in PLANE]
        tile = np.array([list(row) for row in seen_as.pattern(self.drawn.pattern).moved(*first)])
        return tile[np.arange(self.size[0])[:, None] % tile.shape[0], np.arange(self.size[1])[None, :] % tile.shape[1]]

    def filter_at(self, row: int, column: int) -> str:
        """The letter of what is in front of a pixel of a pattern, '' of any other picture."""
        letters = self.filter_letters()
        return "" if letters is None else str(letters[row, column])


def drawn_of(opened: Opened, stage: str, variable: str) -> Drawn:
    """How a variable is drawn, as far as that holds for all cells."""
    return read(variable, opened.groups[stage][0].data.variables[variable].attrs, {})


def _bytes(picture: Array) -> Any:
    return np.ascontiguousarray(np.moveaxis(as_bytes(picture), 0, -1))


def picture(opened: Opened, stage: str, variable: str, at: Mapping[str, int]) -> Picture | None:
    """A variable of the cell at places on the axes; None where there is none.

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


def _line(opened: Opened, group: Group, dim: str, at: Mapping[str, int]) -> tuple[float, float, bool]:
    """First position and step along a dim, and whether they are um on the image plane."""
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
