"""Report of a measured sensor, and its JSON form.

In:  measurements by channel, and the values that the sensor's stages declare.
Out: a document: metrics with intervals beside expected values, and photon transfer curves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from etendue.types.documents import AxisValues, Document
from etendue_camera.electronics import emva

FIGURES = (
    "gain",
    "read_noise",
    "dark_current",
    "full_well",
    "dsnu",
    "prnu",
    "linearity_error",
    "saturation_capacity",
    "absolute_sensitivity",
    "dynamic_range",
    "snr_max",
    "quantum_efficiency",
)
# range over metrics of the share of intervals that held the true value: benchmarks/emva.py, 900 sensors of 2 kinds
SIMULATED = (0.93, 0.97)
HIDDEN = ("read_noise", "dark_current", "dsnu")  # metrics that are wrong if rounding hides the dark noise
SHEET = ("gain", "read_noise", "dark_current", "full_well", "prnu", "quantum_efficiency")
# Metrics whose uncertainty includes the step between levels, which the interval over pixels does not contain.
STEPPED = (
    "saturation_capacity",
    "dynamic_range",
    "snr_max",
)
UNITS = {
    "gain": "DN/electron",
    "read_noise": "electron",
    "dark_current": "electron/s",
    "full_well": "electron",
    "dsnu": "electron",
    "saturation_capacity": "electron",
    "absolute_sensitivity": "electron",
    "dynamic_range": "dB",
    "snr_max": "dB",
    "quantum_efficiency": "electron/photon",
}


class Expected(dict[str, float]):
    """Expected values of metrics, as far as known."""

    @classmethod
    def of(cls, sheet: Mapping[str, float], time: float) -> Expected:
        """Derive the expected values from what stages declare. ``time``: exposure time (s) of the level at which
        patterns are measured.
        """
        found = cls({name: sheet[name] for name in SHEET if name in sheet})
        if "dsnu" in sheet:
            found["dsnu"] = math.hypot(sheet["dsnu"], sheet.get("dark_spread", 0.0) * time)
        if {"gain", "read_noise"} <= set(sheet):
            floor = math.sqrt(sheet["read_noise"] ** 2 + emva.QUANTISATION / sheet["gain"] ** 2)
            found["absolute_sensitivity"] = math.hypot(floor, 0.5) + 0.5
        if {"absolute_sensitivity", "full_well"} <= set(found):
            capacity = (
                emva.saturation_of_well(found["full_well"], sheet.get("prnu", 0.0))
                - sheet.get("dark_current", 0.0) * time
            )
            if capacity > 0:
                found["saturation_capacity"] = capacity
                found["dynamic_range"] = 20 * math.log10(capacity / found["absolute_sensitivity"])
                found["snr_max"] = 10 * math.log10(capacity)
        return found


@dataclass
class SensorChannel:
    """One channel of one camera of a sweep; ``measurement`` is None if there is no photon transfer curve, for the
    reason in ``why``.
    """

    at: AxisValues
    channel: str
    measurement: emva.SensorFigures | None
    times: tuple[float, ...]
    expected: Mapping[str, float]
    why: str = ""

    def rows(self) -> list[Document]:
        """Return a row per metric: ``held`` says whether the interval of the metric contains the expected value;
        ``held`` is None if there is no expected value.
        """
        found = []
        hidden = self.measurement is not None and self.measurement.hidden
        for name in FIGURES if self.measurement is not None else ():
            estimate = getattr(self.measurement, name)
            expected = self.expected.get(name)
            known = (
                expected is not None
                and name not in STEPPED
                and not math.isnan(estimate.low)
                and not math.isnan(estimate.high)
            )
            held = bool(estimate.low <= expected <= estimate.high) if known and expected is not None else None
            found.append(
                {
                    "figure": name,
                    "unit": UNITS.get(name, "1"),
                    "value": estimate.value,
                    "low": estimate.low,
                    "high": estimate.high,
                    "expected": expected,
                    "held": held,
                    "covered": not (hidden and name in HIDDEN),
                }
            )
        return found

    def curve(self) -> Document:
        """Return the photon transfer curve; ``fit`` is the line through the origin with the gain as its slope."""
        one = self.measurement
        if one is None:
            return {}
        return {
            "integration_time": list(self.times),
            "signal": one.signal.tolist(),
            "variance": one.variance.tolist(),
            "fit": (one.gain.value * np.asarray(one.signal)).tolist(),
            "dark_mean": one.dark_mean.tolist(),
            "dark_variance": one.dark_variance.tolist(),
            "pattern_level": one.pattern_level,
        }


@dataclass
class EmvaReport:
    """All channels of all cameras."""

    pipeline: str
    channels: list[SensorChannel]
    notes: list[str] = field(default_factory=list)

    def document(self) -> Document:
        """Return the report as JSON: ``channels`` has an element for every channel of every camera of a sweep."""
        return {
            "pipeline": self.pipeline,
            "standard": "EMVA 1288 release 4, linear",
            "confidence": 0.95,
            "simulated": list(SIMULATED),
            "channels": [
                {
                    "at": dict(c.at),
                    "channel": c.channel,
                    "figures": c.rows(),
                    "photon_transfer": c.curve(),
                    "why": c.why,
                }
                for c in self.channels
            ],
            "notes": self.notes,
        }
