"""Restoration from the picture alone: sharpening, before or after demosaicing, and denoising.

In:  ``rgb_camera`` (channel, y, x), linear, 1 at clipping; ``mosaic_linear`` (y, x) for the paper's other order.
Out: the same variable. Stages that use the camera's transfer function are in ``deconvolve``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from etendue.api import Bounded, Facts, Grid, Haloed, Stage, measured, param, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.restoration import denoise, sharpening
from etendue_camera.restoration.stages.figures import FIGURES, LOOKS, UNSEEN, System, figures
from etendue_camera.sensor.stages.masks import mask_of

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf


@dataclass(frozen=True, kw_only=True)
class Laplacian(Stage):
    """Sharpen with identity + strength x Laplacian (eq. 11)."""

    role: ClassVar = "sharpening"
    gain: ClassVar = 1.0 + 16 * 4.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0

    strength: float = param(0.15, at_least=0, at_most=4, doc="k in identity + k L; the paper's picture uses 1")

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 3e-15) * (1 + 16 * self.strength), "proved"

    def growth(self, facts: Mapping[str, Facts]) -> float:
        """Return the gain at the Nyquist frequency of both axes, (1/2, 1/2) cycles/pixel."""
        return 1.0 + 8.0 * self.strength

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "strength is 0") if self.strength == 0 else None


@dataclass(frozen=True, kw_only=True)
class Sharpen(Laplacian, Bounded, Haloed):
    """Sharpen with identity + strength x Laplacian (eq. 11), without clipping. ``mtf50_gain`` is along x of green,
    ``noise_gain`` refers to white noise.
    """

    reads: ClassVar = LOOKS
    writes: ClassVar = FIGURES
    unseen: ClassVar = UNSEEN

    pixel_pitch: float = quantity("pixel_pitch")

    def run(
        self, rgb_camera: FloatArray, transfers: Sequence[tuple[str, Otf]], asked: frozenset[str] = frozenset()
    ) -> dict[str, Array]:
        def response(frequency: FloatArray) -> FloatArray:
            return sharpening.sharpen_response(0.0, frequency, self.strength)

        system = System.of(transfers, len(rgb_camera), self.pixel_pitch)
        found = figures(asked, system, response, lambda: sharpening.noise_gain(self.strength))
        return {"rgb_camera": sharpening.sharpen(rgb_camera, self.strength), **found}

    def halo(self) -> int:
        return 1


@dataclass(frozen=True, kw_only=True)
class SharpenMosaic(Laplacian, Bounded, Haloed):
    """Sharpen the mosaic with a Laplacian before demosaicing, the order of the paper's section 2.8 (its other sections
    sharpen after demosaicing).

    ``planes = "own"`` uses neighbours of the same colour, a mask period apart, which keeps colours separate. The gain
    is then largest at a quarter of the sampling frequency. ``"mixed"`` is the printed kernel across colours: their
    differences become a pattern with the period of the mask, which no demosaicer removes.
    """

    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]"}

    pattern: str = quantity("pattern")
    planes: str = param(
        "own",
        choices=("own", "mixed"),
        doc="neighbours: of the same colour (own), or the nearest pixels as printed (mixed)",
    )

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def run(self, mosaic_linear: FloatArray) -> dict[str, Array]:
        return {"mosaic_linear": sharpening.sharpen_mosaic(mosaic_linear, self.strength, self.period())}

    def period(self) -> tuple[int, int]:
        """Return the rows and columns between neighbours, the same wherever a window starts."""
        return mask_of(self.pattern).period if self.planes == "own" else (1, 1)

    def halo(self) -> int:
        return self.period()[0]


@dataclass(frozen=True, kw_only=True)
class Unsharp(Bounded, Haloed):
    """Sharpen with an unsharp mask: add ``amount`` times the difference from a Gaussian blur, without clipping.
    ``mtf50_gain`` and ``noise_gain`` apply to differences above the threshold.
    """

    role: ClassVar = "sharpening"
    reads: ClassVar = LOOKS
    writes: ClassVar = FIGURES
    unseen: ClassVar = UNSEEN
    gain: ClassVar = 1.0 + 2 * 10.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 20.0

    pixel_pitch: float = quantity("pixel_pitch")
    radius: float = param(0.7, units="pixel", above=0, at_most=100, doc="standard deviation of the Gaussian")
    amount: float = param(0.8, at_least=0, at_most=10, doc="factor on the difference that is added; 0: none")
    threshold: float = param(
        0.0, at_least=0, at_most=1, doc="amount by which differences are first reduced towards 0 (1 = clipping)"
    )

    def run(
        self, rgb_camera: FloatArray, transfers: Sequence[tuple[str, Otf]], asked: frozenset[str] = frozenset()
    ) -> dict[str, Array]:
        def response(frequency: FloatArray) -> FloatArray:
            return sharpening.unsharp_response(0.0, frequency, self.radius, self.amount)

        system = System.of(transfers, len(rgb_camera), self.pixel_pitch)
        found = figures(asked, system, response, lambda: sharpening.unsharp_noise_gain(self.radius, self.amount))
        return {"rgb_camera": sharpening.unsharp(rgb_camera, self.radius, self.amount, self.threshold), **found}

    def halo(self) -> int:
        return sharpening.gaussian_taps(self.radius).size // 2

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        return (4e-7 if precision == "float32" else 2e-15) * (1 + 2 * self.amount), "measured"

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "amount is 0") if self.amount == 0 else None


@dataclass(frozen=True, kw_only=True)
class Denoise(KnownNoise, Bounded):
    """Denoise with an edge-preserving filter based on the camera's noise: areas that vary no more than the noise are
    replaced by their local mean.

    The noise level is taken from the mosaic. Demosaicing has already averaged out some of this noise, so the default
    strength of 1 denoises strongly. Channels are processed separately, and the mean of each is preserved.
    """

    role: ClassVar = "denoising"
    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 80.0
    working: ClassVar = 3.6
    # Arithmetic error. In single precision the rounding of the input appears as noise of 3e-8.
    error: ClassVar = measured(1e-6, 1e-13)

    strength: float = param(
        1.0, at_least=0, at_most=10, doc="factor on the known standard deviation of the noise; 0: no denoising"
    )
    radius: int = param(
        1, at_least=1, at_most=32, units="pixel", doc="window radius: 2 radius + 1 pixels along each axis"
    )

    def run(self, rgb_camera: FloatArray) -> dict[str, Array]:
        shot, floor = self.noise_model()
        return {"rgb_camera": denoise.denoise(rgb_camera, shot, floor, self.radius, self.strength)}

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "strength is 0") if self.strength == 0 else None
