"""What a camera tells of fine detail, in every cell of a sweep: information capacity, NEQ, SNRi, from its own figures.

In:  the transfer functions of all stages, the white of the light, the expected charge of the picture.
Out: bits a pixel and SNRi by ``stage``, NEQ of the whole camera by frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Line, Probe, param, quantity
from etendue.physics.resolution import information
from etendue.physics.sensor import cfa
from etendue.stages.electronics.known_noise import KnownNoise
from etendue.stages.sensor.masks import mask_of

FREQUENCIES = 33  # from 0 to Nyquist


@dataclass(frozen=True, kw_only=True)
class Information(KnownNoise, Probe):
    """Information capacity up to each stage, noise equivalent quanta and the ideal observer, of grey detail about the picture's mean.

    The mean charge of every channel is that of the picture (``expected_charge``); its noise is shot noise, ``read_noise``, ``dsnu``,
    rounding and ``prnu``, as the stage ``exposure`` has it; dark charge counts as light. All pixels of the mosaic are taken together,
    each by its own noise; the stages behind the mosaic are not looked at, see ``etendue information``.

    ``information_capacity``: bits a pixel, half the integral over the Nyquist square of log2(1 + variance NEQ), with the blurs up to a
    stage and all of the noise; ``information_of_light`` is that of the photoelectrons alone, without blur and with their shot noise.
    The signal is light between two levels of ``contrast_ratio``, all equally likely, with the same power up to Nyquist: variance
    (range/mean)^2 / 12. ``neq`` is along x, in quanta a pixel. ``snri``: of a Gaussian spot ``object_size`` pixels wide at half height.
    NaN from the first stage on that moves light without being a transfer function.
    """

    role: ClassVar = "resolution"
    with_grids: ClassVar = True
    reads: ClassVar = {
        "transfers": "*.transfer [1]",
        "lights": "*.white_irradiance wavelength [W m-2 nm-1]",
        "charges": "*.expected_charge y x [electron]",
    }
    beside: ClassVar = ("lights", "charges")
    writes: ClassVar = {
        "information_capacity": "stage [1] nan", "information_of_light": "[1] nan", "snri": "stage [1] nan", "neq": "detail [1] nan",
    }  # fmt: skip
    creates: ClassVar = {"detail": Line(FREQUENCIES, 0.0, 0.5 / (FREQUENCIES - 1), "cycles/pixel")}
    nanoseconds: ClassVar = 2e7

    pattern: str = quantity("pattern")
    prnu: float = param(0.01, at_least=0, at_most=1, doc="relative rms of the response from pixel to pixel, as in the stage exposure")
    contrast_ratio: float = param(4.0, above=1, at_most=1e6, doc="of the brightest to the darkest detail")
    object_size: float = param(4.0, at_least=0.5, at_most=12, units="pixel", doc="width of the spot at half height")
    object_contrast: float = param(0.05, above=0, at_most=1, doc="of the spot, at its peak")

    def run(self, transfers: Any, lights: Any, charges: Any) -> dict[str, Any]:
        count = len(transfers)
        found = {name: np.full(count, math.nan) for name in ("information_capacity", "snri")}
        nothing = {**found, "information_of_light": np.array(math.nan), "neq": np.full(FREQUENCIES, math.nan)}
        pixel = next((otf for _, otf in transfers if otf.weights is not None), None)
        if pixel is None or not charges:
            return nothing
        charge = self.mean_charge(*charges[0][1:])
        colours = self.colours(pixel.weights, lights[-1][1].astype(float) if lights else None)
        if len(colours) != len(charge) or not all(e > 0 for e in charge):
            return nothing
        square, variance = information.nyquist_square(), information.signal_variance(self.contrast_ratio)
        spot = information.gaussian_object(square.fy[:, None], square.fx, self.object_size / math.sqrt(8 * math.log(2)))
        shares = self.shares()
        for number, (_, otf) in enumerate(transfers):
            if otf.whole:
                quanta = self.quanta(otf, colours, charge, shares, square.fy, square.fx)
                found["information_capacity"][number] = information.capacity(quanta, square, variance)
                found["snri"][number] = information.ideal_observer(quanta, spot, square, self.object_contrast)
        along = np.linspace(0.0, 0.5, FREQUENCIES)
        neq = self.quanta(pixel, colours, charge, shares, np.zeros(1), along)[0] if pixel.whole else nothing["neq"]
        light = float(np.dot(shares, charge))
        return {**found, "information_of_light": np.array(0.5 * math.log2(1 + variance * light)), "neq": neq}

    def quanta(self, otf: Any, colours: Any, charge: Any, shares: Any, fy: Any, fx: Any) -> Any:
        """(m, n): of all channels together."""
        blurs = otf.plane(np.asarray(fy) / self.pixel_pitch, np.asarray(fx) / self.pixel_pitch)
        floor = self.read_sigma() ** 2 + self.dsnu**2 + 1 / (12 * self.dn_per_electron() ** 2)
        return sum(
            share * information.neq(e * np.tensordot(colour, blurs, 1), e + floor + (self.prnu * e) ** 2)
            for share, e, colour in zip(shares, charge, colours, strict=True)
        )

    def shares(self) -> Any:
        """(channel,): of the pixels of the mosaic."""
        mask = mask_of(self.pattern)
        letters = "".join("".join(row) for row in mask.rows)
        return np.array([letters.count(channel) / len(letters) for channel in mask.channels])

    def mean_charge(self, charge: Any, grid: Any) -> Any:
        """(channel,) electron, of the first exposure."""
        charge = charge.reshape(-1, *charge.shape[-2:])[0]
        y, x, mask = grid.line("y"), grid.line("x"), mask_of(self.pattern)
        index = cfa.channel_index(mask, y.size, x.size, round(y.start), round(x.start))
        return np.array([float(np.mean(charge[index == c])) if np.any(index == c) else math.nan for c in range(len(mask.channels))])

    @staticmethod
    def colours(weights: Any, light: Any) -> Any:
        """(channel, wavelength): shares of the photons of a grey surface."""
        own = np.asarray(weights, dtype=float) * (1.0 if light is None else light)
        return own / own.sum(axis=1, keepdims=True)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Of bits, relative: largest where a diffraction cut-off lies inside the square."""
        return 2e-4, "measured"
