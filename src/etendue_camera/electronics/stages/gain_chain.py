"""From electrons to digital numbers: quantities shared by all stages with a gain, a white or a saturation.

In:  camera quantities of pixel, amplifier and ADC.
Out: full well and saturation (electrons), analogue gain, DN per electron.
"""

from __future__ import annotations

from dataclasses import dataclass

from etendue.api import Stage, quantity
from etendue_camera.arrays import Floats
from etendue_camera.electronics import amplifier, response


def analogue_gain(stage: Amplifier) -> float:
    """Return the amplifier gain, as given or from the ISO speed; raise ValueError where they conflict."""
    return amplifier.gain_of_speed(stage.analogue_gain, stage.iso, stage.base_iso)


def common_draws(noise: str) -> bool | str:
    """Return whether all cells share their draws, for a value of the quantity ``noise``; a number, which selects the
    draws, is returned itself.
    """
    return noise if noise.isdigit() else noise == "common"


@dataclass(frozen=True, kw_only=True)
class Amplifier(Stage):
    """A stage that uses the gain before the ADC."""

    analogue_gain: float = quantity("analogue_gain")
    iso: float = quantity("iso")
    base_iso: float = quantity("base_iso")


@dataclass(frozen=True, kw_only=True)
class ReadOut(Amplifier):
    """A stage that uses the noise before and after the amplifier."""

    read_noise: float = quantity("read_noise")
    read_noise_after: float = quantity("read_noise_after")

    def read_sigma(self) -> float:
        """Return the input-referred read noise at the analogue gain, electron."""
        return float(amplifier.read_noise_at_gain(self.read_noise, self.read_noise_after, analogue_gain(self)))


@dataclass(frozen=True, kw_only=True)
class Well(Stage):
    """A stage that uses the full well capacity of a pixel."""

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")

    def well(self) -> float:
        return amplifier.full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)


@dataclass(frozen=True, kw_only=True)
class GainChain(Well, Amplifier):
    """A stage that uses pixel, amplifier and ADC."""

    conversion_gain: float = quantity("conversion_gain")
    black_level: float = quantity("black_level")
    bits: int = quantity("bits")
    response_bend: float = quantity("response_bend")
    response_order: float = quantity("response_order")

    def bend_scale(self) -> float:
        """Return the charge (electron) at which the relative loss is ``response_bend``: that of 2^bits - 1 DN."""
        return float((2**self.bits - 1) / self.dn_per_electron())

    def after_bend(self, charge: Floats) -> Floats:
        """Return the charge after the non-linear response, electron."""
        return response.bent(charge, self.response_bend, self.response_order, self.bend_scale())

    def before_bend(self, charge: Floats) -> Floats:
        """Return the charge before the non-linear response, electron."""
        return response.unbent(charge, self.response_bend, self.response_order, self.bend_scale())

    def dn_per_electron(self) -> float:
        return amplifier.dn_per_electron(
            self.conversion_gain, analogue_gain(self), self.well(), self.black_level, self.bits
        )

    def saturation(self) -> float:
        """Return the charge at which the full well or the top code is reached, electron."""
        found = amplifier.saturation_charge(self.well(), self.dn_per_electron(), self.black_level, self.bits)
        top = float((2**self.bits - 1 - self.black_level) / self.dn_per_electron())  # after the response
        return found if self.response_bend == 0 else min(self.well(), float(self.before_bend(top)))

    def white(self) -> float:
        """Return the range from black to saturation, DN: up to the top code, or to the full well if it is reached
        first."""
        well = self.well() if self.response_bend == 0 else float(self.after_bend(self.well()))
        return amplifier.white_level(well, self.dn_per_electron(), self.black_level, self.bits)
