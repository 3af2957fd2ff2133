"""Frames of a calibrated sensor, with the kernels of the camera's stages.

In:  a calibrated sensor, a level.
Out: raw frames (frame, y, x), DN.
"""

from __future__ import annotations

import math

import numpy as np

from etendue_camera.arrays import Array
from etendue_camera.electronics import converter, noise, response
from etendue_lab.calibrate.pattern_fit import PatternFit, drawn
from etendue_lab.calibrate.sensor_model import SensorModel


class SimulatedSensor:
    """A sensor with the parameters of a calibration and newly drawn fixed patterns."""

    def __init__(self, model: SensorModel, shape: tuple[int, int], seed: int = 0) -> None:
        self.model, self.shape = model, shape
        self._rng = np.random.default_rng(seed)
        normal = self._rng.standard_normal
        gain = model.response.gain
        self.response = 1 + self.value("prnu") * normal(shape)
        self.offset = np.zeros(shape)
        if model.light is not None:
            self.response += drawn(model.light.surface, shape)
            self._add_outliers(self.response, model.light, 1.0)
        if model.dark is not None:
            self._add_outliers(self.offset, model.dark, 1 / gain)
        self.offset += self.value("dsnu") * normal(shape)
        self.leak = np.maximum(1 + self.value("dark_nonuniformity") * normal(shape), 0)
        self.offset += self.value("row_pattern") * normal((shape[0], 1)) + self.value("column_pattern") * normal(
            shape[1]
        )
        for wave in model.dark.waves if model.dark else ():
            self.offset += wave.drawn(shape) / gain

    def _add_outliers(self, plane: Array, found: PatternFit, scale: float) -> None:
        """Add measured outlier values to random pixels. The fraction of outliers is the measured fraction."""
        if found.outliers:
            count = self._rng.binomial(plane.size, found.outliers / found.pixels)
            where = self._rng.integers(0, plane.size, count)
            plane.ravel()[where] += scale * self._rng.choice(found.outlier_values, count)

    def value(self, name: str) -> float:
        return self.model.values[name].value if name in self.model.values else 0.0

    def ceiling(self) -> float:
        """Return the signal of a full well, DN above the dark; infinite if it is not known."""
        fit, well = self.model.response, self.value("full_well")
        if not well:
            return math.inf
        return float(response.bent(np.array(well), max(fit.bend, 0.0), fit.order, fit.full / fit.gain)) * fit.gain

    def light_of(self, signal: float) -> float:
        """Return the light, in the unit of the calibration, that gives a mean signal (DN above the dark)."""
        fit = self.model.response
        straight = response.unbent(signal / fit.gain, max(fit.bend, 0.0), fit.order, fit.full / fit.gain) * fit.gain
        proportional = max((float(straight) - fit.offset) / fit.rate, 0.0)
        if not fit.lamp:
            return proportional
        share = 4 * fit.lamp * proportional / fit.brightest
        # Positive root of L (1 + a L / L_max) = proportional.
        return 2 * proportional / (1 + math.sqrt(max(1 + share, 0.0)))

    def frames(self, time: float, light: float, count: int) -> Array:
        """Return frames of one exposure, DN. ``light`` has the unit of the calibration; 0 gives dark frames."""
        fit, rng = self.model.response, self._rng
        dark = max(self.value("dark_current") * time, 0.0) if time == time else 0.0
        photo = float(fit.straight(np.array(light))) / fit.gain if light > 0 else 0.0
        expected = np.broadcast_to(np.maximum(photo * self.response, 0) + dark * self.leak, (count, *self.shape))
        charge = noise.poisson(np.ascontiguousarray(expected), rng)
        charge = charge + self.value("read_noise") * rng.standard_normal(charge.shape) + self.offset
        charge += self.value("row_noise") * rng.standard_normal((count, self.shape[0], 1))
        charge += self.value("column_noise") * rng.standard_normal((count, 1, self.shape[1]))
        if "full_well" in self.model.values:
            charge = np.minimum(charge, self.value("full_well"))
        charge = response.bent(charge, max(fit.bend, 0.0), fit.order, fit.full / fit.gain)
        return converter.digitise(charge, fit.gain, self.value("black_level"), self.model.bits)
