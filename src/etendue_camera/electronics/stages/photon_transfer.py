"""The photon transfer curve of one exposure series, and the EMVA 1288 metrics that follow from it.

In:  ``raw`` (frame, y, x), DN, under uniform light; the time of each frame.
Out: signal and variance by channel and level, the fitted line, metrics with 95 % intervals.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue.api import Grid, Labels, Stage, measured, param, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics import emva
from etendue_camera.sensor import cfa
from etendue_camera.sensor.stages.masks import first_pixel, mask_of

ESTIMATE = Labels(("value", "low", "high"))
DARK = 1e-6  # of the longest time; shorter frames count as dark
FIGURES = {
    "emva_gain": "gain",
    "emva_read_noise": "read_noise",
    "emva_full_well": "full_well",
    "emva_saturation": "saturation_capacity",
    "emva_dsnu": "dsnu",
    "emva_prnu": "prnu",
    "emva_linearity_error": "linearity_error",
    "emva_sensitivity": "absolute_sensitivity",
    "emva_dynamic_range": "dynamic_range",
    "emva_snr_max": "snr_max",
}


@dataclass(frozen=True, kw_only=True)
class PhotonTransfer(Stage):
    """Measure the photon transfer curve of every channel, from frames of a uniform scene that ``bracket`` takes.

    A level is ``repeats`` consecutive frames, as ``bracket`` takes them; surplus frames are ignored. The first level
    must be dark (a bracket of -30 stops receives no light). All metrics except the curve are NaN without a dark level,
    with fewer than four other levels, with fewer than 8 x 8 pixels per channel, or if the signal does not rise. If
    nothing saturates, full well and saturation are NaN.

    ``transfer_signal`` is the mean above dark and ``transfer_variance`` the temporal variance with the dark variance
    subtracted; ``transfer_fit`` is the line through the origin with slope ``emva_gain``
    (`etendue_camera.electronics.emva`). Dark-current charge counts as signal here: the exposure time of the dark level
    is practically zero, so subtracting that level does not remove the dark-current charge of the others. ``etendue
    emva`` takes dark frames at every time, and so measures the dark current.
    """

    role: ClassVar = "figures"
    reads: ClassVar = {"raw": "frame y x [DN] uint16", "integration_time": "frame [s]"}
    writes: ClassVar = {
        "transfer_time": "level [s] nan",
        "transfer_signal": "channel level [DN] nan",
        "transfer_variance": "channel level [DN2] nan",
        "transfer_fit": "channel level [DN2] nan",
        "emva_gain": "channel estimate [DN/electron] nan",
        "emva_read_noise": "channel estimate [electron] nan",
        "emva_full_well": "channel estimate [electron] nan",
        "emva_saturation": "channel estimate [electron] nan",
        "emva_dsnu": "channel estimate [electron] nan",
        "emva_prnu": "channel estimate [1] nan",
        "emva_linearity_error": "channel estimate [1] nan",
        "emva_sensitivity": "channel estimate [electron] nan",
        "emva_dynamic_range": "channel estimate [dB] nan",
        "emva_snr_max": "channel estimate [dB] nan",
    }
    creates: ClassVar = {"estimate": ESTIMATE}
    decides: ClassVar = True
    nanoseconds: ClassVar = 600.0
    working: ClassVar = 0.3
    error: ClassVar = measured(1e-6, 1e-12)

    pattern: str = quantity("pattern")
    repeats: int = param(2, at_least=2, at_most=10_000, doc="frames per level, as in the stage bracket")

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        frames = inputs["raw"]["frame"].size
        if frames < self.repeats:
            raise ValueError(
                f"there are {frames} frames, and a level has {self.repeats}: give this stage the same repeats as the "
                "stage bracket"
            )
        curve = Grid.of(
            {"channel": Labels(mask_of(self.pattern).channels), "level": Labels(tuple(range(frames // self.repeats)))}
        )
        figures = Grid.of({"channel": curve["channel"], "estimate": ESTIMATE})
        curves = ("transfer_signal", "transfer_variance", "transfer_fit")
        return {
            "transfer_time": curve.take(("level",)),
            **dict.fromkeys(curves, curve),
            **dict.fromkeys(FIGURES, figures),
        }

    def run(self, raw: FloatArray, integration_time: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
        mask, levels = mask_of(self.pattern), len(raw) // self.repeats
        whole = levels * self.repeats
        stacks = raw[:whole].reshape(levels, self.repeats, *raw.shape[1:])
        times = np.asarray(integration_time, dtype=float)[:whole].reshape(levels, self.repeats)
        found: dict[str, Array] = {name: np.full((len(mask.channels), 3), np.nan) for name in FIGURES}
        curve = {name: np.full((len(mask.channels), levels), np.nan) for name in ("signal", "variance", "fit")}
        one_time = bool(np.all(times == times[:, :1]))
        for number, channel in enumerate(mask.channels):
            own = cfa.frames_of_channel(stacks, mask, channel, *first_pixel(y, x))
            if not own.size or not one_time:
                continue
            mean = own.mean(axis=(1, 2, 3), dtype=np.float64)
            noise = own.astype(np.float64).var(axis=1, ddof=1).mean(axis=(1, 2))
            curve["signal"][number], curve["variance"][number] = mean - mean[0], noise - noise[0]
            measurement = _measured(times[:, 0], own)
            if measurement is None:
                continue
            curve["fit"][number] = measurement.gain.value * curve["signal"][number]
            for name, figure in FIGURES.items():
                estimate = getattr(measurement, figure)
                found[name][number] = estimate.value, estimate.low, estimate.high
        time = times[:, 0] if one_time else np.full(levels, np.nan)
        return {"transfer_time": time, **{f"transfer_{name}": values for name, values in curve.items()}, **found}


def _measured(times: Array, stacks: Any) -> emva.SensorFigures | None:
    """Measure a sensor from levels (level, frame, y, x), the first of them dark; None without a photon transfer
    curve.
    """
    if len(times) < 5 or not 0 <= times[0] < DARK * times[1:].min():
        return None
    order = np.argsort(times[1:]) + 1
    try:
        with np.errstate(all="ignore"):
            return emva.measure(times[order], stacks[order], [stacks[0]] * len(order))
    except ValueError:  # raised by the kernel for frames without a curve
        return None
