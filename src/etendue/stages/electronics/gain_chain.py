"""From electrons to digital numbers: the quantities that every stage with a gain, a white or a saturation shares.

In:  camera quantities of pixel, amplifier and converter.
Out: full well and saturation (electrons), analogue gain, DN per electron.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from etendue.api import Stage, quantity
from etendue.physics.electronics import amplifier


def full_well(pitch: float, fraction: float, density: float) -> float:
    """Charge capacity of a pixel, electron: density times light-sensitive area."""
    return density * (pitch * fraction) ** 2


def analogue_gain(stage: Any) -> float:
    """The gain of the amplifier: as given, or as the ISO speed asks for.

    Raises
    ------
    ValueError
        A speed without the speed at gain 1, or a speed and a gain.
    """
    if stage.iso == 0:
        return float(stage.analogue_gain)
    if stage.base_iso == 0:
        raise ValueError(
            f"iso = {stage.iso:g} needs base_iso, the speed at analogue gain 1: take it from a data sheet, or leave iso out, put the stage "
            "exposure_numbers into the pipeline and copy its saturation_iso"
        )
    if stage.analogue_gain != 1:
        raise ValueError(f"iso = {stage.iso:g} and analogue_gain = {stage.analogue_gain:g} are both given; one follows from the other")
    return float(stage.iso / stage.base_iso)


def dn_per_electron(stage: Any) -> float:
    """Digital numbers per electron at the analogue gain: from the conversion gain, or the full well at the top code."""
    if stage.conversion_gain > 0:
        return float(stage.conversion_gain) * analogue_gain(stage)
    top = 2**stage.bits - 1 - stage.black_level
    if top <= 0:
        raise ValueError(f"black_level {stage.black_level:g} leaves nothing of {stage.bits} bits")
    return top / full_well(stage.pixel_pitch, stage.aperture_fraction, stage.full_well_density) * analogue_gain(stage)


@dataclass(frozen=True, kw_only=True)
class Amplifier(Stage):
    """A stage that knows the gain in front of the converter."""

    analogue_gain: float = quantity("analogue_gain")
    iso: float = quantity("iso")
    base_iso: float = quantity("base_iso")


@dataclass(frozen=True, kw_only=True)
class GainChain(Amplifier):
    """A stage that knows pixel, amplifier and converter."""

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    full_well_density: float = quantity("full_well_density")
    conversion_gain: float = quantity("conversion_gain")
    black_level: float = quantity("black_level")
    bits: int = quantity("bits")

    def dn_per_electron(self) -> float:
        return dn_per_electron(self)

    def well(self) -> float:
        return full_well(self.pixel_pitch, self.aperture_fraction, self.full_well_density)

    def saturation(self) -> float:
        """Charge at which the well is full or the top code is reached."""
        return amplifier.saturation_charge(self.well(), self.dn_per_electron(), self.black_level, self.bits)

    def white(self) -> float:
        """Digital numbers between black and saturation: to the top code, or to the full well where that comes first."""
        top = float(2**self.bits - 1 - self.black_level)
        filled = self.well() * self.dn_per_electron()
        return top if filled >= top * (1 - 1e-12) else filled
