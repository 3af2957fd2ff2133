"""White: the signal of a white diffuser in each channel, from the light or from the picture, and the mosaic balanced
to it.

In:  ``white_irradiance``; ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``white`` (channel), the linear camera signal rendered as display white; ``mosaic_linear`` with equal channels
     for it.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from etendue import require
from etendue.api import Facts, Grid, Haloed, Labels, ends, measured, param, proved, quantity
from etendue.contract.stage import state_of
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
    """Compute the linear, noise-free camera signal of a perfect white diffuser on the axis, divided by
    ``render_exposure``.

    Above pixel saturation the signal exceeds 1: ``white_saturated`` counts the channels in which the diffuser itself
    saturates.
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

    def prepare(self, coordinates: Mapping[str, Array]) -> tuple[FloatArray, tuple[float, ...]]:
        edges = tuple(coordinates["wavelength_edges"])
        return electrons_per_irradiance(self, edges), edges

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return the range of ``white`` over channels and exposure times, and the ratio of its largest to its smallest
        channel.
        """
        light = facts["white_irradiance"].white
        if light is None:
            return Facts()
        shortest, longest = ends(self.integration_time)
        one = replace(self, integration_time=1.0)  # equal for all exposures, whose signals are found together
        low, high = _per_second(one, state_of(one)[1], grid["white_irradiance"].bands().edges, light)
        return Facts(low=low * shortest, high=high * longest, contrast=high / low if low > 0 else math.inf)

    def run(self, white_irradiance: FloatArray, prepared: tuple[FloatArray, tuple[float, ...]]) -> dict[str, Array]:
        rates = prepared[0] * white_irradiance
        electrons = mixing_of(self, prepared[1], rates) @ rates.sum(axis=1) * self.integration_time
        diffuse = electrons * (self.dn_per_electron() / self.white())
        return {
            "white": diffuse / self.render_exposure,
            "white_saturated": np.array(float(np.count_nonzero(diffuse > 1))),
        }


@lru_cache(64)
def _per_second(
    stage: White, state: Hashable, edges: tuple[float, ...], light: tuple[float, ...]
) -> tuple[float, float]:
    """Return the smallest and largest channel of ``white`` for one second of a white surface's irradiance."""
    rates = electrons_per_irradiance(stage, edges) * np.array(light)
    own = mixing_of(stage, edges, rates) @ rates.sum(axis=1)
    own = own * (stage.dn_per_electron() / stage.white() / stage.render_exposure)
    return float(own.min()), float(own.max())


@dataclass(frozen=True, kw_only=True)
class WhiteEstimate(KnownNoise):
    """Estimate the colour of the white from the picture, or take it from a preset; the level stays that of the true
    white.

    ``grey_world``: the scene is grey on average; ``white_patch``: the brightest area is white; ``shades_of_grey``: a
    power mean between the two; ``preset``: gains from a list; ``illuminant``: the true white, unchanged. Mosaic cells
    with a value of at least 0.98 or a mean below 3 sigma of the dark noise are ignored as a whole, and ``white_used``
    is the fraction of cells used. ``white_error`` is the angle between this white and the true white. If no cell is
    usable, the stage fails.
    """

    role: ClassVar = "camera white"
    reads: ClassVar = {"mosaic_linear": "y x [1]", "true_white": "white: channel [1]"}
    writes: ClassVar = {"white": "channel [1]", "white_error": "[deg]", "white_used": "[1]", "channels_floored": "[1]"}
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 6.0
    # Arithmetic error only; the error of the estimate is ``white_error``.
    error: ClassVar = measured(2e-7, 1e-12)

    pattern: str = quantity("pattern")
    method: str = param("grey_world", choices=("illuminant", *FOUND, "preset"), doc="source of the white's colour")
    power: float = param(
        6.0,
        at_least=1,
        at_most=100,
        doc="for 'shades_of_grey': power of the mean; 1 is grey_world, large approaches the brightest cell",
    )
    quantile: float = param(
        0.99, above=0, at_most=1, doc="for 'white_patch': fraction of the cells at or below the white"
    )
    gains: tuple[float, ...] = param(
        (), above=0, at_most=1e6, doc="for 'preset': gain per channel, in any scale, such as [2.1, 1, 1.6]"
    )
    cell: int = param(
        4, at_least=1, at_most=1024, doc="side of the cells in pixels, rounded up to whole periods of the pattern"
    )
    floor: float = param(
        0.0,
        at_least=0,
        below=1,
        doc="floor for weak channels, as a fraction of the largest (raised channels are counted); 0: a channel without "
        "signal is an error",
    )

    def __post_init__(self) -> None:
        channels = mask_of(self.pattern).channels
        require.that(
            (self.method == "preset") == bool(self.gains),
            f"method is {self.method!r} and gains {self.gains}; give gains with method = 'preset', and only with it",
        )
        require.that(
            not self.gains or len(self.gains) == len(channels),
            f"gains has {len(self.gains)} values, but the pattern {self.pattern!r} has {len(channels)} channels: "
            f"{', '.join(channels)}",
        )

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        return {"white": _same_channels(inputs["true_white"], self.pattern, "white")}

    def run(self, mosaic_linear: FloatArray, true_white: FloatArray, y: FloatArray, x: FloatArray) -> dict[str, Array]:
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
        """Return the estimated white by channel, and the fraction of the cells used."""
        lowest = DARK_SIGMAS * self.dark_sigma()
        means, cells = white_balance.cell_means(mosaic, mask_of(self.pattern), self.cell, CLIPPED, lowest, *first)
        require.that(
            means.shape[1],
            f"none of the {cells} cells of the mosaic is between {lowest:.2g} (3 sigma of the dark noise) and "
            f"{CLIPPED:g}: there is no "
            "white to estimate; check the exposure, or use method = 'illuminant' or 'preset'",
        )
        if self.method == "white_patch":
            found = white_balance.white_patch(means, self.quantile)
        else:
            found = white_balance.grey_world(means, 1.0 if self.method == "grey_world" else self.power)
        return found, means.shape[1] / cells


