"""Gain and cost of a restoration: the camera before it, and the metrics of its filter.

In:  the transfer functions of all preceding stages, a filter's response.
Out: ``mtf50_gain`` and ``noise_gain``, optional outputs of every sharpening and deconvolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from etendue.transfer import sampling
from etendue_camera.arrays import FloatArray
from etendue_camera.resolution import restoration_gain
from etendue_camera.roles import CROSSTALK, PROCESSING

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf
    from etendue_camera.arrays import Array

UNSEEN = {"mtf50_gain": (CROSSTALK, *PROCESSING)}
BLOCK = 4_000_000  # values of transfer functions in memory at once
LOOKS = {"rgb_camera": "channel y x [1]", "transfers": "*.transfer [1]"}
FIGURES = {"rgb_camera": "channel y x [1]", "mtf50_gain": "[1] nan optional", "noise_gain": "[1] nan optional"}


@dataclass(frozen=True)
class System:
    """The transfer function of all stages before a picture: each channel's photon-weighted mean over wavelength, by
    cycles/pixel.

    Only the baseband is included: the transfer function at the frequency itself. Content that aliases onto this
    frequency is noise for a restoration.
    """

    otf: Any  # None: no blur
    channels: int
    pitch: float
    nodes: int = 0

    @property
    def whole(self) -> bool:
        """Return whether the transfer function is complete: every preceding stage that moves light has one."""
        return self.otf is None or bool(self.otf.whole)

    @classmethod
    def of(cls, transfers: Sequence[tuple[str, Otf]], channels: int, pitch: float, nodes: int = 0) -> System:
        return cls(transfers[-1][1] if transfers else None, channels, pitch, nodes)

    def shares(self) -> FloatArray | None:
        """Return (channel, wavelength) weights, each row with sum 1, for light equally strong in all bands."""
        weights = self.otf.weights
        if weights is None:
            return None
        if len(weights) != self.channels:
            raise ValueError(
                f"the pixel stage has {len(weights)} channels and rgb_camera {self.channels}: a restoration with the "
                f"camera's own "
                "transfer function requires planes of the pixel's channels; put it before the stage that mixes them"
            )
        total = weights.sum(axis=1, keepdims=True)
        return np.where(total > 0, weights, 1.0) / np.where(total > 0, total, weights.shape[1])

    def plane(self, fy: FloatArray, fx: FloatArray) -> FloatArray:
        """Return the OTF (channel or 1, m, n) at frequencies fy (m,), fx (n,), cycles/pixel: exact, or from a table up
        to 1 cycle/pixel.
        """
        if self.otf is None:
            return np.ones((1, fy.size, fx.size))
        if not self.nodes:
            return self._exact(fy, fx)
        nodes = np.arange(-self.nodes, self.nodes + 1) / self.nodes
        rows = scipy.interpolate.CubicSpline(nodes, self._exact(nodes, nodes), axis=1)(fy)
        return scipy.interpolate.CubicSpline(nodes, rows, axis=2)(fx)

    def _exact(self, fy: FloatArray, fx: FloatArray) -> FloatArray:
        shares = self.shares()
        fy, fx = fy / self.pitch, fx / self.pitch
        height = max(1, BLOCK // max(1, fx.size * (1 if shares is None else shares.shape[1])))
        parts = []
        for first in range(0, fy.size, height):
            some = fy[first : first + height]
            if self.otf.behind:
                parts.append(self.otf.channels(some, fx))
                continue
            values = self.otf.plane(some, fx)
            parts.append(values.mean(axis=0)[None] if shares is None else np.tensordot(shares, values, 1))
        return np.concatenate(parts, axis=1)

    def along(self, fx: FloatArray) -> FloatArray:
        """Return the OTF (n,) along x of the second channel: green, or the only one of a monochrome sensor."""
        return one_channel(replace(self, nodes=0).plane(np.zeros(1), np.asarray(fx, dtype=float)))[0]


def one_channel(values: FloatArray) -> FloatArray:
    """Return the values of the second channel (green), or of the only channel."""
    return values[min(1, len(values) - 1)]


def figures(
    asked: frozenset[str], system: System, response: Callable[[Any], Any], noise_gain: Callable[[], float]
) -> dict[str, Array]:
    """Return ``mtf50_gain`` and ``noise_gain``, if wanted, for a filter with this response (n,) along
    x; NaN for a blur that is only partly known.
    """
    found: dict[str, Array] = {}
    if "mtf50_gain" in asked:
        found["mtf50_gain"] = np.array(
            restoration_gain.mtf50_gain(system.along, response) if system.whole else math.nan
        )
    if "noise_gain" in asked:
        found["noise_gain"] = np.array(noise_gain())
    return found


def baseband(frequency: FloatArray) -> FloatArray:
    """Return the frequency after aliasing at the pixels, 0 to 1/2 cycles/pixel."""
    return np.abs(frequency - np.rint(frequency))


def half_plane_gain(gain: FloatArray, columns: int) -> float:
    """Return the noise gain from the half spectrum (m, n // 2 + 1) of a padded plane with the given columns."""
    twice = np.full(gain.shape, 2.0)
    twice[:, 0] = 1.0
    if columns % 2 == 0:
        twice[:, -1] = 1.0
    return restoration_gain.response_noise_gain(gain, twice)


def padded_columns(picture: FloatArray) -> int:
    return sampling.padded_size(picture.shape[-1])
