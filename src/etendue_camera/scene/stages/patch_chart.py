"""Scenes of patches with user-supplied reflectances: your own colour chart, paints, leaves, skin.

In:  a table of reflectances, one column per patch; the chart's geometry (um on the image plane), an illuminant, a
     luminance.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Facts, Grid, param
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.scene import composite
from etendue_camera.scene.stages.scene import Scene, softness_knob


@dataclass(frozen=True, kw_only=True)
class PatchChart(Scene):
    """Draw uniform patches with user-supplied reflectances, row by row from the upper left, on grey.

    Wavelengths outside the table use its first or last row. Reflectances up to 2 are allowed, for fluorescent surfaces.
    Empty places in the last row of patches show the background.
    """

    nanoseconds: ClassVar = 12.0

    reflectances: str = param(
        file=True,
        example="package:etendue_camera/data/examples/reflectances.csv",
        doc="CSV file: wavelength_nm, then a column of reflectance (0 to 1) for each patch",
    )
    across: int = param(
        0,
        at_least=0,
        held=(0, 1000),
        doc="patches per row; 0: chosen for nearly square patches and few empty places",
    )
    background: float = param(0.18, at_least=0, at_most=1)
    gap: float = param(0.1, at_least=0, below=1, doc="gap between patches, in pitches of the shorter side")
    softness: float = softness_knob()

    def known(self) -> Facts:
        """Return facts; the contrast is computed from the reflectances over all wavelengths."""
        names, _, values = spectra.csv_rows(self.reflectances)
        if values.min() < 0:
            worst = names[int(np.argmin(values.min(axis=0)))]
            raise ValueError(f"reflectances: {worst} falls to {values.min():g}; reflectances must not be negative")
        spectra.require_shares("reflectances", self.reflectances)
        rows, columns = self.layout(len(names))
        if min(rows, columns) < 1:
            raise ValueError(f"{self.reflectances} has no patches: a column of reflectance is required for each")
        low, high = min(values.min(), self.background), max(values.max(), self.background)
        return Facts(uniform=bool(low == high), contrast=float(high / low) if low > 0 else math.inf)

    def layout(self, count: int) -> tuple[int, int]:
        """Return the rows and columns for this many patches."""
        columns = self.across or _squarest(count, self.width / self.height)
        return -(-count // columns), min(columns, count)

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        rows = spectra.csv_rows(self.reflectances)[1]
        return [
            *super().warn(facts, grids),
            *spectra.held_note(self.reflectances, rows, self.wavelength_from, self.wavelength_to),
        ]

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        edges = tuple(coordinates["out_wavelength_edges"])
        return super().prepare(coordinates), spectra.table_from_csv(self.reflectances, edges, outside="hold")[1].T

    def by_band(self, prepared: tuple[FloatArray, FloatArray], bands: slice) -> tuple[FloatArray, FloatArray]:
        return prepared[0][bands], prepared[1][:, bands]

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: tuple[FloatArray, FloatArray]) -> dict[str, Array]:
        white, reflectance = prepared
        y, x = self.centred(out_y, out_x)
        across, down = self.layout(len(reflectance))[::-1]
        gap = self.gap * min(self.width / across, self.height / down)
        rows, columns = composite.patches_factors(
            y,
            x,
            composite.PatchGrid(down, across, self.width - gap, self.height - gap, gap),
            self.drawn(self.softness),
        )
        empty = np.full((down * across - len(reflectance), reflectance.shape[1]), self.background)
        cube = composite.patch_contribution(rows, columns, np.concatenate([reflectance, empty]))
        cube += self.background * composite.background_weight(rows, columns)
        cube *= white[:, None, None]
        return {"radiance": cube, "white_radiance": white}


def _squarest(count: int, aspect: float) -> int:
    """Return the number of columns with which patches in a frame (width over height ``aspect``) are most nearly square,
    with few empty places.
    """
    return min(
        range(1, count + 1),
        key=lambda columns: abs(math.log(aspect * -(-count // columns) / columns)) + -count % columns / count,
    )
