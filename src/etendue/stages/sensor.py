"""The sensor: light to photocurrent, in front of exposure.

In:  ``irradiance`` on the image-plane grid (um).
Out: ``photon_rate`` (channel, y, x) and ``photocurrent`` (y, x), electron/s, on the pixel grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import spectra
from etendue.api import RGB, Facts, Grid, Line, Stage, hookimpl, param, quantity
from etendue.physics import mosaic, photodiode, silicon
from etendue.physics.sampling import on_unique_rows
from etendue.stages.sensitivity import electrons_per_irradiance


@dataclass(frozen=True, kw_only=True)
class Diffusion(Stage):
    """Charge that wanders before it is collected: D(f)/D(0) of the photodiode (eqs. 6-8) by wavelength."""

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar = 1.2  # 1.09 at worst, on a grid that cuts its transfer function off
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0

    depletion_depth: float = quantity("depletion_depth")
    diffusion_depth: float = quantity("diffusion_depth")
    diffusion_length: float = quantity("diffusion_length")
    back: str = param("absorbing", choices=("absorbing", "reflecting"), doc="what happens to electrons at the back")

    def transfer(self, fy: Any, fx: Any, wavelength: Any) -> Any:
        alphas = silicon.absorption(np.ravel(wavelength))

        def rows(some: Any) -> Any:
            radial = np.hypot(some, fx)
            return np.stack(
                [
                    photodiode.collection_mtf(
                        radial,
                        float(a),
                        self.depletion_depth,
                        self.diffusion_depth,
                        self.diffusion_length,
                        self.back,  # type: ignore[arg-type]
                    )
                    for a in alphas
                ]
            )

        return on_unique_rows(rows, fy)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        return (0.0, "the scene is uniform: diffusion changes nothing") if facts.uniform else None

    def carry(self, facts: Any, grid: Any) -> Facts:
        """As for every blur: only a uniform plane is sure to stay in its range."""
        return facts["irradiance"] if facts["irradiance"].uniform else Facts(uniform=facts["irradiance"].uniform)

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return (1e-6 if precision == "float32" else 2e-14), "measured"


@dataclass(frozen=True, kw_only=True)
class Pixel(Stage):
    """Light on each pixel's photodiode, summed over wavelength, at the pixel centres.

    What lies beyond the pixel's Nyquist frequency folds back: aliasing is part of the answer. The number of pixels
    is fixed (``rows``, ``columns``), or follows from a fixed sensor (``sensor_height``, ``sensor_width``), or is
    that of the scene's samples (``sampling = "paper"``).
    """

    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"photon_rate": "channel y x [electron/s]"}
    gain: ClassVar = 41.0  # interpolation between samples by pixels smaller than their spacing, 10000 x 10000; 1.4 from two samples on
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 8.0
    libraries: ClassVar = ("colour-science",)

    pixel_pitch: float = quantity("pixel_pitch")
    aperture_fraction: float = quantity("aperture_fraction")
    sensitivity: str = quantity("sensitivity")
    sensitivity_kind: str = quantity("sensitivity_kind")
    sensitivity_per: str = quantity("sensitivity_per")
    peak_qe: tuple[float, ...] = quantity("peak_qe")
    depletion_depth: float = quantity("depletion_depth")
    diffusion_depth: float = quantity("diffusion_depth")
    diffusion_length: float = quantity("diffusion_length")
    surface_transmission: float = quantity("surface_transmission")
    sampling: str = param("physical", choices=("physical", "paper"), doc="pixels of their own, or one scene sample = one pixel")
    rows: int = param(0, at_least=0, doc="pixels along y; 0: as many as the sensor's size or the light hold")
    columns: int = param(0, at_least=0, doc="pixels along x")
    sensor_height: float = param(0.0, units="mm", at_least=0, doc="fixed size of the sensor; 0: not fixed")
    sensor_width: float = param(0.0, units="mm", at_least=0)
    first_row: int = param(0, doc="first row of the window that is read")
    first_column: int = param(0, doc="first column of the window that is read")
    window_rows: int = param(0, at_least=0, doc="rows of the window; 0: all")
    window_columns: int = param(0, at_least=0, doc="columns of the window; 0: all")

    def __post_init__(self) -> None:
        spectra.check_camera(self.sensitivity)

    def grid(self, inputs: Any) -> dict[str, Grid]:
        light = inputs["irradiance"]
        lines = {
            "y": self._line(light.line("y"), self.rows, self.sensor_height, self.first_row, self.window_rows, "rows", "sensor_height"),
            "x": self._line(
                light.line("x"), self.columns, self.sensor_width, self.first_column, self.window_columns, "columns", "sensor_width"
            ),
        }
        return {"photon_rate": Grid.of({"channel": RGB, **lines})}

    def _line(self, light: Line, count: int, size_mm: float, first: int, window: int, what: str, size_name: str) -> Line:
        if self.sampling == "paper":
            if abs(light.step - self.pixel_pitch) > 1e-9 * self.pixel_pitch:
                raise ValueError(
                    f"sampling 'paper' takes one scene sample for one pixel, but the scene's spacing is {light.step:g} um and the pitch "
                    f"{self.pixel_pitch:g} um; make them equal, or use sampling = 'physical'"
                )
            return Line(light.size, 0.0, 1.0, "1", (light.start, light.step))
        if count and size_mm:
            raise ValueError(f"{what} and {size_name} are both given; one follows from the other and the pitch")
        length = light.size * light.step
        total = count or (math.floor(size_mm * 1e3 / self.pixel_pitch + 1e-9) if size_mm else math.floor(length / self.pixel_pitch + 1e-9))
        size = window or total - first
        centre = light.start + 0.5 * (light.size - 1) * light.step
        start = centre + (first - 0.5 * (total - 1)) * self.pixel_pitch
        low, high = start - 0.5 * self.pixel_pitch, start + (size - 0.5) * self.pixel_pitch
        if size < 1 or low < light.start - 0.5 * light.step - 1e-6 or high > light.start + (light.size - 0.5) * light.step + 1e-6:
            raise ValueError(
                f"{size} pixels of {self.pixel_pitch:g} um reach from {low:g} to {high:g} um, but the scene's light is {length:g} um long; "
                f"widen the scene or take fewer {what}"
            )
        return Line(size, float(first), 1.0, "1", (start, self.pixel_pitch))

    def prepare(self, coordinates: Any) -> Any:
        return electrons_per_irradiance(self, tuple(coordinates["wavelength_edges"]))

    def transfer(self, fy: Any, fx: Any, wavelength: Any, prepared: Any) -> Any:
        width = self.pixel_pitch * self.aperture_fraction
        return (photodiode.aperture_otf(fy, width) * photodiode.aperture_otf(fx, width))[None]

    def weights(self, prepared: Any) -> Any:
        return prepared

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Of the sum over wavelength and the evaluation between samples: 3e-6 at worst, up to 1024 x 1500."""
        return (5e-6 if precision == "float32" else 2e-14), "measured"

    def carry(self, facts: Any, grid: Any) -> Facts:
        return Facts(uniform=facts["irradiance"].uniform, contrast=None)


@dataclass(frozen=True, kw_only=True)
class Mosaic(Stage):
    """The colour filter array: each pixel keeps one channel."""

    reads: ClassVar = {"photon_rate": "channel y x [electron/s]"}
    writes: ClassVar = {"photocurrent": "y x [electron/s]"}
    gain: ClassVar = 1.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 1.0

    pattern: str = quantity("pattern")

    def run(self, photon_rate: Any) -> dict[str, Any]:
        return {"photocurrent": mosaic.pick(photon_rate, self.pattern)}

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        return 0.0, "proved"


@hookimpl
def etendue_stages() -> dict[str, type]:
    return {"diffusion": Diffusion, "pixel": Pixel, "mosaic": Mosaic}
