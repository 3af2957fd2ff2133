"""Facts: properties of a variable that are known before it is computed.

Facts determine which stages may be left out and which precision a scene needs. An unknown fact is ``None``; no decision
uses it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

Rings = tuple[tuple[float, ...], ...]  # by band and ring of radial frequencies


@dataclass(frozen=True)
class Content:
    """The power and amplitude of light by band and radial frequency, relative to ``full``, the largest value of any
    band.

    Values are rounded up to three digits, so that differences in the last bits between platforms do not change which
    cells are left out.

    Attributes
    ----------
    full : largest value of any band, in the variable's unit
    edges : ends of the rings, cycles/um; the first is 0; no ring contains the mean
    power : mean square over the frame of the light in a ring, by band
    amplitude : sum of the amplitudes in a ring, by band; no point can exceed it
    low, mean, high : smallest, mean and largest value of every band
    white : light of a white surface in this scene by band, in the variable's unit; empty if the source states none
    norm : how a change of this light is measured: 'rms' over the frame, or at the pixel that changes most ('max')
    widths : rms widths of Gaussian blurs, um, rising from 0; empty if the values after them are not known
    peaks : lower bounds of the largest value of a band after each of these blurs; rounded down
    """

    full: float
    edges: tuple[float, ...]
    power: Rings
    amplitude: Rings
    low: tuple[float, ...]
    mean: tuple[float, ...]
    high: tuple[float, ...]
    white: tuple[float, ...] = ()
    norm: str = "rms"
    widths: tuple[float, ...] = ()
    peaks: Rings = ()

    def __hash__(self) -> int:
        return hash((self.full, self.edges[-1], self.mean, self.power[0]))

    def scaled(self, low: float, high: float, smooth: bool = False) -> Content:
        """Return an upper bound of the content after multiplication by a factor (at least 0) that varies over the frame
        between two values.

        The factor adds detail to uniform light. The share of this detail above a frequency f falls as 1/f, as for an
        edge; with ``smooth`` as 1/f^3, as for a mirrored slope.
        """
        if low == high or high <= 0:
            return replace(self, full=self.full * high, **({} if high > 0 else self._nothing()))
        half, first, fall = 0.5 * (1 - low / high), self.edges[min(2, len(self.edges) - 1)], 3 if smooth else 1
        beyond = [min(1.0, (first / edge) ** fall) if edge > 0 else 1.0 for edge in self.edges[:-1]] + [0.0]
        shares = [a - b for a, b in pairwise(beyond)]
        power, amplitude = [], []
        for mean, own, sums in zip(self.mean, self.power, self.amplitude, strict=True):
            square, most = half * half * (mean * mean + sum(own)), half * (abs(mean) + sum(sums))
            power.append(tuple(p + square * share for p, share in zip(own, shares, strict=True)))
            amplitude.append(tuple(a + most * math.sqrt(share) for a, share in zip(sums, shares, strict=True)))
        darkest = tuple(v * low / high for v in self.low)
        least = self._times([low / high] * len(self.mean))
        return replace(
            self, full=self.full * high, power=tuple(power), amplitude=tuple(amplitude), low=darkest, **least
        )

    def _nothing(self) -> dict[str, Any]:
        """Return the fields of the content for zero light."""
        none, rings = (0.0,) * len(self.mean), tuple((0.0,) * len(row) for row in self.power)
        own = {"power": rings, "amplitude": rings, "low": none, "mean": none, "high": none}
        return {**own, "widths": (), "peaks": ()}

    def _times(self, factors: Sequence[float]) -> dict[str, Any]:
        """Return the fields ``widths`` and ``peaks`` after multiplication by a factor with these lower bounds by band.
        A blur has no negative weights, so the factor also holds after a blur of light that is nowhere below 0.
        """
        if not self.widths or min(self.low) < 0:
            return {"widths": (), "peaks": ()}
        peaks = tuple(tuple(f * v for v in row) for f, row in zip(factors, self.peaks, strict=True))
        return {"widths": self.widths, "peaks": peaks}

    def weighed(self, factors: tuple[float, ...]) -> Content:
        """Return the content after multiplication of every band by its factor (at least 0), one factor per band."""
        largest = max(f * h for f, h in zip(factors, self.high, strict=True))
        if largest <= 0:
            return replace(self, full=0.0, **self._nothing())
        own = [f / largest for f in factors]
        rings = [
            tuple(tuple(f**n * v for v in row) for f, row in zip(own, rows, strict=True)) for n, rows in self._rows()
        ]
        low, mean, high = (
            tuple(f * v for f, v in zip(own, row, strict=True)) for row in (self.low, self.mean, self.high)
        )
        fields = (self.full * largest, self.edges, rings[0], rings[1], low, mean, high, self.white, self.norm)
        return Content(*fields, **self._times(own))

    def _rows(self) -> tuple[tuple[int, Rings], tuple[int, Rings]]:
        return (2, self.power), (1, self.amplitude)

    def filtered(self, passed: Rings, peaks: Rings = ()) -> Content:
        """Return the content after a blur. ``passed``: the share of every ring that the blur passes, a row per band or
        one row for all bands; ``peaks``: lower bounds of the largest values after the blur. The range of values does
        not change.
        """
        rows = passed if len(passed) > 1 else passed * len(self.power)
        power, amplitude = (
            tuple(tuple(p**n * v for p, v in zip(own, row, strict=True)) for own, row in zip(rows, rings, strict=True))
            for n, rings in self._rows()
        )
        widths = self.widths if peaks else ()
        return replace(self, power=power, amplitude=amplitude, widths=widths, peaks=peaks)

    def bands_of_light(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the lower and upper bound of the values of every band. They lie a little outside the range of the
        samples: between samples, and after a transfer function cut off by the grid, light can overshoot the samples by
        as much as the finest detail present."""
        fine = [i for i, edge in enumerate(self.edges[:-1]) if edge > 0.25 * self.edges[-1]]
        low, high = [], []
        for own, mean, most, row, sums in zip(self.low, self.mean, self.high, self.power, self.amplitude, strict=True):
            swing = 6 * math.sqrt(sum(row[i] for i in fine))
            low.append(self.full * (max(own - swing, 0.0) if own >= 0 else own - swing))
            high.append(self.full * min(most + swing, mean + sum(sums)))  # no blur leaves more than its amplitudes
        return tuple(low), tuple(high)

    def range_of_light(self) -> tuple[float, float]:
        """Return the bounds of `bands_of_light` over all bands."""
        low, high = self.bands_of_light()
        return min(low), max(high)

    @property
    def rms(self) -> float:
        """Root of the mean square over frame and bands, relative to ``full``."""
        square = sum(m * m + sum(row) for m, row in zip(self.mean, self.power, strict=True))
        return math.sqrt(square / len(self.mean))

    @property
    def detail(self) -> float:
        """The root of the mean square after subtraction of the mean of each band, relative to ``full``: 0 for uniform
        light.
        """
        return math.sqrt(sum(map(sum, self.power)) / len(self.mean))


