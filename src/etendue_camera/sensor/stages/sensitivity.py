"""Quantum efficiency of the sensor channels from a sensitivity table, shared by the pixel, the white and the colour
fit.

In:  camera quantities of filters and photodiode; the colour filter array; bin edges, nm.
Out: electrons per photon and per irradiance, (channel, wavelength), in the order of the mask's channels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np

from etendue.api import Stage, quantity
from etendue_camera import spectra
from etendue_camera.arrays import FloatArray
from etendue_camera.light.radiometry import photons_from_energy
from etendue_camera.sensor import photodiode, silicon
from etendue_camera.sensor.stages.masks import mask_of

FLAT = "flat"  # the name of a sensitivity equal for photons of every wavelength
CLEAR = "WC"  # letters of pixels without a filter
WORDS = {"red": "R", "green": "G", "blue": "B", "white": "W", "clear": "C"}
CAMERA_COLUMNS = ("R", "G", "B")
# a table whose column peaks are this close to 1 is relative; a peak this close to peak_qe equals it
OF_THE_SAME, SAME_PEAK = (0.005, 0.01)
FINE = tuple(300.0 + 0.25 * i for i in range(3601))  # nm, bins in which the peak of a table is searched


@dataclass(frozen=True, kw_only=True)
class Sensitive(Stage):
    """A stage that uses filters and photodiode."""

    pattern: str = quantity("pattern")
    sensitivity: str = quantity("sensitivity")
    sensitivity_kind: str = quantity("sensitivity_kind")
    sensitivity_per: str = quantity("sensitivity_per")
    peak_qe: tuple[float, ...] = quantity("peak_qe")
    depletion_depth: float = quantity("depletion_depth")
    diffusion_depth: float = quantity("diffusion_depth")
    diffusion_length: float = quantity("diffusion_length")
    back: str = quantity("back")
    surface_transmission: float = quantity("surface_transmission")

    def __post_init__(self) -> None:
        spectra.check_camera(self.sensitivity)
        if not isinstance(self.peak_qe, tuple):  # one number for all channels, as an axis gives it
            object.__setattr__(self, "peak_qe", (float(self.peak_qe),))
        channels = self.channels
        if len(self.peak_qe) not in (1, len(channels)):
            raise ValueError(
                f"peak_qe has {len(self.peak_qe)} values, but the pattern {self.pattern!r} has {len(channels)} "
                f"channels: "
                f"{', '.join(channels)}; give one value per channel, or one for all"
            )
        if not spectra.spectrum(self.sensitivity) and self.sensitivity != FLAT:
            _columns_of(self, CAMERA_COLUMNS)

    @property
    def channels(self) -> tuple[str, ...]:
        """Return the letters of the sensor's channels in the order of its planes."""
        return mask_of(self.pattern).channels


@dataclass(frozen=True, kw_only=True)
class Collecting(Sensitive):
    """A sensitive stage that also uses the pixel geometry."""

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    aperture_offset_y: float = quantity("aperture_offset_y")
    aperture_offset_x: float = quantity("aperture_offset_x")
    microlens_gain: float = quantity("microlens_gain")
    crosstalk: str = quantity("crosstalk")

    def __post_init__(self) -> None:
        super().__post_init__()
        room = 0.5 * (1 - self.aperture_fraction)
        for name, offset in (
            ("aperture_offset_y", self.aperture_offset_y),
            ("aperture_offset_x", self.aperture_offset_x),
        ):
            if abs(offset) > room + 1e-12:
                raise ValueError(
                    f"{name} = {offset:g} shifts the light-sensitive square out of its pixel: with aperture_fraction = "
                    f"{self.aperture_fraction:g} the offset may be at most {room:g} pitches"
                )
        fill = self.aperture_fraction**2
        if self.microlens_gain * fill > 1 + 1e-12:
            raise ValueError(
                f"microlens_gain = {self.microlens_gain:g} times the fill factor {fill:.3g} exceeds 1, but a "
                f"microlens cannot collect more "
                f"than the light on its pixel; the maximum is {1 / fill:.4g}"
            )


