"""Deconvolution with the pipeline's own transfer function.

In:  ``rgb_camera`` (channel, y, x), linear, 1 at clipping; the transfer functions of all preceding stages.
Out: ``rgb_camera``; on request, ``mtf50_gain`` and ``noise_gain``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from etendue.api import Facts, Grid, Stage, moves_light, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.restoration import deconvolution
from etendue_camera.restoration.stages.figures import (
    FIGURES,
    LOOKS,
    UNSEEN,
    System,
    baseband,
    figures,
    half_plane_gain,
    one_channel,
    padded_columns,
)

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf


@dataclass(frozen=True, kw_only=True)
class Inverse(KnownNoise):
    """A restoration that uses the camera's own transfer function and noise."""

    role: ClassVar = "sharpening"

    nodes: int = param(
        0,
        at_least=0,
        at_most=4096,
        fidelity=True,
        reference="0: at every frequency of the picture",
        settings=(16, 32, 64, 128, 0),
        doc="frequencies per cycle/pixel at which the transfer function is evaluated, with cubic interpolation: 128 "
        "for frames above 1 Mpixel",
    )

    def __post_init__(self) -> None:
        if 0 < self.nodes < 16:
            raise ValueError(f"nodes is {self.nodes}; it must be 0 (every frequency) or at least 16")

    def table_error(self) -> float:
        """Return the error that the table causes in the picture. The error is largest if the cut-off of the lens lies
        within the table, as for f/22 and 2 um pixels; for f/4 and 4 um it is 1e-5.
        """
        return 1.5e-3 * max((128 / self.nodes) ** 3, 128 / self.nodes) if self.nodes else 0.0

    def system(self, transfers: Sequence[tuple[str, Otf]], picture: FloatArray) -> System:
        return System.of(transfers, len(picture), self.pixel_pitch, self.nodes)

    def warn_among(self, others: Mapping[str, type[Stage]]) -> list[str]:
        found = " and ".join(use for use, kind in others.items() if moves_light(kind))
        so = "only the blur of other stages is inverted, and its metrics are NaN"
        return [f"{found} has no transfer function, so its effect is unknown here: {so}"] if found else []


@dataclass(frozen=True, kw_only=True)
class Wiener(Inverse):
    """Wiener deconvolution with the pipeline's own transfer function: the linear filter with minimum squared error.

    The filter models the picture as a power law over frequency with a known contrast. The noise is the camera's at the
    white level, plus the content that aliases from above the pixel's Nyquist frequency. Each channel has its own
    transfer function. The mean is preserved. ``mtf50_gain`` is measured along x in the second channel (green), and
    ``noise_gain`` is the factor on white noise in this channel; both are NaN if a preceding stage blurs without a
    transfer function. At the Nyquist frequency half of the signal is aliased, so the filter restores at most half of
    the contrast there, and its MTF50 does not exceed Nyquist.
    """

    reads: ClassVar = LOOKS
    writes: ClassVar = FIGURES
    unseen: ClassVar = UNSEEN
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 400.0
    working: ClassVar = 17.0

    noise_variance: float = param(
        0.0,
        at_least=0,
        apart=(0.0,),
        doc="noise variance, relative to the square of the clipping level; 0: the camera's own noise at clipping",
    )
    contrast: float = param(0.2, above=0, at_most=10, doc="rms contrast of the picture, 1 = clipping")
    exponent: float = param(
        2.0,
        at_least=0,
        at_most=8,
        doc="the power spectrum of the picture falls as 1/f^exponent; 0: constant noise-to-signal ratio",
    )
    aliasing: str = param(
        "noise", choices=("noise", "ignored"), doc="whether content aliased from above Nyquist counts as noise"
    )
    largest_gain: float = param(10.0, at_least=1, at_most=1e6, doc="largest gain at any frequency")

    def response(self, system: System, fy: FloatArray, fx: FloatArray) -> FloatArray:
        """Return the response (channel or 1, m, n) at frequencies fy (m,), fx (n,) up to 1/2 cycle/pixel."""
        rows, columns = (fy, _beside(fy)), (fx, _beside(fx))  # the frequencies, and those that alias onto them
        if self.aliasing == "ignored":
            transfer = [system.plane(fy, fx)]
        else:
            whole = system.plane(np.concatenate(rows), np.concatenate(columns))
            transfer = [half for part in np.split(whole, 2, axis=1) for half in np.split(part, 2, axis=2)]
        power = [deconvolution.signal_spectrum(y[:, None], x, self.exponent) for y in rows for x in columns]
        ratio = (self.noise_variance or sum(self.noise_model())) / self.contrast**2 / power[0]
        for folded, strength in zip(transfer[1:], power[1:], strict=False):
            ratio = ratio + np.abs(folded) ** 2 * (strength / power[0])
        still = (fy[:, None] == 0) & (fx == 0)  # the mean is known and preserved
        gain = deconvolution.wiener_gain(transfer[0], np.where(still, 0.0, ratio))
        return deconvolution.limited(gain, self.largest_gain)

    def run(
        self, rgb_camera: FloatArray, transfers: Sequence[tuple[str, Otf]], asked: frozenset[str] = frozenset()
    ) -> dict[str, Array]:
        system = self.system(transfers, rgb_camera)
        picture, gain = self.restored(rgb_camera, system)
        exact, middle = replace(system, nodes=0), np.zeros(1)

        def response(frequency: FloatArray) -> FloatArray:
            return one_channel(self.response(exact, middle, baseband(frequency)))[0]

        def noise_gain() -> float:
            return half_plane_gain(one_channel(gain), padded_columns(rgb_camera)) if system.whole else math.nan

        return {"rgb_camera": picture, **figures(asked, system, response, noise_gain)}

    def restored(self, picture: FloatArray, system: System) -> tuple[FloatArray, FloatArray]:
        """Return the picture and the gain applied to it, (channel or 1, Ny, Nx // 2 + 1)."""
        gain = self.response(system, *deconvolution.frequencies(*picture.shape[-2:]))
        return deconvolution.apply(picture, gain), gain

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        return (5e-7 if precision == "float32" else 1e-15) * self.largest_gain + self.table_error(), "measured"


