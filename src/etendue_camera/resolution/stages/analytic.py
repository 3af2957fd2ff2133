"""What a camera resolves up to each stage, from its transfer functions alone, and which part of it limits that.

In:  the transfer functions of all stages, the pixel's weights.
Out: MTF, MTF50, MTF10, cut-off, what lies beyond the Nyquist frequency, two-point separations, by ``stage``; MTF, gains
     by ``factor``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from etendue.api import ChannelTransfer, Facts, Grid, Labels, Probe, param, quantity
from etendue.contract.capabilities import ends_in_sum
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.resolution import contrast as resolution
from etendue_camera.resolution import two_points
from etendue_camera.resolution.stages import curves
from etendue_camera.roles import CROSSTALK, PROCESSING, InSilicon

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf

NEARLY = 1e-6  # of a separation, by which its root may err where it is not solved for
FACTORS = ("lens", "diffusion", "geometry", "sampling")


def direction(angle: float) -> tuple[float, float]:
    """(y, x) of a direction in degrees from +x towards +y; exactly an axis where it is one."""
    whole = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), -90.0: (-1.0, 0.0), 180.0: (0.0, -1.0)}
    return whole.get(angle, (math.sin(math.radians(angle)), math.cos(math.radians(angle))))


@dataclass(frozen=True)
class Observed:
    """Whose contrast is asked for.

    ``weights``: (wavelength,) photons of the second channel (green) or the only one; None for all bands alike.
    ``channels``: (channel, wavelength), those of all channels under light that is equally strong in all bands.
    ``light``: (wavelength,); None for such light.
    """

    weights: Any
    channels: Any = None
    light: Any = None

    def mean(self, otf: Otf, fy: FloatArray, fx: FloatArray) -> FloatArray:
        """(n,): over wavelength; behind a pixel with the charge that moves there from pixel to pixel."""
        if otf.behind:
            return one_channel(otf.channels_along(fy, fx, self.light, self.channels))
        return resolution.mean_otf(otf.along(fy, fx), self.weights)

    @property
    def key(self) -> tuple[bytes, ...]:
        return tuple(b"" if one is None else one.tobytes() for one in (self.weights, self.light))


def signed(otf: Otf, observed: Observed, towards: tuple[float, float], rendering: bool) -> Callable[[Any], Any]:
    """The photon-weighted mean along a direction, with the rendering of the chart or without."""

    def value(f: FloatArray) -> FloatArray:
        fy, fx = towards[0] * f, towards[1] * f
        found = observed.mean(otf, fy, fx)
        return found * otf.scene_along(fy, fx) if rendering else found

    return value


def response(otf: Otf, observed: Observed, towards: tuple[float, float], rendering: bool) -> Callable[[Any], Any]:
    """Its size: contrast."""
    own = signed(otf, observed, towards, rendering)
    return lambda f: np.abs(own(f))


def factor_of(stage: Any) -> str:
    """Which factor a stage with a transfer function belongs to: what is not of the sensor is in front of it."""
    if ends_in_sum(type(stage)):
        return "geometry"
    return "diffusion" if isinstance(stage, InSilicon | ChannelTransfer) else "lens"


def half_contrast(
    otf: Otf, observed: Observed, towards: tuple[float, float], highest: float, nodes: int, solved: bool = True
) -> float:
    """MTF50 of a camera without the rendering of its chart; NaN where contrast does not fall to one half up to
    ``highest``.
    """
    own = signed(otf, observed, towards, rendering=False)
    grid = resolution.search_nodes(highest, nodes)
    return resolution.ContrastCurve(grid, own(grid)).half((lambda f: np.abs(own(f))) if solved else None)


def gains(otf: Otf, mtf50: Callable[[Any], float], nyquist: float, highest: float) -> FloatArray:
    """(factor,): MTF50 without each factor over MTF50 with it; of sampling, MTF50 over the Nyquist frequency, where
    above it.

    The rendering of the chart is no part of the camera and is left out. Where contrast then does not fall to one half
    up to ``highest``, it stands for that MTF50: no more is known. NaN where it does not with all of the camera.
    """
    whole = mtf50(otf)
    if math.isnan(whole):
        return np.full(len(FACTORS), math.nan)
    found = []
    for factor in FACTORS[:-1]:
        names = [name for name, stage in otf.stages if factor_of(stage) == factor]
        without = mtf50(otf.without(names)) if names else whole
        found.append((highest if math.isnan(without) else without) / whole)
    return np.array([*found, max(1.0, whole / nyquist)])


def factor_curves(otf: Otf, observed: Observed, towards: tuple[float, float], pitch: float) -> FloatArray:
    """(factor, frequency): contrast of the stages of each factor alone; 1 where there is none, NaN of sampling."""
    names = {name: factor_of(stage) for name, stage in otf.stages}
    alone = [otf.without([name for name, own in names.items() if own != factor]) for factor in FACTORS[:-1]]
    found = [response(one, observed, towards, rendering=False)(curves.PER_PIXEL / pitch) for one in alone]
    return np.array([*found, curves.undefined()])


def first_largest(values: FloatArray) -> float:
    """Index of the largest; NaN where nothing is known, or nothing limits."""
    return (
        float(np.argmax(values))
        if np.isfinite(values).any() and not np.isnan(values).any() and values.max() > 1
        else math.nan
    )


@dataclass(frozen=True, kw_only=True)
class Resolution(Probe):
    """Analytic resolution up to each stage: the photon-weighted polychromatic transfer function along one direction.

    The weights are those of the pixel's second channel (green; of a monochrome sensor its only one) in the light of the
    scene's white behind the filters, or, of a scene that does not say it, in light that is equally strong in all bands.
    The row of the pixel holds the charge that wanders, in front of the colour filters or behind them (``crosstalk``).
    It is the camera's curve: the softness with which the scene's chart was drawn is in every picture of it and in
    ``edge_resolution``, and here only with ``rendering = true``.

    ``mtf50`` and ``mtf10``: lowest frequency at which contrast has fallen to one half, to a tenth; ``cut_off``: highest
    at which it is ``cut_off_contrast``; NaN where that is not below ``highest``, and from the first stage on that moves
    light without being a transfer function. ``aliasing``: share of the energy of a line's picture (a white
    spectrum) beyond the Nyquist frequency, which sampling folds back. ``sparrow`` and ``rayleigh``: separation of two
    points between which there is no dip, and the dip of two Airy discs at Rayleigh's; the curve along the direction
    stands for all directions. ``effective_*``: MTF50, but at most the Nyquist frequency. ``limiting_factor`` is the
    index into ``factor`` with the largest ``resolution_gain``, which is how many times MTF50 would be without that
    factor; sampling's is MTF50 over the Nyquist frequency. ``mtf`` is the whole curve up to each stage and
    ``factor_mtf`` that of each factor alone, at 65 frequencies to 1 cycle/pixel (``frequency``; ``frequency_lp_mm`` has
    them in cycles/mm); sampling has no transfer function and no curve.
    """

    role: ClassVar = "resolution"
    reads: ClassVar = {"transfers": "*.transfer [1]"}
    writes: ClassVar = {
        "mtf50": "stage [cycles/um] nan",
        "mtf50_lp_mm": "stage [cycles/mm] nan",
        "mtf10": "stage [cycles/um] nan",
        "cut_off": "stage [cycles/um] nan",
        "nyquist": "[cycles/um]",
        "mtf_nyquist": "stage [1] nan",
        "aliasing": "stage [1] nan",
        "rayleigh": "stage [um] nan",
        "sparrow": "stage [um] nan",
        "effective_lp_mm": "stage [cycles/mm] nan",
        "effective_cycles": "stage [cycles/pixel] nan",
        "effective_line_widths": "stage [1] nan",
        "resolution_gain": "factor [1] nan",
        "limiting_factor": "[1] nan",
        "mtf": "stage frequency [1] nan",
        "factor_mtf": "factor frequency [1] nan",
        "frequency_lp_mm": "frequency [cycles/mm]",
        "nyquist_lp_mm": "[cycles/mm]",
    }
    unseen: ClassVar = dict.fromkeys(
        (*writes.keys() - {"nyquist", "nyquist_lp_mm", "frequency_lp_mm", "factor_mtf"},), (CROSSTALK, *PROCESSING)
    )
    creates: ClassVar = {"factor": Labels(FACTORS), "frequency": curves.FREQUENCY}
    nanoseconds: ClassVar = 2.3e5

    pixel_pitch: float = quantity("pixel_pitch")
    angle: float = param(
        0.0, units="deg", at_least=-180, at_most=180, doc="direction along which detail changes, from x towards y"
    )
    rendering: bool = param(False, doc="whether the softness or the cells of the scene's chart belong to the curve")
    cut_off_contrast: float = param(1e-3, above=0, below=0.5, doc="contrast that is as good as none")
    highest: float = param(4.0, units="cycles/um", above=0, doc="where the search ends")
    solved: bool = param(
        True,
        fidelity=True,
        exact=True,
        reference="true: on the curve itself",
        settings=(False, True),
        costs=(0.55, 1.0),
        doc="whether crossings and contrast at the Nyquist frequency are asked of the curve itself; else splines on "
        "twice the nodes say",
    )
    point_nodes: int = param(
        160,
        at_least=16,
        held=(16, 4096),
        fidelity=True,
        reference="320",
        settings=(48, 64, 96, 160, 240, 320),
        costs=(0.78, 0.78, 0.84, 1.0, 1.08, 1.1),
        doc="of the integral behind the picture of a point, on which separations rest",
    )
    nodes: int = param(
        512,
        at_least=16,
        held=(16, 16384),
        fidelity=True,
        reference="4096 nodes",
        settings=(32, 64, 128, 256, 512, 1024, 2048, 4096),
        costs=(0.95, 0.95, 0.95, 0.96, 1.0, 1.05, 1.17, 1.36),
        doc="frequencies at which a crossing is looked for, with splines between them",
    )

    def run(self, transfers: Sequence[tuple[str, Otf]], prepared: Any) -> dict[str, Array]:
        observed = self.observed(transfers, prepared)
        towards, nyquist = direction(self.angle), 0.5 / self.pixel_pitch
        seen = [(otf, self.seen(otf, observed, towards)) for _, otf in transfers]
        rows = [self.figures(otf, found, observed, towards, nyquist) for otf, found in seen]
        by_stage = {name: np.array([row[name] for row in rows]) for name in _FIGURES}
        effective = np.fmin(by_stage["mtf50"], nyquist)
        effective = np.where(np.isnan(by_stage["mtf_nyquist"]), np.nan, effective)
        height = picture_height(transfers)
        last = [otf for _, otf in transfers if otf.weights is not None][:1] or [otf for _, otf in transfers][-1:]
        gain = np.full(len(FACTORS), np.nan)
        factors = np.full((len(FACTORS), curves.SAMPLES), np.nan)
        if last and last[0].whole:
            factors = factor_curves(last[0], observed, towards, self.pixel_pitch)
            known = {} if self.rendering else {otf.stages: found.mtf50 for otf, found in seen if found is not None}
            gain = gains(last[0], lambda otf: self.half(otf, observed, towards, known), nyquist, self.highest)
        return {
            **by_stage,
            "mtf50_lp_mm": by_stage["mtf50"] * 1e3,
            "nyquist": np.array(nyquist),
            "effective_lp_mm": effective * 1e3,
            "effective_cycles": effective * self.pixel_pitch,
            "effective_line_widths": 2 * effective * height,
            "resolution_gain": gain,
            "limiting_factor": np.array(first_largest(gain)),
            "mtf": self.curves([otf for otf, _ in seen], observed, towards),
            "factor_mtf": factors,
            **curves.beside(self.pixel_pitch),
        }

    def observed(self, transfers: Sequence[tuple[str, Otf]], prepared: Any) -> Observed:
        if prepared is None:
            return Observed(None)
        light = next((np.array(otf.light) for _, otf in transfers if otf.light is not None), None)
        own = one_channel(prepared)
        if light is None or not np.any(own * light > 0):
            return Observed(_shares(own), prepared)
        return Observed(_shares(own * light), prepared, light)

    def curves(self, otfs: list[Otf], observed: Observed, towards: tuple[float, float]) -> FloatArray:
        """(stage, frequency): contrast up to each stage, on the curve itself whatever the settings; NaN where no
        product is all of the camera."""
        at = curves.PER_PIXEL / self.pixel_pitch
        found = [
            response(otf, observed, towards, self.rendering)(at) if otf.whole else curves.undefined() for otf in otfs
        ]
        return np.array(found).reshape(-1, curves.SAMPLES)

    def seen(self, otf: Otf, observed: Observed, towards: tuple[float, float]) -> CurveFigures | None:
        """What does not depend on the pitch of the pixels behind, remembered for them; None where no product is all
        of the camera.
        """
        if not otf.whole:
            return None
        own = signed(otf, observed, towards, self.rendering)

        def make() -> CurveFigures:
            grid = resolution.search_nodes(self.highest, self.places())
            curve = resolution.ContrastCurve(grid, own(grid))
            crossings = curve.crossings(self.cut_off_contrast, (lambda f: np.abs(own(f))) if self.solved else None)
            ends = self.highest if math.isnan(crossings[2]) else crossings[2]
            within = 0.0 if self.solved else NEARLY
            return CurveFigures(
                curve, *crossings, *two_points.separations(curve.real, ends, nodes=self.point_nodes, within=within)
            )

        how = (self.rendering, self.highest, self.nodes, self.solved, self.cut_off_contrast, self.point_nodes)
        return otf.once(("resolution", *observed.key, towards, how), make)

    def half(self, otf: Otf, observed: Observed, towards: tuple[float, float], known: Mapping[Any, float]) -> float:
        """MTF50 of a camera, remembered where it may come again."""
        if otf.stages in known:
            return known[otf.stages]
        how = (self.highest, self.places(), self.solved)
        return float(
            otf.once(("half", *observed.key, towards, how), lambda: half_contrast(otf, observed, towards, *how))
        )

    def figures(
        self, otf: Otf, seen: CurveFigures | None, observed: Observed, towards: tuple[float, float], nyquist: float
    ) -> dict[str, float]:
        if seen is None:
            return dict.fromkeys(_FIGURES, math.nan)
        if self.solved or nyquist > self.highest:
            at_nyquist = float(np.abs(signed(otf, observed, towards, self.rendering)(np.array([nyquist])))[0])
        else:
            at_nyquist = max(float(seen.curve.contrast(nyquist)), 0.0)
        return {
            "mtf50": seen.mtf50,
            "mtf10": seen.mtf10,
            "cut_off": seen.cut_off,
            "mtf_nyquist": at_nyquist,
            "aliasing": seen.curve.beyond(nyquist),
            "rayleigh": seen.rayleigh,
            "sparrow": seen.sparrow,
        }

    def places(self) -> int:
        """Nodes of the splines."""
        return self.nodes if self.solved else 2 * self.nodes

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Largest of all figures, relative of frequencies and separations: by splines, crossings of them, and the
        integral of a point.

        Crossings that are solved are right to 1e-9, where splines are no worse than 1e-3. Below 48 nodes a point may
        lose its ring.
        """
        on_splines = 0.0 if self.solved else 1.7e-2 * (128 / self.places()) ** 1.5
        points = 8e-5 * (48 / self.point_nodes) ** 2 if self.point_nodes >= 48 else 1.0
        return min(1.0, 7e-3 * (128 / self.nodes) ** 3 + on_splines + points + 2e-6), "fitted"


@dataclass(frozen=True)
class CurveFigures:
    """What is read from one curve, whatever the pitch."""

    curve: resolution.ContrastCurve
    mtf50: float
    mtf10: float
    cut_off: float
    rayleigh: float
    sparrow: float


def _shares(weights: FloatArray) -> FloatArray:
    """Of all photons, to 12 places: pixels of all pitches have the same to rounding, and so the same curves."""
    weights = np.asarray(weights, dtype=float)
    return np.round(weights / weights.sum(), 12)


def one_channel(values: FloatArray) -> FloatArray:
    """The second of some channels: green, or the only one."""
    return values[min(1, len(values) - 1)]


_FIGURES = ("mtf50", "mtf10", "cut_off", "mtf_nyquist", "aliasing", "rayleigh", "sparrow")


def picture_height(transfers: Sequence[tuple[str, Otf]]) -> float:
    """Of the pixels that are read, um; NaN without a pixel stage."""
    for _, otf in transfers:
        if otf.weights is not None and otf.grid is not None:
            line = otf.grid.line("y")
            return float(line.size * line.um()[1])
    return math.nan
