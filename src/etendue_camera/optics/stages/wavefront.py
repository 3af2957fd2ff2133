"""A lens given by its wavefront: aperture, defocus, Zernike and Seidel terms, as one transfer function per frame.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1.
Out: ``irradiance``, blurred. Diffraction is included: use this stage in place of ``diffraction``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, ClassVar, cast

import numpy as np

from etendue.api import Facts, Grid, Transfer, param, quantity
from etendue.transfer.sampling import on_unique_rows
from etendue_camera.arrays import Array, FloatArray, Floats
from etendue_camera.optics import annulus, focus, imaging, pupil, wavefront
from etendue_camera.optics.stages.conjugates import Cone
from etendue_camera.optics.stages.lens import Blur, too_coarse

COARSE = 64  # grid on which the slope of the wavefront is evaluated
MOST_SAMPLES = 2048
WAVES: Any = {"units": "um", "held": (-1e3, 1e3)}
MOVED: Any = {"units": "mm", "held": (-1e3, 1e3)}
TABLE_BYTES = 64 << 20  # size limit of the tables for all bands
# per pupil radius, clear or obstructed: steeper rotationally symmetric wavefronts are summed over cells
ROUND_WAVES = {False: 6.0, True: 2.0}


@dataclass(frozen=True, kw_only=True)
class Aberrated(Cone):
    """Parameters common to aberrated lenses: defocus and Seidel terms, in um of optical path at the pupil edge.

    Positive paths move light towards where they grow: the tail of positive coma points outwards, and positive defocus
    puts the image behind the sensor. One wave at 550 nm is 0.55 um.
    """

    once: ClassVar = ("diffraction",)

    object_distance: float = quantity("object_distance")
    defocus: float = param(
        0.0, **MOVED, doc="distance of the image behind the sensor, in addition to the effect of the object distance"
    )
    spherical: float = param(0.0, **WAVES, doc="spherical aberration W040")
    coma: float = param(0.0, **WAVES, doc="coma W131 at the full image height")
    astigmatism: float = param(0.0, **WAVES, doc="astigmatism W222 at the full image height")
    field_curvature: float = param(0.0, **WAVES, doc="field curvature W220 at the full image height")
    full_height: float = param(
        4.0,
        units="mm",
        above=0,
        held=(1e-3, 1e3),
        doc="full image height, for which coma, astigmatism and field curvature are given",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.shift()  # refuses an object closer than the focal length

    def shift(self) -> float:
        """Return the distance from the sensor to the image, um. An object distance of inf means the focus distance."""
        moved = 0.0
        if math.isfinite(self.object_distance):
            moved = float(focus.defocus_mm(self.focal_length, self.in_focus(), self.object_distance))
        return 1e3 * (self.defocus + moved)

    def seidel(self) -> wavefront.Seidel:
        return wavefront.Seidel(self.spherical, self.coma, self.astigmatism, self.field_curvature)

    def path_at(self, y: Floats, x: FloatArray, height_y: float, height_x: float) -> FloatArray:
        """Return the optical path over the pupil (um) for an image point at heights relative to the full height."""
        return self.seidel().at(y, x, height_y, height_x) + wavefront.defocus(self.shift(), self.cone_f_number(), y, x)


@dataclass(frozen=True, kw_only=True)
class Wavefront(Blur, Aberrated, Transfer):
    """Blur with one wavefront for the whole frame: aperture, defocus, Zernike and Seidel terms at one image point.

    This stage includes diffraction and takes the place of ``diffraction``: with every term at zero and a clear circle
    the results are identical. With both stages in one pipeline the aperture would blur twice. A polygon has the area of
    the f-number's circle, so that it passes the same light.
    """

    gain: ClassVar[float | None] = (
        None  # a point between samples on a coarse grid is truncated: there is no bound for every frame
    )

    aperture: str = param("circular", choices=("circular", "annular", "polygonal"), doc="outline of the pupil")
    obstruction: float = param(
        0.0,
        at_least=0,
        below=1,
        held=(0, 0.999),
        doc="annular: diameter of the central obstruction divided by the diameter of the aperture",
    )
    blades: int = param(6, at_least=3, at_most=64, doc="polygonal: number of blades")
    rotation: float = param(0.0, units="deg", doc="polygonal: angle of a corner, from +x towards +y")
    rounding: float = param(
        0.0, at_least=0, at_most=1, doc="polygonal: curvature of the blades; 1: the circle through the corners"
    )
    zernike: tuple[float, ...] = param(
        (), **WAVES, doc="Zernike coefficients, rms over the f-number's circle, piston first"
    )
    zernike_index: str = param(
        "noll", choices=("noll", "ansi"), doc="order of the coefficients: Noll from 1, or ANSI from 0"
    )
    distortion: float = param(0.0, **WAVES, doc="distortion W311 at the full image height: displaces the image")
    field_y: float = param(0.0, units="mm", doc="y position of the image point of the wavefront")
    field_x: float = param(0.0, units="mm", doc="x position of the image point of the wavefront")
    pupil_samples: int = param(
        128,
        at_least=16,
        at_most=MOST_SAMPLES,
        fidelity=True,
        reference="Gauss quadrature over the overlap, or 2048 samples",
        settings=(16, 32, 64, 128, 256, 512, 1024, 2048),
        doc="samples across the pupil for aberrations without rotational symmetry; steep aberrations use more",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.shape()  # raises on contradictory parameters
        edge = self.shape().reach()
        if self.shift() and 2 * self.cone_f_number() < edge:
            raise ValueError(
                f"f_number is {self.f_number:g}: the corners of {self.blades} blades exceed the largest aperture that "
                "an aplanatic lens can have"
            )

    def shape(self) -> pupil.Aperture:
        turn = math.radians(self.rotation)
        return pupil.Aperture(cast(pupil.Shape, self.aperture), self.obstruction, self.blades, turn, self.rounding)

    def height(self) -> tuple[float, float]:
        return self.field_y / self.full_height, self.field_x / self.full_height

    def terms(self) -> list[tuple[int, int, float]]:
        """Return the Zernike terms (n, m, um) except piston and tilt."""
        orders = wavefront.zernike_orders(len(self.zernike), cast(wavefront.Index, self.zernike_index))
        return [(n, m, value) for (n, m), value in zip(orders, self.zernike, strict=True) if n > 1 and value]

    def moved(self) -> tuple[float, float]:
        """Return the image displacement caused by tilts, in um along y and x; it is applied exactly, as a phase."""
        slope_y, slope_x = wavefront.Seidel(w311=self.distortion).tilt(*self.height())
        orders = wavefront.zernike_orders(len(self.zernike), cast(wavefront.Index, self.zernike_index))
        for (n, m), value in zip(orders, self.zernike, strict=True):
            slope_y += 2.0 * value if (n, m) == (1, -1) else 0.0
            slope_x += 2.0 * value if (n, m) == (1, 1) else 0.0
        double = 2.0 * self.cone_f_number()
        return double * slope_y, double * slope_x

    def path(self, y: Floats, x: FloatArray) -> FloatArray:
        total = self.path_at(y, x, *self.height())
        for n, m, value in self.terms():
            total = total + value * wavefront.zernike(n, m, y, x)
        return total

    @cached_property
    def flat(self) -> bool:
        """Return whether no aberration changes the shape of the PSF."""
        off_axis = self.field_y != 0 or self.field_x != 0
        seidel = self.spherical or (off_axis and (self.coma or self.astigmatism or self.field_curvature))
        return not (self.shift() or seidel or self.terms())

    @cached_property
    def round(self) -> bool:
        """Return whether aperture and wavefront depend only on the distance from the centre."""
        off_axis = self.field_y != 0 or self.field_x != 0
        bent = off_axis and (self.coma or self.astigmatism)
        return self.aperture != "polygonal" and not bent and all(m == 0 for _, m, _ in self.terms())

    @property
    def radial(self) -> bool:  # type: ignore[override]
        """Return whether the transfer function depends only on the radial frequency."""
        return self.round and self.moved() == (0.0, 0.0)

    @cached_property
    def even(self) -> bool:
        """Return whether pupil and wavefront are unchanged by half a turn: the transfer function is then real."""
        off_axis = self.field_y != 0 or self.field_x != 0
        whole = self.aperture != "polygonal" or self.blades % 2 == 0
        return whole and not (off_axis and self.coma) and all(m % 2 == 0 for _, m, _ in self.terms())

    @cached_property
    def steepness(self) -> float:
        """Return the steepest slope of the wavefront in the open pupil, um per pupil radius."""
        shape = self.shape()
        centres = pupil.cell_centres(COARSE, shape.reach())
        path = self.path(centres[:, None], centres)
        return imaging.steepest_slope(path, pupil.amplitude(shape, COARSE), shape.reach())

    def samples(self, shortest: float) -> int:
        """Return the number of samples across the pupil at a wavelength (um): as requested, but at least eight per wave
        of slope per pupil radius; four times as many if the pupil is round.
        """
        needed = math.ceil(8.0 * self.shape().reach() * self.steepness / shortest)
        if needed > MOST_SAMPLES:
            raise ValueError(
                f"the slope of the wavefront reaches {self.steepness / shortest:.0f} waves per pupil radius, but "
                f"{MOST_SAMPLES} samples resolve at most {MOST_SAMPLES // 8}; for aberrations this large, use lens_psf "
                f"with a disc, or lens_gaussian"
            )
        wanted = max(self.pupil_samples, needed + needed % 2)
        return min(4 * wanted, MOST_SAMPLES) if self.round else int(wanted)  # rows only are cheap

    def by_quadrature(self, shortest: float) -> bool:
        """Return whether a rotationally symmetric wavefront is smooth enough for Gauss quadrature, which is faster and
        exact."""
        return self.round and self.steepness <= ROUND_WAVES[self.obstruction > 0] * shortest

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        """Return tables by wavelength, (wavelengths um, nodes or None, values); None if no table is needed or the
        tables would be too large.
        """
        bands = np.asarray(coordinates["wavelength"], dtype=float) * 1e-3
        if self.flat:
            return None
        if not self.round:
            samples = self.samples(float(bands.min()))
            if (2 * samples + 5) ** 2 * (8 if self.even else 16) * bands.size > TABLE_BYTES:
                return None
        return self.tables(bands)

    def tables(self, bands: FloatArray) -> tuple[FloatArray, FloatArray | None, Array]:
        shortest = float(bands.min())
        steep = self.steepness / shortest
        if self.by_quadrature(shortest):
            nodes = imaging.radial_nodes(self.obstruction, int((48 if self.obstruction else 96) * (1 + steep / 3)))
            count = 16 + math.ceil(5 * steep)
            return (
                bands,
                nodes,
                np.stack([imaging.radial_otf(nodes, self.radial_path, w, self.obstruction, count) for w in bands]),
            )
        shape, samples = self.shape(), self.samples(shortest)
        clear = pupil.amplitude(shape, samples)
        if self.round:
            nodes = np.linspace(0.0, 1.0, samples + 1)
            clear_otf = annulus.annular_otf(nodes, 1.0, 1.0, self.obstruction)
            return bands, nodes, clear_otf + imaging.radial_changes(clear, self.radial_path, bands)
        centres = pupil.cell_centres(samples, shape.reach())
        path = self.path(centres[:, None], centres)
        found = np.stack([self.lattice(clear, path, w) for w in bands])
        return bands, None, found

    def radial_path(self, square: FloatArray) -> FloatArray:
        return self.path(0.0, np.sqrt(square))

    def lattice(self, clear: FloatArray, path: FloatArray, wavelength: float) -> Array:
        found = imaging.pupil_lattice(clear, path, wavelength)
        return np.ascontiguousarray(found.real) if self.even else found

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, prepared: Any = None) -> Array:
        number = self.cone_f_number()
        if self.radial and fy.shape[0] > 1:
            return on_unique_rows(lambda rows: self.without_tilt(rows, fx, wavelength, number, prepared), fy)
        value = self.without_tilt(fy, fx, wavelength, number, prepared)
        moved = self.moved()
        if moved != (0.0, 0.0):
            value = value * (np.exp(-2j * np.pi * moved[0] * fy) * np.exp(-2j * np.pi * moved[1] * fx))
        return value

    def without_tilt(
        self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, number: float, prepared: Any
    ) -> Array:
        if self.flat and self.aperture != "polygonal":
            return annulus.annular_otf(np.hypot(fy, fx), wavelength, number, self.obstruction)
        bands = np.asarray(wavelength, dtype=float).ravel()
        radius = np.hypot(fy, fx)
        clear_otf = self.clear_otf(fy, fx)
        out = np.empty((bands.size, *radius.shape), float if self.even or self.flat else complex)
        for band, w in enumerate(bands):
            nu = radius * (w * number)
            if self.flat:
                out[band] = clear_otf(nu)
                continue
            known, nodes, values = self.tables(bands[band : band + 1]) if prepared is None else prepared
            own = values[int(np.argmin(np.abs(known - w)))]
            if nodes is not None:
                out[band] = np.where(nu == 0.0, 1.0, imaging.from_radial(nodes, own, nu))
            else:
                clear = clear_otf(nu)
                change = imaging.from_lattice(own, fy, fx, float(w), number, self.shape().reach())
                out[band] = np.where(clear > 0.0, clear + change, 0.0)
        return out

    def clear_otf(self, fy: FloatArray, fx: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Return the OTF of the aperture alone at these frequencies, as a function of |f| lambda N_w on the same
        grid."""
        if self.aperture != "polygonal":
            return lambda nu: annulus.annular_otf(nu, 1.0, 1.0, self.obstruction)
        outline = _polygon(self.blades, math.radians(self.rotation), self.rounding)
        place = outline.place(fy + 0.0 * fx, fx + 0.0 * fy)
        return lambda nu: outline.at(2.0 * nu, place)

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Return the error bound of the transform pair plus the error of the computed transfer function, rms over
        scenes (points and edges: `benchmarks/pupil.py`).
        """
        own = super().error(facts, grid, precision)[0]
        if self.aperture == "polygonal":
            own += 6e-6
        if self.flat:
            return own, "measured"
        shortest = float(grid["irradiance"].bands().values()[0]) * 1e-3
        if self.by_quadrature(shortest):
            return own + 3e-6, "measured"
        slope = 4e-3 if self.round else 1.2e-4  # a symmetric PSF may be dark in its middle: weak relative to the error
        return min(
            1.0, own + slope * max(1.0, self.steepness / shortest) * (128 / self.samples(shortest)) ** 2
        ), "fitted"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        grid: Grid = grids["irradiance"]
        notes = too_coarse(facts, grid, self.cone_f_number() / self.shape().reach())
        if not self.flat and not facts.uniform:
            shortest = float(grid.bands().values()[0]) * 1e-3
            if not self.round and self.samples(shortest) > self.pupil_samples:
                notes.append(
                    f"the wavefront is steep: {self.samples(shortest)} pupil samples are used instead of "
                    f"{self.pupil_samples}"
                )
        off_axis = [n for n in ("coma", "astigmatism", "field_curvature", "distortion") if getattr(self, n)]
        if off_axis and self.field_y == self.field_x == 0:
            notes.append(
                f"{' and '.join(off_axis)} are zero on axis; give field_y or field_x, or use the stage aberrations"
            )
        return notes


@lru_cache(maxsize=8)
def _polygon(blades: int, rotation: float, rounding: float) -> pupil.PolygonOtf:
    return pupil.PolygonOtf(blades, rotation, rounding)
