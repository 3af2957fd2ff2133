"""Charts: radiance on the image-plane grid, before the lens, at an absolute level.

In:  a chart's geometry (um on the image plane), an illuminant, the luminance of a white diffuser.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from etendue.api import Facts, Grid, param
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.roles import EdgeScene, FlatScene
from etendue_camera.scene import charts, composite
from etendue_camera.scene.stages.scene import Scene, softness_knob


@dataclass(frozen=True, kw_only=True)
class Uniform(Scene, FlatScene):
    """Give the same light everywhere."""

    extends: ClassVar = True
    reflectance: float = param(1.0, at_least=0, at_most=1)

    def known(self) -> Facts:
        return Facts(uniform=True, contrast=1.0)

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return self.grey(np.full((out_y.size, out_x.size), self.reflectance), prepared)


@dataclass(frozen=True, kw_only=True)
class _TwoLevels(Scene):
    """A chart between a dark and a light reflectance."""

    extends: ClassVar = True
    low: float = param(0.1, at_least=0, at_most=1)
    high: float = param(0.9, at_least=0, at_most=1)
    softness: float = softness_knob()

    def known(self) -> Facts:
        charts.require_levels(self.low, self.high)  # rejects reversed levels before anything is drawn
        return Facts(uniform=False, contrast=self.high / self.low if self.low > 0 else math.inf)

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> FloatArray:
        """Return the reflectance (y, x), about the centre of the window."""
        raise TypeError(f"{type(self).__name__} must implement chart")

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        return self.grey(
            self.chart(*self.centred(out_y, out_x), self.drawn(self.softness, self.low, self.high)), prepared
        )


@dataclass(frozen=True, kw_only=True)
class SlantedEdge(_TwoLevels, EdgeScene):
    """Draw a straight edge, dark left and light right, tilted from the vertical (ISO 12233)."""

    angle: float = param(5.0, units="deg", above=-90, below=90)

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> FloatArray:
        return charts.slanted_edge(y, x, self.angle, drawn)


@dataclass(frozen=True, kw_only=True)
class SiemensStar(_TwoLevels):
    """Draw a Siemens star whose reflectance is sinusoidal in the angle (ISO 12233)."""

    cycles: int = param(36, at_least=1, held=(1, 100_000))
    radius: float = param(400.0, units="um", above=0)

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> FloatArray:
        return charts.siemens_star(y, x, self.cycles, self.radius, drawn)


@dataclass(frozen=True, kw_only=True)
class ZonePlate(_TwoLevels):
    """Draw a zone plate: circles whose frequency grows with the radius, which makes aliasing visible."""

    highest_frequency: float = param(0.25, units="cycles/um", above=0, doc="local frequency at the rim")
    radius: float = param(400.0, units="um", above=0)

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> FloatArray:
        return charts.zone_plate(y, x, self.highest_frequency, self.radius, drawn)


@dataclass(frozen=True, kw_only=True)
class StepWedge(Scene):
    """Draw a step wedge: equal bars from dark to light, in equal steps of density."""

    steps: int = param(12, at_least=2, held=(2, 1000))
    low: float = param(0.01, above=0, at_most=1)
    high: float = param(0.9, above=0, at_most=1)
    softness: float = softness_knob()

    def known(self) -> Facts:
        return Facts(uniform=False, contrast=max(self.high / self.low, self.low / self.high))

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        y, x = self.centred(out_y, out_x)
        levels = np.geomspace(self.low, self.high, self.steps)
        wedge = charts.step_wedge(y, x, levels, 0.9 * self.width, 0.6 * self.height, self.drawn(self.softness))
        return self.grey(wedge, prepared)


@dataclass(frozen=True, kw_only=True)
class Points(Scene):
    """Draw a regular grid of small Gaussian spots on a dark background."""

    extends: ClassVar = True
    pitch: float = param(100.0, units="um", above=0, doc="distance between spots")
    spot_sigma: float = param(1.0, units="um", above=0, doc="rms width of a spot")
    background: float = param(0.001, at_least=0, at_most=1)
    peak: float = param(1.0, above=0, at_most=1)
    softness: float = softness_knob()

    def known(self) -> Facts:
        charts.require_levels(self.background, self.peak)
        charts.require_spot_distance(self.pitch, math.hypot(self.spot_sigma, self.softness_um(self.softness)))
        return Facts(
            uniform=False, contrast=(self.background + self.peak) / self.background if self.background > 0 else math.inf
        )

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        y, x = self.centred(out_y, out_x)
        spots = charts.points(y, x, self.pitch, self.spot_sigma, self.drawn(self.softness, self.background, self.peak))
        return self.grey(spots, prepared)


@dataclass(frozen=True, kw_only=True)
class _Coloured(Scene):
    """A chart with the measured reflectances of the ColorChecker."""

    working: ClassVar = 1.1

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, FloatArray]:
        edges = tuple(coordinates["out_wavelength_edges"])
        return super().prepare(coordinates), spectra.colorchecker(edges)[1]

    def by_band(self, prepared: tuple[FloatArray, FloatArray], bands: slice) -> tuple[FloatArray, FloatArray]:
        return prepared[0][bands], prepared[1][:, bands]

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        return [
            *super().warn(facts, grids),
            *spectra.held_in_the_infrared("ColorChecker", self.wavelength_from, self.wavelength_to),
        ]

    def known(self) -> Facts:
        # At every wavelength the darkest patch reflects at least 0.029 and the lightest at most 0.93.
        return Facts(uniform=False, contrast=40.0)


@dataclass(frozen=True, kw_only=True)
class ColorChecker(_Coloured):
    """Draw the ColorChecker: 24 patches with measured reflectance spectra, on grey."""

    background: float = param(0.18, above=0.025, at_most=1)
    gap: float = param(0.1, at_least=0, below=1, doc="gap between patches, in patch pitches")
    softness: float = softness_knob()

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: tuple[FloatArray, FloatArray]) -> dict[str, Array]:
        white, reflectance = prepared
        y, x = self.centred(out_y, out_x)
        size = min(self.width / 6, self.height / 4)
        rows, columns = composite.patches_factors(
            y,
            x,
            composite.PatchGrid(4, 6, 6 * size * 0.94, 4 * size * 0.94, self.gap * size),
            self.drawn(self.softness),
        )
        cube = composite.patch_contribution(rows, columns, reflectance)
        cube = cube + self.background * composite.background_weight(rows, columns)
        return {"radiance": cube * white[:, None, None], "white_radiance": white}


@dataclass(frozen=True, kw_only=True)
class CompositeChart(_Coloured):
    """Draw a ColorChecker, slanted edges, a Siemens star, a zone plate and a step wedge in one frame."""

    extends: ClassVar = True
    highest_frequency: float = param(0.1, units="cycles/um", above=0, doc="frequency at the rim of the zone plate")
    angle: float = param(
        5.0,
        units="deg",
        above=-45,
        below=45,
        held=(-10, 10),
        doc="angle of the tilted square; beyond 10 it overlaps its neighbours",
    )
    cycles: int = param(36, at_least=1, held=(1, 100_000))
    low: float = param(0.05, above=0.025, at_most=1)
    high: float = param(0.9, above=0, at_most=1)
    margin: float = param(
        0.0, units="um", at_least=0, doc="width of the mid-grey border of the chart, inside width and height"
    )
    softness: float = softness_knob()

    def known(self) -> Facts:
        charts.require_levels(self.low, self.high)
        return super().known()

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: tuple[FloatArray, FloatArray]) -> dict[str, Array]:
        white, reflectance = prepared
        y, x = self.centred(out_y, out_x)
        chart = composite.composite(
            y,
            x,
            self.width - 2 * self.margin,
            self.height - 2 * self.margin,
            self.drawn(self.softness, self.low, self.high),
            composite.Panels(self.highest_frequency, self.angle, self.cycles),
        )
        cube = composite.patch_contribution(chart.rows, chart.columns, reflectance)
        cube += chart.grey
        cube *= white[:, None, None]
        return {"radiance": cube, "white_radiance": white}
