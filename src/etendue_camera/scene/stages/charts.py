"""Scenes: radiance on the image-plane grid, before the lens, at an absolute level.

In:  a chart's geometry (um on the image plane), an illuminant, the luminance of a white diffuser.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from etendue import require
from etendue.api import Banded, Bands, Discretised, Facts, Grid, Line, Source, param, quantity
from etendue.contract.values.bounds import MOST_BANDS, MOST_POINTS, beyond
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.roles import EdgeScene, FlatScene
from etendue_camera.scene import charts, composite

DIMMEST, BRIGHTEST = 1e-12, 1e12  # cd m-2: the sun has 1.6e9


@dataclass(frozen=True, kw_only=True)
class Scene(Source, Banded, Discretised):
    """Parameters common to all scenes: level, light, grid."""

    role: ClassVar = "scene"
    reads: ClassVar = {}
    writes: ClassVar = {
        "radiance": "wavelength y x [W m-2 sr-1 nm-1]",
        "white_radiance": "wavelength [W m-2 sr-1 nm-1]",
    }
    libraries: ClassVar[tuple[str, ...]] = ("colour-science",)
    nanoseconds: ClassVar = 12.0
    working: ClassVar = 0.0
    extends: ClassVar[bool] = False  # whether a larger width and height show more of the same chart

    white_luminance: float = param(
        units="cd m-2",
        at_least=0,
        example=1000.0,
        doc="luminance of a perfect white diffuser in the scene, over its full spectrum, rendered or not; 0: give "
        "radiance",
    )
    radiance: float = param(
        0.0,
        units="W m-2 sr-1",
        at_least=0,
        doc="radiance of a perfect white diffuser over the rendered wavelengths, instead of white_luminance: for light "
        "outside the visible range",
    )
    illuminant: str = quantity("illuminant")
    width: float = param(1000.0, units="um", above=0, example=21.0, doc="width of the light on the image plane")
    height: float = param(1000.0, units="um", above=0, example=17.0, doc="height of the light on the image plane")
    spacing: float = param(
        1.0,
        units="um",
        above=0,
        fidelity=True,
        reference="0.25 um",
        studied=True,
        settings=(4.0, 2.0, 1.0, 0.5, 0.25),
        doc="sample spacing; halving it doubles the resolved frequency",
    )
    light: str = param(
        "bandlimited",
        choices=("bandlimited", "cells"),
        doc="meaning of a value: a sample of band-limited light, or the mean over a grid cell (for points, hard "
        "edges, coarse grids)",
    )
    centre_y: float = param(0.0, units="mm", held=(-1e3, 1e3), doc="y position of the window centre from the axis")
    centre_x: float = param(0.0, units="mm", held=(-1e3, 1e3), doc="x position of the window centre from the axis")
    wavelength_from: float = param(380.0, units="nm", above=0)
    wavelength_to: float = param(780.0, units="nm", above=0)
    bin_width: float = param(
        10.0,
        units="nm",
        above=0,
        fidelity=True,
        example=20.0,
        reference="1 nm bins",
        studied=True,
        settings=(40.0, 20.0, 10.0, 5.0, 2.0, 1.0),
        doc="width of the wavelength bins",
    )

    def __post_init__(self) -> None:
        spectra.check_illuminant(self.illuminant, self.wavelength_from, self.wavelength_to)
        require.that(
            (self.white_luminance > 0) != (self.radiance > 0),
            f"white_luminance is {self.white_luminance:g} cd/m2 and radiance {self.radiance:g} W m-2 sr-1; give one of "
            f"them for the "
            "level of the light, and set the other to 0",
        )
        if self.white_luminance > 0:
            spectra.check_luminance(self.illuminant)

    def edges(self) -> tuple[float, ...]:
        quotient = (self.wavelength_to - self.wavelength_from) / self.bin_width
        too_many = beyond(quotient, "bands", MOST_BANDS, f"bin_width {self.bin_width:g} nm is too narrow")
        if too_many:
            raise ValueError(too_many)
        count = round(quotient)
        require.that(
            count >= 1 and abs(self.wavelength_from + count * self.bin_width - self.wavelength_to) <= 1e-6,
            f"bin_width {self.bin_width:g} nm must divide {self.wavelength_from:g}-{self.wavelength_to:g} nm "
            f"into whole bins",
        )
        return tuple(self.wavelength_from + i * self.bin_width for i in range(count + 1))

    def plane(self) -> Grid:
        lines = {}
        for dim, length, centre in (("y", self.height, self.centre_y), ("x", self.width, self.centre_x)):
            too_many = beyond(
                length / self.spacing, f"samples along {dim}", MOST_POINTS, "use a larger spacing or a smaller scene"
            )
            if too_many:
                raise ValueError(too_many)
            size = max(1, round(length / self.spacing))
            lines[dim] = Line(
                size, centre * 1e3 - 0.5 * (size - 1) * self.spacing, self.spacing, cells=self.light == "cells"
            )
        return Grid.of({"wavelength": Bands(self.edges()), **lines})

    def discretisations(self) -> dict[str, str]:
        """Return bins, spacing and margin; a chart whose size follows the frame cannot be given a margin."""
        return {"bins": "", "spacing": "", "margin": "" if self.extends else "that of the chart, which fills the scene"}

    def refined(self, name: str, factor: int) -> dict[str, Any]:
        """Return finer or coarser values; a coarser scene keeps at least four bands."""
        if name == "bins":
            count = len(self.edges()) - 1
            span = self.wavelength_to - self.wavelength_from
            coarser = max(4, count // abs(factor))
            new = count * factor if factor > 0 else coarser
            return {"bin_width": span / new} if factor > 0 or coarser < count else {}
        if name == "spacing":
            return {"spacing": self.spacing / factor if factor > 0 else self.spacing * -factor}
        if factor < 0 or not self.extends:
            return {}
        plane = self.plane()
        sizes = {name: plane.line(dim).size for name, dim in (("width", "x"), ("height", "y"))}
        # The parity stays, so that samples stay where they are.
        return {name: (n * factor - (factor - 1) * n % 2) * self.spacing for name, n in sizes.items()}

    def known(self) -> Facts:
        """Return facts about the chart; its contrast is that of the reflectances."""
        raise TypeError(f"{type(self).__name__} must implement known")

    def band_limit(self) -> float | None:
        """Return the frequency at which the rendering passes one hundredth; None where nothing limits the band."""
        softness = self.softness_um(getattr(self, "softness", 0.0))
        return math.sqrt(0.5 * math.log(100.0)) / (math.pi * softness) if softness > 0 else None

    def describe(self) -> tuple[Facts, dict[str, Grid]]:
        grid = self.plane()
        require.that(
            not self.white_luminance or DIMMEST <= self.white_luminance <= BRIGHTEST,
            f"white_luminance is {self.white_luminance:g} cd m-2; it must be between {DIMMEST:g} and {BRIGHTEST:g}",
        )
        limit = self.band_limit() if self.light == "bandlimited" else None
        facts = replace(self.known(), band_limit=limit, rendered=self.rendered())
        return facts, {"radiance": grid, "white_radiance": grid.take(("wavelength",))}

    def rendered(self) -> tuple[float, float] | None:
        """Return the rendering of the ideal chart: rms width of a Gaussian and side of the cells, um."""
        return self.softness_um(getattr(self, "softness", 0.0)), self.cell

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        said = []
        if self.white_luminance > 0:
            said += spectra.luminance_notes(self.illuminant, self.wavelength_from, self.wavelength_to)
        if not (self.light == "cells" or facts.uniform or getattr(self, "softness", 1.0) > 0):
            said.append("without softness the edges are not band-limited; set softness above 0, or light = 'cells'")
        return said

    def error(self, facts: Facts, grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the interpolation of tables to 1 nm: 1.2e-4 in the chromaticity of D65 at 10 nm bins."""
        return 1.2e-4 * self.bin_width / 10, "measured"

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        edges = tuple(coordinates["out_wavelength_edges"])
        if self.radiance > 0:
            return spectra.light_of_radiance(self.illuminant, edges, self.radiance)
        return spectra.light_of_luminance(self.illuminant, edges, self.white_luminance)

    def by_band(self, prepared: Any, bands: slice) -> Any:
        return prepared[bands]

    def constants(self, prepared: FloatArray) -> dict[str, Array]:
        return {"white_radiance": prepared[0] if isinstance(prepared, tuple) else prepared}

    def white_light(self, edges: tuple[float, ...]) -> FloatArray:
        return spectra.light_of_radiance(self.illuminant, edges, 1.0)

    def softness_um(self, softness: float) -> float:
        return softness * self.spacing

    def drawn(self, softness: float, low: float = 0.0, high: float = 1.0) -> charts.Rendering:
        return charts.Rendering(self.softness_um(softness), self.cell, low, high)

    @property
    def cell(self) -> float:
        """Return the side of the cells over which values are means, um; 0 where they are samples."""
        return self.spacing if self.light == "cells" else 0.0

    def centred(self, y: FloatArray, x: FloatArray) -> tuple[Any, Any]:
        return y - self.centre_y * 1e3, x - self.centre_x * 1e3

    def grey(self, reflectance: FloatArray, white: FloatArray) -> dict[str, Array]:
        """Return the radiance of a chart whose reflectance is the same at every wavelength."""
        return {"radiance": white[:, None, None] * reflectance, "white_radiance": white}


