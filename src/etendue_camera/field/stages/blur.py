"""Field-dependent effects of the lens: blur by position, distortion, lateral colour.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1, at positions from the lens axis.
Out: ``irradiance``, blurred or displaced.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from etendue.api import Banded, Bounded, Facts, Grid, param, quantity
from etendue.contract.stage import file_state
from etendue.transfer import peaks
from etendue.transfer import rings as scene_rings
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.field import blur, warp
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.stages.illumination import ends_of, farthest
from etendue_camera.field.stages.profile import Profiled, measured_heights

Ratios = tuple[Callable[[FloatArray], FloatArray], ...]  # by band, as `warp.DistortionCurve.ratio` gives them


@lru_cache(maxsize=8)
def _bank(path: str, state: tuple[int, int]) -> PsfBank:
    return PsfBank.load(path)


@lru_cache(maxsize=8)
def _table(path: str, state: tuple[int, int]) -> tuple[FloatArray, FloatArray, FloatArray]:
    return warp.read_table(path)


@dataclass(frozen=True)
class _Held:
    """A table that compares equal only to itself. Tables are cached by file, so this comparison is enough, and
    cheap.
    """

    table: warp.Table

    def __hash__(self) -> int:
        return id(self.table)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Held) and other.table is self.table


@lru_cache(maxsize=256)
def _curve(
    coefficients: tuple[float, float, float], reference: float, colour: float, wavelength: float, held: _Held | None
) -> warp.DistortionCurve:
    """Return the curve of a lens; the same object for every body, so that caches recognise it."""
    return warp.DistortionCurve(coefficients, reference, colour, wavelength, None if held is None else held.table)


@lru_cache(maxsize=1024)
def _largest_move(lens: warp.DistortionCurve, corner_um: float, wavelengths_um: tuple[float, ...]) -> float:
    """Return the largest distance (um) by which light moves, up to a height."""
    radius = np.linspace(0.0, corner_um, 65)
    return max(float(np.abs(lens.undistort(radius, w) - radius).max()) for w in wavelengths_um)


@lru_cache(maxsize=1024)
def _missing(
    y_ends: tuple[float, float], x_ends: tuple[float, float], lens: warp.DistortionCurve, wavelength_um: float
) -> float:
    return warp.missing_um(y_ends, x_ends, lens, wavelength_um)


@dataclass(frozen=True, kw_only=True)
class LensPsfField(Banded, Bounded):
    """Blur with measured or exported point spread functions (PSFs) by image height and wavelength.

    The file is a ``PsfBank`` (.npz or .csv, see ``etendue_camera.field.psf_bank``) for image points on the +y axis.
    PSFs are interpolated between its heights and wavelengths, and rotated for other directions. The blur is computed
    with eigen-PSFs or blended tiles, whichever is faster for the tolerance.
    """

    role: ClassVar = "lens"
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar[float | None] = (
        None  # where the grid truncates the transform of a PSF there is no bound for every PSF
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
        doc="bound on the largest error of the convolution for any scene, relative to full scale; at edges the error "
        "is a third to a tenth of it",
    )
    method: str = param(
        "auto",
        choices=("auto", "eigen", "tiles"),
        fidelity=True,
        reference="the other method",
        doc="method of the blur; auto: the faster method; both meet the tolerance",
    )
    weights: str = param(
        "source",
        choices=("source", "image"),
        doc="conserved quantity. source: the flux of every point; image: a uniform plane",
    )
    centre: str = param(
        "reference",
        choices=("reference", "centroid"),
        doc="part of the PSF at the image point: its middle sample, or its centroid (if the distortion is applied "
        "elsewhere)",
    )
    light: str = param(
        "bandlimited",
        choices=("bandlimited", "cells"),
        doc="meaning of a light sample, as in the scene's light: band-limited value or cell mean",
    )

    def bank(self) -> PsfBank:
        return _bank(self.file, file_state(self.file))

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        found = "cells" if inputs["irradiance"].line("x").cells else "bandlimited"
        if found != self.light:
            raise ValueError(
                f"light is {self.light!r}, but the scene's light is {found!r}; set light = {found!r} here as well"
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
        return (0.0, "the scene is uniform: blur has no effect") if facts.uniform and self.weights == "image" else None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        own = facts["irradiance"]
        if own.uniform and self.weights == "image":
            return own
        return dataclasses.replace(
            own, uniform=None if own.uniform else own.uniform, low=None, high=None, contrast=None
        )

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the error of the convolution relative to a separate PSF for every sample."""
        return self.tolerance + (2e-6 if precision == "float32" else 1e-13), "measured"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        grid, bank, notes = grids["irradiance"], self.bank(), []
        corner, last = farthest(grid), float(bank.heights_um[-1])
        if corner > 1.001 * last:
            notes.append(
                f"{self.file} ends {last:g} um from the axis, but the light extends to {corner:g} um: its last PSF is "
                "used beyond"
            )
        if bank.heights_um[0] > 0 and bank.heights_um.size > 1:
            notes.append(
                f"{self.file} begins {bank.heights_um[0]:g} um from the axis; the PSF orientation is discontinuous on "
                "the axis"
            )
        if bank.roundness() > 0.02:
            notes.append(
                f"{self.file}: {bank.roundness():.2g} of the light on axis is not rotationally symmetric; its mean "
                "over directions is used"
            )
        bands, own = np.array(grid.bands().values()) * 1e-3, bank.wavelengths_um
        if bands[0] < 0.99 * own[0] - 0.005 or bands[-1] > 1.01 * own[-1] + 0.005:
            notes.append(
                f"{self.file} has {own[0] * 1e3:g} to {own[-1] * 1e3:g} nm; outside this range the nearest PSF is used"
            )
        if self.weights == "source" and self.centre == "reference":
            uneven = blur.unevenness(bank)
            if uneven > 1e-3:
                notes.append(
                    f"the mean displacement of the PSFs makes a uniform plane non-uniform by up to {uneven:.1g}; "
                    "use weights = 'image' or centre = 'centroid'"
                )
        return notes


