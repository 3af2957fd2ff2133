"""scikit-image: non-local means, and Richardson-Lucy with the camera's own point spread function.

In:  ``rgb_camera`` (channel, y, x), linear, 1 at clipping; for the deconvolution, the preceding transfer functions.
Out: ``rgb_camera``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import skimage.restoration

from etendue.api import Stage, measured, param

PICTURE = {"rgb_camera": "channel y x [1]"}


@dataclass(frozen=True, kw_only=True)
class NonLocalMeans(Stage):
    """Denoise with scikit-image's non-local means (Buades, Coll and Morel 2005): means of similar patches, all channels
    together.
    """

    role: ClassVar = "denoising"
    reads: ClassVar = PICTURE
    writes: ClassVar = PICTURE
    libraries: ClassVar = ("scikit-image",)
    negative: ClassVar = "keep"
    gain: ClassVar = None
    error: ClassVar = measured(1e-7, 1e-14)  # arithmetic error, in double precision throughout
    nanoseconds: ClassVar = 3000.0

    sigma: float = param(0.02, at_least=0, at_most=1, doc="standard deviation of the noise, 1 at clipping")
    smoothing: float = param(0.8, above=0, at_most=10, doc="cut-off of patch differences, in sigmas of the noise")
    patch: int = param(5, at_least=1, at_most=31, doc="side of a patch, pixels")
    reach: int = param(6, at_least=1, at_most=31, doc="distance to the farthest patch, pixels")

    def run(self, rgb_camera: Any) -> dict[str, Any]:
        found = skimage.restoration.denoise_nl_means(
            np.asarray(rgb_camera, np.float64),
            self.patch,
            self.reach,
            h=max(self.smoothing * self.sigma, 1e-6),
            sigma=self.sigma,
            fast_mode=False,
            channel_axis=0,
        )
        return {
            "rgb_camera": found.reshape(rgb_camera.shape).astype(rgb_camera.dtype)
        }  # a side of one is dropped by scikit-image


@dataclass(frozen=True, kw_only=True)
class RichardsonLucy(Stage):
    """Deconvolve with scikit-image's Richardson-Lucy. The point spread function of each channel comes from the
    preceding pixel stage.
    """

    role: ClassVar = "sharpening"
    reads: ClassVar = {**PICTURE, "transfers": "*.transfer [1]"}
    writes: ClassVar = PICTURE
    libraries: ClassVar = ("scikit-image",)
    negative: ClassVar = "clip"  # it divides by its input: negative values have no meaning
    gain: ClassVar = None
    error: ClassVar = measured(1e-7, 1e-12)
    nanoseconds: ClassVar = 2000.0

    iterations: int = param(10, at_least=1, at_most=1000, doc="number of iterations")
    support: int = param(15, at_least=3, at_most=63, doc="side of the point spread function, pixels; odd")

    def __post_init__(self) -> None:
        if self.support % 2 == 0:
            raise ValueError(f"support is {self.support}; it must be odd, to have a centre")

    def run(self, rgb_camera: Any, transfers: Any, y_um: Any, x_um: Any) -> dict[str, Any]:
        otf = transfers[-1][1]
        pitch = [float(along[1] - along[0]) if along.size > 1 else 1.0 for along in (y_um, x_um)]
        fy, fx = np.fft.fftfreq(self.support, pitch[0]), np.fft.rfftfreq(self.support, pitch[1])
        planes = otf.plane(fy, fx)
        if otf.weights is not None:
            planes = np.einsum("cw,wyx->cyx", otf.weights / otf.weights.sum(axis=1)[:, None], planes)
        half = self.support // 2
        spread = np.roll(np.fft.irfft2(planes, (self.support, self.support)), (half, half), (1, 2))
        spread = np.maximum(spread, 0)
        spread /= spread.sum(axis=(1, 2), keepdims=True)
        found = np.empty_like(rgb_camera)
        for number, plane in enumerate(rgb_camera):
            wide = np.pad(np.asarray(plane, np.float64), half, mode="edge")
            own = spread[number if len(spread) == len(rgb_camera) else 0]
            restored = skimage.restoration.richardson_lucy(wide, own, self.iterations, clip=False, filter_epsilon=1e-12)
            found[number] = restored[half:-half, half:-half]
        return {"rgb_camera": found}