def softness_knob() -> Any:
    return param(
        1.0,
        at_least=0,
        fidelity=True,
        reference="the ideal chart",
        studied=True,
        settings=(4.0, 2.0, 1.0, 0.5, 0.25, 0.0),
        doc="rms width in samples of the Gaussian that band-limits the rendered chart; 0: "
        "ideal chart, for light = 'cells'",
    )


@dataclass(frozen=True, kw_only=True)
class Uniform(Scene, FlatScene):
    """Give the same light everywhere."""

    extends: ClassVar = True
    reflectance: float = param(1.0, at_least=0, at_most=1)

    def known(self) -> Facts:
        return Facts(uniform=True, contrast=1.0)

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: Any) -> dict[str, Array]:
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

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> Any:
        """Return the reflectance (y, x), about the centre of the window."""
        raise TypeError(f"{type(self).__name__} must implement chart")

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: Any) -> dict[str, Array]:
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

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> Any:
        return charts.siemens_star(y, x, self.cycles, self.radius, drawn)


@dataclass(frozen=True, kw_only=True)
class ZonePlate(_TwoLevels):
    """Draw a zone plate: circles whose frequency grows with the radius, which makes aliasing visible."""

    highest_frequency: float = param(0.25, units="cycles/um", above=0, doc="local frequency at the rim")
    radius: float = param(400.0, units="um", above=0)

    def chart(self, y: FloatArray, x: FloatArray, drawn: charts.Rendering) -> Any:
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

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: Any) -> dict[str, Array]:
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

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: Any) -> dict[str, Array]:
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

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: Any) -> dict[str, Array]:
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

    def refined(self, name: str, factor: int) -> dict[str, Any]:
        """Return finer or coarser values; a larger margin leaves the chart as large as it is."""
        found = super().refined(name, factor)
        if name != "margin" or not found:
            return found
        more = 2 * self.spacing * round((factor - 1) * max(self.width, self.height) / (2 * self.spacing))
        return {"width": self.width + more, "height": self.height + more, "margin": self.margin + more / 2}

    def known(self) -> Facts:
        charts.require_levels(self.low, self.high)
        return super().known()

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: Any) -> dict[str, Array]:
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