def _columns_of(stage: Sensitive, names: tuple[str, ...]) -> list[int | None]:
    """Return the column of each channel in a table with these names; None for a clear pixel, which needs no column."""
    channels = mask_of(stage.pattern).channels
    if len(channels) == len(names) == 1:
        return [0]
    letters = [WORDS.get(name.casefold(), name.upper()) for name in names]
    found: list[int | None] = []
    for channel in channels:
        if channel in letters:
            found.append(letters.index(channel))
        elif channel in CLEAR and stage.sensitivity_kind == "filter_transmittance":
            found.append(None)
        else:
            clear = (
                ", or use sensitivity_kind = 'filter_transmittance', for which a clear pixel needs no column"
                if channel in CLEAR
                else ""
            )
            raise ValueError(
                f"the pattern {stage.pattern!r} has a channel {channel}, but the sensitivity {stage.sensitivity!r} has "
                f"columns "
                f"{', '.join(names)} only; use a CSV table with a column {channel}{clear}"
            )
    return found


def quantum_efficiency(stage: Sensitive, edges: tuple[float, ...]) -> FloatArray:
    """Return electrons per incident photon, (channel, wavelength), at zero spatial frequency.

    Each channel of a relative table is scaled so that its peak is ``peak_qe``, independently of the bins of the light;
    a clear pixel without a column transmits everything. ``system_qe`` tables include the silicon;
    ``filter_transmittance`` tables are multiplied by the collection D(0) and the surface transmission.
    """
    if stage.sensitivity == FLAT:
        return _of_the_silicon(stage, edges, np.ones((len(mask_of(stage.pattern).channels), len(edges) - 1)))
    names, table = spectra.camera_sensitivity(stage.sensitivity, edges)
    columns, fine = _columns_of(stage, names), spectra.camera_sensitivity(stage.sensitivity, FINE)[1]
    relative, highest = (_relative(stage, columns, *part) for part in ((table, edges), (fine, FINE)))
    peaks = highest.max(axis=1, keepdims=True)
    if not np.all(relative.max(axis=1) > 0):
        raise ValueError(
            f"the sensitivity {stage.sensitivity!r} has a channel without response in {edges[0]:g}-{edges[-1]:g} nm"
        )
    return _of_the_silicon(stage, edges, relative / peaks)


def _of_the_silicon(stage: Sensitive, edges: tuple[float, ...], relative: FloatArray) -> FloatArray:
    """Convert curves with a peak of 1 to electrons per photon: apply ``peak_qe`` and, for tables of filters alone,
    collection and surface.
    """
    efficiency = relative * np.broadcast_to(np.array(stage.peak_qe), relative.shape[0])[:, None]
    if stage.sensitivity_kind == "filter_transmittance":
        efficiency = efficiency * collection_at_zero(stage, _centres(edges)) * stage.surface_transmission
    return efficiency


def _relative(stage: Sensitive, columns: list[int | None], table: FloatArray, edges: tuple[float, ...]) -> FloatArray:
    """Return each channel's relative response per photon, (channel, wavelength)."""
    centres = _centres(edges)
    found = np.stack([np.ones(centres.size) if column is None else table[:, column] for column in columns])
    if stage.sensitivity_per == "energy":
        measured = np.array([column is not None for column in columns])
        found[measured] = found[measured] / centres
    return found


def unused_notes(stage: Sensitive) -> list[str]:
    """Return notes on quantities that were given but have no effect."""
    said = []
    if stage.sensitivity_kind == "system_qe" and stage.surface_transmission != 1:
        said.append(
            f"surface_transmission = {stage.surface_transmission:g} has no effect: sensitivity_kind = 'system_qe' "
            f"includes the surface "
            "already; use sensitivity_kind = 'filter_transmittance', or lower peak_qe"
        )
    if stage.sensitivity == FLAT and stage.sensitivity_per == "energy":
        said.append(
            "sensitivity_per = 'energy' has no effect: sensitivity = 'flat' is the same for photons of every wavelength"
        )
    return said


