"""White: what a white diffuser gives in each channel, from the light or from the picture, and the mosaic balanced by
it.

In:  ``white_irradiance``; ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``white`` (channel), the camera's linear signal that is shown as display white; ``mosaic_linear`` with equal
     channels for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from etendue import require
from etendue.api import Grid, Haloed, Labels, measured, param, proved, quantity
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.electronics.stages.gain_chain import GainChain
from etendue_camera.electronics.stages.known_noise import KnownNoise
from etendue_camera.mosaic import white_balance
from etendue_camera.sensor.stages.crosstalk import mixing_of
from etendue_camera.sensor.stages.masks import first_pixel, mask_of
from etendue_camera.sensor.stages.sensitivity import Collecting, electrons_per_irradiance

FOUND = ("grey_world", "white_patch", "shades_of_grey")
CLIPPED, DARK_SIGMAS = 0.98, 3.0


@dataclass(frozen=True, kw_only=True)
class White(GainChain, Collecting):
    """The camera's linear signal of a perfect white diffuser on the axis, over ``render_exposure``: from the
    illuminant, noise-free.

    It may lie above 1, where no pixel can follow: ``white_saturated`` counts the channels in which the diffuser itself
    does.
    """

    role: ClassVar = "camera white"
    reads: ClassVar = {"white_irradiance": "wavelength [W m-2 nm-1]"}
    writes: ClassVar = {"white": "channel [1]", "white_saturated": "[1]"}
    nanoseconds: ClassVar = 100.0
    libraries: ClassVar = ("colour-science",)
    error: ClassVar = proved(2e-7, 1e-15)

    render_exposure: float = quantity("render_exposure")
    integration_time: float = quantity("integration_time")

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"white": Grid.of({"channel": Labels(self.channels)})}

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        edges = tuple(coordinates["wavelength_edges"])
        return electrons_per_irradiance(self, edges), edges

    def run(self, white_irradiance: FloatArray, prepared: Any) -> dict[str, Array]:
        rates = prepared[0] * white_irradiance
        electrons = mixing_of(self, prepared[1], rates) @ rates.sum(axis=1) * self.integration_time
        diffuse = electrons * (self.dn_per_electron() / self.white())
        return {
            "white": diffuse / self.render_exposure,
            "white_saturated": np.array(float(np.count_nonzero(diffuse > 1))),
        }


@dataclass(frozen=True, kw_only=True)
class WhiteEstimate(KnownNoise):
    """The colour of the white as the camera finds it in the picture, or as a preset has it; its level is that of
    ``white``.

    ``grey_world``: the scene is grey on average; ``white_patch``: the brightest is white; ``shades_of_grey``: a power
    mean between the two; ``preset``: gains from a list; ``illuminant``: the true one, unchanged. Cells of the mosaic
    with a value from 0.98 on or a mean under 3 sigma of the dark noise are left out as a whole, and ``white_used`` is
    the share of the others. ``white_error`` is the angle between this white and the true one. Where no cell is left,
    nothing is guessed: the stage fails.
    """

    role: ClassVar = "camera white"
    reads: ClassVar = {"mosaic_linear": "y x [1]", "true_white": "white: channel [1]"}
    writes: ClassVar = {"white": "channel [1]", "white_error": "[deg]", "white_used": "[1]", "channels_floored": "[1]"}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 6.0
    # Of the arithmetic; how far the estimate is from the truth is ``white_error``.
    error: ClassVar = measured(2e-7, 1e-12)

    pattern: str = quantity("pattern")
    method: str = param(
        "grey_world", choices=("illuminant", *FOUND, "preset"), doc="where the colour of the white comes from"
    )
    power: float = param(
        6.0, at_least=1, at_most=100, doc="of 'shades_of_grey': 1 is grey_world, large is the brightest cell"
    )
    quantile: float = param(
        0.99, above=0, at_most=1, doc="of 'white_patch': share of the cells which are not above the white"
    )
    gains: tuple[float, ...] = param(
        (), above=0, at_most=1e6, doc="of 'preset': by channel, of any scale, such as [2.1, 1, 1.6]"
    )
    cell: int = param(
        4, at_least=1, at_most=1024, doc="side of the cells, pixels, rounded up to whole periods of the pattern"
    )
    floor: float = param(
        0.0,
        at_least=0,
        below=1,
        doc="share of the largest channel to which weaker ones are lifted (counted); 0: vanishing ones are refused",
    )

    def __post_init__(self) -> None:
        channels = mask_of(self.pattern).channels
        require.that(
            (self.method == "preset") == bool(self.gains),
            f"method is {self.method!r} and gains {self.gains}; gains go with method = 'preset', and only with it",
        )
        require.that(
            not self.gains or len(self.gains) == len(channels),
            f"gains has {len(self.gains)} values, but the pattern {self.pattern!r} has {len(channels)} channels: "
            f"{', '.join(channels)}",
        )

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"white": _same_channels(inputs["true_white"], self.pattern, "white")}

    def run(self, mosaic_linear: FloatArray, true_white: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Any]:
        known = np.asarray(true_white, np.float64)
        found, used = known, 1.0
        if self.method == "preset":
            found = 1.0 / np.asarray(self.gains)
        elif self.method in FOUND:
            found, used = self.from_the_picture(mosaic_linear, first_pixel(y, x))
        lifted, floored = white_balance.lifted(found, self.floor)
        unchanged = self.method == "illuminant" and not floored
        return {
            "white": known if unchanged else lifted * (known.sum() / lifted.sum()),
            "white_error": np.array(0.0 if unchanged else white_balance.angle_between(lifted, known)),
            "white_used": np.array(used),
            "channels_floored": np.array(float(floored)),
        }

    def from_the_picture(self, mosaic: FloatArray, first: tuple[int, int]) -> tuple[Any, float]:
        """White by channel, and the share of the cells that it was found from."""
        lowest = DARK_SIGMAS * self.dark_sigma()
        means, cells = white_balance.cell_means(mosaic, mask_of(self.pattern), self.cell, CLIPPED, lowest, *first)
        require.that(
            means.shape[1],
            f"none of {cells} cells of the mosaic lies between {lowest:.2g} (3 sigma of the dark noise) and "
            f"{CLIPPED:g}: there is no "
            "white to be found; look at the exposure, or take method = 'illuminant' or 'preset'",
        )
        if self.method == "white_patch":
            found = white_balance.white_patch(means, self.quantile)
        else:
            found = white_balance.grey_world(means, 1.0 if self.method == "grey_world" else self.power)
        return found, means.shape[1] / cells


@dataclass(frozen=True, kw_only=True)
class BalanceMosaic(Haloed):
    """The mosaic over the white of each site's channel, in front of the demosaicer: a grey edge has no colours to
    invent.

    Gains are relative to the largest channel of the white, the first to clip: ``clipping_level`` stays the level at
    which it does. From there on the other channels' true values are worth nothing beside its, so that
    ``highlights = "neutral"`` ends them there too. ``white`` becomes the level that is shown as display white, equal in
    all channels: that of the scene's white as long as no channel clips below it, else (and with
    ``brightness = "camera"`` always) the level of clipping. What is too bright is white, whatever the exposure, and
    later stages go on unchanged.
    """

    role: ClassVar = "white balance"
    reads: ClassVar = {"mosaic_linear": "y x [1]", "white": "channel [1]", "clipping_level": "[1]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "white": "channel [1]", "balance_gains": "channel [1]"}
    gain: ClassVar = None  # as large as the white is coloured
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0
    working: ClassVar = 0.1
    error: ClassVar = proved(2e-7, 4e-16)

    pattern: str = quantity("pattern")
    brightness: str = quantity("brightness")
    highlights: str = param(
        "neutral", choices=("neutral", "keep"), doc="what becomes of channels beyond the level at which the first clips"
    )

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        channels = _same_channels(inputs["white"], self.pattern, "white")
        return {"white": channels, "balance_gains": channels}

    def run(
        self,
        mosaic_linear: FloatArray,
        white: FloatArray,
        clipping_level: FloatArray,
        y: FloatArray,
        x: FloatArray,
        channel: Array,
    ) -> dict[str, Array]:
        gains, mask = white_balance.gains_of(white), mask_of(self.pattern)
        own = gains[[list(channel).index(name) for name in mask.channels]]  # of a plane alone, its own
        clipped = float(clipping_level)  # the smallest gain is 1
        shown = white_balance.display_white(float(np.max(white)), clipped, self.brightness == "camera")
        ceiling = clipped if self.highlights == "neutral" else math.inf
        return {
            "mosaic_linear": white_balance.balanced(mosaic_linear, own, mask, *first_pixel(y, x), ceiling),
            "white": np.full_like(white, shown),
            "balance_gains": gains,
        }


def _same_channels(grid: Grid, pattern: str, variable: str) -> Grid:
    """The grid of a variable by channel, where its channels are those of the pattern."""
    found, wanted = tuple(grid["channel"].values()), mask_of(pattern).channels
    require.that(
        found == wanted,
        f"the pattern {pattern!r} has channels {' '.join(wanted)}, but {variable} has {' '.join(map(str, found))}",
    )
    return grid.take(("channel",))
