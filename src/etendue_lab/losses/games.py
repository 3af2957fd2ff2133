"""Loss of contrast and of signal-to-noise ratio in a camera with some real stages and all others ideal, from the
parameters of the camera.

In:  a camera viewing a grey card (`FineDetail`).
Out: the loss in decibels for any set of real stages.

Losses are in decibels because transfer functions multiply: the loss of two blurs together is then nearly the sum of
their losses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from etendue.plan.model import StageVariable
from etendue.types.arrays import FloatArray
from etendue_camera.resolution import noise_power
from etendue_camera.resolution.information import nyquist_square
from etendue_lab.information.fine_detail import SHOT, FineDetail
from etendue_lab.losses.shapley import Shares

CAMERA = "rgb_camera"
NODES = 32  # frequencies between 0 and Nyquist, and along x in the Nyquist square


@dataclass(frozen=True)
class Game:
    """One loss, and each stage's share."""

    name: str
    unit: str  # of the shared loss
    figure: str  # name of the metric shown beside the loss
    shares: Shares
    ideal: float  # metric without any of the stages
    camera: float  # with all of them
    without: Mapping[str, float]  # stage -> metric if only this stage is ideal
    # decrease of the loss without both stages: predicted from shares, and actual
    pairs: Mapping[tuple[str, str], tuple[float, float]]


def pictures_of(detail: FineDetail) -> list[StageVariable]:
    """Return the pictures of camera primaries, stage after stage."""
    return [place for place in detail.answers if place[1] == CAMERA]


def channel_of(detail: FineDetail) -> str:
    """Return the analysed channel: green, else the second channel of the camera, or its only channel."""
    return detail.channels[min(1, len(detail.channels) - 1)] if "G" not in detail.channels else "G"


class Contrast:
    """Mean contrast along x from 0 to Nyquist, of one channel.

    A stage before the mosaic contributes its transfer function, band by band; a later stage contributes the factor by
    which it changes the contrast of the picture before it. An ideal pixel is a point; an ideal demosaicer has every
    channel at every pixel.
    """

    def __init__(self, detail: FineDetail) -> None:
        x, w = np.polynomial.legendre.leggauss(NODES)
        self.detail, self.weight, self.frequency, zero = detail, 0.5 * w, 0.25 * (1 + x), np.zeros(1)
        self.channel = channel = channel_of(detail)
        frequency = self.frequency
        self.lens = {name: detail.band_contrast(zero, frequency, [name])[:, 0] for name in detail.lens}
        before, self.behind = detail.contrast(channel, zero, frequency)[0], {}
        for place in pictures_of(detail):
            i = _index(detail, place, channel)
            after = detail.signal_in(place, zero, frequency)[i, 0] / detail.signal_in(place, zero, zero)[i, 0, 0]
            self.behind[place[0]] = np.divide(after, before, out=np.zeros_like(after), where=np.abs(before) > 1e-9)
            before = after
        self.players = (*detail.blurs, *self.behind)

    def contrast(self, present: frozenset[str]) -> float:
        bands: Any = np.ones((len(self.detail.light), NODES))
        for name in present & self.lens.keys():
            bands = bands * self.lens[name]
        moved = [name for name in self.detail.moved if name in present]
        found = self.detail.mean(self.channel, bands[:, None], np.zeros(1), self.frequency, moved)[0]
        for name in present & self.behind.keys():
            found = found * self.behind[name]
        return float(np.sum(self.weight * np.abs(found)))

    def loss(self, present: frozenset[str]) -> float:
        """Return the loss in dB."""
        return -20 * math.log10(max(self.contrast(present), 1e-30))


