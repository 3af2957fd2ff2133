"""What the lens does differently over the field: blur by position, distortion, lateral colour.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1, positions from the axis of the lens.
Out: ``irradiance``, blurred or moved.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from etendue.api import Banded, Bounded, Facts, Grid, param
from etendue.contract.stage import file_state
from etendue.transfer import rings as scene_rings
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.field import blur, warp
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.stages.illumination import ends_of, farthest


@lru_cache(maxsize=8)
def _bank(path: str, state: tuple[int, int]) -> PsfBank:
    return PsfBank.load(path)


@lru_cache(maxsize=8)
def _table(path: str, state: tuple[int, int]) -> tuple[FloatArray, FloatArray, FloatArray]:
    return warp.read_table(path)


@dataclass(frozen=True, kw_only=True)
class LensPsfField(Banded, Bounded):
    """Measured or exported point spread functions by image height and wavelength: every point spreads by its own.

    The file is a ``PsfBank`` (.npz or .csv, see ``etendue_camera.field.psf_bank``), for image points on the +y axis.
    Between its heights and wavelengths pictures are interpolated, for other directions they are turned. The blur is
    computed by eigen-PSFs or by blended tiles, whichever is cheaper for the tolerance.
    """

    role: ClassVar = "lens"
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar[float | None] = (
        None  # where the grid cuts a picture's transform off there is no bound for every picture
    )
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 400.0

    file: str = param(
        file=True,
        example="package:etendue_camera/data/examples/bank.npz",
        doc="point spread functions by height and wavelength, .npz or .csv",
    )
    tolerance: float = param(
        0.01,
        above=0,
        below=1,
        fidelity=True,
        dear=True,
        reference="1e-3",
        settings=(0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3),
        doc="bound on the largest error of the convolution for any scene, as a share of full scale; edges err by a "
        "third to a tenth of it",
    )
    method: str = param(
        "auto",
        choices=("auto", "eigen", "tiles"),
        fidelity=True,
        reference="the other method",
        doc="auto: whichever is cheaper; both keep the tolerance: no order of them is one of errors",
    )
    weights: str = param(
        "source",
        choices=("source", "image"),
        doc="a point's flux is kept exactly, or a uniform plane stays uniform exactly",
    )
    centre: str = param(
        "reference",
        choices=("reference", "centroid"),
        doc="what lies on the image point: the picture's middle sample, or its centroid where distortion says where "
        "that is",
    )
    light: str = param(
        "bandlimited", choices=("bandlimited", "cells"), doc="what a value of the light is: that of the scene's light"
    )

    def bank(self) -> PsfBank:
        return _bank(self.file, file_state(self.file))

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        found = "cells" if inputs["irradiance"].line("x").cells else "bandlimited"
        if found != self.light:
            raise ValueError(
                f"light is {self.light!r}, but the scene's light is {found!r}; set light = {found!r} here too"
            )
        return {}

    def prepare(self, coordinates: Mapping[str, Array]) -> blur.Prepared:
        return blur.prepare(
            self.bank(),
            coordinates["y_um"],
            coordinates["x_um"],
            coordinates["wavelength"] * 1e-3,
            self.method,  # type: ignore[arg-type]
            self.tolerance,
            weights=self.weights,  # type: ignore[arg-type]
            light=self.light,  # type: ignore[arg-type]
            centre=self.centre,  # type: ignore[arg-type]
        )

    def by_band(self, prepared: blur.Prepared, bands: slice) -> blur.Prepared:
        return prepared.take(bands)

    def run(self, irradiance: FloatArray, prepared: blur.Prepared) -> dict[str, Array]:
        return {"irradiance": blur.apply(irradiance, prepared)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (
            (0.0, "the scene is uniform: blur changes nothing") if facts.uniform and self.weights == "image" else None
        )

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        own = facts["irradiance"]
        if own.uniform and self.weights == "image":
            return own
        return dataclasses.replace(
            own, uniform=None if own.uniform else own.uniform, low=None, high=None, contrast=None
        )

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Of the convolution, against the point spread function of every sample taken for itself."""
        return self.tolerance + (2e-6 if precision == "float32" else 1e-13), "measured"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        grid, bank, notes = grids["irradiance"], self.bank(), []
        corner, last = farthest(grid), float(bank.heights_um[-1])
        if corner > 1.001 * last:
            notes.append(
                f"{self.file} ends {last:g} um from the axis, the light reaches {corner:g} um: its last picture holds "
                f"beyond"
            )
        if bank.heights_um[0] > 0 and bank.heights_um.size > 1:
            notes.append(
                f"{self.file} begins {bank.heights_um[0]:g} um from the axis; on the axis the picture turns suddenly"
            )
        if bank.roundness() > 0.02:
            notes.append(
                f"{self.file}: {bank.roundness():.2g} of the light on the axis is not round; its mean over directions "
                f"is taken"
            )
        bands, own = np.array(grid.bands().values()) * 1e-3, bank.wavelengths_um
        if bands[0] < 0.99 * own[0] - 0.005 or bands[-1] > 1.01 * own[-1] + 0.005:
            notes.append(
                f"{self.file} has {own[0] * 1e3:g} to {own[-1] * 1e3:g} nm; beyond them the nearest picture holds"
            )
        if self.weights == "source" and self.centre == "reference":
            uneven = blur.unevenness(bank)
            if uneven > 1e-3:
                notes.append(
                    f"the mean displacement of the pictures makes a uniform plane uneven by up to {uneven:.1g}; "
                    "weights = 'image' or centre = 'centroid' avoids that"
                )
        return notes


