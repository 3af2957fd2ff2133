"""The pictures of docs/paper.md that a run does not draw itself.

    python benchmarks/paper_figures.py fig2 -o docs/paper/fig2.png                 likewise mtf, fig6: no archive needed
    python benchmarks/paper_figures.py fig7 paper_order -o docs/paper/fig7.png     likewise fig1, fig8, fig9, fig10
    python benchmarks/paper_figures.py times times times_order -o docs/paper/times.png

Archives are those of ``etendue run pipelines/paper.toml`` and ``pipelines/paper_order.toml``; their stages are drawn as
the contact sheet has them. The commands of each picture stand beside it in docs/paper.md.
"""

from __future__ import annotations

import argparse
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from etendue.transfer.resampling import area_weights
from etendue_camera.colour.encoding import srgb_decode, srgb_encode
from etendue_camera.optics import diffraction
from etendue_camera.sensor import photodiode, silicon

DPI, BOX, GAP, LABEL = 100, 256, 12, 34
DETAIL = (
    38,
    86,
    64,
)  # first row, first column and side of the part that is drawn four times as large: cap, glasses, eyes
WIDTH = 720  # of all pictures in a row
LINE: dict[str, Any] = {"linewidth": 1.8}
SINC_HALF = 0.603354564  # sin(pi x)/(pi x) is one half: MTF50 of a mean over w is this over w
GAUSSIAN_HALF = 0.187390625  # sqrt(ln 2 / 2) / pi: MTF50 of a Gaussian is this over sigma
INK = {"R": "#c0392b", "G": "#1e8449", "B": "#2459a6"}

PANELS = {
    "fig7": [("scene", "a) input"), ("lens", "b) behind the lens"), ("aperture", "c) behind the aperture")],
    "fig8": [("falloff", "a) light fall-off"), ("pixel", "b) CCD MTF"), ("mosaic", "c) Bayer mosaic")],
    "fig9": [("demosaic", "a) interpolation"), ("sharpen", "b) sharpened"), ("dynamic_range_clip", "c) dynamic range")],
    "fig10": [
        ("balance", "a) colour balance"),
        ("display", "b) colour correction"),
        ("encode", "c) gamma"),
        ("to_xyz", "c) XYZ"),
    ],
}
PHYSICAL = {
    "fig9": [("adc", "c) exposure, noise, converter"), ("demosaic", "a) interpolation"), ("sharpen", "b) sharpened")]
}
MOSAICS = {"mosaic": 3, "adc": 3}  # two thirds of a mosaic's samples are black: these are drawn so many times as bright


def encoded(tree: Any, stage: str) -> NDArray[np.float64]:
    """A stage as the contact sheet shows it: (y, x, 3), encoded sRGB."""
    frames = tree["frames"]
    if stage not in frames.stage.values:
        raise SystemExit(f"the archive has no picture of {stage}; it has {', '.join(map(str, frames.stage.values))}")
    return np.moveaxis(frames.preview.sel(stage=stage).values, 0, -1) / 255.0


def opened(folder: Path) -> Any:
    import xarray

    return xarray.open_datatree(folder / "data.zarr", engine="zarr")


# -- sheets of pictures, a screen pixel for a sample ---------------------------------------------------------------


def enlarged(picture: NDArray[np.float64], times: int) -> NDArray[np.float64]:
    return np.repeat(np.repeat(picture, times, axis=0), times, axis=1)


def sheet(rows: list[list[NDArray[np.float64]]], titles: list[list[str]]) -> Figure:
    """Pictures of one size in rows, each under its title ("": none)."""
    high, wide = rows[0][0].shape[:2]
    heads = [LABEL if any(row) else 0 for row in titles]
    width = GAP + len(rows[0]) * (wide + GAP)
    height = GAP + sum(heads) + len(rows) * (high + GAP)
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    top = height - GAP // 2
    for row, words, head in zip(rows, titles, heads, strict=True):
        for column, (picture, word) in enumerate(zip(row, words, strict=True)):
            left = GAP + column * (wide + GAP)
            figure.text(
                (left + wide / 2) / width,
                (top - head + 5) / height,
                word,
                ha="center",
                va="bottom",
                fontsize=9,
                linespacing=1.15,
            )
            figure.figimage(np.clip(picture, 0, 1), xo=left, yo=top - head - high, origin="upper")
        top -= head + high + GAP
    return figure


