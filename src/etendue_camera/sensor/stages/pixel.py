"""The sensor: light on the photodiodes, behind each filter.

In:  ``irradiance`` on the image-plane grid (um).
Out: ``photon_rate`` (channel, y, x), electron/s, on the pixel grid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from etendue import require
from etendue.api import Bounded, Facts, Grid, Labels, Line, Stage, Summed, Transfer, measured, param, quantity
from etendue.contract.stage import state_of
from etendue.transfer.sampling import on_unique_rows
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.roles import CROSSTALK, InSilicon
from etendue_camera.sensor import photodiode, silicon
from etendue_camera.sensor.stages import missing
from etendue_camera.sensor.stages.sensitivity import (
    FLAT,
    SEEN_BY,
    Collecting,
    collection_at_zero,
    cut_off_notes,
    electrons_per_irradiance,
    peaks_note,
    quantum_efficiency,
    shares,
    unused_notes,
)

TABLES = 3e-7  # largest difference of tabulated transfer functions whose tables end at different frequencies; measured
MEAN = 0.7  # lower bound of the mean over pixels relative to the mean of the light; apertures leave gaps between pixels


@dataclass(frozen=True, kw_only=True)
class Diffusion(Transfer, Bounded, InSilicon):
    """Blur by charge diffusion before collection: D(f)/D(0) of the photodiode (eqs. 6-8) at each wavelength."""

    role: ClassVar = "diffusion"
    once: ClassVar = ("diffusion of charge",)
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    gain: ClassVar = 1.2  # at most 1.09, on a grid that truncates its transfer function
    radial: ClassVar = True
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 5.0

    depletion_depth: float = quantity("depletion_depth")
    diffusion_depth: float = quantity("diffusion_depth")
    diffusion_length: float = quantity("diffusion_length")
    back: str = quantity("back")
    crosstalk: str = quantity("crosstalk")
    nodes: int = param(
        4096,
        at_least=0,
        at_most=1_000_000,
        fidelity=True,
        reference="0: evaluated at every frequency",
        settings=(64, 128, 256, 512, 1024, 4096, 0),
        costs=(0.85, 0.85, 0.86, 0.88, 0.9, 1.0, 1.6),
        doc="number of radial frequencies at which D is evaluated for a whole frame, with cubic interpolation between "
        "them",
    )

    def transfer(self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray) -> FloatArray:
        if self.crosstalk == "through_filter":
            return np.ones((1, np.size(fy), np.size(fx)))
        alphas = silicon.absorption(np.ravel(wavelength))
        diode = (self.depletion_depth, self.diffusion_depth, self.diffusion_length, self.back)

        def contrast(rows: FloatArray) -> FloatArray:
            radial = np.hypot(rows, fx)
            return photodiode.collection_mtf_bands(radial, alphas, *diode, self.nodes)  # type: ignore[arg-type]

        return on_unique_rows(contrast, fy)

    def negligible(self, facts: Facts, grid: Grid) -> tuple[float, str] | None:
        if self.crosstalk == "through_filter":
            return (
                0.0,
                "charge diffuses across filters (crosstalk = through_filter), in the stage crosstalk after the mosaic",
            )
        return (0.0, "the scene is uniform: diffusion changes nothing") if facts.uniform else None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Keep the range only if the plane is uniform, because a blur changes the range of any other plane."""
        return facts["irradiance"] if facts["irradiance"].uniform else Facts(uniform=facts["irradiance"].uniform)

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        table = 1e-12 * (4096 / self.nodes) ** 4 if self.nodes else 0.0
        return table + (1e-6 if precision == "float32" else 2e-14), "fitted" if table else "measured"


class _Extent(NamedTuple):
    """The number of pixels along one axis, and the window that is read."""

    pixels: int
    size_mm: float
    first: int
    window: int
    what: str
    size_name: str


