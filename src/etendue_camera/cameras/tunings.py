"""Read sensor tunings of libcamera for the Raspberry Pi: black level, full scale, gain, shading, colour matrices.

In:  the JSON of one tuning (``src/ipa/rpi/vc4/data``).
Out: ``Tuning``.
Source: ``rpi.noise`` is std = slope sqrt(mean) of raw patches scaled to 16 bits. A Poisson count of K DN per electron
has std = sqrt(K mean), so K = slope^2 and full scale is (65535 - black) / slope^2 electrons.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue_camera.arrays import FloatArray

SOURCE = "https://github.com/raspberrypi/libcamera"
LICENCE = "BSD-2-Clause"
TOP = 65535
GRID = (12, 16)  # rows and columns of the shading tables of target bcm2835
DEFAULTS = (2.5, 2.67)  # noise slopes that many files contain as unmeasured defaults


@dataclass(frozen=True)
class Tuning:
    """The values that a tuning has for a sensor; None if the tuning has no such value.

    ``black`` is in 16 bits, ``slope`` in sqrt(DN) of 16 bits at analogue gain 1, ``shading`` the gains (12, 16) that
    flatten the luminance of the module's lens, ``matrices`` colour matrices by colour temperature, ``lux`` the
    reference (lux, exposure s, gain, mean DN of 16 bits).
    """

    black: float
    slope: float | None
    constant: float
    largest_gain: float | None
    shading: FloatArray | None
    matrices: tuple[tuple[float, FloatArray], ...]
    lux: tuple[float, float, float, float] | None

    def full_scale(self) -> float | None:
        """Return the charge (electron) of a pixel at the top code and analogue gain 1."""
        return (TOP - self.black) / self.slope**2 if self.slope else None

    def gain(self, bits: int) -> float | None:
        """Return the conversion gain (DN/electron) of a converter with this many bits at analogue gain 1; an analogue
        gain g multiplies it by g.
        """
        return self.slope**2 * (2**bits - 1) / TOP if self.slope else None

    def looks_like_a_default(self) -> bool:
        """Return whether the noise slope is one that many files contain as an unmeasured default."""
        return self.slope is not None and any(abs(self.slope - one) < 5e-3 for one in DEFAULTS)

    def fall_off(self) -> tuple[FloatArray, FloatArray] | None:
        """Return, for each cell of the shading table, its distance from the centre over half the diagonal, and the
        relative illumination there.
        """
        if self.shading is None:
            return None
        rows, columns = self.shading.shape
        y = (np.arange(rows) + 0.5) / rows * 2 - 1
        x = (np.arange(columns) + 0.5) / columns * 2 - 1
        aspect = columns / rows
        r = np.hypot(y[:, None], aspect * x[None, :]) / math.hypot(1, aspect)
        return r.ravel(), (self.shading.min() / self.shading).ravel()


def tuning(data: bytes, name: str) -> Tuning:
    """Return the tuning in a file's content.

    Raises
    ------
    ValueError
        If the file is not a tuning, or a number is out of range; the message has one line.
    """
    try:
        document = json.loads(data)
        if document.get("version") != 2.0 or not isinstance(document.get("algorithms"), list):
            raise ValueError("it has no version 2.0 with algorithms")
        parts = {key: own for one in document["algorithms"] for key, own in one.items()}
        if document.get("target") != "bcm2835":
            raise ValueError(
                f"its target is {str(document.get('target'))[:20]!r}; only bcm2835 (vc4) is read: slopes of pisp are "
                "about 1.4 times larger"
            )
        noise, gains = parts.get("rpi.noise"), _gains(parts.get("rpi.agc", {}))
        lux = parts.get("rpi.lux")
        return Tuning(
            black=_number(parts["rpi.black_level"]["black_level"], 0, TOP / 2),
            slope=_number(noise["reference_slope"], 1e-3, 1e3) if noise else None,
            constant=_number(noise["reference_constant"], 0, 1e5) if noise else 0.0,
            largest_gain=max(gains, default=None),
            shading=_shading(parts.get("rpi.alsc", {})),
            matrices=tuple(
                (_number(one["ct"], 500, 3e4), np.array([_number(v, -100, 100) for v in one["ccm"]]).reshape(3, 3))
                for one in parts.get("rpi.ccm", {}).get("ccms", [])
            ),
            lux=None
            if lux is None
            else (
                _number(lux["reference_lux"], 1e-3, 1e7),
                1e-6 * _number(lux["reference_shutter_speed"], 1e-3, 1e10),
                _number(lux["reference_gain"], 1e-3, 1e4),
                _number(lux["reference_Y"], 1e-3, TOP),
            ),
        )
    except KeyError as error:
        raise ValueError(f"{name} is not a tuning of libcamera: {error} is missing") from None
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{name} is not a tuning of libcamera: {' '.join(str(error).split())[:200]}") from None


def _number(value: Any, low: float, high: float) -> float:
    if isinstance(value, bool | str) or not low <= float(value) <= high:
        raise ValueError(f"expected a number from {low:g} to {high:g}, got {str(value)[:40]}")
    return float(value)


def _gains(agc: Any) -> list[float]:
    channels = agc.get("channels", [agc])
    modes = [mode for one in channels for mode in one.get("exposure_modes", {}).values()]
    return [_number(gain, 1e-3, 1e4) for mode in modes for gain in mode.get("gain", [])]


def _shading(alsc: Any) -> FloatArray | None:
    if "luminance_lut" not in alsc:
        return None
    values = [_number(v, 1e-3, 1e3) for v in alsc["luminance_lut"]]
    if len(values) != GRID[0] * GRID[1]:
        raise ValueError(f"luminance_lut has {len(values)} numbers, expected {GRID[0] * GRID[1]}")
    return np.array(values).reshape(GRID)