@dataclass(frozen=True, kw_only=True)
class BalanceMosaic(Haloed):
    """Divide the mosaic by the white of each site's channel before demosaicing, so that grey edges get no false
    colours.

    Gains are relative to the largest channel of the white, which is the first to clip: ``clipping_level`` remains the
    level at which that channel clips. Above this level the channel's true value is unknown, so ``highlights =
    "neutral"`` clips the other channels there too. ``white`` becomes the level rendered as display white, equal in all
    channels. This is the scene white if no channel clips below it; otherwise (and always with ``brightness =
    "camera"``) it is the clipping level. Overexposed areas are white at any exposure, and later stages need no change.
    """

    role: ClassVar = "white balance"
    reads: ClassVar = {"mosaic_linear": "y x [1]", "white": "channel [1]", "clipping_level": "[1]"}
    writes: ClassVar = {"mosaic_linear": "y x [1]", "white": "channel [1]", "balance_gains": "channel [1]"}
    gain: ClassVar = None  # set by the colour of the white
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 3.0
    working: ClassVar = 0.1
    error: ClassVar = proved(2e-7, 4e-16)

    pattern: str = quantity("pattern")
    brightness: str = quantity("brightness")
    highlights: str = param(
        "neutral",
        choices=("neutral", "keep"),
        doc="treatment of channels above the level at which the first channel clips",
    )

    def __post_init__(self) -> None:
        mask_of(self.pattern)

    def grid(self, inputs: Mapping[str, Grid]) -> dict[str, Grid]:
        channels = _same_channels(inputs["white"], self.pattern, "white")
        return {"white": channels, "balance_gains": channels}

    def growth(self, facts: Mapping[str, Facts]) -> float:
        """Return the largest gain divided by the level that is rendered as white: later stages use that level as full
        scale.
        """
        white = facts["white"]
        if white.low is None or white.contrast is None:
            return 1.0
        shown = CLIPPED if self.brightness == "camera" else min(CLIPPED, white.low * white.contrast)
        return white.contrast / shown if shown > 0 else math.inf

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
        own = gains[[list(channel).index(name) for name in mask.channels]]  # a single plane has only its own channel
        clipped = float(clipping_level)  # the smallest gain is 1
        shown = white_balance.display_white(float(np.max(white)), clipped, self.brightness == "camera")
        ceiling = clipped if self.highlights == "neutral" else math.inf
        return {
            "mosaic_linear": white_balance.balanced(mosaic_linear, own, mask, *first_pixel(y, x), ceiling),
            "white": np.full_like(white, shown),
            "balance_gains": gains,
        }


def _same_channels(grid: Grid, pattern: str, variable: str) -> Grid:
    """Return the grid of a variable that has a channel axis; raise an error unless its channels match the pattern."""
    found, wanted = tuple(grid["channel"].values()), mask_of(pattern).channels
    require.that(
        found == wanted,
        f"the pattern {pattern!r} has channels {' '.join(wanted)}, but {variable} has {' '.join(map(str, found))}",
    )
    return grid.take(("channel",))
