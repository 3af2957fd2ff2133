"""Blur of a lens from a photograph of an edge: the width of a Gaussian, in addition to the blur of the pixel.

In:  a raw frame of a slanted edge, a calibrated sensor, the pixel's pitch and aperture.
Out: the rms width of the Gaussian (um) with its interval, and the largest difference between its response and the
     measured response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from etendue.errors import RequestError
from etendue_camera.arrays import Array
from etendue_camera.electronics import response
from etendue_camera.electronics.jackknife import Estimate
from etendue_camera.resolution.edges.edge_interval import CLIPPED, edge_resolution
from etendue_camera.sensor.photodiode import aperture_otf
from etendue_lab.calibrate.sensor_model import SensorModel
from etendue_lab.frames.frame_set import FrameSet, Window, sha256
from etendue_lab.frames.moments import Site
from etendue_lab.frames.reading import frame_of

METHOD = 5e-4  # error of the method, as a fraction of MTF50; added to the error by noise
BEND = 3  # degree of the polynomial that follows the edge, which distortion bends


@dataclass(frozen=True)
class EdgePhotograph:
    """A raw frame of a slanted edge, and the pixel that took it."""

    path: Path
    pitch: float  # um
    aperture: float  # side of the light-sensitive square over the pitch
    window: Window | None = None


@dataclass(frozen=True)
class EdgeBlur:
    """Blur of a lens, measured at one edge."""

    sigma: Estimate  # um, rms width of its point spread function along one axis
    mtf50: Estimate  # cycles/pixel, of lens and pixel together
    angle: float  # degrees from the nearer axis of the raster
    misfit: float  # largest difference between measured response and fitted blur, up to the Nyquist frequency
    file: str
    digest: str


def pixel_otf(frequency: Array | float, angle: float, aperture: float) -> Array:
    """Return the transfer function of a square pixel along the normal of an edge.

    Parameters
    ----------
    frequency : (...) array, cycles/pixel
    angle : float, degrees
        From an axis of the raster.
    aperture : float, pitches
        Side of the light-sensitive square, in units of the pixel pitch.

    Returns
    -------
    (...) array, 1
    """
    along = np.asarray(frequency) * math.cos(math.radians(angle)), np.asarray(frequency) * math.sin(math.radians(angle))
    return np.asarray(aperture_otf(along[0], aperture) * aperture_otf(along[1], aperture))


def width_of(mtf50: float, angle: float, aperture: float) -> float:
    """Return the rms width (pixels) of a Gaussian blur from the MTF50 (cycles/pixel) of Gaussian and pixel together; 0
    if the MTF50 of the pixel alone is lower.

    exp(-2 pi^2 sigma^2 f^2) P(f) = 1/2, solved for sigma.
    """
    if not math.isfinite(mtf50) or mtf50 <= 0:
        return 0.0
    own = float(pixel_otf(mtf50, angle, aperture))
    return math.sqrt(math.log(2 * own) / 2) / (math.pi * mtf50) if own > 0.5 else 0.0


def edge_blur(
    edge: EdgePhotograph, frames: FrameSet, models: list[SensorModel], places: dict[str, Site], confidence: float = 0.95
) -> EdgeBlur:
    """Measure the blur of a lens from a raw frame of a slanted edge, taken with the calibrated sensor.

    Raises
    ------
    RequestError
        There is no edge, it is clipped, or it is sharper than the pixel.
    """
    path, window, pitch, aperture = edge.path, edge.window, edge.pitch, edge.aperture
    codes = frame_of(path) / frames.step
    if window is not None:
        rows, columns = codes.shape
        if window.x + window.width > columns or window.y + window.height > rows:
            raise RequestError(f"--edge-window: outside the {columns} x {rows} pixels of {path}")
        # cut whole periods of the mosaic, so that its sites keep their colours
        window = Window(window.x - window.x % 2, window.y - window.y % 2, window.width, window.height)
        codes = codes[window.y : window.y + window.height, window.x : window.x + window.width]
    image, sites = np.zeros(codes.shape), np.zeros(codes.shape, bool)
    used = [one for one in models if one.channel[0] in "WG"] or models[:1]
    for model in used:
        row, column, step = places[model.channel]
        fit, own = model.response, (slice(row, None, step), slice(column, None, step))
        charge = (codes[own] - model.values["black_level"].value) / fit.gain
        image[own] = response.unbent(charge, max(fit.bend, 0.0), fit.order, fit.full / fit.gain)
        sites[own] = True
    top = 2 ** models[0].bits - 1
    if float((codes[sites] >= top).mean()) > CLIPPED:
        raise RequestError(f"--edge {path}: the bright side is at the top code {top}; take it with less light")
    try:
        found = edge_resolution(image, order=BEND, sites=None if sites.all() else sites, confidence=confidence)
    except ValueError as error:
        raise RequestError(f"--edge {path}: {' '.join(str(error).split())[:200]}; --edge-window selects it") from None
    if found.doubts:
        raise RequestError(f"--edge {path}: this is not one straight edge: {found.doubts[0]}; --edge-window selects it")
    low, high = found.mtf50_low * (1 - METHOD), found.mtf50_high * (1 + METHOD)
    ends = [width_of(one, found.angle, aperture) * pitch for one in (found.mtf50, high, low)]
    if ends[2] == 0:
        raise RequestError(
            f"--edge {path}: MTF50 {found.mtf50:.3g} cycles/pixel is above the MTF50 of a pixel of aperture "
            f"{aperture:g}: "
            f"the picture was sharpened, or the light-sensitive square is smaller"
        )
    frequency = found.response.frequency
    blurred = np.exp(-2 * (math.pi * ends[0] / pitch * frequency) ** 2) * pixel_otf(frequency, found.angle, aperture)
    below = frequency <= 0.5
    return EdgeBlur(
        Estimate(ends[0], ends[1], ends[2], "um"), Estimate(found.mtf50, low, high, "cycles/pixel"), found.angle,
        float(np.abs(found.response.sfr - blurred)[below].max()), path.name, sha256(path),
    )  # fmt: skip
