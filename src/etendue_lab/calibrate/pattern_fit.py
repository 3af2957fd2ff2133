"""Fixed patterns, separated into waves, rows and columns, shading, outliers, and a white remainder.

In:  patterns of groups of frames.
Out: the rms of each part with its interval, for parts that are significant at 1 % divided by the number of tests.
Sources: EMVA 1288 release 4 (linear): spectrograms and defect pixels. Waves: Fisher's test of the largest line of a
spectrum, each line refined in frequency by maximum likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import scipy

from etendue_camera.arrays import Array
from etendue_camera.electronics import periodic
from etendue_camera.electronics.jackknife import Estimate
from etendue_lab.frames.patterns import Pattern

LEVEL = 0.01
MOST_WAVES = 8
DEGREE = 3  # degree of the shading polynomial
OUTLIER = 5.0  # outliers lie farther than this many robust standard deviations from the median


@dataclass(frozen=True)
class Wave:
    """A periodic part: amplitude in the unit of the pattern, frequencies in cycles/pixel, phase in cycles."""

    amplitude: float
    along_y: float
    along_x: float
    phase: float

    def drawn(self, shape: tuple[int, int]) -> Array:
        return periodic.offsets(
            np.arange(shape[0]), np.arange(shape[1]), [self.amplitude], [self.along_y], [self.along_x], [self.phase]
        )


@dataclass
class PatternFit:
    """Parts of a pattern; sizes are standard deviations over pixels."""

    total: Estimate
    white: Estimate
    rows: Estimate | None = None
    columns: Estimate | None = None
    shading: float = 0.0  # rms
    waves: list[Wave] = field(default_factory=list)
    outliers: int = 0
    outlier_values: Array = field(default_factory=lambda: np.zeros(0))
    surface: Array = field(default_factory=lambda: np.zeros((DEGREE + 1, DEGREE + 1)))  # Legendre coefficients
    pixels: int = 0
    frames: int = 0
    chance: float = 1.0  # p value of the hypothesis that there is no white part
    tests: list[str] = field(default_factory=list)


def fit(found: Pattern, shaded: bool) -> PatternFit:
    """Separate a pattern into its parts. ``shaded``: first subtract a third-degree polynomial, because the light is not
    uniform.
    """
    result = PatternFit(root(found.variance()), Estimate(math.nan, math.nan, math.nan, ""))
    shape = found.mean.shape
    result.pixels, result.frames = shape[0] * shape[1], found.frames
    rest = found
    if shaded:
        result.surface = smooth(rest.mean)
        surface = drawn(result.surface, shape)
        result.shading = float(surface.std())
        rest = rest.without(surface)
    rest = _without_waves(rest, result)
    mask, outliers = _outliers(rest.mean)
    result.outliers = int(outliers.sum())
    if result.outliers:
        result.outlier_values = rest.mean[outliers]
    # removing outliers changes the mean
    centre = rest.groups.mean(axis=(1, 2), where=mask, keepdims=True)
    rest = Pattern(np.where(mask, rest.groups - centre, 0.0), rest.frames)
    white = rest.variance()
    lines = {name: rest.groups.mean(axis=axis + 1, keepdims=True) for name, axis in (("rows", 1), ("columns", 0))}
    k = len(rest.groups)  # products of different groups give the variance over pixels
    crossed = {name: float(((g.sum(0) ** 2 - (g**2).sum(0)) / (k * (k - 1))).mean()) for name, g in lines.items()}
    alone = (white.value - sum(crossed.values())) / (1 - 1 / shape[0] - 1 / shape[1])  # without rows and columns
    for name, axis in (("rows", 1), ("columns", 0)):
        groups = lines[name]
        count = groups.size // len(groups)
        variance = crossed[name] - alone / shape[axis]
        error = math.sqrt(2 / count) * (
            abs(variance) + float(groups.var(axis=(1, 2)).mean()) / len(groups) + alone / shape[axis]
        )
        p = float(scipy.special.ndtr(-variance / error * 1.0)) if error > 0 else 1.0
        result.tests.append(f"offsets of {name}: p = {p:.2g}, accepted below {LEVEL / 2:.2g}")
        if p < LEVEL / 2:
            wide = 1.96 * error
            setattr(result, name, root(Estimate(variance, variance - wide, variance + wide, "")))
            white = Estimate(white.value - variance, white.low - variance, white.high - variance, "")
    error = (white.high - white.low) / 3.92
    result.chance = float(scipy.special.ndtr(-white.value / error)) if error > 0 else 1.0
    result.white = root(white)
    return result


def root(square: Estimate) -> Estimate:
    """Return the square root of a variance; the upper end of its interval is above 0."""
    high = square.high if square.high > 0 else square.high - square.value
    value, low, high = (math.sqrt(max(one, 0.0)) for one in (square.value, square.low, high))
    return Estimate(value, low, high, "")


def square(one: Estimate) -> Estimate:
    """Return the square of an estimate."""
    return Estimate(one.value**2, one.low**2, one.high**2, "")


def less(one: Estimate, other: Estimate) -> Estimate:
    """Return a variance minus the variance of an independent part, with the interval of the difference."""
    value = one.value - other.value
    low = math.hypot(one.value - one.low, other.high - other.value)
    high = math.hypot(one.high - one.value, other.value - other.low)
    return Estimate(value, value - low, value + high, "")


def smooth(plane: Array) -> Array:
    """Return the Legendre coefficients of a third-degree polynomial that is fitted to a plane by least squares."""
    y, x = (np.linspace(-1, 1, size) for size in plane.shape)
    by, bx = (np.polynomial.legendre.legvander(one, DEGREE) for one in (y, x))
    # on a full grid the basis is a product: solve along each axis, and drop terms above the total degree
    inverse = [np.linalg.pinv(one) for one in (by, bx)]
    coefficients = inverse[0] @ plane @ inverse[1].T
    degrees = np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1))
    return np.asarray(np.where(degrees <= DEGREE, coefficients, 0.0))


def drawn(surface: Array, shape: tuple[int, ...]) -> Array:
    """Return the surface (y, x) with the given Legendre coefficients."""
    by, bx = (np.polynomial.legendre.legvander(np.linspace(-1, 1, size), DEGREE) for size in shape)
    return np.asarray(by @ surface @ bx.T)


def _outliers(plane: Array) -> tuple[Array, Array]:
    middle = np.median(plane)
    robust = 1.4826 * float(np.median(np.abs(plane - middle)))
    # among this many normally distributed pixels, none is expected beyond this limit
    most = max(OUTLIER, float(-scipy.special.ndtri(0.5 * LEVEL / plane.size)))
    outliers = np.abs(plane - middle) > most * robust
    return ~outliers, outliers


def _without_waves(rest: Pattern, result: PatternFit) -> Pattern:
    """Subtract waves one by one, as long as the highest peak of the spectrum is too high to be noise."""
    shape = rest.mean.shape
    for number in range(MOST_WAVES):
        plane = rest.mean - rest.mean.mean()
        power = np.abs(np.fft.rfft2(plane)) ** 2
        power[0, :2] = power[:2, 0] = power[-1, 0] = 0.0  # ignore the mean, and shading over the frame
        background = float(np.median(power)) / math.log(2)
        at = np.unravel_index(int(power.argmax()), power.shape)
        p = min(1.0, power.size * math.exp(-min(float(power[at]) / background, 700.0)))
        line = at[0] == 0 or at[1] == 0  # row and column patterns also lie on the axes
        if p >= LEVEL / MOST_WAVES or (line and float(power[at]) < 20 * _beside(power, at)):
            result.tests.append(f"a wave beyond {number}: p = {p:.2g}, accepted below {LEVEL / MOST_WAVES:.2g}")
            break
        wave = _refined(plane, (float(at[0]) / shape[0], float(at[1]) / shape[1]))
        result.waves.append(wave)
        rest = rest.without(wave.drawn(shape))
    # refine each wave with the others subtracted
    for i, wave in enumerate(result.waves if len(result.waves) > 1 else []):
        rest = rest.without(-wave.drawn(shape))
        result.waves[i] = _refined(rest.mean - rest.mean.mean(), (wave.along_y, wave.along_x))
        rest = rest.without(result.waves[i].drawn(shape))
    return rest


def _beside(power: Array, at: tuple[np.intp, ...]) -> float:
    """Return the background power on the frequency axis that contains a peak, from the median."""
    own = power[:, 0] if at[1] == 0 else power[0]
    return float(np.median(own)) / math.log(2)


def _refined(plane: Array, start: tuple[float, float]) -> Wave:
    """Return the wave that fits a plane best (least squares), with a frequency close to ``start``."""
    y, x = np.arange(plane.shape[0]), np.arange(plane.shape[1])

    def transform(f: Array) -> complex:
        return complex(np.exp(-2j * np.pi * f[0] * y) @ plane @ np.exp(-2j * np.pi * f[1] * x))

    scale = 1 / np.array(plane.shape)
    found = scipy.optimize.minimize(
        lambda step: -abs(transform(np.array(start) + step * scale)), np.zeros(2), method="Nelder-Mead",
        options={"xatol": 1e-5, "fatol": 1e-9, "initial_simplex": [[0, 0], [0.3, 0], [0, 0.3]]},
    )  # fmt: skip
    fy, fx = np.array(start) + np.clip(found.x, -0.7, 0.7) * scale
    value = transform(np.array([fy, fx]))
    fy, fx = (float((one + 0.5) % 1.0 - 0.5) for one in (fy, fx))
    half = 1 if (2 * fy) % 1 == 0 and (2 * fx) % 1 == 0 else 2  # at the Nyquist frequency, f and -f are the same line
    return Wave(half * abs(value) / plane.size, fy, fx, float(np.angle(value) / (2 * np.pi)))
