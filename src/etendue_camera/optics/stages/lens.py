"""The blur of the lens: transfer functions on the light in front of the sensor, the same over the whole field.

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


@dataclass(frozen=True, kw_only=True)
class Blur(Bounded):
    """A transfer function on irradiance. A uniform scene does not need it: exactly nothing changes."""

    role: ClassVar = "lens"
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar[float | None] = (
        1.5  # where the grid cuts the transfer function off: 1.13 diffraction, 1.27 Gaussian at worst
    )
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 25.0
    # Of the transform pair, relative to full scale: 6e-7 at 1024 x 1500.
    error: ClassVar[Any] = measured(1e-6, 2e-15)

    def changes_nothing(self) -> bool:
        return False

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.changes_nothing():
            return 0.0, "it changes nothing with these parameters"
        if facts.uniform:
            return 0.0, "the scene is uniform: blur changes nothing"
        return None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """A uniform plane stays as it is. Another may leave its range a little where the grid cuts the transfer
        function off.
        """
        own = facts["irradiance"]
        return own if own.uniform else replace(own, low=None, high=None, contrast=None)


@dataclass(frozen=True, kw_only=True)
class Diffraction(Blur, Cone, Transfer):
    """The perfect circular aperture (eqs. 2-4), or one with a dark disc in its middle: its transfer function at every
    wavelength.

    The f-number is that of the whole circle; the light that an obstruction takes away belongs to ``transmittance`` or
    ``t_number``.
    """

    once: ClassVar = ("diffraction",)
    radial: ClassVar = True
    obstruction: float = param(
        0.0,
        at_least=0,
        below=1,
        held=(0, 0.999),
        doc="diameter of a central dark disc over that of the aperture; 0: clear",
    )

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray) -> FloatArray:
        number = self.cone_f_number()
        return on_unique_rows(
            lambda rows: annulus.annular_otf(np.hypot(rows, fx), wavelength, number, self.obstruction), fy
        )

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        return too_coarse(facts, grids["irradiance"], self.cone_f_number())


def too_coarse(facts: Facts, grid: Grid, f_number: float) -> list[str]:
    """A note where the lens passes, and the scene holds, frequencies that the grid does not carry."""
    cutoff = 1.0 / (grid.bands().edges[0] * 1e-3 * f_number)
    step = grid.line("x").step
    if facts.uniform or facts.band_limit is None or min(cutoff, facts.band_limit) <= 1.001 * 0.5 / step:
        return []
    ratios = {round(0.5e-3 * wavelength * f_number / step, 2) for wavelength in grid.bands().values()}
    point, scene = (max(found) for found in zip(*(undershoot(max(ratio, 0.01)) for ratio in ratios), strict=True))
    return [
        f"the grid of {step:g} um is too coarse for what the lens passes: behind a clear aperture a point falls up to "
        f"{point:.2%} of its "
        f"peak below zero, and any light up to {scene:.1%} of the brightest; give the scene a smaller spacing, or "
        f"light = 'cells'"
    ]


@dataclass(frozen=True, kw_only=True)
class LensGaussian(Blur, Transfer):
    """A Gaussian lens blur, the same at every wavelength."""

    radial: ClassVar = True
    sigma: float = param(0.8, units="um", at_least=0, doc="rms width of the point spread function along one axis")

    def changes_nothing(self) -> bool:
        return self.sigma == 0

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray) -> FloatArray:
        return lens.gaussian_otf(fy, fx, self.sigma)


@dataclass(frozen=True, kw_only=True)
class LensPsf(Blur, Transfer):
    """A measured, radially symmetric point spread function from a CSV table ``radius_um,psf``."""

    radial: ClassVar = True
    gain: ClassVar[float | None] = None  # of a ring it has no bound that holds for every grid

    file: str = param(
        file=True, example="package:etendue_camera/data/examples/psf.csv", doc="CSV with columns radius_um, psf"
    )
    nodes: int = param(
        16384,
        at_least=64,
        held=(64, 1_000_000),
        fidelity=True,
        example=256,
        reference="262144: direct evaluation but for 1e-8",
        settings=(256, 1024, 4096, 16384, 65536, 262_144),
        doc="radial frequencies at which the transform is evaluated; linear between them",
    )

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        return _radial_table(self.file, file_state(self.file))

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, prepared: Any) -> Any:
        radial = np.hypot(fy, fx)
        nodes = np.linspace(0.0, float(radial.max()), self.nodes)
        return np.interp(radial, nodes, lens.radial_psf_otf(nodes, *prepared))

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Of straight lines between nodes: an eighth of their distance squared times the second derivative of the
        transfer function.

        That is at most 2 pi^2 times the mean square radius of the spread function.
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
        raise ValueError(f"{path}: expected a header and two columns radius_um, psf: {error}") from None
    table.flags.writeable = False
    return table[:, 0], table[:, 1]
