"""Frames merged: what a burst or a bracket of exposures knows together.

In:  ``rgb_camera`` of every frame, its ``integration_time``, ``white`` and ``clipping_level``.
Out: the same of one picture, and the variance that is left.
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
    """Frames of one scene to one picture, at the scale and the time of the shortest.

    ``mean`` takes all light over all time, for bursts of one exposure; ``sigma_clipped`` leaves out what lies too far
    from the median of the frames (something that moved, a cosmic ray); ``hdr`` weights every frame by its known noise
    and leaves out what is cut off there. ``clipping_level`` stays that of the shortest frame, the last to saturate.
    ``merged_variance`` is that of a mosaic's value with this weighting, from shot noise and the noise of read-out; a
    demosaicer that averages neighbours leaves less.
    """

    role: ClassVar = "merging"
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
    gain: ClassVar = None  # a frame that is left out may be the one with the error
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 40.0
    working: ClassVar = 3.5
    error: ClassVar = measured(2e-6, 1e-14)

    method: str = param("hdr", choices=("mean", "sigma_clipped", "hdr"), doc="which frames count how much")
    sigmas: float = param(3.0, above=0, at_most=100, doc="of 'sigma_clipped': distance from the median, in known noise")
    around: int = param(
        2, at_least=0, at_most=64, doc="of 'hdr': pixels around cut-off ones that are left out with them"
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
                f"the times of the frames are {', '.join(f'{t:g}' for t in integration_time)} s; allowed are times "
                f"above 0"
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
