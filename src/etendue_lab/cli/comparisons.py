"""Commands that run a camera several times and compare the runs: ``compare``, ``quality``, ``noise``."""

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
    help="The axis to compare: demosaic.use, demosaic.use=a,b or sharpen.strength=0,0.1,0.2.",
)
@options.settings()
@click.option(
    "--repeat",
    default=5,
    show_default=True,
    type=click.IntRange(1),
    metavar="N",
    help="Number of timing runs; the fastest is kept.",
)
@click.option("--noise-free", is_flag=True, help="Compare expected values, without noise and rounding.")
@click.option("--no-mtf50", is_flag=True, help="Skip the slanted-edge run.")
@options.SCHEDULER
@options.WORKERS
@options.output("Folder for table, plot and crops. Default: ./<name>-compare-<axis>.")
@options.JSON
@options.gather
@options.gather_way
@later("etendue_lab.compare.ranking:compare_command")
def compare() -> None:
    """Rank alternatives, plugins included, by quality against run time.

    --axis demosaic.use compares all installed stages that can replace the file's stage `demosaic`: stages that write
    the same variables, read no other variables, and declare no other role. demosaic.use=a,b compares these two stages;
    '{ use = "mine", iterations = 5 }' is a stage with parameters. The axis can be any stage or any parameter. All
    stages before the compared one (light, mosaic, noise) are computed once and shared by the alternatives.

    The reference is the picture of a camera whose pixels measure all channels without noise, followed by the same later
    stages. PSNR is measured on linear values: on the picture that the compared stage writes or, if the mosaic comes
    later, on rgb_camera. "encoded", CIEDE2000, zipper and false colour are measured on the finished picture. If the
    axis is a stage that reads and writes only rgb_camera (sharpening, denoising), the reference omits this stage, so
    that its result is compared with an undisturbed picture. Any other axis before the pixels or after the demosaicer
    (f_number, display.display) also changes the reference: each value then has its own reference, and alternatives are
    ranked by PSNR of the encoded picture. A border of 10 pixels is ignored. MTF50 comes from a second, noise-free run
    of the same camera with a slanted edge. Time is the time of the stage alone, on one thread.

    Exit codes: 0 done, 2 invalid request, 3 an alternative failed, a named alternative was refused, or only one was
    left.
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
    help="Viewing condition in pixels per degree; 34 is 100 dpi at 50 cm.",
)
@click.option(
    "--without",
    multiple=True,
    metavar="STAGE",
    help="Also remove this stage from the ideal camera, such as diffusion" + options.REPEAT,
)
@click.option(
    "--keep",
    multiple=True,
    metavar="STAGE",
    help="Keep this stage in the ideal camera, such as distortion" + options.REPEAT,
)
@click.option(
    "--pictures",
    default=12,
    show_default=True,
    type=click.IntRange(0),
    metavar="N",
    help="Maximum number of pictures with -o, spread over the sweep.",
)
@options.SCHEDULER
@options.WORKERS
@options.output("Folder for table (CSV, JSON) and side-by-side pictures.")
@options.JSON
@options.gather
@options.gather_way
@later("etendue_lab.quality.terminal:quality_command")
def quality() -> None:
    """Compare a camera with the ideal camera: the same pipeline with a perfect lens, without noise and mosaic.

    For every cell of the sweep the command gives PSNR of camera primaries and of the encoded picture, SSIM of the luma
    of the encoded picture, CIEDE2000 and S-CIELAB of the displayed light, SNR, visible noise in a uniform region, and
    dynamic range. Blur, aberrations, distortion, glare and sharpening are left out of the ideal camera, which has the
    same pixels, light and colours as the camera.

    Exit codes: 0 done, 2 invalid request, 3 some cells failed.
    """


@command("noise")
@options.FILE
@options.settings("Override a value: camera.iso=800, demosaic.use=demosaic_bilinear" + options.REPEAT)
@click.option("--reflectance", default=0.18, show_default=True, metavar="R", help="Reflectance of the grey card.")
@click.option(
    "--frames",
    default=4,
    show_default=True,
    metavar="N",
    help="Number of noise frames, each with its own fixed patterns.",
)
@options.JSON
@options.gather
@later("etendue_lab.noise.terminal:noise_command")
def noise() -> None:
    """Report the noise after every stage of a camera that views a grey card, predicted and measured in noise frames.

    The prediction uses shot noise, read noise, fixed patterns, rounding, and the impulse response of the stages after
    the mosaic. Stages that adapt to their picture also adapt to its noise; their measured noise differs from
    the prediction. Correlations between channels indicate how coloured the noise looks, correlations between
    neighbouring pixels how coarse it looks.
    """
