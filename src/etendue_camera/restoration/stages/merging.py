"""Merge frames of a burst or an exposure bracket into one.

In:  ``rgb_camera`` of every frame, its ``integration_time``, ``white`` and ``clipping_level``.
Out: the same for one picture, and its remaining variance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import measured, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.restoration import merging


@dataclass(frozen=True, kw_only=True)
class MergeFrames(KnownNoise):
    """Merge frames of one scene into one picture, at the scale and time of the shortest exposure.

    ``mean`` divides all light by all time, for bursts of equal exposures; ``sigma_clipped`` rejects values too far from
    the median of the frames (motion, cosmic rays); ``hdr`` weights every frame by its known noise and rejects clipped
    values. ``clipping_level`` is the level of the shortest frame, which saturates last. ``merged_variance`` is the
    variance of a mosaic value with this weighting, from shot noise and read-out noise; a demosaicer that averages
    neighbours reduces it further.
    """

    role: ClassVar = "merging"
    decides: ClassVar = True  # a small change decides whether a value counts as clipped or far from the median
    reads: ClassVar = {
        "rgb_camera": "frame channel y x [1]",
        "integration_time": "frame [s]",
        "white": "frame channel [1]",
        "clipping_level": "frame [1]",
        "balance_gains": "frame channel [1]",
    }
    writes: ClassVar = {
        "rgb_camera": "channel y x [1]",
        "integration_time": "[s]",
        "white": "channel [1]",
        "clipping_level": "[1]",
        "merged_variance": "channel y x [1]",
    }
    gain: ClassVar = None  # a rejected frame may be the one with the error
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 40.0
    working: ClassVar = 3.5
    error: ClassVar = measured(4e-6, 1e-14)

    method: str = param("hdr", choices=("mean", "sigma_clipped", "hdr"), doc="method of weighting or rejecting frames")
    sigmas: float = param(
        3.0,
        above=0,
        at_most=100,
        doc="for 'sigma_clipped': rejection distance from the median, in sigmas of the known noise",
    )
    around: int = param(
        2, at_least=0, at_most=64, doc="for 'hdr': width of the border around clipped pixels that is also rejected"
    )

    def run(
        self,
        rgb_camera: FloatArray,
        integration_time: FloatArray,
        white: FloatArray,
        clipping_level: FloatArray,
        balance_gains: FloatArray | None = None,
    ) -> dict[str, Array]:
        if not np.all(integration_time > 0):
            raise ValueError(
                f"the frame times are {', '.join(f'{t:g}' for t in integration_time)} s; all must be greater than 0"
            )
        shot, floor = self.noise_model()
        gains = np.ones(rgb_camera.shape[1]) if balance_gains is None else balance_gains[0]
        times = integration_time / np.min(integration_time)
        noise = (shot * gains, floor * gains**2)
        rate, variance = merging.merged(rgb_camera, times, clipping_level, noise, self.method, self.sigmas, self.around)
        shortest = int(np.argmin(integration_time))
        return {
            "rgb_camera": rate,
            "integration_time": np.array(integration_time[shortest]),
            "white": white[shortest].copy(),
            "clipping_level": np.array(clipping_level[shortest]),
            "merged_variance": variance,
        }
