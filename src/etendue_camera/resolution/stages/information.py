"""Information metrics of a camera, in every cell of a sweep: information capacity, NEQ, SNRi.

In:  the transfer functions of all stages, the white of the light, the expected charge.
Out: bits per pixel and SNRi by ``stage``, NEQ of the whole camera by frequency.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from etendue.api import Grid, Line, Probe, measured, param, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.known_noise import KnownNoise, Sheets
from etendue_camera.resolution import information
from etendue_camera.roles import CROSSTALK, DEFECTIVE, PROCESSING
from etendue_camera.sensor import cfa
from etendue_camera.sensor.stages.masks import mask_of

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf

FREQUENCIES = 33  # from 0 to Nyquist


@dataclass(frozen=True, kw_only=True)
class Information(KnownNoise, Probe):
    """Compute the information capacity after each stage, noise-equivalent quanta and the ideal observer's SNR, for grey
    detail about the picture's mean.

    The mean charge of each channel is taken from the picture (``expected_charge``); the part that light causes follows
    from ``photocurrent``. Noise is shot noise, ``read_noise``, ``dsnu``, rounding, and the PRNU, dark current
    non-uniformity, row and column noise that earlier stages state. All pixels of the mosaic are combined, each with its
    own noise; stages after the mosaic are ignored, see ``etendue information``.

    ``information_capacity`` is half the integral over the Nyquist square of log2(1 + variance NEQ), in bits per pixel,
    with all blurs up to a stage and all noise of the camera. ``information_of_light`` is the same without blur and with
    photon shot noise alone. The signal is light that is uniformly distributed between two levels of ``contrast_ratio``,
    with equal power up to Nyquist and the variance (range/mean)^2 / 12. ``neq`` is along x, in quanta per pixel.
    ``snri`` is for a Gaussian spot ``object_size`` pixels wide at half height. All results are NaN after any stage that
    moves light without a transfer function.
    """

    role: ClassVar = "resolution"
    with_grids: ClassVar = True
    reads: ClassVar = {
        "transfers": "*.transfer [1]",
        "lights": "*.white_irradiance wavelength [W m-2 nm-1]",
        "charges": "*.expected_charge y x [electron]",
        "currents": "*.photocurrent y x [electron/s]",
        "sheets": "*.datasheet [1]",
    }
    beside: ClassVar = ("lights", "charges", "currents", "sheets")
    writes: ClassVar = {
        "information_capacity": "stage [1] nan",
        "information_of_light": "[1] nan",
        "snri": "stage [1] nan",
        "neq": "detail [1] nan",
    }
    unseen: ClassVar = dict.fromkeys(
        ("information_capacity", "snri", "neq"), (CROSSTALK, *DEFECTIVE, *PROCESSING, "merging")
    )
    creates: ClassVar = {"detail": Line(FREQUENCIES, 0.0, 0.5 / (FREQUENCIES - 1), "cycles/pixel")}
    nanoseconds: ClassVar = 2e7
    # Relative error of the bits: largest where a diffraction cut-off lies inside the Nyquist square.
    error: ClassVar = measured(2e-4)

    pattern: str = quantity("pattern")
    prnu: float = param(
        0.01, at_least=0, at_most=1, doc="photo-response non-uniformity, relative rms; used if no stage states it"
    )
    contrast_ratio: float = param(4.0, above=1, at_most=1e6, doc="ratio of the brightest to the darkest detail")
    object_size: float = param(
        4.0, at_least=0.5, at_most=12, units="pixel", doc="full width of the spot at half maximum"
    )
    object_contrast: float = param(0.05, above=0, at_most=1, doc="peak contrast of the spot")

    def run(
        self, transfers: Sequence[tuple[str, Otf]], lights: Any, charges: Any, currents: Any = (), sheets: Sheets = ()
    ) -> dict[str, Array]:
        count = len(transfers)
        found = {name: np.full(count, math.nan) for name in ("information_capacity", "snri")}
        nothing = {**found, "information_of_light": np.array(math.nan), "neq": np.full(FREQUENCIES, math.nan)}
        pixel = next((otf for _, otf in transfers if otf.weights is not None), None)
        if pixel is None or not charges:
            return nothing
        charge = self.by_channel(*charges[0][1:])
        white = lights[-1][1].astype(float) if lights else None
        colours = self.colours(pixel.weights, white)
        if len(colours) != len(charge) or not all(e > 0 for e in charge):
            return nothing
        square, variance = information.nyquist_square(), information.signal_variance(self.contrast_ratio)
        spot = information.gaussian_object(square.fy[:, None], square.fx, self.object_size / math.sqrt(8 * math.log(2)))
        shares, (light, noise) = self.shares(), self.light_and_noise(charge, currents, sheets)

        def quanta(otf: Otf, fy: FloatArray, fx: FloatArray) -> FloatArray:
            """Return the NEQ of all channels together, quanta per pixel, (m, n)."""
            return sum(
                share * information.neq(e * contrast, variance)
                for share, e, variance, contrast in zip(
                    shares, light, noise, self.contrasts(otf, colours, white, fy, fx), strict=True
                )
            )

        for number, (_, otf) in enumerate(transfers):
            if otf.whole:
                seen = quanta(otf, square.fy, square.fx)
                found["information_capacity"][number] = information.capacity(seen, square, variance)
                found["snri"][number] = information.ideal_observer(seen, spot, square, self.object_contrast)
        neq = quanta(pixel, np.zeros(1), np.linspace(0.0, 0.5, FREQUENCIES))[0] if pixel.whole else nothing["neq"]
        return {
            **found,
            "information_of_light": np.array(0.5 * math.log2(1 + variance * float(np.dot(shares, light)))),
            "neq": neq,
        }

    def contrasts(
        self, otf: Otf, colours: FloatArray, white: FloatArray | None, fy: FloatArray, fx: FloatArray
    ) -> FloatArray | list[Array]:
        """Return the contrast (channel, m, n) at frequencies in cycles/pixel."""
        fy, fx = np.asarray(fy) / self.pixel_pitch, np.asarray(fx) / self.pixel_pitch
        if otf.behind:
            return otf.channels(fy, fx, white)
        blurs = otf.plane(fy, fx)
        return [np.tensordot(colour, blurs, 1) for colour in colours]

    def light_and_noise(self, charge: FloatArray, currents: Any, sheets: Sheets) -> tuple[Any, Any]:
        """Return the charge of the light, electron, and the variance of a pixel, electron^2, both (channel,)."""
        figures = [sheet.figures for _, sheet in sheets]
        dark, spread = (sum(own.get(name, 0.0) for own in figures) for name in ("dark_current", "dark_spread"))
        said = [own["prnu"] for own in figures if "prnu" in own]
        mosaics = [(current, grid) for _, current, grid in currents if "channel" not in grid]
        light = charge
        if dark > 0 and mosaics:  # the same time for both
            current = np.maximum(self.by_channel(*mosaics[-1]), 0.0)
            light = charge * (current / (current + dark))
        patterns = (
            (math.hypot(*said) if said else self.prnu) * light,
            (spread / dark if dark > 0 else 0.0) * (charge - light),
        )
        return light, charge + self.dark_floor(sheets) + patterns[0] ** 2 + patterns[1] ** 2

    def shares(self) -> FloatArray:
        """Return each channel's fraction of the mosaic's pixels, (channel,)."""
        mask = mask_of(self.pattern)
        letters = "".join("".join(row) for row in mask.rows)
        return np.array([letters.count(channel) / len(letters) for channel in mask.channels])

    def by_channel(self, mosaic: FloatArray, grid: Grid) -> FloatArray:
        """Return the channel means (channel,) of a mosaic, for the first exposure."""
        mosaic = mosaic.reshape(-1, *mosaic.shape[-2:])[0]
        y, x, mask = grid.line("y"), grid.line("x"), mask_of(self.pattern)
        index = cfa.channel_index(mask, y.size, x.size, round(y.start), round(x.start))
        return np.array(
            [float(np.mean(mosaic[index == c])) if np.any(index == c) else math.nan for c in range(len(mask.channels))]
        )

    @staticmethod
    def colours(weights: FloatArray, light: FloatArray | None) -> FloatArray:
        """Return each channel's photon distribution for a grey surface, (channel, wavelength), normalised to sum 1."""
        own = np.asarray(weights, dtype=float) * (1.0 if light is None else light)
        return own / own.sum(axis=1, keepdims=True)
