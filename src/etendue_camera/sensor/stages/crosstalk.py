"""Crosstalk below the colour filters: charge that diffuses into neighbouring pixels of any colour.

In:  ``photocurrent`` (y, x) after the mosaic; ``white_irradiance``, which weights the wavelengths.
Out: ``photocurrent``; the transfer functions between channels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from etendue.api import Bounded, ChannelTransfer, Facts, Grid, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.sensor import crosstalk, crosstalk_planes, silicon
from etendue_camera.sensor.stages.masks import first_pixel, mask_of
from etendue_camera.sensor.stages.sensitivity import Collecting, electrons_per_irradiance

LARGEST_REACH = 256  # pixels


@dataclass(frozen=True, kw_only=True)
class Crosstalk(Collecting, Bounded, ChannelTransfer):
    """Apply charge diffusion below the colour filters (``crosstalk = "through_filter"``), with one pixel kernel per
    channel.

    A kernel gives the share of the charge generated under a pixel's filter that each neighbour collects. The area under
    the filter is lit uniformly, charge diffuses as in the stage ``diffusion``, and every pixel collects over its whole
    pitch. The kernel is the mean over wavelength, weighted with the photons of the channel under the scene white.
    Charge is conserved.
    """

    role: ClassVar = "crosstalk"
    reads: ClassVar = {"photocurrent": "y x [electron/s]", "white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"photocurrent": "y x [electron/s]"}
    keeps: ClassVar = ("sum",)
    gain: ClassVar = 2.0  # a pixel that keeps its own charge and also receives all of its neighbours'
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 150.0
    working: ClassVar = 0.1
    libraries: ClassVar = ("colour-science",)

    beyond: float = param(
        1e-8,
        above=0,
        at_most=0.1,
        fidelity=True,
        reference="1e-14: kernels as wide as the diffusion",
        settings=(0.1, 0.03, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8, 1e-10, 1e-14),
        doc="fraction of the charge that may diffuse beyond the kernels, where it is added to them; if at most "
        "this fraction diffuses, the stage does nothing",
    )

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        edges = tuple(float(e) for e in coordinates["wavelength_edges"])
        return electrons_per_irradiance(self, edges), tables_of(self, edges)

    def run(
        self,
        photocurrent: FloatArray,
        white_irradiance: FloatArray,
        y: FloatArray,
        x: FloatArray,
        prepared: tuple[FloatArray, tuple[FloatArray, ...]],
    ) -> dict[str, Array]:
        if self.crosstalk == "per_plane":
            return {"photocurrent": photocurrent}
        kernel = channel_kernels(prepared[0] * white_irradiance, prepared[1], self.beyond)
        return {"photocurrent": crosstalk.diffuse(photocurrent, kernel, mask_of(self.pattern), *first_pixel(y, x))}

    def moves_charge(self) -> bool:
        return self.crosstalk == "through_filter"

    def channel_transfer(
        self,
        fy: FloatArray,
        fx: FloatArray,
        light: FloatArray,
        prepared: tuple[FloatArray, tuple[FloatArray, ...]],
    ) -> Any:
        """Return the transfer functions of kernels that contain all of the diffusion; ``beyond`` does not truncate
        them.
        """
        electrons, (kept, moved, along_y, along_x) = prepared
        share = shares_of(electrons * light)
        per_pixel = np.asarray(fy) * self.pixel_pitch, np.asarray(fx) * self.pixel_pitch
        return crosstalk_planes.channel_transfer(
            share @ kept, share @ moved, along_y, along_x, mask_of(self.pattern), *per_pixel
        )

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.crosstalk == "per_plane":
            return 0.0, "charge diffusion is applied per plane (crosstalk = per_plane), by the stage diffusion"
        if facts.uniform and len(self.channels) == 1:
            return 0.0, "the light is uniform and the sensor has one channel"
        return None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        return facts["photocurrent"] if self.crosstalk == "per_plane" else Facts()

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the error: twice the charge beyond the largest kernel, which is missing in one place and added in
        another, plus the rounding of the transforms.
        """
        if self.crosstalk == "per_plane":
            return 0.0, "proved"
        kept, moved, along_y, along_x = tables_of(self, grid["white_irradiance"].bands().edges)
        far = 1.0 - kept - moved @ (along_y.sum(axis=1) * along_x.sum(axis=1))
        return 2 * max(self.beyond, float(far.max())) + (2e-6 if precision == "float32" else 1e-14), "proved"


def tables_of(stage: Any, edges: tuple[float, ...]) -> tuple[FloatArray, ...]:
    """Return the fractions of charge that stays and that moves, by wavelength, and the distribution of the moved charge
    along both axes.
    """
    diode = (stage.depletion_depth, stage.diffusion_depth, stage.diffusion_length, stage.back)
    pixel = (stage.pixel_pitch, stage.aperture_fraction, stage.aperture_offset_y, stage.aperture_offset_x)
    return _tables(tuple(edges), diode, pixel)


@lru_cache(maxsize=16)
def _tables(edges: tuple[float, ...], diode: tuple[Any, ...], pixel: tuple[float, ...]) -> tuple[FloatArray, ...]:
    depletion, depth, length, back = diode
    pitch, fraction, offset_y, offset_x = pixel
    alphas = silicon.absorption(0.5e-3 * (np.array(edges[:-1]) + np.array(edges[1:])))
    t = crosstalk.times(depth, length)
    pairs = [crosstalk.shares(t, float(a), depletion, depth, length, back) for a in alphas]
    kept, moved = np.array([k for k, _ in pairs]), np.stack([m for _, m in pairs])
    reach = min(LARGEST_REACH, math.ceil(12 * math.sqrt(2 * t[-1]) / pitch) + 1)
    along = [crosstalk.pixel_shares(t, pitch * fraction, pitch, reach, pitch * o) for o in (offset_y, offset_x)]
    return kept, moved, *along


def channel_kernels(photons: FloatArray, tables: tuple[FloatArray, ...], beyond: float) -> FloatArray:
    """Return the kernel of each channel, averaged over wavelength with the weights ``photons`` (channel,
    wavelength).
    """
    kept, moved, along_y, along_x = tables
    share = shares_of(photons)
    return crosstalk.kernels(share @ kept, share @ moved, along_y, along_x, beyond)[0]


def shares_of(photons: FloatArray) -> FloatArray:
    """Return each channel's photon distribution over wavelength, (channel, wavelength); uniform if it has no
    photons."""
    total = photons.sum(axis=1, keepdims=True)
    return np.where(total > 0, photons / np.where(total > 0, total, 1), 1 / photons.shape[1])


def mixing_of(stage: Any, edges: tuple[float, ...], photons: FloatArray) -> FloatArray:
    """Return the matrix by which crosstalk mixes the channels of uniform light, (channel, channel); the identity if
    diffusion is per plane.
    """
    if stage.crosstalk == "per_plane":
        return np.eye(len(photons))
    kernel = channel_kernels(photons, tables_of(stage, edges), 1e-8)
    return crosstalk.mixing(kernel, mask_of(stage.pattern))