def stages_of(name: str) -> Callable[..., Figure]:
    def draw(folder: Path) -> Figure:
        """Three stages of a run, and a part of each four times as large."""
        tree = opened(folder)
        order = PANELS[name] if PANELS[name][-1][0] in tree["frames"].stage.values else PHYSICAL.get(name, PANELS[name])
        panels = []
        for stage, word in order:
            picture, note = encoded(tree, stage), f"stage {stage}"
            if stage in MOSAICS:
                picture = srgb_encode(np.minimum(MOSAICS[stage] * srgb_decode(picture), 1))
                note += f", {MOSAICS[stage]} x as bright"
            panels.append((picture, f"{word}\n{note}"))
        y, x, side = DETAIL
        side = min(side, WIDTH // len(panels) // 4)  # a row has its width: pictures are cut to the middle and the top
        cut = (BOX - 4 * side) // 2
        whole = [picture[: 4 * side, cut : cut + 4 * side] for picture, _ in panels]
        details = [enlarged(picture[y : y + side, x : x + side], 4) for picture, _ in panels]
        return sheet([whole, details], [[w for _, w in panels], [""] * len(panels)])

    return draw


def fig1(folder: Path) -> Figure:
    """One scene in fewer and fewer pixels, and in 256 x 256 behind lenses that blur as much."""
    from scipy.ndimage import gaussian_filter

    linear = srgb_decode(encoded(opened(folder), "scene"))
    rows: list[list[Any]] = [[], []]
    titles: list[list[str]] = [[], []]
    for count in (16, 32, 64, 128):
        weights = area_weights(BOX, count)
        means = np.einsum("ai,ijc,bj->abc", weights, linear, weights)
        sigma = GAUSSIAN_HALF / SINC_HALF * BOX / count
        rows[0].append(enlarged(srgb_encode(means), BOX // count))
        rows[1].append(srgb_encode(gaussian_filter(linear, (sigma, sigma, 0), mode="mirror")))
        titles[0].append(f"{count} x {count} pixels,\ndrawn as squares")
        titles[1].append("256 x 256 pixels, lens blur\n" + f"of the same MTF50 as {count}")
    return sheet(rows, titles)


def times(physical: Path, paper: Path) -> Figure:
    """The same scene, three integration times, both orders."""
    rows: list[list[Any]] = []
    titles: list[list[str]] = []
    y, x, side = 20, 60, 128
    for title, folder in (("physical order", physical), ("paper's order", paper)):
        shown = opened(folder)["encode"].rgb_display.sortby("integration_time")
        row, words = [], []
        for at in shown.integration_time.values:
            picture = np.moveaxis(
                shown.sel(integration_time=at, channel=["R", "G", "B"]).transpose("channel", "y", "x").values, 0, -1
            )
            row.append(enlarged(picture[y : y + side, x : x + side], 2))
            words.append(f"{title}, {1e3 * at:g} ms")
        rows.append(row)
        titles.append(words)
    return sheet(rows, titles)


# -- curves -----------------------------------------------------------------------------------------------------


def fig2() -> Figure:
    """A point through a round aperture, and two of them at three separations."""
    figure = Figure(figsize=(10.6, 5.6), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 4, height_ratios=(1, 0.95))
    u = np.linspace(-1.25, 1.25, 251)  # lambda/NA; a wavelength of 1 um and f/0.5 make that 1 um
    y, x = np.meshgrid(u, u, indexing="ij")

    def spot(at: float, y: Any, x: Any) -> Any:
        return diffraction.airy_intensity(np.hypot(y, x - at), 1.0, 0.5)

    for column, separation in enumerate((0.0, 0.4, 0.5, 0.6)):
        above, below = axes[0, column], axes[1, column]
        places = (-separation / 2, separation / 2) if separation else (0.0,)
        picture = sum(spot(at, y, x) for at in places)
        lines = [spot(at, 0.0, u) for at in places]
        total = sum(lines)
        peak = float(np.max(total))
        if separation:
            above.imshow(picture / peak, extent=(u[0], u[-1], u[0], u[-1]), cmap="gray", vmin=0, vmax=1)
            ratio, offset = (float(v) for v in diffraction.two_point_saddle(separation))
            verdict = {0.4: "one spot: not resolved", 0.5: "barely resolved", 0.6: "resolved"}[separation]
            above.set_title(f"{'bcd'[column - 1]}) {separation} λ/NA\n{verdict}", fontsize=10)
            below.plot(u, total / peak, color="black", **LINE)
            for line in lines:
                below.plot(u, line / peak, color="#2459a6", linewidth=1, linestyle="--")
            text = f"middle / peak = {ratio:.3f}" + (f"\npeaks at ±{offset:.3f}" if offset else "\none peak")
            below.annotate(
                text,
                (0, ratio),
                (0, 1.32),
                ha="center",
                va="center",
                fontsize=9,
                arrowprops={"arrowstyle": "->", "shrinkB": 1},
            )
        else:
            above.imshow(picture**0.3, extent=(u[0], u[-1], u[0], u[-1]), cmap="gray", vmin=0, vmax=1)
            above.set_title("a) one point\n(brightness to the power 0.3)", fontsize=10)
            below.plot(u, total, color="black", **LINE)
            ring = diffraction.RAYLEIGH / 2
            below.annotate(
                f"first dark ring\n{ring:.4f} λ/NA",
                (ring, 0),
                (0.62, 1.32),
                ha="center",
                va="center",
                fontsize=9,
                arrowprops={"arrowstyle": "->"},
            )
        above.set_xticks([])
        above.set_yticks([])
        below.set(xlim=(u[0], u[-1]), ylim=(0, 1.5), xlabel="distance, λ/NA", yticks=[0, 0.5, 1])
        below.set_xticks([-1, -0.5, 0, 0.5, 1])
        below.grid(color="0.9")
    axes[1, 0].set_ylabel("intensity over peak")
    return figure


def mtf() -> Figure:
    """The three factors of section 2.4 and their product."""
    figure = Figure(figsize=(9.4, 4.2), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    f = np.linspace(0, 0.65, 651)
    optics = diffraction.circular_otf(f, 0.55, 2.8)
    window = photodiode.aperture_otf(f, 4.0)

    def diffusion(wavelength: float, at: Any) -> Any:
        return photodiode.collection_mtf(at, float(silicon.absorption(wavelength)), 1.8, 10.0, 50.0)

    for wavelength, ink, dash in ((0.45, INK["B"], ":"), (0.55, INK["G"], "-"), (0.65, INK["R"], ":")):
        axis.plot(
            f,
            diffusion(wavelength, f),
            color=ink,
            linestyle=dash,
            label=f"diffusion D(f)/D(0), {1e3 * wavelength:.0f} nm",
            **LINE,
        )
    axis.plot(f, optics, color="#b9770e", label="optics: f/2.8, 550 nm", **LINE)
    axis.plot(f, window, color="#7d3c98", label="geometric: sinc(w f), w = 4 µm", **LINE)
    axis.plot(f, optics * diffusion(0.55, f) * window, color="black", label="product, 550 nm", linewidth=2.6)
    nyquist = 0.5 / 5.4
    value = float(
        diffraction.circular_otf(nyquist, 0.55, 2.8) * diffusion(0.55, nyquist) * photodiode.aperture_otf(nyquist, 4.0)
    )
    axis.axvline(nyquist, color="0.45", linestyle="--", linewidth=1)
    axis.text(nyquist + 0.004, 1.04, "Nyquist of 5.4 µm", fontsize=9, color="0.3")
    axis.plot([nyquist], [value], "o", color="black")
    axis.annotate(f"{value:.3f}", (nyquist, value), (0.018, 0.46), fontsize=11, arrowprops={"arrowstyle": "->"})
    axis.axhline(0, color="0.6", linewidth=0.8)
    axis.axvspan(nyquist, f[-1], color="0.95", zorder=0)
    axis.text(0.62, -0.24, "folds back", ha="right", fontsize=9, color="0.3")
    axis.set(xlim=(0, f[-1]), ylim=(-0.3, 1.1), xlabel="spatial frequency, cycles/µm", ylabel="contrast (signed)")
    axis.legend(fontsize=9, loc="center left", bbox_to_anchor=(1.01, 0.6))
    return figure


def fig6() -> Figure:
    """Cones of the eye and primaries of a display."""
    from etendue_camera import spectra

    edges = np.arange(390.0, 731.0, 5.0)
    middle = 0.5 * (edges[1:] + edges[:-1])
    figure = Figure(figsize=(9.6, 3.5), dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    for axis, curves, names, title in (
        (left, spectra.cone_fundamentals(tuple(edges)), "LMS", "a) cones (Stockman and Sharpe, 2 degrees)"),
        (
            right,
            spectra.display_primaries("Apple Studio Display", tuple(edges)),
            "RGB",
            "b) display primaries (Apple Studio Display)",
        ),
    ):
        for curve, name, ink in zip(np.asarray(curves).T, names, INK.values(), strict=True):
            axis.plot(middle, curve / np.max(curves), color=ink, label=name, **LINE)
        axis.set(xlabel="wavelength, nm", xlim=(390, 730), ylim=(0, 1.05), title=title)
        axis.title.set_fontsize(10)
        axis.grid(color="0.92")
        axis.legend()
    left.set_ylabel("relative")
    return figure


# -- one file ---------------------------------------------------------------------------------------------------

FIGURES: dict[str, tuple[Callable[..., Figure], int]] = {  # what draws it, and how many archives it takes
    "fig1": (fig1, 1),
    "fig2": (fig2, 0),
    "mtf": (mtf, 0),
    "fig6": (fig6, 0),
    **{name: (stages_of(name), 1) for name in PANELS},
    "times": (times, 2),
}


def written(figure: Figure, path: Path) -> None:
    """As a PNG in true colour: a palette would put contours round heads and into skies, which no camera has made."""
    from PIL import Image

    raw = io.BytesIO()
    figure.savefig(raw, format="png")
    Image.open(raw).convert("RGB").save(
        path, format="PNG", optimize=True
    )  # the ground is white: nothing is transparent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("figure", choices=FIGURES)
    parser.add_argument("archives", nargs="*", type=Path, metavar="ARCHIVE")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.png")
    asked = parser.parse_args()
    draw, count = FIGURES[asked.figure]
    if len(asked.archives) != count:
        parser.error(f"{asked.figure} takes {count} {'archive' if count == 1 else 'archives'}")
    written(draw(*asked.archives), asked.output)


if __name__ == "__main__":
    main()
