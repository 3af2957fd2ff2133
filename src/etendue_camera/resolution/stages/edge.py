"""What a run resolves: a slanted edge measured in every picture of it, beside what the transfer functions say.

In:  the pictures, transfer functions and white of all stages.
Out: measured MTF50 with its interval, the analytic one along the same normal, their difference, flags, by ``stage``;
     what limits.
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
NOISY = 0.1  # width of an interval from which on noise limits


@dataclass(frozen=True, kw_only=True)
class EdgeProbe(PictureProbe):
    """The slanted edge of the pipeline's own scene, measured at every stage that has a picture.

    One edge between even fields is looked for in every picture (2 to 43 degrees from rows and columns), or in a region
    about a place on the image plane. Measured is luminance: of light, the photons of the pixel's second channel
    (green); behind the filters that channel's plane, or its sites in the mosaic; of camera channels Y through the
    fitted matrix where there is a ``colour_fit`` and ``white`` (green where not); Y of tristimulus values; Y of display
    primaries taken as sRGB's, encoded ones decoded first with ``encoding``.

    ``edge_mtf50`` and its 95 % interval (bootstrap of the rows; NaN where a picture has no noise) and
    ``edge_mtf50_cycles`` are along the edge's normal. A pixel is the camera's, also where the picture is light in front
    of it, on a grid of its own: so it is of ``edge_mtf50_cycles``, of ``edge_aliasing`` (share of the line spread's
    energy above Nyquist), of the flag, and of ``edge_effective_*``: MTF50, but at most Nyquist. ``edge_analytic`` is
    the frequency of half contrast of the transfer functions up to there under the scene's own white, the rendering of
    its chart included: NaN from the first stage on that is not linear and shift-invariant, the mosaic at the latest.
    ``edge_difference`` is measured minus analytic. ``edge_flags`` adds 1 (half contrast above Nyquist), 2 (not
    reached), 4 (clipped: in this picture, or in the mosaic in front of it), 8 (interval wider than a tenth), 16 (no
    edge to be measured). ``esfr`` is the whole measured response at 65 frequencies to 1 cycle/pixel (``frequency``;
    ``frequency_lp_mm`` has them in cycles/mm), NaN beyond 1 cycle/sample of light on a grid coarser than the pixels,
    and ``esfr_analytic`` that of the transfer functions.

    ``limiting_factor`` is an index into ``factor``: noise where the interval of the mosaic and that of the first
    picture in camera channels, both ended at Nyquist, are wider than a tenth, or hide an edge that the pixels do show;
    else the largest ``resolution_gain``: how many times MTF50 would be without the factor. Lens, diffusion, geometry
    and sampling are analytic (see ``resolution``), demosaic is MTF50 of the pixels over that of the first
    ``rgb_camera``, each at most Nyquist, noise 1 and the width of the narrower interval over MTF50. It is NaN where
    pixels are clipped, where the analytic gains are not known (a lens that is no transfer function), and where the
    pixels' own picture, free of noise, shows no edge.
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
    nanoseconds: ClassVar = 9e5

    centre_y: float = param(0.0, units="um", doc="middle of the region on the image plane, where it has a size")
    centre_x: float = param(0.0, units="um", doc="the same along x")
    region_height: float = param(
        0.0, units="um", at_least=0, doc="size of the region; 0: the strongest edge is looked for"
    )
    region_width: float = param(0.0, units="um", at_least=0, doc="the same along x")
    encoding: str = param("sRGB", choices=("sRGB", "BT.709", "power"), doc="of rgb_display, as the stage encode has it")
    exponent: float = param(0.45, above=0, at_most=5, doc="of encoding 'power'")
    tails: bool = param(True, doc="whether light beyond the region is extrapolated; not under uneven light")
    draws: int = param(
        400,
        at_least=50,
        at_most=100_000,
        fidelity=True,
        reference="6400 draws",
        studied=True,
        settings=(50, 100, 200, 400, 1600, 6400),
        doc="of the bootstrap",
    )
    highest: float = param(4.0, units="cycles/um", above=0, doc="where the search for the analytic MTF50 ends")
    nodes: int = param(
        512,
        at_least=16,
        held=(16, 16384),
        fidelity=True,
        reference="1024 nodes",
        settings=(64, 128, 256, 512, 1024),
        doc="frequencies at which a crossing is looked for",
    )

    def __post_init__(self) -> None:
        if (self.region_height > 0) != (self.region_width > 0):
            raise ValueError(
                f"region_height is {self.region_height:g} and region_width {self.region_width:g}; give both, or "
                f"neither to have the edge "
                "found"
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
        observed = Observed(
            green if light is None or green is None else green * light, channels, light
        )  # of a grey chart
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
        """The edge of a picture, None where there is none."""
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
        weighed = taken(np.eye(len(array), dtype=array.dtype)).tobytes()  # with what the bands are weighed
        return once_for(array, (window, self.tails, weighed), make)

    def window(self, grid: Grid) -> Window | None:
        """The region in a picture, as slices count; None where there is none."""
        if not self.region_height > 0:
            return None
        y, x = grid.line("y"), grid.line("x")
        (start_y, step), (start_x, _) = y.um(), x.um()
        top, bottom = _span(self.centre_y, self.region_height, start_y, step, y.size)
        left, right = _span(self.centre_x, self.region_width, start_x, step, x.size)
        return top, bottom, left, right

    def clips(self, mosaic: FloatArray, grid: Grid) -> bool:
        """Whether pixels of any colour are clipped where the edge is looked for, in the exposure that is measured."""
        top, bottom, left, right = self.window(grid) or (0, grid.line("y").size, 0, grid.line("x").size)
        seen = first_exposure(mosaic, "mosaic_linear")[top:bottom, left:right]
        return bool(np.count_nonzero(seen >= 1) > SATURATED * seen.size)

    # -- what the transfer functions say --------------------------------------------------------------------------

    def analytic(
        self, transfers: Sequence[tuple[str, Otf]], observed: Observed, found: Any
    ) -> dict[str, tuple[float, Any]]:
        """MTF50 and the curve along each picture's own normal, NaN where no product of transfer functions is what
        made the picture.
        """
        by_name = dict(transfers)
        values: dict[str, tuple[float, Any]] = {}
        current = transfers[0][1].without([name for name, _ in transfers[0][1].parts]) if transfers else None
        ended, pixel = not transfers, None
        for number, (name, variable, edge) in enumerate(found):
            if name in by_name:
                pixel = by_name[name]
                current = replace(pixel, behind=())  # its own picture: charge moves later
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
        """(factor,) gains, and the index of what limits, NaN where that is not known."""
        gain = np.full(len(EVERY_FACTOR), math.nan)
        edges = [edge for *_, edge, _ in found if edge is not None]
        gain[: len(FACTORS)], spread = self.known_gains(transfers, observed, edges)
        if clipped:
            return gain, math.nan
        first = {
            variable: (edge, self.pixel_pitch / step) for _, variable, edge, step in reversed(found)
        }  # picture of each kind
        (before, pixels), (after, behind) = (
            first.get(variable, (None, 1.0)) for variable in ("photon_rate", "rgb_camera")
        )
        if before is not None and after is not None:
            gain[EVERY_FACTOR.index("demosaic")] = effective(before, pixels, spread) / effective(after, behind)
        noise = _noise(first)
        gain[EVERY_FACTOR.index("noise")] = 1.0 + noise if math.isfinite(noise) else math.nan
        if np.isnan(gain[: len(FACTORS)]).any() or (before is None and not math.isnan(noise)):
            return gain, math.nan
        if noise > NOISY:  # or noise hides an edge that is there
            return gain, float(EVERY_FACTOR.index("noise"))
        return gain, first_largest(np.where(np.isnan(gain), 0.0, gain)[:-1])

    def known_gains(
        self, transfers: Sequence[tuple[str, Otf]], observed: Observed, edges: list[Edge]
    ) -> tuple[Any, float]:
        """Gains of what the transfer functions know, along the first edge, NaN where they do not say all; and what
        charge that moves between pixels leaves of MTF50.
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
        """Of a noise-free edge before the mosaic; with noise the interval says more. Of what the transfer functions
        say, by the nodes.
        """
        return 5e-3 + 1e-6 * (64 / self.nodes) ** 3, "measured"


def _noise(first: dict[str, tuple[Edge | None, float]]) -> float:
    """The least doubt of the mosaic and of the first picture in camera channels; inf where noise hides their edges,
    NaN where no picture has noise.
    """
    read_out = [seen for variable, seen in first.items() if variable not in NOISE_FREE]
    two = [first[variable] for variable in ("mosaic_linear", "rgb_camera") if variable in first] or read_out[:1]
    known = (doubt(edge, per_pixel) for edge, per_pixel in two if edge is not None)
    return min(known, default=math.inf) if two else math.nan


def _span(centre: float, size: float, start: float, step: float, count: int) -> tuple[int, int]:
    """First and last pixel, as slices count, of a stretch on the image plane; none where it lies outside."""
    low = round((centre - 0.5 * size - start) / step + 0.5)
    high = round(low + size / step)
    return min(max(low, 0), count), min(max(high, 0), count)
