"""Noise model as the camera maker knows it: variance of a pixel of the linearised mosaic, from camera quantities.

Noise that is not a camera quantity, such as row and column noise, is taken from the ``datasheet`` of the stages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from etendue.api import quantity
from etendue.contract.capabilities import Sheet
from etendue_camera.electronics.stages.gain_chain import GainChain, ReadOut
from etendue_camera.roles import READ_NOISE

Sheets = Sequence[tuple[str, Sheet]]


def elsewhere(sheets: Sheets, figure: str) -> float:
    """Return the variance of a noise (``read_noise``, ``dsnu``), electron^2, summed over all stages except those whose
    noise is a shared quantity of the camera.
    """
    return sum(sheet.figures.get(figure, 0.0) ** 2 for _, sheet in sheets if sheet.role != READ_NOISE)


@dataclass(frozen=True, kw_only=True)
class KnownNoise(ReadOut, GainChain):
    """A stage that uses the noise of its input: variance = shot x value + floor, for values that are 1 at clipping.

    This variance includes photon shot noise, read noise, DSNU and quantisation. Shot noise of the dark current depends
    on the time, which metering may set, and is not included: 1.3 electrons rms after 10 ms at 1e-10 A/cm2 and 5.4 um.
    """

    dsnu: float = quantity("dsnu")

    def electrons(self) -> float:
        """Return the charge at which ``mosaic_linear`` is 1, electron."""
        return self.white() / self.dn_per_electron()

    def noise_model(self) -> tuple[float, float]:
        """Return the noise variance of ``mosaic_linear``: shot noise per unit of value, and floor in the dark."""
        electrons = self.electrons()
        return 1 / electrons, self.dark_floor() / electrons**2

    def dark_floor(self, sheets: Sheets = ()) -> float:
        """Return the variance in the dark without dark charge, electron^2; ``sheets``: data sheets of the other stages
        that add noise.
        """
        own = self.read_sigma() ** 2 + self.dsnu**2 + 1 / (12 * self.dn_per_electron() ** 2)
        return own + (elsewhere(sheets, "read_noise") + elsewhere(sheets, "dsnu"))

    def dark_sigma(self) -> float:
        """Return the standard deviation of ``mosaic_linear`` in the dark."""
        return math.sqrt(self.noise_model()[1])
