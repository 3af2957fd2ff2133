"""Quantum efficiency of a sensor's channels from a sensitivity table: shared by the pixel, the white and the colour fit."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from etendue import spectra
from etendue.physics import photodiode, silicon
from etendue.physics.radiometry import photons_from_energy


class Photodiode(Protocol):
    """A stage that knows its photodiode and filters."""

    @property
    def sensitivity(self) -> str: ...
    @property
    def sensitivity_kind(self) -> str: ...
    @property
    def sensitivity_per(self) -> str: ...
    @property
    def peak_qe(self) -> tuple[float, ...]: ...
    @property
    def surface_transmission(self) -> float: ...
    @property
    def depletion_depth(self) -> float: ...
    @property
    def diffusion_depth(self) -> float: ...
    @property
    def diffusion_length(self) -> float: ...


class Pixel(Photodiode, Protocol):
    """One that knows the pixel's size as well."""

    @property
    def pixel_pitch(self) -> float: ...
    @property
    def aperture_fraction(self) -> float: ...


def quantum_efficiency(stage: Photodiode, edges: tuple[float, ...]) -> Any:
    """Electrons per photon that arrives, (channel, wavelength), at zero spatial frequency.

    A relative table is brought to ``peak_qe`` per channel. ``system_qe`` tables hold the silicon already;
    ``filter_transmittance`` tables are multiplied by the collection D(0) and the surface transmission.
    """
    if stage.sensitivity.endswith(".csv"):
        names, table = spectra.table_from_csv(stage.sensitivity, edges)
        if table.shape[1] != 3:
            raise ValueError(f"the sensitivity table needs three columns behind wavelength_nm, it has {', '.join(names)}")
    else:
        _, table = spectra.camera_sensitivity(stage.sensitivity, edges)
    centres = 0.5 * (np.array(edges[:-1]) + np.array(edges[1:]))
    if stage.sensitivity_per == "energy":
        table = table / centres[:, None]
    peaks = table.max(axis=0)
    if not np.all(peaks > 0):
        raise ValueError(f"the sensitivity {stage.sensitivity!r} has a channel that sees nothing in {edges[0]:g}-{edges[-1]:g} nm")
    efficiency = (table / peaks * np.array(stage.peak_qe)).T
    if stage.sensitivity_kind == "filter_transmittance":
        efficiency = efficiency * collection_at_zero(stage, centres) * stage.surface_transmission
    return efficiency


def collection_at_zero(stage: Photodiode, wavelength_nm: Any) -> Any:
    """D(0) by wavelength."""
    alphas = silicon.absorption(np.asarray(wavelength_nm) * 1e-3)
    return np.array(
        [
            float(photodiode.collection(np.array(0.0), float(a), stage.depletion_depth, stage.diffusion_depth, stage.diffusion_length))
            for a in alphas
        ]
    )


def electrons_per_irradiance(stage: Pixel, edges: tuple[float, ...]) -> Any:
    """(channel, wavelength): electron/s of a pixel per W m-2 nm-1 in each bin: width x lambda/hc x area x efficiency."""
    bounds = np.array(edges)
    centres, widths = 0.5 * (bounds[:-1] + bounds[1:]), np.diff(bounds)
    area = (stage.pixel_pitch * stage.aperture_fraction * 1e-6) ** 2
    return quantum_efficiency(stage, edges) * (widths * photons_from_energy(1.0, centres * 1e-3) * area)
