"""Photographs as scenes: a picture file as a reflecting surface under an illuminant.

In:  a picture file and the common parameters of scenes.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from etendue.api import Facts, Grid, param
from etendue.contract.values.bounds import beyond
from etendue.transfer import resampling
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.colour.encoding import srgb_decode
from etendue_camera.picture_files import MOST_PIXELS, read_picture
from etendue_camera.scene.stages.scene import Scene

BLOCK = 1 << 15  # pixels whose temporaries stay in the cache


@dataclass(frozen=True)
class LinearPicture(Sequence[FloatArray]):
    """The red, green and blue planes of a picture in linear sRGB. They are stored as such, or in an eighth of the
    memory as the codes of the file and a table of the light of each code.
    """

    values: Array  # (1 or 3, rows, columns)
    table: FloatArray | None
    note: str

    def __len__(self) -> int:
        return 3

    def __getitem__(self, colour: Any) -> Any:
        """Return the linear plane of one colour, (rows, columns)."""
        values = self.values[min(range(3)[colour], len(self.values) - 1)]
        if self.table is None:
            return values
        return self.table.take(values, out=np.empty(values.shape), mode="clip")

    def ends(self) -> tuple[float, float]:
        """Return the least and the largest value."""
        low, high = (end if self.table is None else self.table[end] for end in (self.values.min(), self.values.max()))
        return float(low), float(high)

    def mixed(self, weights: FloatArray, first: int, out: FloatArray) -> None:
        """Write the weighted sum of the light of the three colours, starting at row ``first``, into ``out``."""
        some = self.values[:, first : first + len(out)]
        planes = np.broadcast_to(some, (3, *out.shape))
        rows = max(BLOCK // out.shape[1], 1)
        # no matrix product: its rounding depends on the number of bands
        tables = None if self.table is None else weights[:, None] * self.table
        lit = np.empty((rows, out.shape[1]))
        for start in range(0, len(out), rows):
            own = out[start : start + rows]
            for colour, plane in enumerate(planes):
                part, to = plane[start : start + rows], lit[: len(own)] if colour else own
                if tables is None:
                    np.multiply(part, weights[colour], out=to)
                else:
                    tables[colour].take(part, out=to, mode="clip")
                if colour:
                    own += to


def _linear_photograph(path: str, rows: int, columns: int) -> LinearPicture:
    """Return ``_read_photograph``, cached until the file changes."""
    state = os.stat(path)
    return _read_photograph(path, rows, columns, (state.st_mtime_ns, state.st_size))


def _pixels(path: str) -> tuple[int, int]:
    """Return the height and width of a picture file."""
    state = os.stat(path)
    return _counted(path, (state.st_mtime_ns, state.st_size))


@lru_cache(maxsize=16)
def _counted(path: str, state: tuple[int, int]) -> tuple[int, int]:
    height, width = read_picture(path).values.shape[:2]
    return height, width


@lru_cache(maxsize=4)
def _read_photograph(path: str, rows: int, columns: int, state: tuple[int, int]) -> LinearPicture:
    """Return the largest centred crop with the grid's aspect ratio, area-averaged onto the grid in linear light."""
    picture = read_picture(path)
    height, width = picture.values.shape[:2]
    scale = min(height / rows, width / columns)
    crop_rows, crop_columns = max(1, round(rows * scale)), max(1, round(columns * scale))
    top, left = (height - crop_rows) // 2, (width - crop_columns) // 2
    crop = picture.values[top : top + crop_rows, left : left + crop_columns]
    table = _table(crop.dtype, picture.full)
    if crop.shape[:2] == (rows, columns) and table is not None:  # averages of one sample each
        values = np.ascontiguousarray(np.moveaxis(crop, -1, 0))
    else:
        full = picture.full
        decode = (lambda codes: srgb_decode(codes.astype(float) / full)) if table is None else table.take
        values = resampling.area_average(crop, rows, columns, decode)
        table = None
    values.flags.writeable = False
    return LinearPicture(values, table, picture.note)


def _table(kind: np.dtype, full: float) -> FloatArray | None:
    """Return the linear light of every code of an integer picture of up to 16 bits; None for other pictures."""
    if kind.kind != "u" or kind.itemsize > 2:
        return None
    return srgb_decode(np.arange(np.iinfo(kind).max + 1.0) / full)


@dataclass(frozen=True, kw_only=True)
class Photograph(Scene):
    """Use a picture (PNG, JPEG, TIFF; sRGB-encoded, at full bit depth) as a reflecting surface under the illuminant.

    The picture is decoded to linear light, area-averaged onto the grid, and given spectra from a basis that reproduces
    its colours under D65 (to rounding, over the full spectrum). The samples of the picture set the band limit of the
    scene.
    """

    file: str = param(
        file=True,
        example="package:etendue_camera/data/examples/picture.png",
        doc="path of the picture; package:matplotlib/... refers to a file of an installed distribution",
    )
    working: ClassVar = 1.0
    libraries: ClassVar = ("colour-science", "pillow", "tifffile")

    def band_limit(self) -> float:
        return 0.5 / self.spacing

    def discretisations(self) -> dict[str, str]:
        """Return bins, spacing and margin; the spacing is fixed if half of it would be finer than the file's pixels."""
        rows, columns = self.size()
        height, width = _pixels(self.file)
        finer = min(height / rows, width / columns) < 2
        return {**super().discretisations(), **({"spacing": "fixed by the file"} if finer else {})}

    def rendered(self) -> None:
        """Return None: the processing by camera and file format is unknown."""

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        note = _linear_photograph(self.file, *self.size()).note
        return [
            *super().warn(facts, grids),
            *spectra.held_in_the_infrared("basis of RGB", self.wavelength_from, self.wavelength_to),
            *([f"{os.path.basename(self.file)}: {note}"] if note else []),
        ]

    def size(self) -> tuple[int, int]:
        grid = self.plane()
        rows, columns = grid["y"].size, grid["x"].size
        too_many = beyond(
            rows * columns, "samples in a photograph", MOST_PIXELS, "use a larger spacing or a smaller scene"
        )
        if too_many:
            raise ValueError(too_many)
        return rows, columns

    def known(self) -> Facts:
        low, high = _linear_photograph(self.file, *self.size()).ends()
        return Facts(uniform=low == high, contrast=high / low if low > 0 else math.inf)

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        edges = tuple(coordinates["out_wavelength_edges"])
        return super().prepare(coordinates), spectra.upsampling_basis(edges)

    def by_band(self, prepared: tuple[FloatArray, FloatArray], bands: slice) -> tuple[FloatArray, FloatArray]:
        return prepared[0][bands], prepared[1][bands]

    def in_rows(self) -> bool:
        return True

    def mixture(self, prepared: tuple[FloatArray, FloatArray]) -> tuple[LinearPicture, Array]:
        """Return the red, green and blue of the picture, and the light of each by band."""
        white, basis = prepared
        return _linear_photograph(self.file, *self.size()), np.maximum(basis, 0.0) * white[:, None]

    def run(self, prepared: tuple[FloatArray, FloatArray], out_y: FloatArray) -> dict[str, Array]:
        white, basis = prepared
        rows, columns = self.size()
        line = self.plane().line("y")
        first = round((out_y[0] - line.start) / line.step)
        cube = np.zeros((len(white), len(out_y), columns))
        for plane, own, lit in zip(cube, np.maximum(basis, 0.0) * white[:, None], white > 0, strict=True):
            if lit:  # the other bands have no light
                _linear_photograph(self.file, rows, columns).mixed(own, first, plane)
        return {"radiance": cube, "white_radiance": white}
