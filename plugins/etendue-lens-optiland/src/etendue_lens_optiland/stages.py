"""Stages of a ray-traced lens: blur, distortion, illumination and metrics.

In:  ``irradiance`` (wavelength, y, x), W m-2 nm-1, on the image-plane grid; the lens by name or file, focal length,
     f-number.
Out: ``irradiance``; scalars by field and wavelength.

Keep the order ``irradiance``, ``real_lens_distortion``, ``real_lens_illumination``, ``real_lens``. These stages replace
``falloff`` and ``diffraction``: diffraction at the stop is included in the PSFs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from etendue.api import Banded, Bounded, Facts, Grid, Labels, Stage, file_state, param, quantity
from etendue_camera.field import blur, warp
from etendue_lens_optiland import banks, pupil
from etendue_lens_optiland.lens import AIMING, FOCUS, Lens, open_lens

# um by which 17 fields from the axis to the corner may misplace a point: 8.5e-4 for a double Gauss lens over 20 degrees
MISPLACED = 5e-3


@dataclass(frozen=True, kw_only=True)
class RealLens(Stage):
    """Parameters common to all stages of a real lens: the lens and its setting."""

    libraries: ClassVar[tuple[str, ...]] = ("optiland",)
    negative: ClassVar[str] = "keep"

    sample_lens: str = param(
        "ReverseTelephoto", shared=True, doc="sample lens of optiland; ignored if prescription is given"
    )
    prescription: str = param(
        "", shared=True, file=True, doc="Zemax file .zmx or surface table .csv; '': the sample lens"
    )
    focal_length: float = quantity("focal_length")
    f_number: float = quantity("f_number")
    reference_wavelength: float = param(
        550.0,
        shared=True,
        units="nm",
        at_least=300,
        at_most=2000,
        doc="wavelength for which focal length, f-number and focus are given",
    )
    focus: str = param(
        "design",
        shared=True,
        choices=FOCUS,
        doc="image plane: as designed, paraxial, or at the smallest rms axial wavefront error",
    )
    aiming: str = param(
        "stop",
        shared=True,
        choices=AIMING,
        doc="ray aiming: light fills the stop, or the paraxial entrance pupil at every angle (unaimed rays)",
    )

    def opened(self) -> Lens:
        return open_lens(
            self.sample_lens,
            self.prescription,
            self.focal_length,
            self.f_number,
            self.reference_wavelength * 1e-3,
            self.focus,
            self.aiming,
            file_state(self.prescription),
        )

    def traced_wavelengths(self, wavelengths: tuple[float, ...]) -> tuple[float, ...]:
        if not wavelengths or any(b <= a for a, b in pairwise(wavelengths)):
            raise ValueError(f"wavelengths are {list(wavelengths)}; they must ascend, in nm")
        return tuple(w * 1e-3 for w in wavelengths)


@dataclass(frozen=True, kw_only=True)
class Moved(RealLens):
    """A stage that reads and writes irradiance."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}

    def grid(self, inputs: Any) -> dict[str, Grid]:
        """Keep the grid of the light. A lens that cannot be opened, or that does not cover the corner of the frame, is
        rejected in planning.
        """
        lens = self.opened()
        lens.tangent_for(_corner_of(inputs["irradiance"]), (lens.reference,))
        return {}