def peaks_note(stage: Sensitive) -> list[str]:
    """Return a note for a table that looks absolute (columns between 0 and 1, with peaks other than 1) but is scaled to
    other peaks.
    """
    if stage.sensitivity == FLAT or not spectra.spectrum(stage.sensitivity) or stage.sensitivity_kind != "system_qe":
        return []
    names, _, values = spectra.camera_rows(stage.sensitivity)
    channels = [
        (letter, column)
        for letter, column in zip(stage.channels, _columns_of(stage, names), strict=True)
        if column is not None
    ]
    peaks = np.array([values[:, column].max() for _, column in channels])
    wanted = (
        np.broadcast_to(np.array(stage.peak_qe), len(channels)) if len(stage.peak_qe) == 1 else np.array(stage.peak_qe)
    )
    relative = np.ptp(peaks) < OF_THE_SAME and peaks.max() > 1 - OF_THE_SAME
    if stage.sensitivity_per == "energy" or relative or peaks.max() > 1 or not peaks.min() > 0:
        return []
    if np.all(np.abs(peaks - wanted) <= SAME_PEAK * peaks):
        return []
    found, given = (", ".join(f"{one:.3g}" for one in part) for part in (peaks, wanted))
    what = (
        stage.sensitivity if stage.sensitivity.endswith(spectra.ENDINGS) else f"the sensitivity {stage.sensitivity!r}"
    )
    return [
        f"the columns of {what} peak at {found} ({', '.join(letter for letter, _ in channels)}) and are scaled to "
        f"peak_qe = [{given}]; "
        f"to use them unscaled, set peak_qe = [{found}]"
    ]


def cut_off_notes(stage: Sensitive, edges: tuple[float, ...]) -> list[str]:
    """Return notes on a table that ends where a channel still responds: beyond its end the response counts as 0.

    Tables of filters over silicon are judged separately, because the charge at the ends of such a table depends on the
    silicon too.
    """
    if stage.sensitivity == FLAT:
        return []
    lowest, highest = spectra.range_of(stage.sensitivity, "camera")
    if lowest <= edges[0] and edges[-1] <= highest:
        return []  # without colour-science
    names, rows, values = spectra.camera_rows(stage.sensitivity)
    what = (
        stage.sensitivity if stage.sensitivity.endswith(spectra.ENDINGS) else f"the sensitivity {stage.sensitivity!r}"
    )
    chosen = [column for column in _columns_of(stage, names) if column is not None]
    curves = values[:, chosen] / (rows[:, None] if stage.sensitivity_per == "energy" else 1.0)
    return spectra.cut_off_note(what, [names[column] for column in chosen], rows, curves, edges[0], edges[-1])


def collection_at_zero(stage: Sensitive, wavelength_nm: FloatArray) -> FloatArray:
    """Return the collection D(0) at each wavelength, electrons per photon that enters the silicon."""
    alphas = silicon.absorption(np.asarray(wavelength_nm) * 1e-3)
    diode = (stage.depletion_depth, stage.diffusion_depth, stage.diffusion_length, stage.back)
    return np.array([_collected_at_zero(float(a), *diode) for a in alphas])


@lru_cache(4096)  # a plan needs the same wavelengths of the same diode many times
def _collected_at_zero(alpha: float, *diode: Any) -> float:
    return float(photodiode.collection(0.0, alpha, *diode))


def electrons_per_irradiance(stage: Collecting, edges: tuple[float, ...]) -> FloatArray:
    """Return electron/s of a pixel per W m-2 nm-1 in each bin, (channel, wavelength): bin width x lambda/hc x area x
    efficiency.

    The area is the area of the light-sensitive square times the gain of its microlens.
    """
    area = (stage.pixel_pitch * stage.aperture_fraction * 1e-6) ** 2 * stage.microlens_gain
    return quantum_efficiency(stage, edges) * (_photons(edges) * area)


def _photons(edges: tuple[float, ...]) -> FloatArray:
    """Return the photons per second and m2 of 1 W m-2 nm-1 in each bin, (wavelength,)."""
    return np.diff(np.array(edges)) * photons_from_energy(1.0, _centres(edges) * 1e-3)


def _centres(edges: tuple[float, ...]) -> FloatArray:
    return 0.5 * (np.array(edges[:-1]) + np.array(edges[1:]))


# what determines the colours of a sensor, whatever the pixel size
SEEN_BY = tuple(field.name for field in fields(Sensitive))


@lru_cache(64)
def shares(seen_by: tuple[Any, ...], files: Any, edges: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
    """Return each channel's electrons per irradiance, normalised to a sum of 1, (channel, wavelength); 0 for a channel
    without response.

    ``seen_by`` contains the values of ``SEEN_BY``, ``files`` the state of the files that they name.
    """
    weights = quantum_efficiency(Sensitive(**dict(zip(SEEN_BY, seen_by, strict=True))), edges)
    weights = weights * _photons(edges)
    sums = weights.sum(axis=1, keepdims=True)
    found = np.divide(weights, sums, out=np.zeros_like(weights), where=sums > 0)
    return tuple(tuple(map(float, row)) for row in found)