@dataclass(frozen=True)
class Facts:
    """Known properties of the noise-free values of one variable.

    Attributes
    ----------
    uniform : the same value at every position
    white : for light, the light of a white surface by band, in the variable's unit
    low, high : bounds on the values, in the variable's unit
    mean : lower bound of the mean of the values over the frame
    brightest : lower bound of the largest value over the whole light
    contrast : largest over smallest value; inf if the scene contains exact black
    band_limit : frequency above which the scene has less than a hundredth of its contrast, cycles/um
    rendered : for a scene, how its ideal chart was drawn: (rms width of a Gaussian, side of the cells over which values
        are means), um, each 0 if it does not apply
    content : for light, its power by band and frequency; the planner computes it for a scene, and updates it after
        every transfer function
    """

    uniform: bool | None = None
    low: float | None = None
    high: float | None = None
    mean: float | None = None
    contrast: float | None = None
    band_limit: float | None = None
    rendered: tuple[float, float] | None = None
    content: Content | None = None
    white: tuple[float, ...] | None = None
    brightest: float | None = None

    def scaled(self, low: float, high: float | None = None, smooth: bool = False) -> Facts:
        """Return the facts after multiplication by a factor between ``low`` and ``high`` (both above 0); ``smooth``:
        the factor varies slowly."""
        high = low if high is None else high
        return replace(
            self,
            uniform=self.uniform if low == high else False,
            low=None if self.low is None else min(self.low * low, self.low * high),
            high=None if self.high is None else max(self.high * low, self.high * high),
            mean=None if self.mean is None else self.mean * low,
            brightest=None if self.brightest is None else self.brightest * low,
            contrast=None if self.contrast is None or low <= 0 else self.contrast * (high / low),
            content=None if self.content is None else self.content.scaled(low, high, smooth),
            white=None if self.white is None else tuple(high * own for own in self.white),
        )


UNKNOWN = Facts()
