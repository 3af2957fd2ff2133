"""Analytic resolution after each stage, from transfer functions alone, and the factor that limits it.

In:  the transfer functions of all stages, the pixel's weights.
Out: MTF, MTF50, MTF10, cut-off, energy above Nyquist, two-point separations, by ``stage``; MTF, gains
     by ``factor``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from etendue.api import ChannelTransfer, Facts, Grid, Labels, Probe, Stage, param, quantity
from etendue.contract.capabilities import ends_in_sum
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.resolution import contrast as resolution
from etendue_camera.resolution import two_points
from etendue_camera.resolution.stages import curves
from etendue_camera.roles import CROSSTALK, PROCESSING, InSilicon

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf

NEARLY = 1e-6  # relative error of a separation whose root is not solved exactly
FACTORS = ("lens", "diffusion", "geometry", "sampling")


def direction(angle: float) -> tuple[float, float]:
    """Return the unit vector (y, x) of a direction in degrees from +x towards +y; exact along an axis."""
    whole = {0.0: (0.0, 1.0), 90.0: (1.0, 0.0), -90.0: (-1.0, 0.0), 180.0: (0.0, -1.0)}
    return whole.get(angle, (math.sin(math.radians(angle)), math.cos(math.radians(angle))))


@dataclass(frozen=True)
class Observed:
    """The channel and light whose contrast is computed.

    ``weights``: (wavelength,) photons of the second channel (green) or the only channel; None: all bands weigh the
    same. ``channels``: (channel, wavelength), weights of all channels for light that is equally strong in all bands.
    ``light``: (wavelength,), spectrum of the light; None: equally strong in all bands.
    """

    weights: FloatArray | None
    channels: FloatArray | None = None
    light: FloatArray | None = None

    def mean(self, otf: Otf, fy: FloatArray, fx: FloatArray) -> FloatArray:
        """Return the mean transfer function over wavelength, (n,); after a pixel stage it includes charge that moves
        between pixels.
        """
        if otf.behind:
            return one_channel(otf.channels_along(fy, fx, self.light, self.channels))
        return resolution.mean_otf(otf.along(fy, fx), self.weights)

    @property
    def key(self) -> tuple[bytes, ...]:
        return tuple(b"" if one is None else one.tobytes() for one in (self.weights, self.light))


def signed(
    otf: Otf, observed: Observed, towards: tuple[float, float], rendering: bool
) -> Callable[[FloatArray], FloatArray]:
    """Return a function of frequency (cycles/um): the photon-weighted mean transfer function along a direction, with or
    without the rendering of the chart.
    """

    def value(f: FloatArray) -> FloatArray:
        fy, fx = towards[0] * f, towards[1] * f
        found = observed.mean(otf, fy, fx)
        return found * otf.scene_along(fy, fx) if rendering else found

    return value


def response(
    otf: Otf, observed: Observed, towards: tuple[float, float], rendering: bool
) -> Callable[[FloatArray], FloatArray]:
    """Return contrast as a function of frequency: the magnitude of `signed`."""
    own = signed(otf, observed, towards, rendering)
    return lambda f: np.abs(own(f))


def factor_of(stage: Stage) -> str:
    """Return the factor that a stage with a transfer function belongs to: the lens for all stages before the sensor."""
    if ends_in_sum(type(stage)):
        return "geometry"
    return "diffusion" if isinstance(stage, InSilicon | ChannelTransfer) else "lens"


def half_contrast(
    otf: Otf, observed: Observed, towards: tuple[float, float], highest: float, nodes: int, solved: bool = True
) -> float:
    """Return the MTF50 of a camera without the rendering of its chart, cycles/um; NaN if contrast does not fall to one
    half up to ``highest``.
    """
    own = signed(otf, observed, towards, rendering=False)
    grid = resolution.search_nodes(highest, nodes)
    return resolution.ContrastCurve(grid, own(grid)).half((lambda f: np.abs(own(f))) if solved else None)


def gains(otf: Otf, mtf50: Callable[[Otf], float], nyquist: float, highest: float) -> FloatArray:
    """Return, for each factor, the ratio of MTF50 without the factor to MTF50 with it, (factor,); for sampling, the
    ratio of MTF50 to Nyquist, at least 1.

    The rendering of the chart is not part of the camera and is excluded. Where contrast without a factor does not fall
    to one half up to ``highest``, that frequency is used for MTF50, as a lower bound. NaN where the contrast of the
    whole camera does not fall to one half.
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
    """Return the contrast after the stages of each factor alone, (factor, frequency); 1 for a factor without stages,
    NaN for sampling.
    """
    names = {name: factor_of(stage) for name, stage in otf.stages}
    alone = [otf.without([name for name, own in names.items() if own != factor]) for factor in FACTORS[:-1]]
    found = [response(one, observed, towards, rendering=False)(curves.PER_PIXEL / pitch) for one in alone]
    return np.array([*found, curves.undefined()])


def first_largest(values: FloatArray) -> float:
    """Return the index of the largest gain; NaN where no gain is known, or no gain is above 1."""
    return (
        float(np.argmax(values))
        if np.isfinite(values).any() and not np.isnan(values).any() and values.max() > 1
        else math.nan
    )


