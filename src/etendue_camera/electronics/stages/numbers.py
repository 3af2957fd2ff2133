"""Metrics of exposure and noise: dynamic range, exposure of a frame, signal of a grey card.

In:  camera quantities; ``raw`` and ``expected_charge``; the light of a white diffuser.
Out: scalars, each over the axes that affect it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import measured, quantity
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.constants import LUMINOUS_EFFICACY
from etendue_camera.electronics import amplifier, dynamic_range, metering
from etendue_camera.electronics.stages.gain_chain import GainChain, analogue_gain
from etendue_camera.electronics.stages.known_noise import KnownNoise, Sheets, elsewhere
from etendue_camera.roles import DEFECTIVE, PROCESSING
from etendue_camera.sensor.stages.crosstalk import mixing_of
from etendue_camera.sensor.stages.sensitivity import Collecting, electrons_per_irradiance

Colours = tuple[FloatArray, FloatArray, tuple[float, ...]]  # electrons per irradiance, lumens, edges of the bands
# roles of stages that change noise but enter no metric of a good pixel
NOT_OF_A_PIXEL = (*DEFECTIVE, *PROCESSING, "merging")


@dataclass(frozen=True, kw_only=True)
class NoiseFloor(GainChain):
    """The quantities that noise and saturation depend on, except the time."""

    dark_current_density: float = quantity("dark_current_density")
    temperature: float = quantity("temperature")
    dark_reference_temperature: float = quantity("dark_reference_temperature")
    dark_doubling: float = quantity("dark_doubling")
    read_noise: float = quantity("read_noise")
    read_noise_after: float = quantity("read_noise_after")

    def dark_charge(self, time: float) -> FloatArray:
        warm = amplifier.dark_current_factor(self.temperature, self.dark_reference_temperature, self.dark_doubling)
        return dynamic_range.dark_electrons(self.dark_current_density * warm, self.pixel_pitch**2, time)

    def sigma(self) -> float:
        """Return the input-referred read noise at the analogue gain, electron."""
        return float(amplifier.read_noise_at_gain(self.read_noise, self.read_noise_after, analogue_gain(self)))

    def dark_variance(self, time: float, sheets: Sheets) -> float:
        """Return the temporal dark variance, electron^2: shot noise of the dark charge, read noise, quantisation, row
        and column noise.
        """
        floor = self.sigma() ** 2 + 1 / (12 * self.dn_per_electron() ** 2)
        return float(self.dark_charge(time)) + floor + elsewhere(sheets, "read_noise")


def _with(noise: float, more: float) -> float:
    """Return the rms after the variance ``more`` is added; bit-identical to ``noise`` if this variance is 0."""
    return math.sqrt(noise**2 + more) if more else noise


@dataclass(frozen=True, kw_only=True)
class DynamicRange(NoiseFloor):
    """Compute the dynamic range, down to the dark noise (eqs. 12-13) and down to SNR = 1 (EMVA 1288).

    Both values are for the camera's analogue gain, which ``system_gain`` gives in DN per electron. Row and column noise
    is treated as if it were independent in each pixel; the DSNU of eq. 13 does not include the non-uniformity of the
    dark current.
    """

    role: ClassVar = "figures"
    reads: ClassVar = {"sheets": "*.datasheet [1]"}
    writes: ClassVar = {
        "dr_elgamal": "[dB] nan",
        "dr_emva": "[dB] nan",
        "dark_charge": "[electron]",
        "dr_elgamal_stops": "[stop] nan",
        "dr_emva_stops": "[stop] nan",
        "system_gain": "[DN/electron]",
    }
    unseen: ClassVar = dict.fromkeys(("dr_elgamal", "dr_emva", "dr_elgamal_stops", "dr_emva_stops"), NOT_OF_A_PIXEL)
    error: ClassVar = measured(1e-7, 1e-14)

    dsnu: float = quantity("dsnu")
    integration_time: float = quantity("integration_time")

    def run(self, sheets: Sheets = ()) -> dict[str, float | Array]:
        gain, dark, largest = self.dn_per_electron(), self.dark_charge(self.integration_time), self.saturation()
        sigma = _with(self.sigma(), elsewhere(sheets, "read_noise"))
        elgamal = dynamic_range.dynamic_range_elgamal(largest, dark, sigma, _with(self.dsnu, elsewhere(sheets, "dsnu")))
        emva = dynamic_range.dynamic_range_emva(largest, dark, sigma, gain)
        decibel_per_stop = 20 * np.log10(2)
        return {
            "dr_elgamal": elgamal,
            "dr_emva": emva,
            "dark_charge": dark,
            "dr_elgamal_stops": elgamal / decibel_per_stop,
            "dr_emva_stops": emva / decibel_per_stop,
            "system_gain": np.array(gain),
        }


@dataclass(frozen=True, kw_only=True)
class ExposureReport(KnownNoise):
    """Report the exposure of the frame: fractions of clipped and black pixels, and mean signal-to-noise ratio of the
    expected charge (0 for clipped pixels).

    Noise is the noise of one frame: shot noise, read noise, DSNU, rounding, rows and columns. PRNU, the dark current
    pattern and hot pixels are part of the expected charge, not of the noise.

    A pixel counts as clipped at the top code, or where the expected charge exceeds the full well. The second condition
    is needed because codes do not reveal clipping at a full well below the top code, or before read noise.
    """

    role: ClassVar = "figures"
    reads: ClassVar = {"raw": "y x [DN] uint16", "expected_charge": "y x [electron]", "sheets": "*.datasheet [1]"}
    writes: ClassVar = {"clipped_fraction": "[1]", "black_fraction": "[1]", "mean_snr": "[1]"}
    unseen: ClassVar = {"mean_snr": NOT_OF_A_PIXEL[1:]}
    nanoseconds: ClassVar = 5.0
    working: ClassVar = 1.5
    error: ClassVar = measured(1e-6, 1e-14)

    def run(self, raw: Array, expected_charge: FloatArray, sheets: Sheets = ()) -> dict[str, Array]:
        floor = self.dark_floor(sheets)
        # rounding of a coarse ADC may be beyond float32
        held = np.result_type(expected_charge, np.min_scalar_type(floor))
        variance = expected_charge + held.type(floor)
        snr = expected_charge / np.sqrt(np.maximum(variance, np.finfo(variance.dtype).tiny))
        clipped = (raw >= 2**self.bits - 1) | (expected_charge >= self.well())
        if clipped.any():  # such a pixel carries no information on the light
            snr[clipped] = 0
        return {
            "clipped_fraction": np.array(np.count_nonzero(clipped) / raw.size),
            "black_fraction": np.array(np.count_nonzero(raw <= self.black_level) / raw.size),
            "mean_snr": np.array(snr.mean(dtype=np.float64)),
        }


@dataclass(frozen=True, kw_only=True)
class ExposureNumbers(NoiseFloor, Collecting):
    """Compute exposure value, saturation-based ISO speed at the gain, and the signal of a grey card under the scene's
    light, on axis.

    ``exposure_value`` is log2(N^2 / t). ``saturation_iso`` is 78 over the exposure (lx s) at which the first channel
    saturates (ISO 12232), by full well or ADC. ``snr_18`` is the temporal signal-to-noise ratio of an 18 % grey card in
    the raw channel with most charge. Its noise is shot noise of light and dark current, read noise (also of rows and
    columns) and quantisation, without fixed patterns. ``snr10_illuminance`` is the scene illuminance (lx on the card)
    at which that ratio is 10, at this f-number, time and light. The mobile industry's metric of this name is measured
    after a colour matrix at 1/15 s, f/2.8 and 3200 K, and is larger by the noise amplification of the matrix.
    ``snr_18`` and ``snr10_illuminance`` are undefined (NaN) if the card saturates first.
    """

    role: ClassVar = "figures"
    reads: ClassVar = {
        "white_radiance": "wavelength [W m-2 sr-1 nm-1]",
        "white_irradiance": "wavelength [W m-2 nm-1]",
        "sheets": "*.datasheet [1]",
    }
    writes: ClassVar = {
        "exposure_value": "[stop]",
        "saturation_iso": "[1]",
        "snr_18": "[dB] nan",
        "snr10_illuminance": "[lx] nan",
    }
    unseen: ClassVar = dict.fromkeys(("snr_18", "snr10_illuminance"), NOT_OF_A_PIXEL)
    nanoseconds: ClassVar = 1000.0
    libraries: ClassVar = ("colour-science",)
    error: ClassVar = measured(1e-6, 1e-13)

    f_number: float = quantity("f_number")
    integration_time: float = quantity("integration_time")

    def prepare(self, coordinates: Mapping[str, Array]) -> Colours:
        edges = tuple(coordinates["wavelength_edges"])
        lumens = LUMINOUS_EFFICACY * spectra.luminous_efficiency(edges) * np.diff(edges)
        return electrons_per_irradiance(self, edges), lumens, edges

    def run(
        self, white_radiance: FloatArray, white_irradiance: FloatArray, prepared: Colours, sheets: Sheets = ()
    ) -> dict[str, Array]:
        time = self.integration_time
        electrons, lumens, edges = prepared
        rates = electrons * white_irradiance
        rate = float((mixing_of(self, edges, rates) @ rates.sum(axis=1)).max())
        illuminance, luminance = float(lumens @ white_irradiance), float(lumens @ white_radiance)
        if not (rate > 0 and illuminance > 0 and luminance > 0):
            raise ValueError(
                f"a white diffuser gives {rate:g} electron/s, {illuminance:g} lx at the sensor and {luminance:g} "
                f"cd/m2: metrics of a "
                "grey card require light that both sensor and eye respond to; check the filter, the illuminant and the "
                "wavelengths"
            )
        variance = self.dark_variance(time, sheets)
        needed = float(metering.charge_at_snr(10.0, variance))
        scene = np.pi * luminance  # lx on a perfect white diffuser of this luminance
        room = self.saturation()
        card = metering.GREY * rate * time
        return {
            "exposure_value": metering.exposure_value(self.f_number, time),
            "saturation_iso": metering.saturation_iso(illuminance * room / rate),
            "snr_18": np.array(metering.grey_card_snr(rate * time, variance) if card < room else np.nan),
            "snr10_illuminance": np.array(scene * needed / card if needed < room else np.nan),
        }