@dataclass(frozen=True, kw_only=True)
class Distortion(Profiled, Banded, Bounded):
    """Apply distortion and lateral colour: move each image point to its real height, r' = r (1 + k1 q + k2 q^2 + k3
    q^3).

    q = (r / reference_radius)^2, with r the ideal height. Irradiance is not scaled by the change of area, because a
    lens preserves radiance: a uniform scene stays uniform, and the falloff stage applies the falloff at the real
    position. Beyond the rendered light, the distorted frame shows its mirror image; the plan reports the width of this
    border.
    """

    role: ClassVar = "distortion"
    once: ClassVar = ("distortion",)
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar = 3.5  # 3.3 for the quintic spline between samples of opposite signs
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 350.0

    focal_length: float = quantity("focal_length")
    k1: float = param(0.0, doc="cubic distortion at the reference radius; negative: barrel")
    k2: float = param(0.0, doc="fifth-order distortion at the reference radius")
    k3: float = param(0.0, doc="seventh-order distortion at the reference radius")
    reference_radius: float = param(1.0, units="mm", above=0, doc="ideal image height to which the coefficients refer")
    table: str = param(
        "",
        table=True,
        doc="CSV file instead of coefficients: ideal_um or ideal_mm, then real heights in columns named by wavelength "
        "in nm",
    )
    lateral_colour: float = param(
        0.0, above=-0.1, below=0.1, doc="relative change of image scale per 100 nm of wavelength"
    )
    reference_wavelength: float = param(550.0, units="nm", above=0, doc="wavelength without lateral colour")
    order: int = param(
        5,
        at_least=1,
        at_most=5,
        fidelity=True,
        reference="order 5 with oversampling 4",
        settings=(1, 2, 3, 5),
        doc="order of the interpolating spline",
    )
    oversampling: int = param(
        1,
        at_least=1,
        at_most=8,
        fidelity=True,
        reference="order 5 with oversampling 4",
        settings=(1, 2, 4),
        doc="oversampling of the light before spline interpolation",
    )

    def __post_init__(self) -> None:
        self.check_lens()
        if self.table and (self.k1 or self.k2 or self.k3):
            raise ValueError("table and coefficients are both given; give only one of them")

    def of_lens(self) -> warp.Table | None:
        """Return the measured heights of the lens at this focal length; None if there are none, or if the stage has its
        own coefficients or table.
        """
        if not self.lens_profile or self.table or self.k1 or self.k2 or self.k3:
            return None
        return measured_heights(self.lens_profile, file_state(self.lens_profile), self.crop_factor, self.focal_length)

    def map(self) -> warp.DistortionCurve:
        table = _table(self.table, file_state(self.table)) if self.table else self.of_lens()
        return _curve(
            (self.k1, self.k2, self.k3),
            1e3 * self.reference_radius,
            self.lateral_colour,
            1e-3 * self.reference_wavelength,
            None if table is None else _Held(table),
        )

    def does_nothing(self) -> bool:
        own = self.table or self.k1 or self.k2 or self.k3 or self.lateral_colour
        return not own and self.of_lens() is None

    def prepare(self, coordinates: Mapping[str, Array]) -> Ratios:
        corner = math.hypot(np.abs(coordinates["y_um"]).max(), np.abs(coordinates["x_um"]).max())
        lens, bands = self.map(), coordinates["wavelength"]
        if lens.table is None and not lens.lateral_colour:  # the same for every colour
            return (lens.ratio(corner, float(bands[0]) * 1e-3),) * len(bands)
        return tuple(lens.ratio(corner, float(w) * 1e-3) for w in bands)

    def by_band(self, prepared: Ratios, bands: slice) -> Ratios:
        return prepared[bands]

    def run(self, irradiance: FloatArray, y_um: FloatArray, x_um: FloatArray, prepared: Ratios) -> dict[str, Array]:
        if self.does_nothing():
            return {"irradiance": irradiance}
        planes = np.empty_like(irradiance)
        for number, (plane, ratio) in enumerate(zip(irradiance, prepared, strict=True)):
            planes[number] = warp.radial(plane, y_um, x_um, ratio, self.order, self.oversampling)
        return {"irradiance": planes}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.does_nothing():
            return 0.0, "nothing is displaced"
        if facts.uniform:
            return 0.0, "the scene is uniform: displacement has no effect"
        if facts.content is None:
            return None
        most = _largest_move(self.map(), farthest(grid), tuple(w * 1e-3 for w in grid.bands().values()))
        factors = scene_rings.moved(most, np.array(facts.content.edges))[None]
        lost = peaks.relative(factors, np.ones_like(factors), facts.content, grid).apart
        return lost, f"light moves by at most {most:.2g} um, and the scene has little detail of this size"

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return what the plan knows about the output. Uniform light stays as it is. Of other light only the lowest and
        the highest value are known, with room for the overshoot of the spline between samples.
        """
        own = facts["irradiance"]
        low, high = own.content.range_of_light() if own.content is not None else (None, None)
        return (
            own
            if own.uniform or self.does_nothing()
            else dataclasses.replace(own, low=low, high=high, contrast=None, band_limit=None)
        )

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the interpolation error of the light, frequency by frequency. If its content is unknown, return the
        error at a Gaussian edge with the scene's band limit, or with 1 sample rms if that is unknown too.
        """
        rounding = 2e-6 if precision == "float32" else 1e-12
        if self.does_nothing():
            return 0.0, "proved"
        light, lines = facts["irradiance"], grid["irradiance"]
        if light.content is not None:
            step = max(lines.line(dim).step for dim in ("y", "x"))
            cycles = np.array(light.content.edges[1:]) * step
            lost = warp.wave_error(self.order, cycles, self.oversampling)[None]
            found = peaks.relative(lost, np.ones_like(lost), light.content, lines).apart
            return min(1.0, found + warp.BORDER) + rounding, "proved"
        limit = light.band_limit
        # exp(-2 pi^2 s^2 f^2) = 0.01
        softness = 1.0 if not limit else 0.483 / (limit * grid["irradiance"].line("x").step)
        return min(1.0, warp.edge_error(self.order, softness, self.oversampling)) + rounding, "fitted"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        has_own = bool(self.table or self.k1 or self.k2 or self.k3)
        notes = [] if has_own else self.lens_notes("distortion", "none is applied", self.of_lens() is not None)
        if self.does_nothing():
            return notes
        grid, lens = grids["irradiance"], self.map()
        whose = self.table or self.lens_name()
        wavelengths = [w * 1e-3 for w in (grid.bands().values()[0], grid.bands().values()[-1])]
        corner = farthest(grid)
        if lens.table is not None:
            ideal, own = lens.table[0], lens.table[1]
            if float(lens.undistort(corner, wavelengths[0])) > 1.001 * ideal[-1]:
                notes.append(
                    f"{whose} ends {ideal[-1]:g} um from the axis; beyond it the curve is extrapolated linearly"
                )
            if self.table and own.size > 1 and (wavelengths[0] < own[0] - 0.005 or wavelengths[1] > own[-1] + 0.005):
                notes.append(
                    f"{whose} has {own[0] * 1e3:g} to {own[-1] * 1e3:g} nm; outside this range the nearest column "
                    "is used"
                )
        missing = max(_missing(ends_of(grid.line("y")), ends_of(grid.line("x")), lens, w) for w in wavelengths)
        if missing > 0.5 * grid.line("x").step and not facts.uniform:
            notes.append(
                f"the distorted frame extends {missing:.3g} um beyond the rendered light and reads its mirror "
                f"image; widen the scene"
            )
        if grid.line("x").cells and self.order > 1:
            notes.append(
                "light samples are cell means: a spline may undershoot zero next to points and edges; order = 1 does "
                "not"
            )
        return notes