@dataclass(frozen=True, kw_only=True)
class Resolution(Probe):
    """Compute analytic resolution after each stage: the photon-weighted polychromatic MTF along one direction.

    Wavelengths are weighted with the photons of the pixel's second channel (green; on a monochrome sensor the only
    channel) under the scene white after the filters. If the scene gives no white, light is taken as equally strong in
    all bands. The pixel row includes charge diffusion, below the colour filters or per plane (``crosstalk``). The curve
    describes the camera alone. The softness of the chart is included in every picture and in ``edge_resolution``, but
    in this curve only with ``rendering = true``.

    ``mtf50`` and ``mtf10``: lowest frequency at which contrast has fallen to one half and to a tenth. ``cut_off``:
    highest frequency at which contrast is ``cut_off_contrast``. All three are NaN if the frequency is not below
    ``highest``, and after any stage that moves light without a transfer function. ``aliasing``: fraction of the line
    spread energy (white spectrum) above Nyquist, which sampling folds back. ``sparrow``: separation at which the dip
    between two points disappears. ``rayleigh``: separation at which the dip equals the dip of two Airy discs at
    Rayleigh's criterion. Both assume that the curve is the same in all directions. ``effective_*``: MTF50, capped at
    Nyquist. ``resolution_gain`` is the ratio by which MTF50 would grow without a factor; for sampling it is MTF50 over
    Nyquist. ``limiting_factor`` is the index, into ``factor``, of the largest gain. ``mtf`` is the curve after each
    stage and ``factor_mtf`` the curve of each factor alone, at 65 frequencies up to 1 cycle/pixel (``frequency``;
    ``frequency_lp_mm`` in cycles/mm). Sampling has no transfer function and no curve.
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
    nanoseconds: ClassVar = 5e4

    pixel_pitch: float = quantity("pixel_pitch")
    angle: float = param(
        0.0, units="deg", at_least=-180, at_most=180, doc="direction along which detail changes, from x towards y"
    )
    rendering: bool = param(False, doc="whether the curve includes the softness or the cells of the scene's chart")
    cut_off_contrast: float = param(1e-3, above=0, below=0.5, doc="contrast at which detail counts as lost")
    highest: float = param(4.0, units="cycles/um", above=0, doc="highest frequency of the search")
    solved: bool = param(
        True,
        fidelity=True,
        exact=True,
        reference="true: on the curve itself",
        settings=(False, True),
        costs=(0.55, 1.0),
        doc="whether crossings and contrast at Nyquist are solved on the curve itself; false: on splines with "
        "twice the nodes",
    )
    point_nodes: int = param(
        160,
        at_least=16,
        held=(16, 4096),
        fidelity=True,
        reference="320",
        settings=(48, 64, 96, 160, 240, 320),
        costs=(0.78, 0.78, 0.84, 1.0, 1.08, 1.1),
        doc="nodes of the integral for the point image, on which separations are based",
    )
    nodes: int = param(
        512,
        at_least=16,
        held=(16, 16384),
        fidelity=True,
        reference="4096 nodes",
        settings=(32, 64, 128, 256, 512, 1024, 2048, 4096),
        costs=(0.95, 0.95, 0.95, 0.96, 1.0, 1.05, 1.17, 1.36),
        doc="number of frequencies at which crossings are searched, with splines between them",
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
        """Return the contrast after each stage, (stage, frequency), always from the transfer functions themselves
        rather than a spline; NaN where no product of transfer functions describes the camera.
        """
        at = curves.PER_PIXEL / self.pixel_pitch
        found = [
            response(otf, observed, towards, self.rendering)(at) if otf.whole else curves.undefined() for otf in otfs
        ]
        return np.array(found).reshape(-1, curves.SAMPLES)

    def seen(self, otf: Otf, observed: Observed, towards: tuple[float, float]) -> CurveFigures | None:
        """Return the results that do not depend on the pitch of later pixels, cached for all pitches; None where no
        product of transfer functions describes the camera.
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
        """Return the MTF50 of a camera, cycles/um, from ``known`` or else from the cache."""
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
            at_nyquist = max(float(seen.curve.contrast(np.array(nyquist))), 0.0)
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
        """Return the number of spline nodes."""
        return self.nodes if self.solved else 2 * self.nodes

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Return a bound on the errors of all metrics (relative for frequencies and separations), caused by splines,
        their crossings, and the integral for a point.

        Solved crossings are accurate to 1e-9, where splines reach 1e-3. With fewer than 48 ``point_nodes``, the dark
        ring of a point may not be found.
        """
        on_splines = 0.0 if self.solved else 1.7e-2 * (128 / self.places()) ** 1.5
        points = 8e-5 * (48 / self.point_nodes) ** 2 if self.point_nodes >= 48 else 1.0
        return min(1.0, 7e-3 * (128 / self.nodes) ** 3 + on_splines + points + 2e-6), "fitted"


@dataclass(frozen=True)
class CurveFigures:
    """Metrics of one curve that do not depend on the pitch."""

    curve: resolution.ContrastCurve
    mtf50: float
    mtf10: float
    cut_off: float
    rayleigh: float
    sparrow: float


def _shares(weights: FloatArray) -> FloatArray:
    """Return fractions of all photons, rounded to 12 digits. They agree for all pitches up to rounding errors, so
    rounding lets all pitches share one curve.
    """
    weights = np.asarray(weights, dtype=float)
    return np.round(weights / weights.sum(), 12)


def one_channel(values: FloatArray) -> FloatArray:
    """Return the values of the second channel (green), or of the only channel."""
    return values[min(1, len(values) - 1)]


_FIGURES = ("mtf50", "mtf10", "cut_off", "mtf_nyquist", "aliasing", "rayleigh", "sparrow")


def picture_height(transfers: Sequence[tuple[str, Otf]]) -> float:
    """Return the height of the area of pixels that is read out, um; NaN without a pixel stage."""
    for _, otf in transfers:
        if otf.weights is not None and otf.grid is not None:
            line = otf.grid.line("y")
            return float(line.size * line.um()[1])
    return math.nan