@dataclass(frozen=True, kw_only=True)
class RichardsonLucy(Inverse):
    """Richardson-Lucy deconvolution with the pipeline's own transfer function: iterative, positive, preserves the sum.

    Iteration ends when the blurred estimate differs from the picture by no more than the camera's noise times ``stop``,
    or after ``iterations``; the default of ``stop`` is below 1 because demosaicing averages some of the noise. A
    pedestal preserves negative values. The iteration starts from the picture, so the result is never less sharp than
    the picture. Each channel has its own transfer function and number of iterations. The metrics apply to small
    contrasts on a uniform background, where the iterations are a linear filter of known response. They do not include
    the reduction of the noise gain by total variation.
    """

    reads: ClassVar = LOOKS
    writes: ClassVar = FIGURES
    unseen: ClassVar = UNSEEN
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1000.0
    working: ClassVar = 5.8

    iterations: int = param(10, at_least=1, at_most=1000, doc="largest number of iterations")
    stop: float = param(
        0.7, at_least=0, at_most=100, doc="multiple of the known noise at which the iteration stops; 0: no such limit"
    )
    start: str = param(
        "data",
        choices=("data", "mean"),
        doc="first estimate: the picture itself, or a uniform plane, which also smooths noise",
    )
    total_variation: float = param(
        0.0,
        at_least=0,
        at_most=0.2,
        doc="total-variation weight, which favours flat areas between edges; 0.002 is weak, 0.01 strong",
    )

    def run(
        self, rgb_camera: FloatArray, transfers: Sequence[tuple[str, Otf]], asked: frozenset[str] = frozenset()
    ) -> dict[str, Array]:
        system = self.system(transfers, rgb_camera)
        picture, transfer, done = self.restored(rgb_camera, system)
        iterations = float(one_channel(done))

        def response(frequency: FloatArray) -> FloatArray:
            return deconvolution.richardson_lucy_response(system.along(baseband(frequency)), iterations, self.start)

        def noise_gain() -> float:
            gain = deconvolution.richardson_lucy_response(one_channel(transfer), iterations, self.start)
            return half_plane_gain(gain, padded_columns(rgb_camera)) if system.whole else math.nan

        return {"rgb_camera": picture, **figures(asked, system, response, noise_gain)}

    def restored(self, picture: FloatArray, system: System) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the picture, the transfer function (channel or 1, Ny, Nx // 2 + 1) that was deconvolved, and the
        number of iterations by channel.
        """
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

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the rounding error. The error grows with each iteration, and faster if some pixels are far above
        clipping; it also shifts the stopping point. With total variation there is no useful bound: where a
        picture is nearly flat, rounding decides the direction of a gradient, so a picture in single precision may
        differ by its full scale.
        """
        if self.total_variation:
            return (1.0 if precision == "float32" else 1e-7) + self.table_error(), "measured"
        hot = min(max(facts["rgb_camera"].high or 1.0, 1.0), 1e4)  # measured up to 10,000 times clipping
        rounding = (1e-6 * max(1.0, hot / 300) if precision == "float32" else 3e-15 * hot) * (10 + self.iterations)
        return rounding + self.table_error(), "measured"


def _beside(frequency: FloatArray) -> FloatArray:
    """Return the nearest frequency above Nyquist that aliases onto each frequency, cycles/pixel."""
    return frequency - np.where(frequency >= 0, 1.0, -1.0)
