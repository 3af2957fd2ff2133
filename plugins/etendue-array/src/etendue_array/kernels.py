"""Kernels of a line array of microphones and its beam: plain functions on arrays.

In:  positions on the line, m; frequencies, Hz; directions, deg from the normal of the line.
Out: delays, s; the array factor, 1.

A plane wave from a direction t reaches a microphone at x earlier by x sin(t) / c: the signal at the centre of the line
at time T is the signal of that microphone at T - x sin(t) / c.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

TAPERS = ("uniform", "hann")


def advance(positions: Any, direction: Any, speed: float) -> Any:
    """Return by how much (s) a plane wave reaches these positions before the centre; plain or labelled arrays."""
    return positions * np.sin(np.deg2rad(direction)) / speed


def taper(name: str, count: int) -> NDArray:
    """Return weights (microphone,) with sum 1. For ``hann`` the zeros of the squared sine lie beyond the ends of the
    line, so that no microphone is ignored.
    """
    inside = (np.arange(count) + 1.0) / (count + 1.0)
    weights = np.ones(count) if name == "uniform" else np.sin(math.pi * inside) ** 2
    return weights / weights.sum()


def white_noise_gain(weights: NDArray) -> float:
    """Return the gain in signal-to-noise ratio of a beam if the noise of the microphones is independent. With uniform
    weights it equals the number of microphones.
    """
    return float(weights.sum() ** 2 / (weights**2).sum())


def array_factor(count: int, spacing: float, frequency: float, speed: float, direction: Any, steered: float) -> NDArray:
    """Return the relative power of a uniform beam, steered to one direction, for waves from other directions: |sin(N u)
    / (N sin u)|^2, with u = pi f d (sin t - sin t0) / c (Van Trees, Optimum Array Processing, 2002, eq. 2.93)."""
    u = math.pi * frequency * spacing / speed * (np.sin(np.deg2rad(direction)) - math.sin(math.radians(steered)))
    whole = np.abs(np.sin(u)) < 1e-9
    safe = np.where(whole, 1.0, np.sin(u))
    return np.where(whole, 1.0, np.sin(count * u) / (count * safe)) ** 2


def half_power_width(directions: NDArray, power: NDArray) -> float:
    """Return the full width (deg) of the main lobe at half its peak, by linear interpolation; limited to the range of
    directions."""
    top = int(np.argmax(power))
    half = 0.5 * power[top]
    ends = []
    for step in (-1, 1):
        at = top
        while 0 <= at + step < power.size and power[at + step] > half:
            at += step
        if 0 <= at + step < power.size and power[at] > power[at + step]:
            share = (power[at] - half) / (power[at] - power[at + step])
            ends.append(directions[at] + share * (directions[at + step] - directions[at]))
        else:
            ends.append(directions[at])
    return float(ends[1] - ends[0])


def side_lobe(power: NDArray) -> float:
    """Return the highest power beyond the nulls on both sides of the main lobe, relative to the peak of the main lobe,
    dB; -300 if there are no side lobes.
    """
    top = int(np.argmax(power))
    if not power[top] > 0:
        return 0.0
    left = right = top
    while left > 0 and power[left - 1] <= power[left]:
        left -= 1
    while right < power.size - 1 and power[right + 1] <= power[right]:
        right += 1
    beyond = max([float(part.max()) for part in (power[:left], power[right + 1 :]) if part.size], default=0.0)
    return 10.0 * math.log10(max(beyond / float(power[top]), 1e-30))


def parabola(directions: NDArray, power: NDArray) -> float:
    """Return the direction (deg) of the vertex of the parabola through the largest sample and its neighbours."""

    top = int(np.argmax(power))
    if not 0 < top < power.size - 1:
        return float(directions[top])
    before, at, after = (float(power[top + n]) for n in (-1, 0, 1))
    bent = before - 2 * at + after
    return float(directions[top] + (0.5 * (before - after) / bent if bent else 0.0) * (directions[1] - directions[0]))
