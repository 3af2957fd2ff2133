"""Commands that follow detail, noise and colour through a camera: ``information`` and ``losses``."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("information")
@options.FILE
@options.settings("Override a value: camera.f_number=4, sharpen.strength=0.3" + options.REPEAT)
@click.option(
    "--reflectance", default=0.18, show_default=True, metavar="R", help="Mean reflectance of the grey detail."
)
@click.option(
    "--contrast-ratio",
    default=4.0,
    show_default=True,
    metavar="C",
    help="Ratio of the brightest to the darkest detail.",
)
@click.option(
    "--object",
    "size",
    default=4.0,
    show_default=True,
    metavar="PIXELS",
    help="Full width at half maximum of the spot for SNRi.",
)
@click.option("--object-contrast", default=0.05, show_default=True, metavar="K", help="Contrast of that spot.")
@click.option(
    "--frames",
    default=16,
    show_default=True,
    metavar="N",
    help="Number of noise frames from which NEQ is measured; 0: do not measure.",
)
@options.JSON
@options.gather
@later("etendue_lab.information.terminal:information_command")
def information() -> None:
    """Report how many bits per pixel of fine detail a camera transmits, and where along the chain they are lost.

    Shannon's information capacity, noise equivalent quanta (NEQ) and the signal-to-noise ratio of the ideal observer
    (SNRi) are given for grey detail on a grey card: for the light with its shot noise alone, then after every blur,
    every source of noise and every picture. They are predicted from transfer functions, the camera's noise and the
    response of stages to one pixel. NEQ of the linear pictures is also measured: mean^2 MTF^2 / NPS, with the MTF of a
    slanted edge and the NPS of noise frames.

    The signal is light that is uniformly distributed between two levels of the contrast ratio, with equal power at all
    frequencies up to Nyquist: its variance is (range/mean)^2 / 12. After the mosaic the channels are combined optimally
    at each frequency; each channel alone is listed too.
    """


@command("losses")
@options.FILE
@options.settings("Override a value: camera.f_number=4, sharpen.strength=0.3" + options.REPEAT)
@click.option(
    "--reflectance",
    default=0.18,
    show_default=True,
    metavar="R",
    help="Reflectance of the grey card for contrast and noise.",
)
@click.option(
    "--runs",
    default=64,
    show_default=True,
    type=click.IntRange(0),
    metavar="N",
    help="Maximum number of cameras to run for colour; 64 cameras cover all sets of six stages. For more "
    "stages, orders are sampled. 0: no colour.",
)
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(0), metavar="N", help="Seed of the sampled orders."
)
@options.JSON
@options.gather
@later("etendue_lab.losses.terminal:losses_command")
def losses() -> None:
    """Compute each stage's share of the lost contrast, signal-to-noise ratio and colour.

    Shares are Shapley values. Starting from the ideal camera, each ideal stage is replaced by the real one; the share
    of a stage is the loss that its replacement adds, averaged over all orders of replacement. The shares sum to the
    total loss. A stage that reduces the loss, such as sharpening, has a negative share. Contrast (mean up to Nyquist)
    and SNR of a grey card are in decibels, in which the effects of blurs and gains add up. Colour is the mean squared
    CIEDE2000 difference from the ideal camera, as defined by `etendue quality`. For pairs of stages, the command
    prints by how much the loss decreases if both stages are ideal: as predicted from the shares, and as computed.

    For numerical error by stage, see `etendue accuracy`.
    """
