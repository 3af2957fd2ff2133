"""The response of a sensor: mean and variance of a level from its light.

In:  gain, rate, bend, and deviations of the light from its labels.
Out: expected means and variances, DN above the dark.
Sources: Janesick 2007 (photon transfer with a non-linear response): a signal s gives the mean g(s) and the variance
g'(s)^2 (K s + dark).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from etendue_camera.arrays import Array
from etendue_camera.electronics.emva import QUANTISATION


@dataclass(frozen=True)
class ResponseFit:
    """The fitted response. Errors are standard errors, scaled by the lack of fit."""

    gain: float  # DN/electron, at the dark
    rate: float  # DN per photon, or per unit of light, in the limit of no light
    bend: float
    order: float
    full: float  # DN above the dark where the bend is defined
    brightest: float  # light where ``lamp`` is defined
    offset: float = 0.0  # DN, of all light levels: light outside the exposure time
    lamp: float = 0.0  # relative excess of the brightest light over its label
    leak: float = 0.0  # DN/s, dark charge per time in excess of the exposure time of the only dark level
    floor: float | None = None  # DN^2, variance without light, if dark frames do not show it
    errors: dict[str, float] = field(default_factory=dict)
    tests: tuple[str, ...] = ()
    lack: tuple[float, float] = (1.0, 1.0)  # rms of residuals of means and variances over their own errors
    mean_scatter: float = 0.0  # relative scatter of the light, from means of neighbouring levels
    mean_error: float = 0.0  # relative error of means about the response
    used: Array = field(default_factory=lambda: np.zeros(0))
    freedom: float = 1.0

    def straight(self, light: Array) -> Array:
        """Return the signal that a sensor without non-linearity would give, DN."""
        return np.asarray(self.rate * light * (1 + self.lamp * light / self.brightest) + self.offset)

    def mean(self, light: Array, charge: Array | float = 0.0, after: Array | float = 0.0) -> Array:
        """Return the expected signal (DN) above a dark charge (DN), for an exposure that is ``after`` seconds longer
        than the exposure of the dark level.
        """
        s = self.straight(light) + self.leak * after
        return self.bent(s + charge) - self.bent(np.asarray(charge))

    def bent(self, s: Array) -> Array:
        return np.asarray(s * (1 - self.bend * (np.maximum(s, 0) / self.full) ** self.order))

    def slope(self, s: Array) -> Array:
        return np.asarray(1 - self.bend * (self.order + 1) * (np.maximum(s, 0) / self.full) ** self.order)

    def variance_at(self, signal: Array, dark: Array, charge: Array | float = 0.0) -> Array:
        """Return the expected temporal variance, DN^2. ``signal``: measured mean, DN above the dark level; ``dark``:
        temporal variance of the dark frames, DN^2; ``charge``: the part of the dark signal, DN, whose shot noise
        ``dark`` does not include.
        """
        signal = signal + charge
        s = signal
        if self.bend:
            most = self.full * (0.999 / (abs(self.bend) * (self.order + 1))) ** (1 / self.order)
            for _ in range(12):  # Newton; the loss is a few per cent
                s = np.clip(s - (s * (1 - self.bend * (np.maximum(s, 0) / self.full) ** self.order) - signal)
                            / np.maximum(self.slope(s), 1e-3), 0, most)  # fmt: skip
        dark = dark - QUANTISATION if self.floor is None else np.full(np.shape(signal), self.floor)
        return np.asarray(self.slope(s) ** 2 * (self.gain * s + dark) + QUANTISATION)
