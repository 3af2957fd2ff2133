"""Commands that follow detail, noise and colour along a camera: ``information`` and ``losses``."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("information")
@options.FILE
@options.settings("camera.f_number=4, sharpen.strength=0.3" + options.REPEAT)
@click.option(
    "--reflectance", default=0.18, show_default=True, metavar="R", help="Of the grey card on which the detail lies."
)
@click.option(
    "--contrast-ratio", default=4.0, show_default=True, metavar="C", help="Of the brightest to the darkest detail."
)
@click.option(
    "--object",
    "size",
    default=4.0,
    show_default=True,
    metavar="PIXELS",
    help="Width of the spot of SNRi at half height.",
)
@click.option("--object-contrast", default=0.05, show_default=True, metavar="K", help="Of that spot.")
@click.option(
    "--frames", default=16, show_default=True, metavar="N", help="Frames of noise in which NEQ is measured; 0: none."
)
@options.JSON
@options.gather
@later("etendue_lab.information.terminal:information_command")
def information() -> None:
    """Bits a pixel that a camera tells of fine detail, and where along the chain they are lost.

    Shannon's information capacity, noise equivalent quanta (NEQ) and the signal-to-noise ratio of the ideal observer
    (SNRi) for grey detail on a grey card: of the light with its shot noise alone, then behind every blur, every source
    of noise and every picture, predicted from transfer functions, the camera's noise and what stages answer to one
    pixel. NEQ of the linear pictures is measured beside: mean^2 MTF^2 / NPS, with the MTF of a slanted edge and the NPS
    of frames of noise.

    The signal is light between two levels of the contrast ratio, all equally likely, with the same power at all
    frequencies up to
    Nyquist: variance (range/mean)^2 / 12. Behind the mosaic the channels are taken together, as the best sum of them at
    each frequency; what each tells alone stands beside.
    """


@command("losses")
@options.FILE
@options.settings("camera.f_number=4, sharpen.strength=0.3" + options.REPEAT)
@click.option(
    "--reflectance", default=0.18, show_default=True, metavar="R", help="Of the grey card of contrast and noise."
)
@click.option(
    "--runs",
    default=64,
    show_default=True,
    type=click.IntRange(0),
    metavar="N",
    help="Cameras that may be run for colour; 64 hold all sets of six stages, beyond that orders are drawn. 0: no "
    "colour.",
)
@click.option(
    "--seed", default=0, show_default=True, type=click.IntRange(0), metavar="N", help="Of orders that are drawn."
)
@options.JSON
@options.gather
@later("etendue_lab.losses.terminal:losses_command")
def losses() -> None:
    """What part of the lost contrast, signal-to-noise ratio and colour each stage is owed.

    Shapley values: what a stage adds to the loss, averaged over all orders in which the stages of the camera could be
    made real from the ideal one; they sum to the loss. Shares are of what is lost before others win it back; a stage
    below 0 wins back. Contrast (its mean up to Nyquist) and SNR of a grey card are counted in decibels, in which blurs
    and gains add up, colour as mean squared CIEDE2000 to the ideal camera of `quality`. What two stages lose together
    is predicted from the values and the interactions of pairs, and held against the camera without both.

    Numerical error by stage is another question: `etendue accuracy`.
    """
