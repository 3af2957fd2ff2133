"""Blur of the lens: transfer functions on the light before the sensor, the same over the whole field.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1.
Out: ``irradiance``, blurred.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from etendue.api import Bounded, Facts, Grid, Transfer, measured, param
from etendue.contract.stage import file_state
from etendue.transfer.sampling import on_unique_rows
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.optics import annulus, lens
from etendue_camera.optics.stages.conjugates import Cone
from etendue_camera.optics.undershoot import undershoot

FEW = 1 << 14  # frequencies of a plane up to which all bands are evaluated at once


@dataclass(frozen=True, kw_only=True)
class Blur(Bounded):
    """Apply a transfer function to irradiance. The stage does not change a uniform scene and is left out for it."""

    role: ClassVar = "lens"
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar[float | None] = (
        1.5  # where the grid truncates the transfer function: at most 1.13 for diffraction, 1.27 for a Gaussian
    )
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 25.0
    # Error of the transform pair, relative to full scale: 6e-7 at 1024 x 1500.
    error: ClassVar[Any] = measured(1e-6, 2e-15)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if facts.uniform:
            return 0.0, "the scene is uniform: blur has no effect"
        return None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Keep the facts of a uniform plane, which is unchanged, and drop the range of values of any other plane.

        Where the grid truncates the transfer function, the output may leave the range of the input slightly.
        """
        own = facts["irradiance"]
        return own if own.uniform else replace(own, low=None, high=None, contrast=None)


@dataclass(frozen=True, kw_only=True)
class Diffraction(Blur, Cone, Transfer):
    """Blur by diffraction at a perfect circular aperture (eqs. 2-4), optionally with a central obstruction, at every
    wavelength.

    The f-number refers to the whole circle; light blocked by an obstruction belongs to ``transmittance`` or
    ``t_number``.
    """

    once: ClassVar = ("diffraction",)
    radial: ClassVar = True
    obstruction: float = param(
        0.0,
        at_least=0,
        below=1,
        held=(0, 0.999),
        doc="diameter of the central obstruction divided by the diameter of the aperture; 0: none",
    )

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray) -> FloatArray:
        number = self.cone_f_number()

        def contrast(rows: FloatArray) -> FloatArray:
            radial = np.hypot(rows, fx)
            if radial.size < FEW:
                return np.asarray(annulus.annular_otf(radial, wavelength, number, self.obstruction))
            found = np.empty((wavelength.size, *radial.shape))  # band by band, so that no temporary array is large
            for band, one in zip(found, np.ravel(wavelength), strict=True):
                band[...] = annulus.annular_otf(radial, one, number, self.obstruction)
            return found

        return on_unique_rows(contrast, fy)

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        return too_coarse(facts, grids["irradiance"], self.cone_f_number())


def too_coarse(facts: Facts, grid: Grid, f_number: float) -> list[str]:
    """Return a note if the scene contains, and the lens passes, frequencies above the Nyquist frequency of the grid."""
    cutoff = 1.0 / (grid.bands().edges[0] * 1e-3 * f_number)
    step = grid.line("x").step
    if facts.uniform or facts.band_limit is None or min(cutoff, facts.band_limit) <= 1.001 * 0.5 / step:
        return []
    ratios = {round(0.5e-3 * wavelength * f_number / step, 2) for wavelength in grid.bands().values()}
    point, scene = (max(found) for found in zip(*(undershoot(max(ratio, 0.01)) for ratio in ratios), strict=True))
    return [
        f"the grid of {step:g} um is too coarse for the frequencies that the lens passes: for a clear aperture, a "
        f"point undershoots zero by up to {point:.2%} of its peak, and any scene by up to {scene:.1%} of its brightest "
        "value; use a smaller spacing in the scene, or light = 'cells'"
    ]


@dataclass(frozen=True, kw_only=True)
class LensGaussian(Blur, Transfer):
    """Blur with a Gaussian point spread function, the same at every wavelength."""

    radial: ClassVar = True
    sigma: float = param(0.8, units="um", at_least=0, doc="rms width of the point spread function along one axis")

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return super().negligible(facts, grid) if self.sigma else (0.0, "no effect with these parameters")

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray) -> FloatArray:
        return lens.gaussian_otf(fy, fx, self.sigma)


@dataclass(frozen=True, kw_only=True)
class LensPsf(Blur, Transfer):
    """Blur with a measured, rotationally symmetric point spread function from a CSV table ``radius_um,psf``."""

    radial: ClassVar = True
    gain: ClassVar[float | None] = None  # a ring has no bound that holds for every grid

    file: str = param(
        file=True, example="package:etendue_camera/data/examples/psf.csv", doc="CSV file with columns radius_um, psf"
    )
    nodes: int = param(
        16384,
        at_least=64,
        held=(64, 1_000_000),
        fidelity=True,
        example=256,
        reference="262144: direct evaluation to within 1e-8",
        settings=(256, 1024, 4096, 16384, 65536, 262_144),
        doc="number of radial frequencies at which the transform is evaluated, with linear interpolation between them",
    )

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        return _radial_table(self.file, file_state(self.file))

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, prepared: Any) -> Any:
        radial = np.hypot(fy, fx)
        nodes = np.linspace(0.0, float(radial.max()), self.nodes)
        return np.interp(radial, nodes, lens.radial_psf_otf(nodes, *prepared))

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the error of linear interpolation: an eighth of the squared node distance times the second derivative
        of the transfer function.

        The second derivative is at most 2 pi^2 times the mean square radius of the spread function.
        """
        lines = grid["irradiance"]
        step = 0.5 * math.hypot(*(1.0 / lines.line(dim).step for dim in ("y", "x"))) / (self.nodes - 1)
        between = (
            0.25 * (math.pi * step) ** 2 * lens.mean_square_radius(*_radial_table(self.file, file_state(self.file)))
        )
        return min(1.0, between) + super().error(facts, grid, precision)[0], "proved"


@lru_cache(maxsize=8)
def _radial_table(path: str, state: tuple[int, int]) -> tuple[Any, Any]:
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except ValueError as error:
        raise ValueError(f"{path}: expected a header and two columns, radius_um and psf: {error}") from None
    table.flags.writeable = False
    return table[:, 0], table[:, 1]
