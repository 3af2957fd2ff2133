"""How an array of an archive looks: light through the observer's eyes, a mosaic through its own filters, a display's values as they are.

In:  an archive opened to be shown; a stage, a variable, places on the axes.
Out: ``Picture``: the array as it was stored, where it lies on the image plane, and itself in 8-bit sRGB.

What distributions say of a variable (``spec.variables.Variable``) decides, as on the contact sheet (``report.thumbnails``), which needs
a plan; here the archive alone is asked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from etendue import spectra
from etendue.page.opened import PLANE, Group, Opened
from etendue.physics.colour import matrices
from etendue.physics.colour.encoding import srgb_encode
from etendue.physics.sensor import cfa
from etendue.report.thumbnails import mapped
from etendue.spec.variables import variable as known

QUANTILE, LEVEL = 0.995, 0.9  # of the samples of a linear picture: shown at this share of white
LARGEST = 64 * 2**20  # numbers of an array that is shown


def pictured(opened: Opened) -> list[tuple[str, str]]:
    """Every (stage, variable) that is a picture, in the order of the stages."""
    found: dict[tuple[str, str], None] = {}
    for stage in opened.stages:
        for group in opened.groups.get(stage, []):
            for name, dims in group.variables.items():
                if dims[-2:] == PLANE and (known(name).shown or len(dims) <= 3):
                    found[stage, name] = None
    return list(found)


@dataclass(frozen=True)
class Picture:
    """One variable of one cell over y and x."""

    group: Group
    variable: str
    array: Any  # (..., y, x) as stored
    origin: tuple[float, float]  # y, x of the first sample
    step: tuple[float, float]
    on_plane: bool  # whether they are um on the image plane; else samples
    pattern: str  # of the colour filter array, '' where none is known
    black_level: float = 0.0

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
        return [f"{v:g} {units}".removesuffix(" 1") if isinstance(v, float) else str(v) for v in self.group.data[dim].to_numpy().tolist()]

    @cached_property
    def linear(self) -> Any:
        """(3, y, x) float32: linear sRGB, or, where it is encoded or a map, what is shown as it is."""
        dims, array = self.dims, self.array
        while dims and dims[0] not in ("channel", "wavelength"):  # of several frames the one in the middle
            dims, array = dims[1:], array[len(array) // 2]
        how = known(self.variable)
        if dims == ("wavelength",):
            return self._light(np.asarray(array, dtype=np.float32))
        if dims == ("channel",):
            return self._planes(np.asarray(array, dtype=np.float32))
        if how.shown == "map" or not how.shown:
            return mapped(np.asarray(array), how) if max(array.shape) <= 256 else _grey(np.asarray(array, dtype=np.float32), how)
        return self._mosaic(np.asarray(array, dtype=np.float32))

    def _light(self, array: Any) -> Any:
        edges = self.group.data["wavelength_bounds"].to_numpy()
        bounds = np.append(edges[:, 0], edges[-1, 1])
        observer = (spectra.colour_matching(bounds) * np.diff(bounds)[:, None]).T.astype(np.float32)
        return matrices.apply_matrix(np.linalg.inv(matrices.RGB_TO_XYZ_SRGB), np.tensordot(observer, array, axes=1))

    def _planes(self, array: Any) -> Any:
        names = self.labels("channel")
        if names[:3] == ["X", "Y", "Z"]:
            return matrices.apply_matrix(np.linalg.inv(matrices.RGB_TO_XYZ_SRGB), array[:3])
        return array[:3] if names[:3] == ["R", "G", "B"] else np.repeat(array.mean(axis=0, keepdims=True), 3, axis=0)

    def _mosaic(self, array: Any) -> Any:
        black = known(self.variable).black
        if black:
            array = np.maximum(array - self.black_level, 0)
        if not self.pattern:
            return np.repeat(array[None], 3, axis=0)
        tints = np.array([cfa.tint(channel) for channel in cfa.read(self.pattern).channels], dtype=np.float32)
        return np.moveaxis(tints[self._channels], -1, 0) * array

    @property
    def scaled(self) -> bool:
        """Whether its brightness is chosen for the eye."""
        how = known(self.variable)
        return how.shown == "linear" and how.white is None

    @cached_property
    def bright(self) -> float:
        """The linear value that is shown as white."""
        how = known(self.variable)
        if how.shown != "linear":
            return 1.0
        if how.white is not None:
            return how.white
        peaks = self.linear.max(axis=0)
        peaks = peaks[np.isfinite(peaks)]
        if not peaks.size:
            return 1.0
        found = max(float(np.quantile(peaks, QUANTILE)), 1e-3 * float(peaks.max())) / LEVEL
        return found if found > 0 else 1.0

    def eight_bit(self, gain: float = 1.0, bright: float | None = None) -> Any:
        """(y, x, 3) uint8; what is undefined is black. ``gain``: times brighter than it would be."""
        shown = np.nan_to_num(self.linear, nan=0.0, posinf=0.0, neginf=0.0)
        if known(self.variable).shown == "linear":
            shown = srgb_encode(np.clip(shown * (gain / (bright or self.bright)), 0, 1))
        return np.ascontiguousarray(np.moveaxis(np.round(np.clip(shown, 0, 1) * 255).astype(np.uint8), 0, -1))

    # -- places -----------------------------------------------------------------------------------------

    def sample(self, y: float, x: float) -> tuple[int, int] | None:
        """Row and column of the sample at a place (um, or samples); None beside the picture."""
        row, column = (int(np.floor((at - origin) / step + 0.5)) for at, origin, step in zip((y, x), self.origin, self.step, strict=True))
        return (row, column) if 0 <= row < self.size[0] and 0 <= column < self.size[1] else None

    def filter_letters(self) -> Any:
        """(y, x) letters of the filters in front of the pixels of a mosaic; None of any other picture."""
        if not self.pattern or "channel" in self.dims or "wavelength" in self.dims or known(self.variable).shown != "linear":
            return None
        return np.array(cfa.read(self.pattern).channels)[self._channels]

    def filter_at(self, row: int, column: int) -> str:
        """The letter of the filter in front of a pixel of a mosaic, '' of any other picture."""
        letters = self.filter_letters()
        return "" if letters is None else str(letters[row, column])

    @cached_property
    def _channels(self) -> Any:
        first = [round(float(self.group.data[dim].to_numpy()[0])) if dim in self.group.data.coords else 0 for dim in PLANE]
        return cfa.channel_index(cfa.read(self.pattern), *self.size, *first)


def _grey(plane: Any, how: Any) -> Any:
    """Numbers over y and x as grey at their full size, from the lowest to the highest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.log(plane) if how.log else plane
    finite = found[np.isfinite(found)]
    low, high = (np.log(how.range) if how.log else how.range) if how.range else (finite.min(initial=0.0), finite.max(initial=0.0))
    share = (found - low) / (high - low) if high > low else np.full_like(found, 0.5)
    return np.repeat(np.where(np.isfinite(share), np.clip(share, 0, 1), 0)[None].astype(np.float32), 3, axis=0)


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
    node = opened.record["nodes"].get(stage, {}).get("shown", {})
    camera = {**opened.record["camera"], **node}
    camera |= {axis.key.rpartition(".")[2]: axis.values[at.get(axis.dim, 0)] for axis in opened.axes}
    pattern = str(camera.get("pattern") or "")
    black = camera.get(known(variable).black) if known(variable).black else 0.0
    return Picture(group, variable, array, (y, x), (dy, dx), on_y and on_x, pattern, black_level=float(black or 0.0))


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