class SignalToNoise:
    """SNR of the grey card in one channel, relative to its SNR with shot noise alone.

    A stage that adds noise before the mosaic contributes its variance; a later stage contributes the factor by which it
    changes the noise power. ``gains``: transmission of each stage that absorbs light.
    """

    def __init__(self, detail: FineDetail, gains: Mapping[str, float]) -> None:
        self.detail, self.gains, self.channel = detail, dict(gains), channel_of(detail)
        self.square = nyquist_square(NODES)
        self.places = pictures_of(detail)
        self.noise = tuple(name for name in detail.noisy() if any(detail.added(c)[name] for c in detail.channels))
        self.players = (*self.gains, *self.noise, *(stage for stage, _ in self.places))

    def snr(self, present: frozenset[str]) -> float:
        passed = math.prod(gain for name, gain in self.gains.items() if name not in present)
        light = {c: e / passed for c, e in self.detail.electrons.items()}
        variance = {c: e + self._added(e, present) for c, e in light.items()}
        behind = [place for place in self.places if place[0] in present]
        if not behind:
            return float(light[self.channel] / math.sqrt(variance[self.channel]))
        power, signal = self._mosaic(behind[0], light, variance)
        for place in behind[1:] if behind[0] == self.places[0] else behind:
            own, gain = self._step[place]
            power, signal = power * own, signal * gain
        return float(signal / math.sqrt(self.square.mean(power)))

    def loss(self, present: frozenset[str]) -> float:
        """Return the loss in dB."""
        return 20 * math.log10(self.snr(frozenset()) / self.snr(present))

    def _added(self, light: float, present: frozenset[str]) -> float:
        """Return the variance (electron^2) that the real stages add to the shot noise of the light."""
        charge = light + self.detail.dark
        every = {
            n: stage.variance(charge) - (light if stage.role == SHOT else 0.0)
            for n, stage in self.detail.noisy().items()
        }
        return sum(max(0.0, v) for n, v in every.items() if n in present)

    def _mosaic(
        self, place: StageVariable, light: Mapping[str, float], variance: Mapping[str, float]
    ) -> tuple[FloatArray, float]:
        """Return noise power and signal of the demosaiced picture or, if the demosaicer is ideal, of full planes."""
        if place != self.places[0]:
            return np.full(self.square.weight.shape, variance[self.channel]), light[self.channel]
        shares, level = self._carried[place]
        return self._weighed(shares, variance), float(self._weighed(level, light))

    def _weighed(self, values: FloatArray, numbers: Mapping[str, float]) -> FloatArray:
        """Return the weighted sum of values over the positions of the mosaic cell. The weight of a position is the
        number given for its channel.
        """
        channels = [str(self.detail.mask[p]) for p in self.detail.order]
        return np.asarray(sum(value * numbers[channel] for value, channel in zip(values, channels, strict=True)))

    @cached_property
    def _carried(self) -> dict[StageVariable, tuple[FloatArray, FloatArray]]:
        """How each picture transfers noise and signal from each position of the mosaic cell: noise power (place, m, n)
        for unit variance there, and signal (place,) for unit mean.
        """
        found, count = {}, len(self.detail.order)
        for place in self.places:
            i, zero = _index(self.detail, place, self.channel), np.zeros(1)
            power: Any = 0.0
            level: Any = 0.0
            for h, _, weight in self.detail.answers[place]:
                sites = self.detail.sites(h.shape)
                power = (
                    power
                    + weight * np.abs(noise_power.spectra(h, sites, self.square.fy, self.square.fx)[:, i]) ** 2 / count
                )
                level = level + weight * noise_power.spectra(h, sites, zero, zero)[:, i, 0, 0].real / count
            found[place] = (power, level)
        return found

    @cached_property
    def _step(self) -> dict[StageVariable, tuple[FloatArray, float]]:
        """For each picture after the first: noise power and signal relative to the previous picture."""
        variance = {c: self.detail.variances(c) for c in self.detail.channels}
        found, last = {}, None
        for place in self.places:
            shares, level = self._carried[place]
            power, signal = self._weighed(shares, variance), self._weighed(level, self.detail.electrons)
            if last is not None:
                seen = last[0] > 1e-9 * np.max(last[0])
                found[place] = np.divide(power, last[0], out=np.ones_like(power), where=seen), float(signal / last[1])
            last = power, signal
        return found


def _index(detail: FineDetail, place: StageVariable, channel: str) -> int:
    names = detail.names_of(place)
    return names.index(channel) if channel in names else min(1, len(names) - 1)
