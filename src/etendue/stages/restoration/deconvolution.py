"""The inverse problem: deconvolution with the pipeline's own transfer function, and the figures of a restoration.

In:  ``rgb_camera`` (channel, y, x), linear, 1 at clipping; the transfer functions of all stages in front.
Out: ``rgb_camera``; of the stages ``restore_*`` also ``mtf50_gain`` and ``noise_gain``.

``restore_laplacian``, ``restore_unsharp``, ``restore_wiener`` and ``restore_richardson_lucy`` give the picture of ``sharpen``,
``unsharp``, ``wiener`` and ``richardson_lucy``, bit for bit, and say what it gains and costs. Either family can be swapped
among itself (``sharpen.use``); see decision 0023.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from etendue.api import hookimpl, param, quantity
from etendue.physics.light import sampling
from etendue.physics.resolution import restoration_gain
from etendue.physics.restoration import deconvolution, sharpening
from etendue.spec.stage import is_transfer, reads_of, writes_of
from etendue.stages.electronics.known_noise import KnownNoise
from etendue.stages.restoration.sharpening import Laplacian, UnsharpMask

BLOCK = 4_000_000  # values of transfer functions held at once
LOOKS = {"rgb_camera": "channel y x [1]", "transfers": "*.transfer [1]"}
PICTURE = {"rgb_camera": "channel y x [1]"}
FIGURES = {**PICTURE, "mtf50_gain": "[1] nan", "noise_gain": "[1] nan"}
NO_FIGURES = "; mtf50_gain and noise_gain are NaN"


@dataclass(frozen=True)
class System:
    """The camera in front of a picture: each channel's photon-weighted mean over wavelength, at frequencies of its pixels.

    The baseband: the transfer function at the frequency itself. What folds onto it from beyond is noise to a restoration.
    """

    otf: Any  # None: nothing blurs
    channels: int
    pitch: float
    nodes: int = 0

    @property
    def whole(self) -> bool:
        """Whether this is all of the blur: no stage in front moves light without being a transfer function."""
        return self.otf is None or bool(self.otf.whole)

    @classmethod
    def of(cls, transfers: Any, channels: int, pitch: float, nodes: int = 0) -> System:
        return cls(transfers[-1][1] if transfers else None, channels, pitch, nodes)

    def shares(self) -> Any:
        """(channel, wavelength), each row with the sum 1: under light that is equally strong in all bands."""
        weights = self.otf.weights
        if weights is None:
            return None
        if len(weights) != self.channels:
            raise ValueError(
                f"the pixel stage has {len(weights)} channels and rgb_camera {self.channels}: a restoration with the camera's own "
                "transfer function needs planes of the pixel's channels; put it in front of what mixes them"
            )
        total = weights.sum(axis=1, keepdims=True)
        return np.where(total > 0, weights, 1.0) / np.where(total > 0, total, weights.shape[1])

    def plane(self, fy: Any, fx: Any) -> Any:
        """(channel or 1, m, n) at frequencies fy (m,), fx (n,) in cycles/pixel: exactly, or from a table up to 1."""
        if self.otf is None:
            return np.ones((1, fy.size, fx.size))
        if not self.nodes:
            return self._exact(fy, fx)
        nodes = np.arange(-self.nodes, self.nodes + 1) / self.nodes
        rows = CubicSpline(nodes, self._exact(nodes, nodes), axis=1)(fy)
        return CubicSpline(nodes, rows, axis=2)(fx)

    def _exact(self, fy: Any, fx: Any) -> Any:
        shares = self.shares()
        fy, fx = fy / self.pitch, fx / self.pitch
        height = max(1, BLOCK // max(1, fx.size * (1 if shares is None else shares.shape[1])))
        parts = []
        for first in range(0, fy.size, height):
            values = self.otf.plane(fy[first : first + height], fx)
            parts.append(values.mean(axis=0)[None] if shares is None else np.tensordot(shares, values, 1))
        return np.concatenate(parts, axis=1)

    def along(self, fx: Any) -> Any:
        """(n,) along x, of the second channel: green, or the only one of a monochrome sensor."""
        return one_channel(replace(self, nodes=0).plane(np.zeros(1), np.asarray(fx, dtype=float)))[0]


def one_channel(values: Any) -> Any:
    """The second of some channels: green, or the only one."""
    return values[min(1, len(values) - 1)]


def figures(system: System, response: Callable[[Any], Any], noise_gain: float) -> dict[str, Any]:
    """``mtf50_gain`` and ``noise_gain`` of a filter with this response (n,) along x; no gain in MTF50 of a blur half known."""
    gain = restoration_gain.mtf50_gain(system.along, response) if system.whole else math.nan
    return {"mtf50_gain": np.array(gain), "noise_gain": np.array(noise_gain)}


def unknown_blur(kinds: Any, so: str) -> list[str]:
    """The warning of a stage that knows the camera by its transfer functions, where light is moved by something else."""
    moving = {name: kind for name, kind in kinds.items() if not (kind.pointwise or is_transfer(kind))}
    light = [{d.variable for d in reads_of(kind).values()} & {d.variable for d in writes_of(kind).values()} for kind in moving.values()]
    found = [name for name, both in zip(moving, light, strict=True) if "irradiance" in both]
    return [f"what {' and '.join(found)} does to light is no transfer function, and unknown here: {so}"] if found else []


def baseband(frequency: Any) -> Any:
    """What a frequency is to a filter that works on pixels, cycles/pixel: 0 to 1/2."""
    return np.abs(frequency - np.rint(frequency))


def half_plane_gain(gain: Any, columns: int) -> float:
    """Noise gain from the half spectrum (m, n // 2 + 1) of a padded plane with so many columns."""
    twice = np.full(gain.shape, 2.0)
    twice[:, 0] = 1.0
    if columns % 2 == 0:
        twice[:, -1] = 1.0
    return restoration_gain.response_noise_gain(gain, twice)


@dataclass(frozen=True, kw_only=True)
class Inverse(KnownNoise):
    """A restoration by the camera's own transfer function and noise."""

    role: ClassVar = "sharpening"
    without_figures: ClassVar = ""

    nodes: int = param(
        0, at_least=0, at_most=4096, fidelity=True, reference="0: at every frequency of the picture",
        doc="frequencies per cycle/pixel at which the transfer function is evaluated, cubic between them: 128 for frames above 1 Mpixel",
    )  # fmt: skip

    def __post_init__(self) -> None:
        if 0 < self.nodes < 16:
            raise ValueError(f"nodes is {self.nodes}; allowed are 0 (every frequency) and numbers from 16")

    def table_error(self) -> float:
        """Of the picture, by the table: worst where the lens' cut-off lies inside, f/22 at 2 um; 1e-5 at f/4 and 4 um."""
        return 1.5e-3 * max((128 / self.nodes) ** 3, 128 / self.nodes) if self.nodes else 0.0

    def system(self, transfers: Any, picture: Any) -> System:
        return System.of(transfers, len(picture), self.pixel_pitch, self.nodes)

    def warn_among(self, kinds: Any) -> list[str]:
        return unknown_blur(kinds, "only the blur of other stages is undone" + self.without_figures)


@dataclass(frozen=True, kw_only=True)
class Wiener(Inverse):
    """Wiener deconvolution by the pipeline's own transfer function: the least mean-square error a linear filter can have.

    What the filter takes for a picture is a power law over frequency with a known contrast; noise is the camera's at the
    white level, and what folds onto a frequency from beyond the pixel's Nyquist frequency. Each channel has its own
    transfer function. The mean is kept. At the Nyquist frequency half of what is seen is folded: there the filter gives back
    at most half of the contrast, so that its MTF50 does not pass the Nyquist frequency.
    """

    reads: ClassVar = LOOKS
    writes: ClassVar = PICTURE
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 400.0

    noise_variance: float = param(0.0, at_least=0, doc="of the noise, 1 = the square of clipping; 0: the camera's own at clipping")
    contrast: float = param(0.2, above=0, at_most=10, doc="rms contrast of the picture, 1 = clipping")
    exponent: float = param(2.0, at_least=0, at_most=8, doc="power of the picture falls as 1/f^exponent; 0: noise over signal is constant")
    aliasing: str = param("noise", choices=("noise", "ignored"), doc="what folds back from beyond the Nyquist frequency")
    largest_gain: float = param(10.0, at_least=1, at_most=1e6, doc="of any frequency")

    def response(self, system: System, fy: Any, fx: Any) -> Any:
        """(channel or 1, m, n) at frequencies fy (m,), fx (n,) up to 1/2 cycle/pixel."""
        rows, columns = (fy, _beside(fy)), (fx, _beside(fx))  # the frequencies themselves, and what folds onto them
        if self.aliasing == "ignored":
            transfer = [system.plane(fy, fx)]
        else:
            whole = system.plane(np.concatenate(rows), np.concatenate(columns))
            transfer = [half for part in np.split(whole, 2, axis=1) for half in np.split(part, 2, axis=2)]
        power = [deconvolution.signal_spectrum(y[:, None], x, self.exponent) for y in rows for x in columns]
        ratio = (self.noise_variance or sum(self.noise_model())) / self.contrast**2 / power[0]
        for folded, strength in zip(transfer[1:], power[1:], strict=False):
            ratio = ratio + np.abs(folded) ** 2 * (strength / power[0])
        still = (fy[:, None] == 0) & (fx == 0)  # the mean is known: it is kept
        gain = deconvolution.wiener_gain(transfer[0], np.where(still, 0.0, ratio))
        return deconvolution.limited(gain, self.largest_gain)

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        return {"rgb_camera": self.restored(rgb_camera, self.system(transfers, rgb_camera))[0]}

    def restored(self, picture: Any, system: System) -> tuple[Any, Any]:
        """The picture, and the gain (channel or 1, Ny, Nx // 2 + 1) it was multiplied with."""
        gain = self.response(system, *deconvolution.frequencies(*picture.shape[-2:]))
        return deconvolution.apply(picture, gain), gain

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (5e-7 if precision == "float32" else 1e-15) * self.largest_gain + self.table_error(), "measured"


@dataclass(frozen=True, kw_only=True)
class RichardsonLucy(Inverse):
    """Richardson-Lucy deconvolution by the pipeline's own transfer function: iterative, positive, keeps the sum.

    Ends where the blurred estimate differs from the picture by no more than the camera's noise, times ``stop``, or after
    ``iterations``; the default of ``stop`` is below 1 since demosaicing evens out some of the noise. Values below 0 are
    kept, on a pedestal. Starting from the picture, it is never less sharp than that. Each channel has its own transfer
    function and number of iterations.
    """

    reads: ClassVar = LOOKS
    writes: ClassVar = PICTURE
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1000.0

    iterations: int = param(10, at_least=1, at_most=1000, doc="at most so many")
    stop: float = param(0.7, at_least=0, at_most=100, doc="times the known noise: ends where no more remains; 0: never")
    start: str = param(
        "data", choices=("data", "mean"), doc="first estimate: the picture itself, or an even plane, which also evens out noise"
    )
    total_variation: float = param(0.0, at_least=0, at_most=0.2, doc="favours flat parts between edges; 0.002 is weak, 0.01 strong")

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        return {"rgb_camera": self.restored(rgb_camera, self.system(transfers, rgb_camera))[0]}

    def restored(self, picture: Any, system: System) -> tuple[Any, Any, Any]:
        """The picture, the transfer function (channel or 1, Ny, Nx // 2 + 1) it was freed of, and the iterations by channel."""
        transfer = system.plane(*deconvolution.frequencies(*picture.shape[-2:]))
        shot, floor = self.noise_model()
        means = np.maximum(picture.mean(axis=(1, 2), dtype=np.float64), 0) if picture.size else np.zeros(len(picture))
        estimate, done = deconvolution.richardson_lucy(
            picture,
            transfer,
            self.iterations,
            self.total_variation,
            self.stop * np.sqrt(shot * means + floor),
            math.sqrt(floor),
            self.start,
        )
        return estimate, transfer, done

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Rounding grows with each iteration; where the end falls between two of them hangs on all of the picture."""
        return (1e-6 if precision == "float32" else 3e-15) * (10 + self.iterations) + self.table_error(), "measured"


@dataclass(frozen=True, kw_only=True)
class RestoreWiener(Wiener):
    """``wiener``, with its figures: gain in MTF50 along x of the second channel (green), and factor on white noise there.

    Both are NaN where a stage in front blurs without a transfer function: the filter is not that of the camera then.
    """

    writes: ClassVar = FIGURES
    without_figures: ClassVar = NO_FIGURES

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        system = self.system(transfers, rgb_camera)
        picture, gain = self.restored(rgb_camera, system)
        exact, middle = replace(system, nodes=0), np.zeros(1)

        def response(frequency: Any) -> Any:
            return one_channel(self.response(exact, middle, baseband(frequency)))[0]

        noise_gain = half_plane_gain(one_channel(gain), padded_columns(rgb_camera)) if system.whole else math.nan
        return {"rgb_camera": picture, **figures(system, response, noise_gain)}


@dataclass(frozen=True, kw_only=True)
class RestoreRichardsonLucy(RichardsonLucy):
    """``richardson_lucy``, with its figures, those of small contrasts on an even ground after the iterations done.

    There it is a linear filter of known response. Total variation lowers the price in noise, which is not counted.
    Both are NaN where a stage in front blurs without a transfer function.
    """

    writes: ClassVar = FIGURES
    without_figures: ClassVar = NO_FIGURES

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        system = self.system(transfers, rgb_camera)
        picture, transfer, done = self.restored(rgb_camera, system)
        iterations = float(one_channel(done))

        def response(frequency: Any) -> Any:
            return deconvolution.richardson_lucy_response(system.along(baseband(frequency)), iterations, self.start)

        gain = deconvolution.richardson_lucy_response(one_channel(transfer), iterations, self.start)
        noise_gain = half_plane_gain(gain, padded_columns(rgb_camera)) if system.whole else math.nan
        return {"rgb_camera": picture, **figures(system, response, noise_gain)}


@dataclass(frozen=True, kw_only=True)
class RestoreLaplacian(Laplacian):
    """``sharpen``, with its figures: gain in MTF50 along x of the second channel (green), and factor on white noise."""

    reads: ClassVar = LOOKS
    writes: ClassVar = FIGURES
    nanoseconds: ClassVar = 100.0

    pixel_pitch: float = quantity("pixel_pitch")

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        def response(frequency: Any) -> Any:
            return sharpening.sharpen_response(0.0, frequency, self.strength)

        system = System.of(transfers, len(rgb_camera), self.pixel_pitch)
        found = figures(system, response, sharpening.noise_gain(self.strength))
        return {"rgb_camera": sharpening.sharpen(rgb_camera, self.strength), **found}

    def warn_among(self, kinds: Any) -> list[str]:
        return unknown_blur(kinds, "mtf50_gain is NaN")


@dataclass(frozen=True, kw_only=True)
class RestoreUnsharp(UnsharpMask):
    """``unsharp``, with its figures: those of what stands above the threshold."""

    reads: ClassVar = LOOKS
    writes: ClassVar = FIGURES
    nanoseconds: ClassVar = 150.0

    pixel_pitch: float = quantity("pixel_pitch")

    def run(self, rgb_camera: Any, transfers: Any) -> dict[str, Any]:
        def response(frequency: Any) -> Any:
            return sharpening.unsharp_response(0.0, frequency, self.radius, self.amount)

        system = System.of(transfers, len(rgb_camera), self.pixel_pitch)
        found = figures(system, response, sharpening.unsharp_noise_gain(self.radius, self.amount))
        return {"rgb_camera": sharpening.unsharp(rgb_camera, self.radius, self.amount, self.threshold), **found}

    def warn_among(self, kinds: Any) -> list[str]:
        return unknown_blur(kinds, "mtf50_gain is NaN")


def _beside(frequency: Any) -> Any:
    """The nearest frequency beyond the Nyquist frequency that folds onto each, cycles/pixel."""
    return frequency - np.where(frequency >= 0, 1.0, -1.0)


def padded_columns(picture: Any) -> int:
    return sampling.padded_size(picture.shape[-1])


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {
        "wiener": Wiener, "richardson_lucy": RichardsonLucy, "restore_laplacian": RestoreLaplacian, "restore_unsharp": RestoreUnsharp,
        "restore_wiener": RestoreWiener, "restore_richardson_lucy": RestoreRichardsonLucy,
    }  # fmt: skip
