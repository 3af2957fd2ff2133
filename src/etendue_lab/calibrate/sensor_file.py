"""The sensor file of a calibration, in the form of the packaged sensors.

In:  calibrated channels, the frames' digests.
Out: TOML: every value with its interval and the method by which it was measured.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable

import numpy as np

from etendue_camera.constants import ELEMENTARY_CHARGE
from etendue_camera.electronics.jackknife import Estimate
from etendue_lab.calibrate.edge_blur import EdgeBlur
from etendue_lab.calibrate.sensor_model import SensorModel
from etendue_lab.frames.frame_set import FrameSet

PITCH = 5.0  # um, if none is given
UNKNOWN = (
    ("read_noise", "read_noise", "0"),
    ("dsnu", "dsnu", "0"),
    ("dark_current", "dark_current_density", '"0 A cm-2"'),
)
QUIET = 1e-6  # written in place of 0, because 0 would select the default of the stage


class _Writer:
    """Lines of a sensor file, from calibrated channels."""

    def __init__(self, models: list[SensorModel]) -> None:
        self.models, self.lines = models, list[str]()

    def entry(self, table: str, key: str, value: object, note: str, source: str = "measured") -> None:
        self.lines += [
            f"[{table}.{key}]", f"value = {value}", f"source = {quoted(source)}", f"note = {quoted(note)}", "",
        ]  # fmt: skip

    def put(self, key: str, name: str, scale: float = 1.0, unit: str = "", table: str = "camera") -> None:
        """Write the mean of a value over the channels, with an interval that contains the intervals of all channels."""
        found = [model.values[name] for model in self.models if name in model.values]
        if not found:
            return
        value = float(np.mean([one.value for one in found])) * scale
        low, high = min(one.low for one in found) * scale, max(one.high for one in found) * scale
        how = next(model.how[name] for model in self.models if name in model.how)
        least = QUIET if key.startswith("sensor_") else 0.0 if table == "camera" else value
        shown = quoted(f"{max(value, least):.7g} {unit}") if unit else f"{max(value, least):.7g}"
        self.entry(table, key, shown, f"95 % interval {low:.5g} to {high:.5g}{' ' + unit if unit else ''}; {how}")


def text(
    models: list[SensorModel], frames: FrameSet, pitch: float | None, aperture: float, digests: dict[str, str],
    blur: EdgeBlur | None = None,
) -> str:  # fmt: skip
    """Return the text of the sensor file of a calibration. Measured charges are per pixel and do not depend on pitch
    and aperture.
    """
    area, file = (pitch or PITCH) ** 2, _Writer(models)
    about = f"{len(frames.frames)} frames of {frames.shape[1]} x {frames.shape[0]} pixels"
    file.lines += [
        f"title = {quoted(f'calibrated from {frames.path.stem or frames.path.name}')}",
        'kind = "calibrated"',
        f"description = {quoted(f'{about}; SHA-256 of their digests {digest_of(digests)[:16]}')}",
        "",
    ]
    _put_pixel(file, pitch, aperture, frames.pattern)
    _put_electronics(file)
    if any("dark_current" in model.values for model in models):
        file.put("dark_current_density", "dark_current", ELEMENTARY_CHARGE / (area * 1e-8), "A cm-2")
        file.put("sensor_dark_nonuniformity", "dark_nonuniformity")
    for name, key, zero in UNKNOWN:  # the value that the check used, rather than the default of other sensors
        if (need := models[0].needs.get(name)) and not any(name in model.values for model in models):
            file.entry("camera", key, zero, f"not known; frames needed: {need}", "typical")
    _put_full_well(models, area * aperture**2, file.entry, file.put)
    _put_efficiency(models, file.entry)
    for key, name, unit in (
        ("dsnu_in_all", "dsnu_total", "electron"),
        ("prnu_in_all", "prnu_total", ""),
        ("light_outside_the_exposure", "light_offset", "DN"),
        ("light_over_its_label", "light_excess", ""),
    ):
        file.put(key, name, 1.0, unit or "relative", "facts")
    _put_channels(models, file.entry)
    _waves(models[0], file.entry)
    if blur is not None:
        _put_lens(blur, file.entry)
    for number, one in enumerate(models[0].tests):
        file.entry("facts", f"test_{number + 1:02d}", quoted(one), f"channel {models[0].channel}", "definition")
    for number, (name, digest) in enumerate(sorted(digests.items())):
        file.entry("facts", f"frames_{number + 1:04d}", quoted(name), f"SHA-256 {digest}", "definition")
    return "\n".join(file.lines)


def _put_pixel(file: _Writer, pitch: float | None, aperture: float, pattern: str) -> None:
    note = "as given" if pitch else "assumed, because no --pitch was given; charges do not depend on it"
    file.entry("camera", "pixel_pitch", quoted(f"{pitch or PITCH:g} um"), note, "measured" if pitch else "typical")
    if aperture == 1:
        note = "densities and efficiency hold for the whole pixel"
        file.entry("camera", "aperture_fraction", "1.0", note, "definition")
    else:
        note = "as given; the efficiency holds for the light on the whole pixel"
        file.entry("camera", "aperture_fraction", f"{aperture:g}", note)
        file.entry("camera", "microlens_gain", f"{1 / aperture**2:.9g}", note, "definition")
    file.entry("camera", "pattern", quoted(pattern), "of the frames", "definition")


def _put_electronics(file: _Writer) -> None:
    models = file.models
    file.entry("camera", "bits", models[0].bits, f"highest code {max(model.curve.top for model in models)}")
    file.put("conversion_gain", "gain")
    for key in ("read_noise", "dsnu", "black_level"):
        file.put(key, key)
    bent = [model for model in models if model.response.bend > 0]
    if bent:
        file.put("response_bend", "bend")
        order = bent[0].response.order
        file.entry("camera", "response_order", f"{order:g}", "; ".join(bent[0].response.tests[:1]))
    file.put("sensor_prnu", "prnu")
    for key in ("row_noise", "column_noise", "row_pattern", "column_pattern"):
        file.put(f"sensor_{key}", key)


def _put_channels(models: list[SensorModel], entry: Callable[..., None]) -> None:
    """Write gain and black level of every channel, if there are several; the camera uses their means."""
    for model in models if len(models) > 1 else []:
        for name in ("gain", "black_level"):
            one = model.values[name]
            entry("facts", f"{name}_{model.channel.lower()}", f"{one.value:.7g}",
                  f"95 % interval {one.low:.5g} to {one.high:.5g} {one.unit}; channel {model.channel}")  # fmt: skip


def _put_lens(blur: EdgeBlur, entry: Callable[..., None]) -> None:
    """Write the blur of a lens, as the parameter of the stage lens_gaussian."""
    sigma = blur.sigma
    note = (
        f"95 % interval {sigma.low:.5g} to {sigma.high:.5g} um; parameter of the stage lens_gaussian: a sensor adds no "
        f"stage; from an edge at {blur.angle:.3g} degrees, MTF50 {blur.mtf50.value:.4g} cycles/pixel with the pixel, "
        f"which is divided out; charge diffusion, if any, counts as lens"
    )
    entry("facts", "lens", quoted(f"sigma = {sigma.value:.5g} um"), note)
    entry("facts", "edge_frame", quoted(blur.file), f"SHA-256 {blur.digest}", "definition")


def _put_full_well(
    models: list[SensorModel], area: float, entry: Callable[..., None], put: Callable[..., None]
) -> None:
    """Write the measured full well or, if the top code is reached first, a full well that never clips."""
    well = [model.values["full_well"] for model in models if "full_well" in model.values]
    if well:
        put("full_well_density", "full_well", 1 / area, "electron um-2")
    else:
        model = models[0]
        most = 1.2 * (2**model.bits - 1) / model.response.gain
        entry("camera", "full_well_density", quoted(f"{most / area:.6g} electron um-2"),
              "1.2 times the charge of the top code, which is reached first", "definition")  # fmt: skip


def _put_efficiency(models: list[SensorModel], entry: Callable[..., None]) -> None:
    """Write the quantum efficiency for the light of the calibration, if it is known for every channel."""
    efficiency = [model.values["quantum_efficiency"].value for model in models if "quantum_efficiency" in model.values]
    if len(efficiency) == len(models):
        letters = _by_letter(models, efficiency)
        entry("camera", "peak_qe", json.dumps([float(f"{min(one, 1.0):.6g}") for one in letters]),
              f"electrons per photon at the light used; {_interval(models, 'quantum_efficiency')}")  # fmt: skip
        entry(
            "camera",
            "sensitivity",
            quoted("flat"),
            "only one wavelength was measured: the same value is used at all wavelengths",
            "typical",
        )


def _waves(model: SensorModel, entry: object) -> None:
    """Write waves as parameters of a stage with the role of periodic patterns."""
    put = entry
    if model.dark is None or not callable(put):
        return
    waves, gain = model.dark.waves, model.response.gain
    if waves:
        stage = (
            f"amplitudes = {[float(f'{w.amplitude / gain:.5g}') for w in waves]}; "
            f"frequencies_y = {[float(f'{w.along_y:.7g}') for w in waves]}; "
            f"frequencies_x = {[float(f'{w.along_x:.7g}') for w in waves]}; "
            f"phases = {[float(f'{w.phase:.5g}') for w in waves]}"
        )
        put(
            "facts",
            "waves",
            quoted(stage),
            "parameters of a stage of the role 'periodic pattern'; a sensor adds no stage",
        )
    if model.dark.outliers or (model.light and model.light.outliers):
        bright = model.light.outliers if model.light else 0
        put("facts", "outliers", quoted(f"{model.dark.outliers} of the dark, {bright} of the response"),
            f"pixels beyond 5 robust standard deviations, of {model.dark.pixels}")  # fmt: skip


def _by_letter(models: list[SensorModel], values: list[float]) -> list[float]:
    found: dict[str, list[float]] = {}
    for model, value in zip(models, values, strict=True):
        found.setdefault(model.channel[0], []).append(value)
    return [float(np.mean(found[letter])) for letter in sorted(found, key="RGBW".find)]


def _interval(models: Iterable[SensorModel], name: str) -> str:
    found: list[Estimate] = [model.values[name] for model in models]
    return f"95 % interval {min(one.low for one in found):.5g} to {max(one.high for one in found):.5g}"


def digest_of(digests: dict[str, str]) -> str:
    """Return one digest of all files."""
    import hashlib

    joined = "\n".join(f"{digest}  {name}" for name, digest in sorted(digests.items()))
    return hashlib.sha256(joined.encode()).hexdigest()


def quoted(value: str) -> str:
    """Return a TOML string."""
    return json.dumps(value, ensure_ascii=True)


def number(value: float) -> float | None:
    """Return a number as JSON allows it: None if it is not finite."""
    return value if math.isfinite(value) else None