@dataclass(frozen=True, kw_only=True)
class Distortion(Banded, Bounded):
    """Distortion and lateral colour: every image point stands where the lens puts it, r' = r (1 + k1 q + k2 q^2 + k3
    q^3).

    q = (r / reference_radius)^2, r the ideal height. Irradiance is carried over without the change of area, as radiance
    is what is imaged: a uniform scene stays uniform, and how light falls off at the real position is the fall-off's
    business. Where the distorted frame looks beyond the rendered light it sees the mirror image; the plan says by how
    much.
    """

    role: ClassVar = "distortion"
    once: ClassVar = ("distortion",)
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar = 3.5  # of the quintic spline between samples of opposite signs: 3.3
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 350.0

    k1: float = param(0.0, doc="cubic distortion at the reference radius; negative: barrel")
    k2: float = param(0.0, doc="fifth-order distortion at the reference radius")
    k3: float = param(0.0, doc="seventh-order distortion at the reference radius")
    reference_radius: float = param(1.0, units="mm", above=0, doc="ideal image height at which the coefficients hold")
    table: str = param(
        "",
        table=True,
        doc="CSV in place of the coefficients: ideal_um or ideal_mm, then real heights in columns named by wavelength "
        "in nm",
    )
    lateral_colour: float = param(
        0.0, above=-0.1, below=0.1, doc="relative change of the image's scale for 100 nm more wavelength"
    )
    reference_wavelength: float = param(
        550.0, units="nm", above=0, doc="wavelength that lateral colour leaves where it is"
    )
    order: int = param(
        5,
        at_least=1,
        at_most=5,
        fidelity=True,
        reference="order 5 with oversampling 4",
        settings=(1, 2, 3, 5),
        doc="of the spline between samples",
    )
    oversampling: int = param(
        1,
        at_least=1,
        at_most=8,
        fidelity=True,
        reference="order 5 with oversampling 4",
        settings=(1, 2, 4),
        doc="samples per sample that the spline goes through",
    )

    def __post_init__(self) -> None:
        if self.table and (self.k1 or self.k2 or self.k3):
            raise ValueError("table and coefficients are both given; distortion is one or the other")

    def map(self) -> warp.DistortionCurve:
        return warp.DistortionCurve(
            (self.k1, self.k2, self.k3),
            1e3 * self.reference_radius,
            self.lateral_colour,
            1e-3 * self.reference_wavelength,
            _table(self.table, file_state(self.table)) if self.table else None,
        )

    def does_nothing(self) -> bool:
        return not self.table and not (self.k1 or self.k2 or self.k3 or self.lateral_colour)

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        corner = math.hypot(np.abs(coordinates["y_um"]).max(), np.abs(coordinates["x_um"]).max())
        lens = self.map()
        return tuple(lens.ratio(corner, float(w) * 1e-3) for w in coordinates["wavelength"])

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared[bands]

    def run(self, irradiance: FloatArray, y_um: FloatArray, x_um: FloatArray, prepared: Any) -> dict[str, Array]:
        if self.does_nothing():
            return {"irradiance": irradiance}
        planes = np.empty_like(irradiance)
        for number, (plane, ratio) in enumerate(zip(irradiance, prepared, strict=True)):
            planes[number] = warp.radial(plane, y_um, x_um, ratio, self.order, self.oversampling)
        return {"irradiance": planes}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.does_nothing():
            return 0.0, "it moves nothing"
        if facts.uniform:
            return 0.0, "the scene is uniform: moving it changes nothing"
        if facts.content is None:
            return None
        radius, lens = np.linspace(0.0, farthest(grid), 65), self.map()
        most = max(float(np.abs(lens.undistort(radius, w * 1e-3) - radius).max()) for w in grid.bands().values())
        content = facts.content
        lost = scene_rings.rms_of(scene_rings.moved(most, np.array(content.edges)), np.array(content.power))
        return lost, f"it moves light by {most:.2g} um at most, and the scene holds little that is as fine"

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """A uniform plane stays as it is; a spline may leave the range of another a little."""
        own = facts["irradiance"]
        return (
            own
            if own.uniform or self.does_nothing()
            else dataclasses.replace(own, low=None, high=None, contrast=None, band_limit=None)
        )

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Of the interpolation: a Gaussian edge with the scene's band limit, of 1 sample rms where that is not
        known.
        """
        rounding = 2e-6 if precision == "float32" else 1e-12
        if self.does_nothing():
            return 0.0, "proved"
        limit = facts["irradiance"].band_limit
        softness = (
            1.0 if not limit else 0.483 / (limit * grid["irradiance"].line("x").step)
        )  # exp(-2 pi^2 s^2 f^2) = 0.01
        return min(1.0, warp.edge_error(self.order, softness, self.oversampling)) + rounding, "fitted"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if self.does_nothing():
            return []
        grid, lens, notes = grids["irradiance"], self.map(), []
        wavelengths = [w * 1e-3 for w in (grid.bands().values()[0], grid.bands().values()[-1])]
        corner = farthest(grid)
        if lens.table is not None:
            ideal, own = lens.table[0], lens.table[1]
            if float(lens.undistort(corner, wavelengths[0])) > 1.001 * ideal[-1]:
                notes.append(f"{self.table} ends {ideal[-1]:g} um from the axis; beyond it the curve goes on straight")
            if own.size > 1 and (wavelengths[0] < own[0] - 0.005 or wavelengths[1] > own[-1] + 0.005):
                notes.append(
                    f"{self.table} has {own[0] * 1e3:g} to {own[-1] * 1e3:g} nm; beyond them the nearest column holds"
                )
        missing = max(warp.missing_um(ends_of(grid.line("y")), ends_of(grid.line("x")), lens, w) for w in wavelengths)
        if missing > 0.5 * grid.line("x").step and not facts.uniform:
            notes.append(
                f"the distorted frame looks {missing:.3g} um beyond the rendered light, where it sees its mirror "
                f"image; widen the scene"
            )
        if grid.line("x").cells and self.order > 1:
            notes.append(
                "light is means over cells: a spline may swing below zero beside points and edges; order = 1 does not"
            )
        return notes
