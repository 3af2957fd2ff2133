"""``etendue information``: the bits per pixel of fine detail that a camera transmits, and the loss at every stage.

In:  a pipeline as written, the reflectance of its grey card, the contrast of the detail on it, a number of frames.
Out: information capacity, NEQ and SNRi from the light to the last picture, predicted from the camera's parameters; NEQ
     measured in its pictures.

Three quantities are measured: noise power in periodograms of frames of the grey card, contrast across a noise-free
slanted edge, and the mean of the card. They do not use the transfer functions and variances of the prediction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.errors import EtendueError, RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Plan, StageVariable
from etendue.session import Options
from etendue.types.arrays import Array
from etendue.types.documents import Document
from etendue_camera.resolution import information as kernel
from etendue_camera.resolution import noise_power
from etendue_lab.compare.axis import one_camera
from etendue_lab.compare.edge import ANGLE
from etendue_lab.information.edge_contrast import edge_contrast
from etendue_lab.information.fine_detail import LINEAR, FineDetail, fine_detail, frames
from etendue_lab.information.report import InformationReport, NeqCurve, StageRow
from etendue_lab.noise.flat_field import MOSAIC

BLOCK = 16  # pixels, side of a periodogram
ROWS = 3  # rows of a periodogram next to fy = 0 that are averaged
ENOUGH = 400  # number of periodograms per value below which a note is added


def information(
    pipeline: PipelineFile,
    registry: Registry,
    reflectance: float = 0.18,
    ratio: float = 4.0,
    size: float = 4.0,
    contrast: float = 0.05,
    count: int = 16,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
) -> InformationReport:
    """Predict bits per pixel along the chain, and predict and measure NEQ of the linear pictures.

    Parameters
    ----------
    pipeline : Pipeline
        Its scene is replaced by a grey card of the same size and light; a sweep is ignored.
    registry : Registry
    reflectance : float
        Reflectance of the card, greater than 0 and at most 1.
    ratio : float
        Ratio of the brightest to the darkest detail, greater than 1. The signal is uniformly distributed between them,
        with the same power at all frequencies.
    size, contrast : float
        Full width at half maximum (pixels) and peak contrast of the Gaussian spot that the ideal observer detects.
    count : int
        Number of noise frames; 0: nothing is measured.

    Raises
    ------
    RequestError
        The pipeline or one of these values is invalid; a stage does not declare its noise.
    """
    _check(ratio, size, contrast, count)
    alone, notes = one_camera(pipeline)
    detail = fine_detail(alone, registry, reflectance, options, progress, notes)
    report = InformationReport(
        pipeline.name, reflectance, ratio, size, contrast, detail.electrons, BLOCK, notes=detail.notes
    )
    _Chain(detail, report).follow()
    if count:
        _Found(detail, report, registry, options).measure(count)
    return report


def _check(ratio: float, size: float, contrast: float, count: int) -> None:
    for option, value, holds, allowed in (
        ("--contrast-ratio", ratio, ratio > 1, "greater than 1"),
        ("--object", size, 0.5 <= size <= 12, "from 0.5 to 12 pixels"),
        ("--object-contrast", contrast, 0 < contrast <= 1, "greater than 0 and at most 1"),
    ):
        if not holds:
            raise RequestError(f"{option} {value:g}: must be {allowed}")
    if count < 0 or count == 1:
        raise RequestError(f"--frames {count}: must be 0, or at least 2")


class _Chain:
    """The prediction, stage after stage."""

    def __init__(self, detail: FineDetail, report: InformationReport) -> None:
        self.detail, self.report = detail, report
        self.square = kernel.nyquist_square()
        sigma = report.size / math.sqrt(8 * math.log(2))
        self.spot = kernel.gaussian_object(self.square.fy[:, None], self.square.fx, sigma)
        self.variance = kernel.signal_variance(report.ratio)

    def follow(self) -> None:
        detail = self.detail
        left = [*detail.blurs, *detail.noisy()]
        self._add("light", "photons", lambda fy, fx: detail.quanta(fy, fx, left))
        for name in list(left):
            left.remove(name)
            kind = "blur" if name in detail.blurs else "noise"
            without = tuple(left)
            if kind == "noise" and not any(detail.added(c)[name] for c in detail.channels):
                continue
            self._add(name, kind, lambda fy, fx, without=without: detail.quanta(fy, fx, without))
        for picture in detail.answers:
            self._add(
                picture[0], picture[1], lambda fy, fx, p=picture: self._together(p, fy, fx), self._by_channel(picture)
            )

    def _together(self, picture: StageVariable, fy: Array, fx: Array) -> Array:
        return kernel.neq_of_channels(self.detail.signal_in(picture, fy, fx), self.detail.noise_in(picture, fy, fx))

    def _by_channel(self, picture: StageVariable) -> dict[str, float]:
        """Return bits per pixel of each channel alone."""
        s, w = (of(picture, self.square.fy, self.square.fx) for of in (self.detail.signal_in, self.detail.noise_in))
        return {
            name: kernel.capacity(kernel.neq(s[i], w[i, i].real), self.square, self.variance)
            for i, name in enumerate(self.detail.names_of(picture))
        }

    def _add(self, stage: str, what: str, quanta: Any, channels: dict[str, float] | None = None) -> None:
        found = quanta(self.square.fy, self.square.fx)
        ends = quanta(np.zeros(1), np.array([0.0, 0.25, 0.4999]))[0]
        self.report.rows.append(
            StageRow(
                stage,
                what,
                kernel.capacity(found, self.square, self.variance),
                kernel.capacity_along(lambda f: quanta(np.zeros(1), f)[0], self.variance),
                tuple(float(v) for v in ends),
                kernel.ideal_observer(found, self.spot, self.square, self.report.contrast),
                channels or {},
            )
        )


class _Found:
    """Measurements in frames of noise and on an edge."""

    def __init__(
        self, detail: FineDetail, report: InformationReport, registry: Registry, options: Options | None
    ) -> None:
        self.detail, self.report, self.registry, self.options = detail, report, registry, options
        self.frequency = np.arange(1, BLOCK // 2 + 1) / BLOCK
        self.variance = kernel.signal_variance(report.ratio)

    def measure(self, count: int) -> None:
        stacks: dict[StageVariable, list[Any]] = {}
        for frame in frames(self.detail, self.registry, count):
            for place, picture in frame.items():
                stacks.setdefault(place, []).append(picture)
        every = {place: np.stack(stack) for place, stack in stacks.items()}
        mosaic = every[self.detail.first.name, MOSAIC]
        wanted = {
            place: planes for place, planes in every.items() if place in self.detail.answers and place[1] in LINEAR
        }
        means = [planes.mean(axis=(0, 2, 3)).max() for place, planes in wanted.items() if place[1] != "xyz_scene"]
        white = max([float(mosaic.mean(axis=0).max()), *means]) / self.report.reflectance
        try:
            places = [*wanted, (self.detail.first.name, MOSAIC)]
            seen = edge_contrast(self.detail, places, white, self.frequency, self.registry, self.options)
        except (EtendueError, ValueError) as error:
            text = error.faults[0].message if isinstance(error, RequestError) and error.faults else str(error)
            self.report.notes.append(f"NEQ is not measured: {text}")
            return
        for place in ((self.detail.first.name, MOSAIC), *wanted):
            self.report.curves += (
                self._mosaic(mosaic, seen[place])
                if place[1] == MOSAIC
                else self._picture(place, every[place], seen[place])
            )
        fewest = min((curve.periodograms for curve in self.report.curves), default=ENOUGH)
        if fewest < ENOUGH:
            self.report.notes.append(
                f"only {fewest} periodograms per measured value; use --frames "
                f"{1 + math.ceil((count - 1) * ENOUGH / fewest)}"
            )

    # -- noise ------------------------------------------------------------------------------------------------------

    def _mosaic(self, frames: Array, contrast: Document) -> list[NeqCurve]:
        """Measure the NEQ of each channel of the mosaic. The pixels at one position of the mosaic cell form a coarser
        lattice, whose spectrum repeats beyond its Nyquist frequency.
        """
        detail, period = self.detail, self.detail.mask.shape
        block = [max(2, BLOCK // p) for p in period]
        curves = []
        for channel in detail.channels:
            total, periodograms = np.zeros(len(self.frequency)), 0
            for y, x in detail.order:
                if str(detail.mask[y, x]) != channel:
                    continue
                plane = frames[:, None, y :: period[0], x :: period[1]]
                power, periodograms = noise_power.periodograms(plane, min(block))
                own = np.fft.fftfreq(min(block), period[1])
                lattice = 1 / period[1]  # period of the spectrum
                folded = [abs(f - lattice * round(f / lattice)) for f in self.frequency]
                places = [int(np.argmin(np.abs(f - np.abs(own)))) for f in folded]
                noise = self._band(power[0, 0].real)[places]
                light = plane.mean() * detail.electrons[channel] / detail.signal()[channel]
                total += kernel.neq(light * contrast[channel], noise) / len(detail.order)
            fy, fx = self._normal()
            expected = (
                detail.quanta_of(channel, [0.0], np.zeros(1))[0, 0]
                * np.abs(np.diagonal(detail.contrast(channel, fy, fx))) ** 2
            )
            place = detail.first.name, MOSAIC
            curves.append(self._curve(place, channel, expected, total, periodograms))
        return curves

    def _picture(self, place: StageVariable, frames: Array, contrast: Document) -> list[NeqCurve]:
        detail = self.detail
        power, count = noise_power.periodograms(frames, BLOCK)
        answers = detail.answers[place]
        expected_power: Any = sum(w * noise_power.expected_periodogram(h, v, BLOCK) for h, v, w in answers)
        fy, fx = self._normal()
        signal = np.abs(np.diagonal(detail.signal_in(place, fy, fx), axis1=1, axis2=2))
        zero = np.zeros(1)
        light, whole = (np.abs(detail.signal_in(place, zero, zero, dark)[:, 0, 0]) for dark in (False, True))
        curves = []
        for i, name in enumerate(detail.names_of(place)):
            mean = frames[:, i].mean() * light[i] / whole[i]
            places = np.arange(1, BLOCK // 2 + 1)
            noise, expected_noise = (self._band(p[i, i].real)[places] for p in (power, expected_power))
            found = kernel.neq(mean * contrast[name], noise)
            curves.append(self._curve(place, name, kernel.neq(signal[i], expected_noise), found, count))
        return curves

    @staticmethod
    def _band(power: Array) -> Any:
        """Return the noise power along fx: the mean of three rows of a power spectrum, at fy = 0 and on both sides of
        it.
        """
        return (power[0] + power[1] + power[-1]) / ROWS

    def _curve(self, place: StageVariable, channel: str, expected: Array, found: Any, count: int) -> NeqCurve:
        bits = [
            kernel.capacity_along(partial(np.interp, xp=self.frequency, fp=own), self.variance)
            for own in (expected, found)
        ]
        return NeqCurve(
            *place,
            channel,
            tuple(self.frequency),
            tuple(map(float, expected)),
            tuple(map(float, found)),
            count,
            1 / math.sqrt(count * ROWS),
            *bits,
        )

    # -- contrast ---------------------------------------------------------------------------------------------------

    def _normal(self) -> tuple[Any, Any]:
        """Return the components (fy, fx) of the frequencies along the normal of the edge, cycles/pixel."""
        turn = math.radians(ANGLE)
        return math.sin(turn) * self.frequency, math.cos(turn) * self.frequency