@dataclass(frozen=True, kw_only=True)
class Blur(Moved, Banded, Bounded):
    """Blur every point by the wavefront of its own field and wavelength, ray-traced through the prescription."""

    role: ClassVar = "lens"
    once: ClassVar = ("diffraction",)
    nanoseconds: ClassVar = 400.0

    fields: tuple[float, ...] = param(
        (0.0, 22.0, 30.0),
        units="deg",
        at_least=0,
        below=89,
        example=(0.0, 22.0),
        doc="field angles at which PSFs are traced",
    )
    heights: int = param(
        0,
        at_least=0,
        at_most=200,
        fidelity=True,
        reference="twice as many heights",
        doc="number of image heights from the axis to the frame corner at which PSFs are traced, instead of fields; "
        "0: use fields, which is a different lens and not a coarser setting",
    )
    wavelengths: tuple[float, ...] = param(
        (450.0, 550.0, 650.0),
        units="nm",
        at_least=200,
        at_most=5000,
        example=(500.0, 600.0),
        doc="wavelengths at which PSFs are traced, with linear interpolation between them",
    )
    pupil_samples: int = param(
        128,
        at_least=16,
        at_most=1024,
        fidelity=True,
        example=32,
        reference="1024 samples",
        settings=(32, 64, 128, 256, 512, 1024),
        costs=(1.0, 1.0, 1.0, 1.35, 3.5, 12.0),
        doc="smallest number of samples across the pupil",
    )
    lost: float = param(
        0.02,
        above=0,
        at_most=0.5,
        fidelity=True,
        dear=True,
        example=0.2,
        reference="2e-3",
        settings=(0.2, 0.1, 0.05, 0.02, 0.01, 5e-3, 2e-3),
        doc="fraction of the flux of a PSF allowed outside its window; small values may require windows above the "
        "size limit",
    )
    window: float = param(0.0, units="um", at_least=0, doc="side of the PSF window; 0: set by lost")
    tolerance: float = param(
        0.1,
        above=0,
        below=1,
        fidelity=True,
        dear=True,
        reference="0.01",
        settings=(0.3, 0.1, 0.03, 0.01),
        doc="bound on the largest error of the convolution for any scene, relative to full scale; for photographs the "
        "error is about a tenth of it",
    )
    method: str = param(
        "tiles",
        choices=("auto", "eigen", "tiles"),
        fidelity=True,
        reference="the other method",
        doc="blended tiles, an expansion in eigen-PSFs, or whichever is faster; all meet the tolerance, none is "
        "always more accurate",
    )
    weights: str = param(
        "source",
        choices=("source", "image"),
        doc="object: the flux of a point is conserved exactly; image: a uniform plane stays uniform exactly",
    )
    light: str = param(
        "bandlimited",
        choices=("bandlimited", "cells"),
        doc="meaning of a light sample, as in the scene's light: band-limited value or cell mean",
    )

    def grid(self, inputs: Any) -> dict[str, Grid]:
        found = "cells" if inputs["irradiance"].line("x").cells else "bandlimited"
        if found != self.light:
            raise ValueError(
                f"light is {self.light!r}, but the scene's light is {found!r}; set light = {found!r} here as well"
            )
        self.traced_wavelengths(self.wavelengths)
        if self.heights:
            return super().grid(inputs)
        lens = self.opened()
        if not np.isfinite(lens.chief(banks.tangents_of(self.fields), lens.reference)[1]).all():
            raise ValueError(
                f"fields are {list(self.fields)}, but {lens.prescription.name} does not image all of them; use "
                f"smaller ones"
            )
        return {}

    def prepare(self, coordinates: Any) -> Any:
        lens = self.opened()
        y, x = coordinates["y_um"], coordinates["x_um"]
        wavelengths = self.traced_wavelengths(self.wavelengths)
        if self.heights:
            tangents = banks.nodes_to(lens, _corner(y, x), wavelengths, max(2, self.heights))
        else:
            tangents = banks.tangents_of(self.fields)
        traced = banks.psf_bank(lens, tangents, wavelengths, self.pupil_samples, self.window, self.lost)
        return blur.prepare(
            traced.bank,
            y,
            x,
            coordinates["wavelength"] * 1e-3,
            self.method,  # type: ignore[arg-type]
            self.tolerance,
            weights=self.weights,
            light=self.light,  # type: ignore[arg-type]
        )

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared.take(bands)

    def run(self, irradiance: Any, prepared: Any) -> dict[str, Any]:
        return {"irradiance": blur.apply(irradiance, prepared)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "the scene is uniform: blur has no effect") if facts.uniform and self.weights == "image" else None

    def carry(self, facts: Any, grid: Any) -> Facts:
        own = facts["irradiance"]
        if own.uniform and self.weights == "image":
            return own
        return replace(own, uniform=None if own.uniform else own.uniform, low=None, high=None, contrast=None)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the error of the convolution, of the light outside the PSF windows, and of the sampled pupil edge.

        The error of linear interpolation between fields and wavelengths is not included. To see it, compare with twice
        as many ``heights``.
        """
        pictures = 0.5 * self.lost + 1e-3 * (128 / self.pupil_samples) ** 1.5
        return self.tolerance + pictures + (2e-6 if precision == "float32" else 1e-13), "measured"

    def warn(self, facts: Facts, grids: Any) -> list[str]:
        if self.heights:
            return []
        lens, corner = self.opened(), _corner_of(grids["irradiance"])
        last = float(lens.chief(banks.tangents_of(self.fields)[-1:], lens.reference)[1][0])
        if corner > 1.001 * last:
            return [
                f"traced up to {last * 1e-3:.4g} mm from the axis, but the light extends to {corner * 1e-3:.4g} mm: "
                "the last PSF is used beyond"
            ]
        return []


@dataclass(frozen=True, kw_only=True)
class Distortion(Moved, Banded, Bounded):
    """Move the light of every wavelength to where its chief ray lands: distortion and lateral colour, relative to the
    image of a pinhole.
    """

    role: ClassVar = "distortion"
    once: ClassVar = ("distortion",)
    gain: ClassVar[float | None] = 3.5  # 3.3 for the quintic spline between samples of opposite signs
    nanoseconds: ClassVar = 350.0

    nodes: int = param(
        17,
        at_least=4,
        at_most=500,
        fidelity=True,
        example=6,
        reference="129 fields",
        settings=(5, 9, 17, 33, 65, 129),
        doc="number of fields traced from the axis to the corner",
    )
    order: int = param(
        5,
        at_least=1,
        at_most=5,
        fidelity=True,
        reference="order 5 with oversampling 4",
        settings=(1, 2, 3, 5),
        costs=(0.27, 0.41, 0.58, 1.0),
        doc="order of the interpolating spline",
    )
    oversampling: int = param(
        1,
        at_least=1,
        at_most=8,
        fidelity=True,
        reference="order 5 with oversampling 4",
        settings=(1, 2, 4),
        costs=(1.0, 1.8, 4.0),
        doc="oversampling of the light before spline interpolation",
    )

    def prepare(self, coordinates: Any) -> Any:
        wavelengths = tuple(float(w) * 1e-3 for w in coordinates["wavelength"])
        return banks.ideal_over_real(
            self.opened(), _corner(coordinates["y_um"], coordinates["x_um"]), wavelengths, self.nodes
        )

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared[bands]

    def run(self, irradiance: Any, y_um: Any, x_um: Any, prepared: Any) -> dict[str, Any]:
        planes = np.empty_like(irradiance)
        for number, (plane, ratio) in enumerate(zip(irradiance, prepared, strict=True)):
            planes[number] = warp.radial(plane, y_um, x_um, ratio, self.order, self.oversampling)
        return {"irradiance": planes}

    def carry(self, facts: Any, grid: Any) -> Facts:
        """A uniform plane is unchanged. In other planes the spline may slightly exceed the range of the input."""
        own = facts["irradiance"]
        return own if own.uniform else replace(own, low=None, high=None, contrast=None, band_limit=None)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "the scene is uniform: displacement has no effect") if facts.uniform else None

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the interpolation error and the position error of a Gaussian edge. The width of the edge follows from
        the band limit of the scene; it is 1 sample rms if the limit is unknown.
        """
        limit = facts["irradiance"].band_limit
        step = grid["irradiance"].line("x").step
        softness = 1.0 if not limit else 0.483 / (limit * step)  # exp(-2 pi^2 s^2 f^2) = 0.01
        rounding = 2e-6 if precision == "float32" else 1e-12
        moved = 0.4 / softness * MISPLACED * (17 / self.nodes) ** 3.5 / step  # an edge rises by 0.4 in its rms width
        return min(1.0, warp.edge_error(self.order, softness, self.oversampling) + moved) + rounding, "fitted"

    def warn(self, facts: Facts, grids: Any) -> list[str]:
        lens, corner = self.opened(), _corner_of(grids["irradiance"])
        ratio = banks.ideal_over_real(lens, corner, (lens.reference,), self.nodes)[0]
        beyond = corner * (float(ratio(corner**2)) - 1.0)
        if beyond > 2.0 * grids["irradiance"].line("x").step and not facts.uniform:
            return [
                f"the corner extends {beyond:.3g} um beyond the scene and reads its mirror image: enlarge the scene"
            ]
        return []


