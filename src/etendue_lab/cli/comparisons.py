"""Commands that run a camera several times and compare the runs: ``compare``, ``quality``, ``noise``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, say, show, tell


@command("compare")
@options.FILE
@click.option(
    "--axis",
    required=True,
    metavar="AXIS[=V,V,..]",
    help="What to compare: demosaic.use, demosaic.use=a,b or sharpen.strength=0,0.1,0.2.",
)
@options.settings()
@click.option(
    "--repeat",
    default=5,
    show_default=True,
    type=click.IntRange(1),
    metavar="N",
    help="Timing repeats; the best is kept.",
)
@click.option("--noise-free", is_flag=True, help="Expected values: no noise, no rounding.")
@click.option("--no-mtf50", is_flag=True, help="Skip the slanted-edge run.")
@options.SCHEDULER
@options.WORKERS
@options.output("Folder for table, plot and crops. Default: ./<name>-compare-<axis>.")
@options.JSON
@options.gather
@options.gather_way
def compare(
    given: options.Given,
    way: options.Way,
    axis: str,
    repeat: int,
    noise_free: bool,
    no_mtf50: bool,
    output: Path | None,
) -> None:
    """Rank alternatives, plugins included, by quality against run time.

    --axis demosaic.use takes every installed stage that writes what the file's stage `demosaic` writes, reads no more
    than it does, and declares no other role; demosaic.use=a,b takes these two, and '{ use = "mine", iterations = 5 }'
    takes one with parameters. Any stage and any parameter can be the axis. Light, mosaic and noise are computed once
    and shared by all alternatives after them.

    The reference is what the same pixels would give without noise and mosaic, at every pixel, through the same later
    stages. PSNR is measured on linear values where the axis takes effect: on the stage's own picture, or on rgb_camera
    for earlier stages. "encoded", CIEDE2000, zipper and false colour are measured on the finished picture. A stage that
    reads and writes only rgb_camera (sharpening, denoising) is left out of the reference: it is compared with the
    picture that did not need it. Any other axis before the pixels or after the demosaicer (f_number, display.display)
    affects the reference too: each value then has its own reference, and alternatives are ranked by PSNR of the encoded
    picture. A border of 10 pixels is ignored. MTF50 comes from a second, noise-free run of the same camera with a
    slanted edge. Time is that of the stage alone on one thread.

    Exit codes: 0 done, 2 invalid request, 3 an alternative failed, a named one was refused, or only one was left.
    """
    from etendue.result_files import check_folder
    from etendue_lab.compare.axis import parse_axis
    from etendue_lab.compare.ranking import document, print_comparison, write_files
    from etendue_lab.compare.study import compare as measure

    pipeline = given.pipeline()
    how, progress = way.options(), options.progress(way.silent)
    along = parse_axis(axis, options.number)
    folder = output or Path(
        f"{pipeline.name}-compare-{along.key.removesuffix('.use').removeprefix('camera.').replace('.', '_')}"
    )
    found = measure(pipeline, along, repeat, noise_free, how, progress, not no_mtf50, lambda: check_folder(folder))
    files = write_files(found, folder)
    if way.as_json:
        say({**document(found), "files": [str(path) for path in files]})
    else:
        show(print_comparison, found, files)
    sys.exit(3 if found.failed or found.lacking else 0)


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
    help="Also leave this stage out of the ideal camera, such as diffusion" + options.REPEAT,
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
def quality(
    given: options.Given,
    way: options.Way,
    samples_per_degree: float,
    without: tuple[str, ...],
    keep: tuple[str, ...],
    pictures: int,
    output: Path | None,
) -> None:
    """Compare a camera with the ideal one: the same pipeline with a perfect lens, without noise and mosaic.

    For every cell of the sweep: PSNR of camera primaries and of the encoded picture, SSIM of its luma, CIEDE2000 and
    S-CIELAB of the displayed light, SNR, visible noise in a uniform region, dynamic range. Blur, aberrations,
    distortion, glare and sharpening are left out of the ideal camera; its pixels, light and colours are those of the
    camera.

    Exit codes: 0 done, 2 invalid request, 3 some cells failed.
    """
    from etendue_lab.quality.study import pictures_of, write
    from etendue_lab.quality.study import quality as measure
    from etendue_lab.quality.terminal import print_quality

    pipeline, leave_out = given.pipeline(), not given.nothing_left_out
    found = measure(
        pipeline,
        options.installed(),
        samples_per_degree,
        without,
        keep,
        leave_out,
        way.options(),
        options.progress(way.silent),
        pictures_of(pipeline.name) if output else None,
        output,
        pictures,
    )
    if output:
        write(found, output)
    tell(way.as_json, found.document(), print_quality)
    sys.exit(3 if found.failed else 0)


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
def noise(given: options.Given, reflectance: float, frames: int, as_json: bool) -> None:
    """Report noise after every stage of a camera that views a grey card: predicted, and measured in noise frames.

    The prediction uses shot noise, read noise, fixed patterns, rounding, and the response of the stages after the
    mosaic to one pixel. Stages that adapt to their picture adapt to noise and differ from the prediction. Correlations
    between channels and between neighbours say how coloured and how coarse the noise looks.
    """
    from etendue_lab.noise.study import noise as measure
    from etendue_lab.noise.terminal import print_noise

    pipeline = given.pipeline()
    found = measure(pipeline, options.installed(), reflectance, frames, None, options.progress(as_json))
    tell(as_json, found.document(), print_noise)
