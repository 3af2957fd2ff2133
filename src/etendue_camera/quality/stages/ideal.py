"""The camera without noise, converter and mosaic: stages that studies put in the place of others, for the picture to
compare with.

In:  ``photon_rate`` (channel, y, x) or ``photocurrent`` (y, x), electron/s, of the same pixel stage.
Out: ``photocurrent``, ``mosaic_linear`` and ``rgb_camera`` of every channel at every pixel, or of the mosaic; 1 where
     pixels saturate.

Full planes are a mosaic run plane by plane: between ``no_mask`` and ``no_demosaicing`` every stage that works on a
mosaic is given one plane after the other, each as the mosaic of a sensor with one filter.
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

UNCLIPPED = 1e30  # a level of clipping that no value reaches


class _HandedOn(Stage):
    """All planes as they are, under another name."""

    working: ClassVar = 0.0
    role: ClassVar = "reference"
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0
    error: ClassVar = proved(0.0)


@dataclass(frozen=True, kw_only=True)
class NoMask(_HandedOn):
    """Behind every pixel all filters at once: every channel at every pixel. Takes the place of ``mosaic``."""

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
        return ["charge diffuses behind the filters, but not in these planes: put crosstalk_planes before them"]


@dataclass(frozen=True, kw_only=True)
class IdealMosaic(GainChain):
    """Expected values in place of exposure, noise and converter: the mosaic without noise and rounding, clipped where
    pixels saturate.

    Without dark charge and the fixed patterns of the sensor (PRNU, DSNU).
    """

    role: ClassVar = "reference"
    reads: ClassVar = {"photocurrent": "y x [electron/s]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "clipping_level": "[1]"}
    keeps: ClassVar = ("order",)
    gain: ClassVar = None  # where the light exceeds the well, what is not clipped gains in share of full scale
    negative: ClassVar = "clip"  # the undershoot of band-limited light, as in front of the Poisson draw
    nanoseconds: ClassVar = 2.0
    error: ClassVar = proved(2e-7, 4e-16)

    integration_time: float = quantity("integration_time")
    clip: bool = param(True, doc="whether pixels end where they saturate; false: nowhere, for pictures to compare with")

    def run(self, photocurrent: FloatArray) -> dict[str, Array]:
        kind = photocurrent.dtype.type
        # photoelectrons per second: times the time and the gain of the converter, over black to white
        found = photocurrent * kind(self.integration_time * self.dn_per_electron() / self.white())
        if not self.clip:
            return {"mosaic_linear": found, "clipping_level": np.array(UNCLIPPED)}
        return {"mosaic_linear": np.minimum(found, kind(1)), "clipping_level": np.array(1.0)}


class NoDemosaicing(_HandedOn):
    """Full planes, of which nothing has to be invented, as camera channels. Takes the place of a demosaicer behind
    ``no_mask``.
    """

    reads: ClassVar = {"mosaic_linear": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}

    def run(self, mosaic_linear: FloatArray) -> dict[str, Array]:
        return {"rgb_camera": mosaic_linear.copy()}


@dataclass(frozen=True, kw_only=True)
class CrosstalkPlanes(Crosstalk):
    """Crosstalk behind the filters for full planes: at every pixel what each channel would collect beside the mask's
    neighbours.

    Stands in front of ``no_mask`` where ``crosstalk`` stands behind a mosaic (``crosstalk = "through_filter"``).
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
                f"the pattern {self.pattern!r} has channels {', '.join(channels)}, but photon_rate "
                f"{', '.join(map(str, found))}"
            )
        return {}

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return facts["photon_rate"] if self.crosstalk == "per_plane" else Facts()
