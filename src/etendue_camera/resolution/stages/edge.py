"""Measured resolution: a slanted edge in every picture of a run, compared with the transfer functions.

In:  the pictures, transfer functions and white of all stages.
Out: measured MTF50 with its interval, analytic MTF50 along the same normal, their difference, flags, by ``stage``;
     the limiting factor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from etendue.api import Facts, Grid, Labels, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.resolution import contrast
from etendue_camera.resolution.stages import curves
from etendue_camera.resolution.stages.analytic import (
    FACTORS,
    Observed,
    first_largest,
    gains,
    half_contrast,
    picture_height,
    response,
)
from etendue_camera.resolution.stages.edge_figures import COLUMNS, carry_clipped, doubt, effective, normal, row
from etendue_camera.resolution.stages.edge_pictures import Edge, KnownPicture, Window, known_edge, once_for
from etendue_camera.resolution.stages.luminance import (
    NOISE_FREE,
    SATURATED,
    PictureProbe,
    Seen,
    channels_of,
    check_encoding,
    decoded,
    first_exposure,
    second_of,
    weighed,
)
from etendue_camera.sensor import cfa
from etendue_camera.sensor.stages.masks import mask_of

if TYPE_CHECKING:
    from etendue.compute.joined.otf import Otf

EVERY_FACTOR = (*FACTORS, "demosaic", "noise")
NOISY = 0.1  # interval width above which noise limits


@dataclass(frozen=True, kw_only=True)
class EdgeProbe(PictureProbe):
    """Measure the slanted edge of the pipeline's own scene at every stage that has a picture.

    One edge between uniform areas is searched in every picture (2 to 43 degrees from rows and columns), or in a region
    around a position on the image plane. The measured signal is luminance. For light, this is the photons of the
    pixel's second channel (green); after the filters it is the plane of this channel, or its sites in the mosaic. For
    camera channels it is Y from the fitted matrix if there are ``colour_fit`` and ``white``, otherwise green.
    Tristimulus values give Y directly; display RGB gives Y as sRGB, after ``encoding`` has been decoded.

    ``edge_mtf50``, its 95 % interval (bootstrap over rows; NaN where a picture has no noise) and ``edge_mtf50_cycles``
    are along the edge normal. Cycles per pixel and Nyquist refer to the pixels of the camera, even if the picture is
    light on a finer grid. This applies to ``edge_mtf50_cycles``, ``edge_aliasing`` (fraction of the line spread energy
    above Nyquist), the flags and ``edge_effective_*`` (MTF50, capped at Nyquist). ``edge_analytic`` is the MTF50 of the
    transfer functions up to the stage under the scene's own white, including the rendering of the chart. It is NaN from
    the first stage that is not linear and shift-invariant, at the latest from the mosaic. ``edge_difference`` is
    measured minus analytic. ``edge_flags`` adds 1 (MTF50 above Nyquist), 2 (not reached), 4 (clipped: in this picture,
    or in the mosaic before it), 8 (interval wider than a tenth), 16 (no edge to measure). ``esfr`` is the measured
    response at 65 frequencies up to 1 cycle/pixel (``frequency``; ``frequency_lp_mm`` in cycles/mm), NaN above 1
    cycle/sample for light on a grid coarser than the pixels, and ``esfr_analytic`` the response computed from the
    transfer functions.

    ``limiting_factor`` is an index into ``factor``. It is noise if the intervals of the mosaic and of the first picture
    in camera channels, both capped at Nyquist, are wider than a tenth of MTF50, or if noise hides an edge that is
    visible in the noise-free pixels. Otherwise it is the factor with the largest ``resolution_gain``, the ratio by
    which MTF50 would grow without it. The gains of lens, diffusion, geometry and sampling are analytic (see
    ``resolution``). The gain of demosaicing is MTF50 of the pixels divided by MTF50 of the first ``rgb_camera``, each
    capped at Nyquist. The gain of noise is 1 plus the width of the narrower interval divided by MTF50. It is NaN if
    pixels are clipped, if the analytic gains are unknown (a lens without a transfer function), or if the noise-free
    picture of the pixels shows no edge.
    """

    writes: ClassVar = {
        "edge_mtf50": "stage [cycles/um] nan",
        "edge_mtf50_low": "stage [cycles/um] nan",
        "edge_mtf50_high": "stage [cycles/um] nan",
        "edge_mtf50_cycles": "stage [cycles/pixel] nan",
        "edge_effective_lp_mm": "stage [cycles/mm] nan",
        "edge_effective_cycles": "stage [cycles/pixel] nan",
        "edge_effective_line_widths": "stage [1] nan",
        "edge_mtf10": "stage [cycles/um] nan",
        "edge_aliasing": "stage [1] nan",
        "edge_angle": "stage [deg] nan",
        "edge_analytic": "stage [cycles/um] nan",
        "edge_difference": "stage [cycles/um] nan",
        "edge_flags": "stage [1] uint8",
        "resolution_gain": "factor [1] nan",
        "limiting_factor": "[1] nan",
        "esfr": "stage frequency [1] nan",
        "esfr_analytic": "stage frequency [1] nan",
        "frequency_lp_mm": "frequency [cycles/mm]",
        "nyquist_lp_mm": "[cycles/mm]",
    }
    creates: ClassVar = {"factor": Labels(EVERY_FACTOR), "frequency": curves.FREQUENCY}
    nanoseconds: ClassVar = 5e5

    centre_y: float = param(0.0, units="um", doc="y centre of the region on the image plane, if it has a size")
    centre_x: float = param(0.0, units="um", doc="x centre of the region on the image plane")
    region_height: float = param(
        0.0, units="um", at_least=0, doc="height of the region; 0: the strongest edge is searched"
    )
    region_width: float = param(0.0, units="um", at_least=0, doc="width of the region")
    encoding: str = param(
        "sRGB", choices=("sRGB", "BT.709", "power"), doc="encoding of rgb_display, as in the stage encode"
    )
    exponent: float = param(0.45, above=0, at_most=5, doc="exponent of encoding 'power'")
    tails: bool = param(True, doc="whether light beyond the region is extrapolated; set false under non-uniform light")
    draws: int = param(
        400,
        at_least=50,
        at_most=100_000,
        fidelity=True,
        reference="6400 draws",
        studied=True,
        settings=(50, 100, 200, 400, 1600, 6400),
        doc="number of bootstrap draws",
    )
    highest: float = param(4.0, units="cycles/um", above=0, doc="upper end of the search for the analytic MTF50")
    nodes: int = param(
        512,
        at_least=16,
        held=(16, 16384),
        fidelity=True,
        reference="1024 nodes",
        settings=(64, 128, 256, 512, 1024),
        doc="number of frequencies at which crossings are searched",
    )

    def __post_init__(self) -> None:
        if (self.region_height > 0) != (self.region_width > 0):
            raise ValueError(
                f"region_height is {self.region_height:g} and region_width {self.region_width:g}; give both, or "
                f"neither to have the edge found automatically"
            )

    # -- pictures ------------------------------------------------------------------------------------------------

    def run(
        self,
        transfers: Sequence[tuple[str, Otf]],
        lights: list[tuple[str, FloatArray, Grid]],
        matrices: Seen,
        whites: Seen,
        irradiance: list[tuple[str, FloatArray, Grid]],
        photon_rate: list[tuple[str, FloatArray, Grid]],
        mosaic_linear: Seen,
        rgb_camera: Seen,
        xyz_scene: Seen,
        rgb_linear: Seen,
        rgb_display: Seen,
        stage: Array,
    ) -> dict[str, Array]:
        light = lights[-1][1].astype(float) if lights else None
        channels, green = channels_of(transfers), second_of(transfers)
        # for a grey chart
        observed = Observed(green if light is None or green is None else green * light, channels, light)
        taken = weighed(transfers, matrices, whites, lambda a: decoded(a, self.encoding, self.exponent))
        check_encoding(rgb_linear, rgb_display, self.encoding, self.exponent)
        given = {
            "irradiance": irradiance,
            "photon_rate": photon_rate,
            "mosaic_linear": mosaic_linear,
            "rgb_camera": rgb_camera,
            "xyz_scene": xyz_scene,
            "rgb_linear": rgb_linear,
            "rgb_display": rgb_display,
        }
        found: dict[str, tuple[str, Edge | None, float]] = {}
        for variable, pictures in given.items():
            for name, array, grid in pictures:
                found[name] = (variable, self.measured(variable, array, taken[variable], grid), grid.line("x").um()[1])
        clipped = any(self.clips(array, grid) for _, array, grid in mosaic_linear[:1])
        rows = {name: row(*found[name][1:], self.pixel_pitch) for name in stage}
        carry_clipped(rows, [name for name, *_ in mosaic_linear[:1]], stage, clipped)
        analytic = self.analytic(transfers, observed, [(name, *found[name][:2]) for name in stage])
        esfr = [
            curves.undefined() if edge is None else curves.of_edge(edge.frequency, edge.sfr, self.pixel_pitch / step)
            for edge, step in (found[name][1:] for name in stage)
        ]
        columns = {key: np.array([rows[name][key] for name in stage]) for key in COLUMNS}
        columns["edge_flags"] = columns["edge_flags"].astype(np.uint8)
        known = np.array([analytic[name][0] for name in stage])
        limited = columns["edge_effective_cycles"] / self.pixel_pitch
        gain, limiting = self.limits(transfers, observed, [(name, *found[name]) for name in stage], clipped)
        return {
            **columns,
            "edge_effective_lp_mm": limited * 1e3,
            "edge_effective_line_widths": 2 * limited * picture_height(transfers),
            "edge_analytic": known,
            "edge_difference": columns["edge_mtf50"] - known,
            "resolution_gain": gain,
            "limiting_factor": np.array(limiting),
            "esfr": np.array(esfr).reshape(-1, curves.SAMPLES),
            "esfr_analytic": np.array([analytic[name][1] for name in stage]).reshape(-1, curves.SAMPLES),
            **curves.beside(self.pixel_pitch),
        }

    def measured(self, variable: str, array: FloatArray, taken: Callable[[Any], Any], grid: Grid) -> Edge | None:
        """Return the edge of a picture; None if there is no edge."""
        y, x = grid.line("y"), grid.line("x")
        sites = None
        if variable == "mosaic_linear":
            mask = mask_of(self.pattern)
            if len(mask.channels) > 1:
                index = cfa.channel_index(mask, y.size, x.size, round(y.start), round(x.start))
                sites = index == min(1, len(mask.channels) - 1)
        window = self.window(grid)
        limits = {"mosaic_linear": (-math.inf, 1.0), "rgb_display": (0.0, 1.0)}.get(variable)

        def make() -> Edge | None:
            picture = KnownPicture(np.ascontiguousarray(taken(first_exposure(array, variable)), dtype=float), sites)
            return known_edge(
                picture,
                window,
                limits,
                0 if variable in NOISE_FREE else self.draws,
                self.tails,
                variable == "irradiance",
            )

        if variable != "irradiance" or not isinstance(array, np.ndarray):
            return make()
        weighed = taken(np.eye(len(array), dtype=array.dtype)).tobytes()  # the weights of the bands
        return once_for(array, (window, self.tails, weighed), make)

    def window(self, grid: Grid) -> Window | None:
        """Return the region in a picture as slice limits; None if no region is given and the edge is searched."""
        if not self.region_height > 0:
            return None
        y, x = grid.line("y"), grid.line("x")
        (start_y, step), (start_x, _) = y.um(), x.um()
        top, bottom = _span(self.centre_y, self.region_height, start_y, step, y.size)
        left, right = _span(self.centre_x, self.region_width, start_x, step, x.size)
        return top, bottom, left, right

    def clips(self, mosaic: FloatArray, grid: Grid) -> bool:
        """Return whether pixels of any colour are clipped around the edge, in the measured exposure."""
        top, bottom, left, right = self.window(grid) or (0, grid.line("y").size, 0, grid.line("x").size)
        seen = first_exposure(mosaic, "mosaic_linear")[top:bottom, left:right]
        return bool(np.count_nonzero(seen >= 1) > SATURATED * seen.size)

    # -- results of the transfer functions ------------------------------------------------------------------------

    def analytic(
        self, transfers: Sequence[tuple[str, Otf]], observed: Observed, found: Any
    ) -> dict[str, tuple[float, Any]]:
        """Return the analytic MTF50 (cycles/um) and MTF curve of each picture along the normal of its edge, NaN where
        no product of transfer functions describes the picture.
        """
        by_name = dict(transfers)
        values: dict[str, tuple[float, Any]] = {}
        current = transfers[0][1].without([name for name, _ in transfers[0][1].parts]) if transfers else None
        ended, pixel = not transfers, None
        for number, (name, variable, edge) in enumerate(found):
            if name in by_name:
                pixel = by_name[name]
                current = replace(pixel, behind=())  # its own picture: charge moves in a later stage
                ended = ended or not current.whole
            elif pixel is not None and name in dict(pixel.behind):
                last = list(dict(pixel.behind)).index(name)
                current = replace(pixel, behind=pixel.behind[: last + 1])
            elif variable != "irradiance" or not any(by_name[n].whole for n, *_ in found[number + 1 :] if n in by_name):
                ended = True
            if ended or edge is None or current is None:
                values[name] = (math.nan, curves.undefined())
                continue
            own = response(current, observed, normal(edge), rendering=True)
            grid = contrast.search_nodes(self.highest, self.nodes)
            values[name] = (contrast.falls_below(own, 0.5, grid, own(grid)), own(curves.PER_PIXEL / self.pixel_pitch))
        return values

    def limits(
        self, transfers: Sequence[tuple[str, Otf]], observed: Observed, found: Any, clipped: bool
    ) -> tuple[Any, float]:
        """Return the gains, (factor,), and the index of the limiting factor, NaN where it is unknown."""
        gain = np.full(len(EVERY_FACTOR), math.nan)
        edges = [edge for *_, edge, _ in found if edge is not None]
        gain[: len(FACTORS)], spread = self.known_gains(transfers, observed, edges)
        if clipped:
            return gain, math.nan
        # first picture of each kind
        first = {variable: (edge, self.pixel_pitch / step) for _, variable, edge, step in reversed(found)}
        (before, pixels), (after, behind) = (
            first.get(variable, (None, 1.0)) for variable in ("photon_rate", "rgb_camera")
        )
        if before is not None and after is not None:
            gain[EVERY_FACTOR.index("demosaic")] = effective(before, pixels, spread) / effective(after, behind)
        noise = _noise(first)
        gain[EVERY_FACTOR.index("noise")] = 1.0 + noise if math.isfinite(noise) else math.nan
        if np.isnan(gain[: len(FACTORS)]).any() or (before is None and not math.isnan(noise)):
            return gain, math.nan
        if noise > NOISY:  # or noise hides an existing edge
            return gain, float(EVERY_FACTOR.index("noise"))
        return gain, first_largest(np.where(np.isnan(gain), 0.0, gain)[:-1])

    def known_gains(
        self, transfers: Sequence[tuple[str, Otf]], observed: Observed, edges: list[Edge]
    ) -> tuple[Any, float]:
        """Return the analytic gains along the normal of the first edge, NaN where a transfer function is missing; and
        the ratio of MTF50 after charge has moved between pixels to MTF50 before.
        """
        pixel = next((otf for _, otf in transfers if otf.weights is not None), None)
        if pixel is None or not pixel.whole or not edges:
            return np.full(len(FACTORS), math.nan), 1.0
        across = normal(edges[0])

        def half(otf: Otf) -> float:
            return half_contrast(otf, observed, across, self.highest, self.nodes)

        gain = gains(pixel, half, 0.5 / self.pixel_pitch, self.highest)
        return gain, half(pixel) / half(replace(pixel, behind=())) if pixel.behind else 1.0

    def error(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Bound the error of a noise-free edge before the mosaic, plus the error of the analytic MTF50 due to the
        number of nodes. With noise, use the interval instead.
        """
        return 5e-3 + 1e-6 * (64 / self.nodes) ** 3, "measured"


def _noise(first: dict[str, tuple[Edge | None, float]]) -> float:
    """Return the relative MTF50 interval width of the mosaic or of the first picture in camera channels, whichever is
    smaller; inf if noise hides both edges, NaN if no picture has noise.
    """
    read_out = [seen for variable, seen in first.items() if variable not in NOISE_FREE]
    two = [first[variable] for variable in ("mosaic_linear", "rgb_camera") if variable in first] or read_out[:1]
    known = (doubt(edge, per_pixel) for edge, per_pixel in two if edge is not None)
    return min(known, default=math.inf) if two else math.nan


def _span(centre: float, size: float, start: float, step: float, count: int) -> tuple[int, int]:
    """Return the slice limits of the pixels in a range on the image plane; empty for a range outside the picture."""
    low = round((centre - 0.5 * size - start) / step + 0.5)
    high = round(low + size / step)
    return min(max(low, 0), count), min(max(high, 0), count)