@dataclass(frozen=True, kw_only=True)
class Illumination(Moved, Banded):
    """Scale light by the cone that arrives at each image height, relative to the axis, including pupil aberration and
    vignetting.
    """

    role: ClassVar = "falloff"
    once: ClassVar = ("fall-off",)
    gain: ClassVar[float | None] = banks.BRIGHTEST
    pointwise: ClassVar = True
    nanoseconds: ClassVar = 8.0

    wavelengths: tuple[float, ...] = param(
        (450.0, 550.0, 650.0),
        units="nm",
        at_least=200,
        at_most=5000,
        doc="wavelengths at which cones are traced, with linear interpolation between them",
    )
    nodes: int = param(
        9,
        at_least=4,
        at_most=200,
        fidelity=True,
        example=4,
        reference="65 fields",
        settings=(5, 9, 17, 33, 65),
        doc="number of fields traced from the axis to the corner",
    )
    pupil_samples: int = param(
        64,
        at_least=16,
        at_most=512,
        fidelity=True,
        example=16,
        reference="512 samples",
        settings=(16, 32, 64, 128, 256, 512),
        doc="samples across the pupil",
    )

    def prepare(self, coordinates: Any) -> Any:
        y, x = coordinates["y_um"], coordinates["x_um"]
        traced = self.traced_wavelengths(self.wavelengths)
        curves = banks.relative_illumination(self.opened(), _corner(y, x), traced, self.nodes, self.pupil_samples)
        rows = []
        for wavelength in coordinates["wavelength"] * 1e-3:
            rows.append([float(np.interp(wavelength, traced, np.eye(len(traced))[i])) for i in range(len(traced))])
        return curves, np.array(rows)

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared[0], prepared[1][bands]

    def carry(self, facts: Any, grid: Any) -> Facts:
        own = facts["irradiance"]
        return replace(own, uniform=None, low=None, high=None, contrast=None)

    def run(self, irradiance: Any, y_um: Any, x_um: Any, prepared: Any) -> dict[str, Any]:
        curves, mix = prepared
        squared = y_um[:, None] ** 2 + x_um[None, :] ** 2
        maps = np.stack([np.clip(curve(squared), 0.0, banks.BRIGHTEST) for curve in curves])
        out = np.empty_like(irradiance)
        for number, row in enumerate(mix):
            out[number] = irradiance[number] * np.tensordot(row, maps, axes=1).astype(irradiance.dtype)
        return {"irradiance": out}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the error of the cone area due to pupil sampling, and the error of the curve between fields."""
        return 4e-4 * (64 / self.pupil_samples) ** 1.5 + 1e-4 * (9 / self.nodes) ** 3 + (
            2e-7 if precision == "float32" else 0.0
        ), "measured"


@dataclass(frozen=True, kw_only=True)
class Numbers(RealLens):
    """Compute metrics of the lens, by field angle and wavelength.

    ``image_scale`` is image height per tangent of the field angle close to the axis; distortion is relative to it.
    ``axial_f_number`` is 1/(2 sin) of the cone on axis. ``strehl_ratio`` is the PSF peak over that of the same pupil
    without aberrations; ``lateral_colour`` is the image height of the chief ray relative to that of the reference
    wavelength.
    """

    role: ClassVar = "figures"
    writes: ClassVar = {
        "real_focal_length": "[mm]",
        "back_focal_distance": "[mm]",
        "image_scale": "[mm]",
        "axial_f_number": "[1]",
        "image_height": "field [mm]",
        "strehl_ratio": "field wavelength [1]",
        "wavefront_rms": "field wavelength [1]",
        "distortion": "field [percent]",
        "lateral_colour": "field wavelength [um]",
        "real_illumination": "field wavelength [1]",
    }
    nanoseconds: ClassVar = 5e7

    fields: tuple[float, ...] = param((0.0, 22.0, 30.0), units="deg", at_least=0, below=89, doc="field angles")
    wavelengths: tuple[float, ...] = param(
        (450.0, 550.0, 650.0), units="nm", at_least=200, at_most=5000, doc="wavelengths"
    )
    pupil_samples: int = param(
        128,
        at_least=16,
        at_most=1024,
        fidelity=True,
        example=16,
        reference="1024 samples",
        settings=(32, 64, 128, 256, 512, 1024),
        doc="samples across the pupil",
    )

    def grid(self, inputs: Any) -> dict[str, Grid]:
        self.opened()
        fields, lines = Labels(self.fields, "deg"), Labels(self.wavelengths, "nm")
        both = Grid.of({"field": fields, "wavelength": lines})
        return {variable: both for variable in self.writes}

    def run(self) -> dict[str, Any]:
        lens, tangents = self.opened(), banks.tangents_of(self.fields)
        wavelengths = self.traced_wavelengths(self.wavelengths)
        bundles = [[banks.resolved(lens, float(t), w, self.pupil_samples) for w in wavelengths] for t in tangents]
        axis = [lens.bundle(0.0, w, self.pupil_samples) for w in (*wavelengths, lens.reference)]
        heights = lens.chief(tangents, lens.reference)[1]
        ideal = lens.image_distance_um * tangents
        return {
            "real_focal_length": np.array(lens.focal_length_um * 1e-3),
            "back_focal_distance": np.array(lens.back_focus * lens.scale * 1e-3),
            "image_scale": np.array(lens.image_distance_um * 1e-3),
            "axial_f_number": np.array(0.5 * math.sqrt(math.pi / axis[-1].solid_angle)),
            "image_height": heights * 1e-3,
            "strehl_ratio": np.array([[pupil.strehl(b) for b in row] for row in bundles]),
            "wavefront_rms": np.array([[b.wavefront_rms() for b in row] for row in bundles]),
            "distortion": 100.0 * np.divide(heights - ideal, ideal, out=np.zeros_like(ideal), where=ideal > 0),
            "lateral_colour": np.array([[b.height - h for b in row] for row, h in zip(bundles, heights, strict=True)]),
            "real_illumination": np.array(
                [[b.solid_angle / a.solid_angle for b, a in zip(row, axis, strict=False)] for row in bundles]
            ),
        }

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the error of the pupil's area and edge from the number of samples across the pupil."""
        return 1e-3 * (128 / self.pupil_samples) ** 1.5 + (1e-6 if precision == "float32" else 0.0), "measured"


def _corner(y: Any, x: Any) -> float:
    return math.hypot(max(abs(float(y[0])), abs(float(y[-1]))), max(abs(float(x[0])), abs(float(x[-1]))))


def _corner_of(grid: Grid) -> float:
    ends = []
    for dim in ("y", "x"):
        line = grid.line(dim)
        start, step = line.um()
        ends.append(np.array([start, start + step * (line.size - 1)]))
    return _corner(*ends)
