"""Measured resolution: a Siemens star or a dead-leaves texture in every picture of a run.

In:  the pictures and white of all stages.
Out: MTF50 and MTF10 of the star, MTF50 of the texture, by ``stage``; NaN where nothing can be measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import scipy

from etendue.api import Grid, measured, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.resolution.siemens import Star, StarResponse, star_response
from etendue_camera.resolution.stages.edge_pictures import FAINTEST
from etendue_camera.resolution.stages.luminance import (
    NOISE_FREE,
    SATURATED,
    PictureProbe,
    Seen,
    check_encoding,
    decoded,
    first_exposure,
    weighed,
)
from etendue_camera.resolution.texture import SMALLEST, TextureResponse, texture_response
from etendue_camera.sensor.stages.masks import mask_of

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf

MARGIN = 1.0  # pixels between the outermost ring and the border, for the centre to move
OUTERMOST = 0.75  # smallest response of the outermost ring from which an unknown contrast can be found
REFERENCE = 1.0  # rms width, in pixels, of the Gaussian that prevents aliasing of a reference on a coarser grid
TAIL, ORDER = 6.0, 5  # truncation in rms widths; order of the spline that interpolates it
EVEN = 0.2  # min/max energy of slopes over directions, above which a picture is not an edge
DOUBTFUL = 0.05  # standard error of the response at MTF50 above which MTF50 is undefined


@dataclass(frozen=True, kw_only=True)
class _Pictures(PictureProbe):
    """The luminance of every picture of a run, as in `edge_resolution`. Cycles per pixel refer to camera pixels at
    every stage.
    """

    encoding: str = param(
        "sRGB", choices=("sRGB", "BT.709", "power"), doc="encoding of rgb_display, as in the stage encode"
    )
    exponent: float = param(0.45, above=0, at_most=5, doc="exponent of encoding 'power'")

    def planes(
        self, transfers: Sequence[tuple[str, Otf]], matrices: Seen, whites: Seen, given: dict[str, Any]
    ) -> Iterator[tuple[str, str, Any, Any]]:
        """Yield (stage, variable, plane, grid); the plane is None where it is clipped or its sites have different
        colours.
        """
        check_encoding(given["rgb_linear"], given["rgb_display"], self.encoding, self.exponent)
        taken = weighed(transfers, matrices, whites, lambda a: decoded(a, self.encoding, self.exponent))
        one_colour = len(mask_of(self.pattern).channels) == 1
        clipped = any(_clipped(array) for _, array, _ in given["mosaic_linear"][:1])
        for variable, pictures in given.items():
            for name, array, grid in pictures:
                shown = first_exposure(array, variable)
                lost = (
                    (clipped and variable not in NOISE_FREE)
                    or (variable == "mosaic_linear" and not one_colour)
                    or (variable == "rgb_display" and (_clipped(shown) or _clipped(1 - np.asarray(shown))))
                )
                plane = None if lost else np.asarray(taken[variable](shown), dtype=float)
                yield name, variable, plane, grid


@dataclass(frozen=True, kw_only=True)
class StarProbe(_Pictures):
    """Measure the sinusoidal Siemens star of the pipeline's own scene at every stage that has a picture.

    Luminance is measured as in ``edge_resolution``, over the whole of every picture; a mosaic of several colours is
    skipped. ``cycles`` and ``radius`` must equal the values of the scene; if a star does not fit into a picture, the
    part that fits is measured. Frequencies are means over all directions, including the rendering of the chart.

    Contrast is relative to the star before the lens (the limit of the outer rings of the first ``irradiance`` towards
    frequency 0), so that veiling glare counts as lost contrast. The result is NaN if there is no star with this many
    cycles about the centre, if its contrast is below 2 % or below the fit residual, if the picture is clipped or too
    small for rings below half contrast, or if half contrast is not reached at ``highest``.
    """

    writes: ClassVar = {
        "star_mtf50": "stage [cycles/um] nan",
        "star_mtf50_cycles": "stage [cycles/pixel] nan",
        "star_mtf10": "stage [cycles/um] nan",
    }
    nanoseconds: ClassVar = 1e8
    error: ClassVar = measured(2e-3)  # for a noise-free star of 36 cycles

    cycles: int = param(36, at_least=8, doc="cycles of the star, as in the scene")
    radius: float = param(400.0, units="um", above=0, doc="radius of the star on the image plane, as in the scene")
    centre_y: float = param(
        0.0, units="um", doc="y centre of the star on the image plane, accurate to a quarter of the finest cycle"
    )
    centre_x: float = param(0.0, units="um", doc="x centre of the star on the image plane")
    contrast: float = param(
        0.0,
        at_least=0,
        at_most=1,
        doc="contrast of the star, (light - dark)/(light + dark); 0: measured in the first irradiance",
    )
    highest: float = param(0.7, above=0, at_most=1, doc="frequency of the innermost ring, cycles/pixel")

    def run(
        self,
        transfers: Sequence[tuple[str, Otf]],
        lights: Seen,
        matrices: Seen,
        whites: Seen,
        irradiance: FloatArray,
        photon_rate: FloatArray,
        mosaic_linear: FloatArray,
        rgb_camera: FloatArray,
        xyz_scene: FloatArray,
        rgb_linear: FloatArray,
        rgb_display: FloatArray,
        stage: Any,
    ) -> dict[str, Array]:
        given = {
            "irradiance": irradiance,
            "photon_rate": photon_rate,
            "mosaic_linear": mosaic_linear,
            "rgb_camera": rgb_camera,
            "xyz_scene": xyz_scene,
            "rgb_linear": rgb_linear,
            "rgb_display": rgb_display,
        }
        found = {}
        contrast = self.contrast
        for name, variable, plane, grid in self.planes(transfers, matrices, whites, given):
            star = None if plane is None else self.measured(plane, grid, contrast)
            if not contrast and star is not None and variable == "irradiance":
                contrast = min(1.0, star.contrast)
            half, tenth = (math.nan, math.nan) if star is None else (star.mtf50, star.mtf10)
            step = grid.line("x").um()[1]
            found[name] = (half / step, half / step * self.pixel_pitch, tenth / step)
        rows = np.array([found[name] for name in stage], dtype=float).reshape(-1, 3)
        return {"star_mtf50": rows[:, 0], "star_mtf50_cycles": rows[:, 1], "star_mtf10": rows[:, 2]}

    def measured(self, plane: FloatArray, grid: Grid, contrast: float) -> StarResponse | None:
        """Return the response of the star in a picture, None if there is no star; ``contrast`` is 0 if unknown."""
        places = [
            (c - start) / step for c, (start, step) in zip((self.centre_y, self.centre_x), _lines(grid), strict=True)
        ]
        room = min(min(place, size - 1 - place) for place, size in zip(places, plane.shape, strict=True)) - MARGIN
        radius = min(self.radius / grid.line("x").um()[1], room / 0.95)  # the kernel omits the outer twentieth
        if not radius > 0:
            return None
        low = [math.floor(place - radius - MARGIN) for place in places]
        part = plane[
            tuple(slice(max(0, a), math.ceil(p + radius + MARGIN) + 1) for a, p in zip(low, places, strict=True))
        ]
        centre = (places[0] - max(0, low[0]), places[1] - max(0, low[1]))
        try:
            with np.errstate(all="ignore"):
                star = star_response(
                    part, Star(self.cycles, radius), centre=centre, contrast=contrast or None, highest=self.highest
                )
        except (ValueError, np.linalg.LinAlgError):  # raised by the kernel for pictures without a star
            return None
        moved = math.hypot(star.centre[0] - centre[0], star.centre[1] - centre[1])
        outermost = 0.0 if contrast else OUTERMOST
        return (
            star
            if star.contrast >= FAINTEST
            and star.residual <= star.contrast
            and star.sfr[0] >= outermost
            and moved < 0.1 * radius
            else None
        )


@dataclass(frozen=True, kw_only=True)
class LeavesProbe(_Pictures):
    """Measure the dead-leaves texture of the pipeline's own scene at every stage that has a picture, by its
    cross-spectrum with the light before the lens.

    The reference is the first ``irradiance``. If the grids of chart and picture differ, the chart is blurred by a
    Gaussian of one pixel, whose transfer function is divided out again, and interpolated at the pixel centres. The
    rendering of the chart affects both and cancels: the result is the response of the stages after the chart, averaged
    over all directions. Noise and aliases are not in the reference and are not counted.

    Luminance is measured as in ``edge_resolution``, over the whole of every picture; a mosaic of several colours is
    skipped. The result is NaN if there is no texture (uniform light, or edges of one direction), if the picture is
    below 64 x 64 pixels or clipped, or if half contrast is not reached below 0.5 cycles/pixel or is hidden by noise.
    """

    writes: ClassVar = {"leaves_mtf50": "stage [cycles/um] nan", "leaves_mtf50_cycles": "stage [cycles/pixel] nan"}
    nanoseconds: ClassVar = 1e8
    # For a noise-free picture of 144 x 144 pixels at 0.49 cycles/pixel, where aliases are near; 4e-3 up to 0.38.
    error: ClassVar = measured(4e-2)

    def run(
        self,
        transfers: Sequence[tuple[str, Otf]],
        lights: Seen,
        matrices: Seen,
        whites: Seen,
        irradiance: FloatArray,
        photon_rate: FloatArray,
        mosaic_linear: FloatArray,
        rgb_camera: FloatArray,
        xyz_scene: FloatArray,
        rgb_linear: FloatArray,
        rgb_display: FloatArray,
        stage: Any,
    ) -> dict[str, Array]:
        given = {
            "irradiance": irradiance,
            "photon_rate": photon_rate,
            "mosaic_linear": mosaic_linear,
            "rgb_camera": rgb_camera,
            "xyz_scene": xyz_scene,
            "rgb_linear": rgb_linear,
            "rgb_display": rgb_display,
        }
        found, first, held = {}, None, {}
        for name, variable, plane, grid in self.planes(transfers, matrices, whites, given):
            if first is None and variable == "irradiance" and plane is not None:
                first = (plane, grid)
            half = math.nan
            if first is not None and plane is not None and min(plane.shape) >= SMALLEST:
                where = (plane.shape, _lines(grid))
                if where not in held:
                    held[where] = _reference(*first, plane.shape, grid)
                half = _half(plane, *held[where])
            half /= grid.line("x").um()[1]
            found[name] = (half, half * self.pixel_pitch)
        rows = np.array([found[name] for name in stage], dtype=float).reshape(-1, 2)
        return {"leaves_mtf50": rows[:, 0], "leaves_mtf50_cycles": rows[:, 1]}


def _clipped(array: FloatArray) -> bool:
    return float(np.mean(np.asarray(array) >= 1)) > SATURATED


def _lines(grid: Grid) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return (start, step) of y and of x, um."""
    return grid.line("y").um(), grid.line("x").um()


