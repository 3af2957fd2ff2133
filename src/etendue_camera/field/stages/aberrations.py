"""Field-dependent aberrations: every point is blurred by the wavefront at its own image height.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1.
Out: ``irradiance``, blurred. Diffraction is included: use this stage in place of ``diffraction``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from etendue.api import Banded, Facts, Grid, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.field import blur, node_grids
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.stages.illumination import farthest, nearest
from etendue_camera.optics import imaging, pupil
from etendue_camera.optics.stages.lens import Blur, too_coarse
from etendue_camera.optics.stages.wavefront import Aberrated

PER_SPOT = 0.45  # PSF spacing in lambda N_w: the PSF is band-limited at 0.5
COARSE = 64
MOST_SAMPLES = 1024
NEARLY = 0.98  # fraction of the PSF radius; light in the outermost rings may be lost
COARSE_ERROR = 0.04  # error of kernels as cell means, on a grid too coarse for the lens


@dataclass(frozen=True, kw_only=True)
class Aberrations(Blur, Aberrated, Banded):
    """Blur by field-dependent Seidel aberrations: spherical, coma, astigmatism, field curvature and defocus, with a PSF
    for each point.

    The aperture is a circle or an annulus. For a single wavefront over the whole frame, ``wavefront`` is exact and
    faster; image displacement belongs to ``distortion``. PSFs are truncated where the light in their tails is half of
    ``accuracy``.
    """

    obstruction: float = param(
        0.0,
        at_least=0,
        below=1,
        held=(0, 0.999),
        doc="diameter of the central obstruction divided by the diameter of the aperture; 0: none",
    )
    accuracy: float = param(
        0.03,
        at_least=5e-3,
        at_most=0.2,
        fidelity=True,
        dear=True,
        example=0.2,
        reference="5e-3; for smaller errors use wavefront",
        settings=(0.2, 0.1, 0.05, 0.03, 0.02, 0.01, 5e-3),
        doc="largest error of the blur, relative to full scale; half of it is light in truncated tails",
    )
    heights: int = param(
        9,
        at_least=2,
        at_most=65,
        fidelity=True,
        example=3,
        reference="65 heights",
        settings=(2, 3, 5, 9, 17, 33, 65),
        doc="number of image heights in the PSF bank",
    )
    bands: int = param(
        5,
        at_least=1,
        at_most=64,
        fidelity=True,
        example=1,
        reference="64, or the number of bands",
        settings=(1, 2, 3, 5, 9, 17, 33, 64),
        doc="number of wavelengths in the PSF bank, interpolated between them",
    )
    method: str = param("auto", choices=("auto", "eigen", "tiles"), doc="method of the blur; auto: the faster method")
    light: str = param(
        "bandlimited",
        choices=("bandlimited", "cells"),
        doc="meaning of a light sample, as in the scene's light: band-limited value or cell mean",
    )
    pupil_samples: int = param(
        128,
        at_least=16,
        at_most=MOST_SAMPLES,
        fidelity=True,
        example=32,
        reference="1024 samples",
        settings=(16, 32, 64, 128, 256, 512, 1024),
        doc="samples across the pupil; wide PSFs use more",
    )

    gain: ClassVar[float | None] = (
        None  # a point between samples on a coarse grid is truncated: there is no bound for every frame
    )
    nanoseconds: ClassVar = 300.0

    def aperture(self) -> pupil.Aperture:
        return pupil.Aperture("annular", self.obstruction) if self.obstruction else pupil.Aperture()

    def path(self, y: FloatArray, x: FloatArray, height_um: float) -> FloatArray:
        """Return the optical path for an image point on the +y axis."""
        return self.path_at(y, x, height_um * 1e-3 / self.full_height, 0.0)

    def half(self, wavelength: float, heights: FloatArray | tuple[float, float]) -> int:
        """Return the PSF half width in samples, from the tails 2/(pi v) of the aperture and the geometrical spot."""
        tail = 4.0 / (math.pi**2 * self.accuracy * (1.0 - self.obstruction))
        centres = pupil.cell_centres(COARSE)
        cells = pupil.amplitude(self.aperture(), COARSE)
        steep = max(
            imaging.steepest_slope(self.path(centres[:, None], centres, h), cells) for h in (heights[0], heights[-1])
        )
        return math.ceil((tail + 2.0 * steep / wavelength) / PER_SPOT)

    def samples(self, half: int) -> int:
        """Return the samples across the pupil that avoid aliasing; raise ValueError if there are too many."""
        samples = max(self.pupil_samples, math.ceil(2.0 * PER_SPOT * (half + 1)))
        samples += samples % 2
        if samples > MOST_SAMPLES:
            raise ValueError(
                f"accuracy {self.accuracy:g} and these aberrations require {float(samples):.4g} pupil samples, but "
                f"{MOST_SAMPLES} is the "
                "maximum; allow a larger error, or reduce the aberrations"
            )
        return samples

    def bank(self, heights: FloatArray, wavelengths: FloatArray) -> PsfBank:
        """Return the PSFs at image heights (um) and wavelengths (um), each wavelength on its own sample spacing."""
        number, half = self.cone_f_number(), self.half(float(wavelengths[0]), heights)
        samples = self.samples(half)
        clear = pupil.amplitude(self.aperture(), samples)
        centres = pupil.cell_centres(samples)
        spacing = PER_SPOT * wavelengths * number
        steps = np.arange(-half, half + 1)
        pictures = np.empty((len(heights), len(wavelengths), steps.size, steps.size))
        for k, height in enumerate(heights):
            path = self.path(centres[:, None], centres, float(height))
            for band, w in enumerate(wavelengths):
                pictures[k, band] = imaging.pupil_psf(
                    clear, path, float(w), number, steps * spacing[band], steps * spacing[band]
                )
        return PsfBank(np.asarray(heights), np.asarray(wavelengths), pictures, spacing, "Seidel wavefront")

    def prepare(self, coordinates: Mapping[str, Array]) -> blur.Prepared:
        y, x, bands = (
            coordinates["y_um"],
            coordinates["x_um"],
            np.asarray(coordinates["wavelength"], dtype=float) * 1e-3,
        )
        nearest = math.hypot(*(max(0.0, float(line.min()), -float(line.max())) for line in (y, x)))
        corner = math.hypot(*(float(np.abs(line).max()) for line in (y, x)))
        heights = np.linspace(nearest, corner, self.heights) if corner > nearest else np.array([corner])
        count = min(self.bands, bands.size)
        wavelengths = np.linspace(bands[0], bands[-1], count) if count > 1 else np.array([bands.mean()])
        bank = self.bank(heights, wavelengths)
        step = max((float(line[1] - line[0]) for line in (y, x) if line.size > 1), default=0.0)
        coarse = self.coarse(step, float(bands[0]))
        light: Any = "cells" if coarse else self.light
        room = max(0.5 * self.accuracy, COARSE_ERROR) if coarse else 0.5 * self.accuracy
        return blur.prepare(
            bank, y, x, bands, cast(Any, self.method), room, weights="image", lost=1e-3 * self.accuracy, light=light
        )

    def coarse(self, step: float, shortest: float) -> bool:
        """Return whether the grid is too coarse for the frequencies that the lens passes. Truncated kernels would ring
        over the whole frame; cell means do not.
        """
        return step > 0.5 * shortest * self.cone_f_number()

    def by_band(self, prepared: blur.Prepared, bands: slice) -> blur.Prepared:
        return prepared.take(bands)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        found = "cells" if inputs["irradiance"].line("x").cells else "bandlimited"
        if found != self.light:
            raise ValueError(
                f"light is {self.light!r}, but the scene's light is {found!r}; set light = {found!r} here as well"
            )
        light = inputs["irradiance"]
        bands = light.bands().values()
        shortest = float(bands[0] if min(self.bands, len(bands)) > 1 else sum(bands) / len(bands)) * 1e-3
        half = self.half(shortest, (nearest(light), farthest(light)))
        self.samples(half)
        longest = float(bands[-1] if min(self.bands, len(bands)) > 1 else sum(bands) / len(bands)) * 1e-3
        step = max(abs(light.line(dim).step) for dim in ("y", "x"))
        reach = NEARLY * half * PER_SPOT * longest * self.cone_f_number() / step
        if not node_grids.kernels_fit(
            2 * math.ceil(reach) + 1, min(self.bands, len(bands)), light["y"].size, light["x"].size
        ):
            raise ValueError(
                f"PSFs extend over {2 * reach:.4g} samples, and too many kernels of that size are needed for "
                f"accuracy "
                f"{self.accuracy:g}; allow a larger error, smaller aberrations, or a coarser grid"
            )
        return {}

    def run(self, irradiance: FloatArray, prepared: blur.Prepared) -> dict[str, Array]:
        return {"irradiance": blur.apply(irradiance, prepared)}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        own = facts["irradiance"]
        return own if own.uniform else replace(own, low=None, high=None, contrast=None)

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Estimate the error: the requested accuracy, interpolation between heights and wavelengths of the bank, pupil
        sampling.
        """
        lines: Grid = grid["irradiance"]
        edges = lines.bands().values()
        height = farthest(lines) * 1e-3 / self.full_height
        shortest = float(edges[0]) * 1e-3
        waves = (abs(self.coma) * height + (abs(self.astigmatism) + abs(self.field_curvature)) * height**2) / shortest
        between = min(1.0, 2.0 * waves**2) / (self.heights - 1) ** 2
        ratio = float(edges[-1]) / float(edges[0])
        colours = (
            0.25 * (ratio - 1.0) ** 2 / max(1, min(self.bands, len(edges)) - 1) ** 2 if len(edges) > self.bands else 0.0
        )
        steep = max(
            1.0,
            4.0 * (waves + (abs(self.spherical) + abs(self.shift()) / (8.0 * self.cone_f_number() ** 2)) / shortest),
        )
        cells = 1.2e-4 * steep * (128 / self.pupil_samples) ** 2
        coarse = COARSE_ERROR if self.coarse(lines.line("x").step, shortest) else 0.0
        return min(
            1.0, self.accuracy + coarse + between + colours + cells + (1e-6 if precision == "float32" else 0.0)
        ), "fitted"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        return too_coarse(facts, grids["irradiance"], self.cone_f_number())
