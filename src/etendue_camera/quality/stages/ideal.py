"""The camera without noise, ADC and mosaic: stages that studies substitute for others to get a reference picture.

In:  ``photon_rate`` (channel, y, x) or ``photocurrent`` (y, x), electron/s, of the same pixel stage.
Out: ``photocurrent``, ``mosaic_linear`` and ``rgb_camera`` of every channel at every pixel, or of the mosaic; 1 where
     pixels saturate.

Full planes are a mosaic run plane by plane: between ``no_mask`` and ``no_demosaicing`` every stage that works on a
mosaic receives one plane after the other, each as the mosaic of a sensor with one filter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Facts, Grid, Stage, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.gain_chain import GainChain
from etendue_camera.roles import CROSSTALK
from etendue_camera.sensor.crosstalk_planes import diffuse_planes
from etendue_camera.sensor.stages.crosstalk import Crosstalk, channel_kernels
from etendue_camera.sensor.stages.masks import mask_of

UNCLIPPED = 1e30  # a clipping level that no value reaches


class _HandedOn(Stage):
    """Pass all planes on unchanged, under another name."""

    working: ClassVar = 0.0
    role: ClassVar = "reference"
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0
    error: ClassVar = proved(0.0)


@dataclass(frozen=True, kw_only=True)
class NoMask(_HandedOn):
    """Record every channel at every pixel, as if every pixel had all filters. Takes the place of ``mosaic``."""

    reads: ClassVar = {"photon_rate": "channel y x [electron/s]"}
    writes: ClassVar = {"photocurrent": "channel y x [electron/s]"}

    crosstalk: str = quantity("crosstalk")

    def run(self, photon_rate: FloatArray) -> dict[str, Array]:
        return {"photocurrent": photon_rate.copy()}

    def warn_among(self, others: Mapping[str, type[Stage]]) -> list[str]:
        if self.crosstalk != "through_filter":
            return []
        mixing = [kind for kind in others.values() if kind.role == CROSSTALK]
        if not mixing or any("photon_rate" in kind.writes for kind in mixing):
            return []
        return [
            "charge diffuses across filters, but not in these planes: put the stage crosstalk_planes before this one"
        ]


@dataclass(frozen=True, kw_only=True)
class IdealMosaic(GainChain):
    """Use expected values in place of exposure, noise and ADC: the mosaic without noise and rounding, clipped where
    pixels saturate.

    Dark charge and the fixed patterns of the sensor (PRNU, DSNU) are not included.
    """

    role: ClassVar = "reference"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = None  # above 1 where light exceeds the full well, as for FullWell
    negative: ClassVar = "clip"  # undershoot of band-limited light, as before the Poisson draw
    nanoseconds: ClassVar = 2.0
    error: ClassVar = proved(2e-7, 4e-16)

    integration_time: float = quantity("integration_time")
    clip: bool = param(True, doc="whether pixels clip at saturation; false: no clipping, for reference pictures")

    def run(self, photocurrent: FloatArray) -> dict[str, Array]:
        kind = photocurrent.dtype.type
        # photoelectrons per second: times exposure time and conversion gain, over the range from black to white
        found = photocurrent * kind(self.integration_time * self.dn_per_electron() / self.white())
        if not self.clip:
            return {"mosaic_linear": found, "clipping_level": np.array(UNCLIPPED)}
        return {"mosaic_linear": np.minimum(found, kind(1)), "clipping_level": np.array(1.0)}


class NoDemosaicing(_HandedOn):
    """Pass full planes on as camera channels, without interpolation. This stage takes the place of a demosaicer after
    ``no_mask``.
    """

    reads: ClassVar = {"mosaic_linear": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}

    def run(self, mosaic_linear: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": mosaic_linear.copy()}


@dataclass(frozen=True, kw_only=True)
class CrosstalkPlanes(Crosstalk):
    """Apply crosstalk below the filters to full planes: each pixel of each channel exchanges charge with the neighbours
    that it would have in the mask.

    Put it before ``no_mask`` where ``crosstalk`` follows a mosaic (``crosstalk = "through_filter"``).
    """

    role: ClassVar = "crosstalk"
    reads: ClassVar = {"photon_rate": "channel y x [electron/s]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"photon_rate": "channel y x [electron/s]"}

    def run(self, photon_rate: FloatArray, white_irradiance: FloatArray, prepared: Any) -> dict[str, Array]:  # type: ignore[override]
        if self.crosstalk == "per_plane":
            return {"photon_rate": photon_rate}
        kernel = channel_kernels(prepared[0] * white_irradiance, prepared[1], self.beyond)
        return {"photon_rate": diffuse_planes(photon_rate, kernel, mask_of(self.pattern))}

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        found, channels = tuple(inputs["photon_rate"]["channel"].values()), mask_of(self.pattern).channels
        if found != channels:
            raise ValueError(
                f"the pattern {self.pattern!r} has the channels {', '.join(channels)}, but photon_rate has "
                f"{', '.join(map(str, found))}"
            )
        return {}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return facts["photon_rate"] if self.crosstalk == "per_plane" else Facts()
