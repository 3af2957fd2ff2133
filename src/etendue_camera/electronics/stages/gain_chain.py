"""From electrons to digital numbers: the quantities that every stage with a gain, a white or a saturation shares.

In:  camera quantities of pixel, amplifier and converter.
Out: full well and saturation (electrons), analogue gain, DN per electron.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from etendue.api import Stage, quantity
from etendue_camera.electronics import amplifier


def analogue_gain(stage: Any) -> float:
    """The gain of the amplifier: as given, or as the ISO speed asks for; ``ValueError`` where they do not go
    together.
    """
    return amplifier.gain_of_speed(stage.analogue_gain, stage.iso, stage.base_iso)


@dataclass(frozen=True, kw_only=True)
class Amplifier(Stage):
    """A stage that knows the gain in front of the converter."""

    analogue_gain: float = quantity("analogue_gain")
    iso: float = quantity("iso")
    base_iso: float = quantity("base_iso")


@dataclass(frozen=True, kw_only=True)
class ReadOut(Amplifier):
    """A stage that knows the noise in front of the amplifier and behind it."""

    read_noise: float = quantity("read_noise")
    read_noise_after: float = quantity("read_noise_after")

    def read_sigma(self) -> float:
        """Read noise at the gain, referred to the pixel, electron."""
        return float(amplifier.read_noise_at_gain(self.read_noise, self.read_noise_after, analogue_gain(self)))


@dataclass(frozen=True, kw_only=True)
class Well(Stage):
    """A stage that knows how much charge a pixel holds."""

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")

    def well(self) -> float:
        return amplifier.full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)


@dataclass(frozen=True, kw_only=True)
class GainChain(Well, Amplifier):
    """A stage that knows pixel, amplifier and converter."""

    conversion_gain: float = quantity("conversion_gain")
    black_level: float = quantity("black_level")
    bits: int = quantity("bits")

    def dn_per_electron(self) -> float:
        return amplifier.dn_per_electron(
            self.conversion_gain, analogue_gain(self), self.well(), self.black_level, self.bits
        )

    def saturation(self) -> float:
        """Charge at which the well is full or the top code is reached."""
        return amplifier.saturation_charge(self.well(), self.dn_per_electron(), self.black_level, self.bits)

    def white(self) -> float:
        """Digital numbers between black and saturation: to the top code, or to the full well where that comes first."""
        return amplifier.white_level(self.well(), self.dn_per_electron(), self.black_level, self.bits)
