"""Parameters common to all scenes: level, light, grid, and how the grid is refined.

In:  a chart's geometry (um on the image plane), an illuminant, the luminance of a white diffuser.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from etendue import require
from etendue.api import Banded, Bands, Discretised, Facts, Grid, Line, Source, param, quantity
from etendue.contract.values.bounds import MOST_BANDS, MOST_POINTS, beyond
from etendue_camera import spectra
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.scene import charts

WIDEST_BINS = 10.0  # nm; width of the bins that are chosen if the pipeline gives none
AROUND = 8  # the automatic surround is the longer side of the scene divided by this
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
    automatic: ClassVar[Mapping[str, str]] = {"bin_width": "bins", "spacing": "spacing", "surround": "margin"}

    white_luminance: float = param(
        units="cd m-2",
        at_least=0,
        example=1000.0,
        doc="luminance of a perfect white diffuser in the scene, over its full spectrum, rendered or not; 0: radiance "
        "is given",
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
    surround: float = param(
        0.0,
        units="um",
        at_least=0,
        doc="width of a margin of the same chart around the frame, from which blur and glare bring light into it; "
        "auto: an eighth of the longer side",
    )
    spacing: float = param(
        1.0,
        units="um",
        above=0,
        fidelity=True,
        reference="0.25 um",
        studied=True,
        settings=(4.0, 2.0, 1.0, 0.5, 0.25),
        doc="sample spacing; halving it doubles the resolved frequency; auto: half the smallest pixel pitch",
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
        doc="width of the wavelength bins; auto: at most 10 nm",
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

        require.that(
            self.extends or not self.surround,
            f"surround is {self.surround:g} um, but this chart fills its width and height; set surround to 0",
        )

    @classmethod
    def chosen(cls, name: str, values: Mapping[str, Any], shared: Mapping[str, tuple[Any, ...]]) -> float:
        """Return the value of a parameter that the pipeline leaves open: bins of at most 10 nm that divide the range
        evenly; a spacing of half the smallest pixel pitch, adjusted to divide the width evenly (1 um without pixels); a
        surround of an eighth of the longer side if the chart extends beyond the frame.
        """
        own = {"wavelength_from": 380.0, "wavelength_to": 780.0, "width": 1000.0, "height": 1000.0, **values}
        if name == "bin_width":
            span = own["wavelength_to"] - own["wavelength_from"]
            return span / max(1, math.ceil(span / WIDEST_BINS - 1e-9)) if span > 0 else WIDEST_BINS
        if name == "spacing":
            most = 0.5 * min(shared.get("pixel_pitch", ()), default=2.0)
            return own["width"] / max(1, math.ceil(own["width"] / most - 1e-9))
        return max(own["width"], own["height"]) / AROUND if cls.extends else 0.0

    def edges(self) -> tuple[float, ...]:
        require.that(
            self.wavelength_from < self.wavelength_to,
            f"wavelength_from, {self.wavelength_from:g} nm, must be below wavelength_to, {self.wavelength_to:g} nm",
        )
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
                (length + 2 * self.surround) / self.spacing,
                f"samples along {dim}",
                MOST_POINTS,
                "use a larger spacing or a smaller scene",
            )
            if too_many:
                raise ValueError(too_many)
            size = max(1, round(length / self.spacing)) + 2 * round(self.surround / self.spacing)
            lines[dim] = Line(
                size, centre * 1e3 - 0.5 * (size - 1) * self.spacing, self.spacing, cells=self.light == "cells"
            )
        return Grid.of({"wavelength": Bands(self.edges()), **lines})

    def discretisations(self) -> dict[str, str]:
        """Return bins, spacing and margin; a chart whose size follows the frame cannot be given a margin."""
        return {"bins": "", "spacing": "", "margin": "" if self.extends else "the chart fills the scene"}

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
        # Add a whole number of samples on each side, so that the existing ones keep their positions.
        more = (factor - 1) * 0.5 * max(line.size for _, line in self.plane().entries[1:]) * self.spacing
        return {"surround": self.surround + math.ceil(more / self.spacing - 1e-9) * self.spacing}

    def finer(self, name: str) -> dict[str, Any]:
        """Return the parameter values one step finer; a margin becomes twice as wide."""
        if name != "margin" or not self.surround:
            return self.refined(name, 2)
        return {"surround": 2 * self.surround} if self.extends else {}

    def known(self) -> Facts:
        """Return facts about the chart; its contrast is computed from the reflectances."""
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