def _reference(plane: FloatArray, grid: Grid, shape: tuple[int, int], wanted: Grid) -> tuple[Any, float]:
    """Return the light interpolated at the positions of another grid, and the rms width of its blur (pixels of that
    grid); None instead of light without texture.
    """
    own, other = _lines(grid), _lines(wanted)
    if shape == plane.shape and np.allclose(own, other, rtol=1e-9, atol=1e-9 * own[1][1]):
        return (plane, 0.0) if _textured(plane) else (None, 0.0)
    places = [(start + step * np.arange(n) - a) / b for n, (start, step), (a, b) in zip(shape, other, own, strict=True)]
    width = [REFERENCE * step / b for (_, step), (_, b) in zip(other, own, strict=True)]
    blurred = scipy.ndimage.gaussian_filter(plane, width, truncate=TAIL, mode="mirror")
    read = scipy.ndimage.map_coordinates(blurred, np.meshgrid(*places, indexing="ij"), order=ORDER, mode="mirror")
    return (read, REFERENCE) if _textured(read) else (None, 0.0)


def _textured(plane: FloatArray) -> bool:
    """Return whether a picture has contrast, and slopes in all directions."""
    down, across = np.gradient(plane)
    tensor = np.array([[np.sum(down**2), np.sum(down * across)], [np.sum(down * across), np.sum(across**2)]])
    least, most = np.linalg.eigvalsh(tensor)
    return bool(np.std(plane) >= FAINTEST * abs(np.mean(plane)) and np.mean(plane) != 0 and least >= EVEN * most)


def _half(plane: FloatArray, reference: FloatArray, width: float) -> float:
    """Return the MTF50 of a picture against its reference, cycles/pixel."""
    if reference is None:
        return math.nan
    try:
        with np.errstate(all="ignore"):
            found: TextureResponse = texture_response(
                plane,
                reference,
                known=lambda f: np.exp(-2 * (np.pi * width * f) ** 2),
                rings=min(64, min(plane.shape) // 4),
            )
    except (ValueError, np.linalg.LinAlgError):  # raised by the kernel for pictures without texture
        return math.nan
    if math.isnan(found.mtf50) or not np.interp(found.mtf50, found.frequency, found.doubt) <= DOUBTFUL:
        return math.nan
    return found.mtf50
