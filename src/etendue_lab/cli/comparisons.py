"""Commands that run a camera many times and hold the runs against each other: ``compare``, ``quality``, ``noise``."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("compare")
@options.FILE
@click.option(
    "--axis",
    required=True,
    metavar="AXIS[=V,V,..]",
    help="demosaic.use, demosaic.use=a,b or sharpen.strength=0,0.1,0.2.",
)
@options.settings()
@click.option(
    "--repeat",
    default=5,
    show_default=True,
    type=click.IntRange(1),
    metavar="N",
    help="Time each alternative so often; the best counts.",
)
@click.option("--noise-free", is_flag=True, help="Expected values: no noise, no rounding.")
@click.option("--no-mtf50", is_flag=True, help="Leave the run in front of an edge out.")
@options.SCHEDULER
@options.WORKERS
@options.output("Table, plot and crops; default ./<name>-compare-<axis>.")
@options.JSON
@options.gather
@options.gather_way
@later("etendue_lab.compare.ranking:compare_command")
def compare() -> None:
    """Rank alternatives: quality against run time, plugins included.

    --axis demosaic.use takes every installed stage that writes what the stage `demosaic` of the file writes and reads
    no more than it does, and does not say that it has another role; demosaic.use=a,b takes these, and '{ use = "mine",
    iterations = 5 }' one with its parameters. Any stage and any parameter may be the axis. Light, mosaic and noise are
    computed once, the same for all that stand behind them.

    The reference is what the same pixels would give without noise and mosaic, at every pixel, through the same later
    stages. PSNR is measured on linear values where the axis has its effect: at the stage's own picture, or at
    rgb_camera for what stands before it; "encoded", CIEDE2000, zipper and false colour on the finished picture. A stage
    that reads and writes rgb_camera alone (sharpening, denoising) is left out of the reference: it is held against the
    picture that did not need it. Any other axis in front of the pixels or behind the demosaicer (f_number,
    display.display) reaches the reference too: then each value has one of its own, and the rank goes by PSNR of the
    encoded picture. A border of 10 pixels is not counted. MTF50 comes from a second, noise-free run of the same camera
    in front of a slanted edge. Time is that of the stage alone on one thread.

    Exit codes: 0 done, 2 the request is wrong, 3 an alternative broke off, or one that was named is refused, or all but
    one are.
    """


@command("quality")
@options.FILE
@options.settings()
@options.SWEEPS
@options.TOLERANCE
@options.NOTHING_LEFT_OUT
@click.option(
    "--samples-per-degree",
    default=34.0,
    show_default=True,
    metavar="S",
    help="Pixels in a degree of view: 100 dpi at 50 cm.",
)
@click.option(
    "--without",
    multiple=True,
    metavar="STAGE",
    help="Leave this too out of the ideal camera: diffusion" + options.REPEAT,
)
@click.option(
    "--keep", multiple=True, metavar="STAGE", help="Keep this in the ideal camera, such as distortion" + options.REPEAT
)
@click.option(
    "--pictures",
    default=12,
    show_default=True,
    type=click.IntRange(0),
    metavar="N",
    help="Pictures with -o at most, spread over the sweep.",
)
@options.SCHEDULER
@options.WORKERS
@options.output("Table as CSV and JSON, pictures side by side.")
@options.JSON
@options.gather
@options.gather_way
@later("etendue_lab.quality.terminal:quality_command")
def quality() -> None:
    """How far a camera is from the ideal one: the same pipeline with a perfect lens, without noise and mosaic.

    For every cell of the sweep: PSNR of camera primaries and of the encoded picture, SSIM of its luma, CIEDE2000 and
    S-CIELAB of the displayed light, SNR, visible noise in a uniform region, dynamic range. Blur, aberrations,
    distortion and glare are left out of the ideal camera, and so is sharpening; its pixels, its light and its colours
    are those of the camera.

    Exit codes: 0 done, 2 the request is wrong, 3 some cells failed.
    """


@command("noise")
@options.FILE
@options.settings("camera.iso=800, demosaic.use=demosaic_bilinear; repeatable.")
@click.option("--reflectance", default=0.18, show_default=True, metavar="R", help="Of the grey card.")
@click.option(
    "--frames", default=4, show_default=True, metavar="N", help="Frames of noise, each with fixed patterns of its own."
)
@options.JSON
@options.gather
@later("etendue_lab.noise.terminal:noise_command")
def noise() -> None:
    """Noise behind every stage of a camera in front of a grey card: predicted, and found in frames of noise.

    Predicted from shot noise, read noise, fixed patterns and rounding, and from what the stages behind the mosaic
    answer to one pixel; stages that adapt to their picture adapt to noise, and differ from the prediction. Correlations
    between channels and between neighbours say how coarse and how coloured the noise looks.
    """