@dataclass(frozen=True, kw_only=True)
class Pixel(Collecting, Summed):
    """Integrate light over each pixel's light-sensitive square and sum over wavelength, at the pixel centres.

    Content beyond the pixel's Nyquist frequency folds back: aliasing is part of the result. The number of pixels is
    fixed (``rows``, ``columns``), or follows from the sensor size (``sensor_height``, ``sensor_width``), or equals the
    number of scene samples (``sampling = "paper"``).
    """

    role: ClassVar = "pixel"
    handed: ClassVar = True  # aperture_offset_x and aperture_offset_y shift the light-sensitive area of each pixel
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"photon_rate": "channel y x [electron/s]"}
    # worst case: pixels smaller than the sample spacing, which interpolate, 10000 x 10000; 1.4 from two samples on
    gain: ClassVar = 41.0
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 8.0
    libraries: ClassVar = ("colour-science",)
    # Error of the sum over wavelength and of the evaluation between samples: at most 3e-6, up to 1024 x 1500.
    error: ClassVar = measured(5e-6, 2e-14)

    sampling: str = param(
        "physical",
        choices=("physical", "paper"),
        doc="physical: independent pixel grid; paper: one scene sample = one pixel",
    )
    rows: int = param(0, at_least=0, doc="pixels along y; 0: as many as fit the sensor size or the light")
    columns: int = param(0, at_least=0, doc="pixels along x; 0: as many as fit")
    sensor_height: float = param(0.0, units="mm", at_least=0, doc="sensor height; 0: not fixed")
    sensor_width: float = param(0.0, units="mm", at_least=0)
    first_row: int = param(0, doc="first row of the window that is read")
    first_column: int = param(0, doc="first column of the window that is read")
    window_rows: int = param(0, at_least=0, doc="rows of the window; 0: all")
    window_columns: int = param(0, at_least=0, doc="columns of the window; 0: all")
    wavelength_terms: int = param(
        0,
        at_least=0,
        at_most=32,
        fidelity=True,
        reference="0: a transform for every band",
        settings=(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 20, 24, 32, 0),
        doc="number of planes into which the bands are combined before the transforms, at least the number of "
        "channels; 7 to 9 suit most lenses",
    )
    kept_frequencies: float = param(
        1.0,
        above=0,
        at_most=1,
        fidelity=True,
        exact=True,
        reference="1: all frequencies of the grid",
        settings=(0.125, 0.1875, 0.25, 0.375, 0.5, 0.75, 1.0),
        costs=(0.23, 0.24, 0.25, 0.26, 0.27, 0.35, 1.0),
        doc="frequency above which light is left out, as a fraction of the grid's Nyquist frequency",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require.that(
            not 0 < self.wavelength_terms < len(self.channels),
            f"wavelength_terms is {self.wavelength_terms}, but the sensor has {len(self.channels)} channels; use "
            f"at least as many terms, or 0",
        )

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        light = inputs["irradiance"]
        down = _Extent(self.rows, self.sensor_height, self.first_row, self.window_rows, "rows", "sensor_height")
        across = _Extent(
            self.columns, self.sensor_width, self.first_column, self.window_columns, "columns", "sensor_width"
        )
        lines = {"y": self._line(light.line("y"), down), "x": self._line(light.line("x"), across)}
        return {"photon_rate": Grid.of({"channel": Labels(self.channels), **lines})}

    def _line(self, light: Line, side: _Extent) -> Line:
        count, size_mm, first, window, what, size_name = side
        if self.sampling == "paper":
            if abs(light.step - self.pixel_pitch) > 1e-9 * self.pixel_pitch:
                raise ValueError(
                    f"sampling = 'paper' maps one scene sample to one pixel, but the scene's spacing is {light.step:g} "
                    f"um and the pitch "
                    f"{self.pixel_pitch:g} um; make them equal, or use sampling = 'physical'"
                )
            return Line(light.size, 0.0, 1.0, "1", (light.start, light.step))
        require.that(not count or not size_mm, f"{what} and {size_name} are both given; give only one of them")
        length = light.size * light.step
        total = count or (
            math.floor(size_mm * 1e3 / self.pixel_pitch + 1e-9)
            if size_mm
            else math.floor(length / self.pixel_pitch + 1e-9)
        )
        size = window or total - first
        centre = light.start + 0.5 * (light.size - 1) * light.step
        start = centre + (first - 0.5 * (total - 1)) * self.pixel_pitch
        low, high = start - 0.5 * self.pixel_pitch, start + (size - 0.5) * self.pixel_pitch
        if not total:
            raise ValueError(
                f"no pixel of {self.pixel_pitch:g} um fits into the light from the scene, which is {length:g} um long; "
                f"reduce pixel_pitch or widen the scene"
            )
        if (
            size < 1
            or low < light.start - 0.5 * light.step - 1e-6
            or high > light.start + (light.size - 0.5) * light.step + 1e-6
        ):
            raise ValueError(
                f"{size} pixels of {self.pixel_pitch:g} um extend from {low:g} to {high:g} um, but the light from the "
                f"scene is {length:g} um long; widen the scene or reduce {what}"
            )
        return Line(size, float(first), 1.0, "1", (start, self.pixel_pitch))

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        edges = tuple(coordinates["wavelength_edges"])
        return electrons_per_irradiance(self, edges), np.array(self._shares(edges))

    def _shares(self, edges: tuple[float, ...]) -> missing.Weights:
        return shares(tuple(getattr(self, name) for name in SEEN_BY), state_of(self)[1], edges)

    def transfer(
        self, fy: FloatArray, fx: FloatArray, wavelength: FloatArray, prepared: tuple[FloatArray, FloatArray]
    ) -> FloatArray:
        width = self.pixel_pitch * self.aperture_fraction
        aperture = photodiode.aperture_otf(fy, width) * photodiode.aperture_otf(fx, width)
        if self.aperture_offset_y == 0 == self.aperture_offset_x:
            return aperture[None]
        return (
            aperture
            * np.exp(2j * np.pi * self.pixel_pitch * (self.aperture_offset_y * fy + self.aperture_offset_x * fx))
        )[None]

    def weights(self, prepared: tuple[FloatArray, FloatArray]) -> FloatArray:
        return prepared[0]

    def shares(self, prepared: tuple[FloatArray, FloatArray]) -> FloatArray:
        return prepared[1]

    def segment_error(
        self, before: tuple[Transfer, ...], facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str
    ) -> tuple[float, str]:
        """Bound the error, including the expansion and the omitted frequencies: for the content of the scene if it is
        known, otherwise for light that is equally strong in every band and at the worst frequency.
        """
        bound, how = self.error(facts, grid, precision)
        light = grid["irradiance"]
        few = 0 < self.wavelength_terms < light.bands().size and bool(before)
        if not few and self.kept_frequencies == 1:
            return bound, how
        lost = missing.of_the_light(
            self._shares(light.bands().edges),
            before,
            light,
            facts["irradiance"].content,
            self.pixel_pitch * self.aperture_fraction,
            self.wavelength_terms if few else 0,
            self.kept_frequencies,
        )
        # stages with tables of their transfer function interpolate between other nodes
        return bound + lost + (TABLES if before else 0.0), "fitted"

    def terms(self) -> int:
        return self.wavelength_terms

    def kept(self) -> float:
        return self.kept_frequencies

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return the range of ``photon_rate``, from the darkest to the brightest light in any channel."""
        light = facts["irradiance"]
        if light.content is None or light.low is None or light.high is None:
            return Facts(uniform=light.uniform)
        weights = electrons_per_irradiance(self, grid["irradiance"].bands().edges)
        low, high = light.content.bands_of_light()
        below, above = weights @ np.array(low), weights @ np.array(high)
        # the mean over pixels differs from that of the light only by the light between their apertures
        means = MEAN * light.content.full * (weights @ np.array(light.content.mean))
        return Facts(
            uniform=light.uniform,
            low=float(below.min()),
            high=float(above.max()),
            mean=float(means.min()),
            brightest=float(means.max()),
        )

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        edges = grids["irradiance"].bands().edges
        return [
            *unused_notes(self),
            *peaks_note(self),
            *self._beyond_the_light(edges),
            *cut_off_notes(self, edges),
            *self._charge_under_other_filters(facts, grids),
        ]

    def warn_among(self, others: Mapping[str, type[Stage]]) -> list[str]:
        if self.crosstalk != "through_filter" or any(kind.role == CROSSTALK for kind in others.values()):
            return []
        return [
            "crosstalk = 'through_filter', but there is no stage crosstalk after the mosaic: charge does not diffuse "
            "at all"
        ]

    def _beyond_the_light(self, edges: tuple[float, ...]) -> list[str]:
        """Warn about sensitivity outside the wavelengths of the scene, unless these span less than 200 nm."""
        # Tables of colour-science end where their filters block the light.
        known = self.sensitivity == FLAT or spectra.spectrum(self.sensitivity)
        if edges[-1] - edges[0] < 200 or not known:
            return []
        bins = tuple(300.0 + 10 * i for i in range(91))
        centres = np.array(bins[:-1]) + 5
        seen = quantum_efficiency(self, bins)
        if self.sensitivity_kind == "system_qe":
            seen = seen * (collection_at_zero(self, centres) > 0.02)
        outside = (centres < edges[0]) | (centres > edges[-1])
        share = float((seen[:, outside].sum(axis=1) / np.maximum(seen.sum(axis=1), 1e-300)).max())
        if share <= 0.02:
            return []
        return [
            f"{100 * share:.0f} % of a channel's sensitivity lies outside {edges[0]:g} to {edges[-1]:g} nm: light "
            "there is ignored; widen the scene's wavelengths (wavelength_to = 1100), unless a filter blocks it"
        ]

    def _charge_under_other_filters(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        if self.crosstalk != "per_plane" or facts.uniform or len(self.channels) == 1:
            return []
        middle = min(grids["irradiance"].bands().values(), key=lambda w: abs(w - 555))
        alpha = float(silicon.absorption(middle * 1e-3))
        diode = (self.depletion_depth, self.diffusion_depth, self.diffusion_length, self.back)
        left = float(photodiode.collection_mtf(0.5 / self.pixel_pitch, alpha, *diode))  # type: ignore[arg-type]
        if self.pixel_pitch >= 3 and left >= 0.8:
            return []
        return [
            "charge diffuses into pixels of other colours (pixel pitch below 3 um, or an MTF of diffusion below 0.8 "
            "at the Nyquist "
            "frequency in green light); crosstalk = 'through_filter', with the stage crosstalk after the mosaic, "
            "models this"
        ]
