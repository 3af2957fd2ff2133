"""What a camera without noise, converter and mosaic would give: the reference that alternatives are compared with.

In:  ``photon_rate`` (channel, y, x) or ``photocurrent`` (y, x), electron/s, of the same pixel stage.
Out: ``rgb_camera`` (channel, y, x) or ``mosaic_linear`` (y, x), 1 where pixels saturate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Facts, Grid, proved, quantity
from etendue.physics.sensor.crosstalk_planes import diffuse_planes
from etendue.stages.electronics.gain_chain import GainChain
from etendue.stages.sensor.crosstalk import Crosstalk, channel_kernels
from etendue.stages.sensor.masks import mask_of


@dataclass(frozen=True, kw_only=True)
class _Ideal(GainChain):
    """Electrons per second to the scale of ``mosaic_linear``."""

    role: ClassVar = "reference"
    negative: ClassVar = "clip"  # the undershoot of band-limited light, as in front of the Poisson draw
    error: ClassVar = proved(2e-7, 4e-16)

    integration_time: float = quantity("integration_time")

    def scale(self) -> float:
        """Of photoelectrons per second: the time, the gain of the converter, over black to white."""
        return self.integration_time * self.dn_per_electron() / self.white()


@dataclass(frozen=True, kw_only=True)
class FullPlanes(_Ideal):
    """Every channel at every pixel, noise-free and unclipped: what ``mosaic_linear`` would be without noise, converter and mosaic.

    Takes the place of a demosaicer. Without dark charge and the fixed patterns of the sensor (PRNU, DSNU).
    """

    reads: ClassVar = {"photon_rate": "channel y x [electron/s]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    gain: ClassVar = 1.0
    nanoseconds: ClassVar = 3.0

    crosstalk: str = quantity("crosstalk")

    def run(self, photon_rate: Any) -> dict[str, Any]:
        return {"rgb_camera": photon_rate * photon_rate.dtype.type(self.scale())}

    def warn_among(self, uses: frozenset[str]) -> list[str]:
        if self.crosstalk != "through_filter" or "crosstalk" not in uses or "crosstalk_planes" in uses:
            return []
        return ["charge diffuses behind the filters, but not in these planes: put crosstalk_planes before them"]


@dataclass(frozen=True, kw_only=True)
class IdealMosaic(_Ideal):
    """Expected values in place of exposure, noise and converter: the mosaic without noise and rounding, clipped where pixels saturate."""

    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    gain: ClassVar = None  # where the light exceeds the well, what is not clipped gains in share of full scale
    nanoseconds: ClassVar = 2.0

    def run(self, photocurrent: Any) -> dict[str, Any]:
        kind = photocurrent.dtype.type
        return {"mosaic_linear": np.minimum(photocurrent * kind(self.scale()), kind(1)), "clipping_level": np.array(1.0)}


@dataclass(frozen=True, kw_only=True)
class CrosstalkPlanes(Crosstalk):
    """Crosstalk behind the filters for full planes: at every pixel what each channel would collect beside the mask's neighbours.

    Goes with ``full_planes`` where ``crosstalk`` goes with a mosaic (``crosstalk = "through_filter"``).
    """

    role: ClassVar = "crosstalk"
    reads: ClassVar = {"photon_rate": "channel y x [electron/s]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"photon_rate": "channel y x [electron/s]"}

    def run(self, photon_rate: Any, white_irradiance: Any, prepared: Any) -> dict[str, Any]:  # type: ignore[override]
        if self.crosstalk == "per_plane":
            return {"photon_rate": photon_rate}
        kernel = channel_kernels(prepared[0] * white_irradiance, prepared[1], self.beyond)
        return {"photon_rate": diffuse_planes(photon_rate, kernel, mask_of(self.pattern))}

    def grid(self, inputs: Any) -> dict[str, Grid]:
        found, channels = tuple(inputs["photon_rate"]["channel"].values()), mask_of(self.pattern).channels
        if found != channels:
            raise ValueError(
                f"the pattern {self.pattern!r} has channels {', '.join(channels)}, but photon_rate {', '.join(map(str, found))}"
            )
        return {}

    def carry(self, facts: Any, grid: Any) -> Facts:
        return facts["photon_rate"] if self.crosstalk == "per_plane" else Facts()
