"""Photographs as scenes: a picture file as a reflecting surface under an illuminant.

In:  a picture file and the common parameters of scenes.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from etendue.api import Facts, Grid, param
from etendue.contract.values.bounds import beyond
from etendue.transfer import resampling
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.colour.encoding import srgb_decode
from etendue_camera.picture_files import MOST_PIXELS, read_picture
from etendue_camera.scene.stages.scene import Scene

BLOCK = 1 << 15  # pixels whose temporaries stay in the cache


def _linear_photograph(path: str, rows: int, columns: int) -> tuple[FloatArray, str]:
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
def _read_photograph(path: str, rows: int, columns: int, state: tuple[int, int]) -> tuple[FloatArray, str]:
    """Return linear sRGB (3, rows, columns) from the largest centred crop of the right shape, area-averaged in linear
    light, and a note.
    """
    picture = read_picture(path)
    height, width = picture.values.shape[:2]
    scale = min(height / rows, width / columns)
    crop_rows, crop_columns = max(1, round(rows * scale)), max(1, round(columns * scale))
    top, left = (height - crop_rows) // 2, (width - crop_columns) // 2
    crop = picture.values[top : top + crop_rows, left : left + crop_columns]
    linear = resampling.area_average(crop, rows, columns, _decoder(crop.dtype, picture.full))
    linear.flags.writeable = False
    return np.broadcast_to(linear, (3, rows, columns)), picture.note


def _decoder(kind: np.dtype, full: float) -> Callable[[Array], NDArray[np.float64]]:
    """Return the function from the values of a picture to linear light; of whole numbers a table."""
    if kind.kind != "u" or kind.itemsize > 2:
        return lambda values: srgb_decode(values.astype(float) / full)
    return srgb_decode(np.arange(np.iinfo(kind).max + 1.0) / full).take


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
        """Return bins, spacing and margin; samples finer than the pixels of the file add nothing."""
        rows, columns = self.size()
        height, width = _pixels(self.file)
        finer = min(height / rows, width / columns) < 2
        return {**super().discretisations(), **({"spacing": "fixed by the file"} if finer else {})}

    def rendered(self) -> None:
        """Return None: the processing by camera and file format is unknown."""

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        _, note = _linear_photograph(self.file, *self.size())
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
        linear, _ = _linear_photograph(self.file, *self.size())
        low, high = float(linear.min()), float(linear.max())
        return Facts(uniform=low == high, contrast=high / low if low > 0 else math.inf)

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        edges = tuple(coordinates["out_wavelength_edges"])
        return super().prepare(coordinates), spectra.upsampling_basis(edges)

    def by_band(self, prepared: tuple[FloatArray, FloatArray], bands: slice) -> tuple[FloatArray, FloatArray]:
        return prepared[0][bands], prepared[1][bands]

    def mixture(self, prepared: tuple[FloatArray, FloatArray]) -> tuple[Array, Array]:
        """Return the red, green and blue of the picture, and the light of each by band."""
        white, basis = prepared
        return _linear_photograph(self.file, *self.size())[0], np.maximum(basis, 0.0) * white[:, None]

    def run(self, prepared: tuple[FloatArray, FloatArray]) -> dict[str, Array]:
        white, _ = prepared
        linear, weights = self.mixture(prepared)
        cube = np.zeros((len(white), *linear.shape[1:]))
        rows = max(BLOCK // linear.shape[2], 1)
        for plane, own, lit in zip(cube, weights, white > 0, strict=True):
            for start in range(0, len(plane) if lit else 0, rows):  # the other bands have no light
                part, out = linear[:, start : start + rows], plane[start : start + rows]
                np.multiply(part[0], own[0], out=out)  # no matrix product: its rounding depends on the number of bands
                out += own[1] * part[1]
                out += own[2] * part[2]
        return {"radiance": cube, "white_radiance": white}
