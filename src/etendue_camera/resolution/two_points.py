"""Two equal points through any transfer function: depth of the dip between them, and its limit.

In:  a real transfer function of radial frequency (cycles/um), photon weights by wavelength, separations (um).
Out: brightness midway over the brightness of a peak (1), Sparrow's and Rayleigh's separation (um).
Sources: Sparrow 1916: the second derivative midway vanishes. Rayleigh 1879: one point lies on the first dark ring of
the other. Without a dark ring: the separation at which the dip equals that of two Airy discs at Rayleigh's separation.
`diffraction` has the closed forms for the Airy disc.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.resolution import roots

Transfer = Callable[[FloatArray], NDArray]  # (n,) cycles/um -> (n,) or (wavelength, n)

RAYLEIGH_SADDLE = 0.735031662423275
"""Brightness midway over that of a peak, for two Airy discs at the Rayleigh separation."""
DARK = 1e-3  # relative to the peak; below it a ring counts as dark
NODES = 400
STEP = 1 / 16  # step of the search for a sign change, times 1/highest; the finest ripple is 1/2 on the same scale
AT_ONCE = 24
MOST = 400  # largest number of places at which a peak is searched
RINGS = 33  # distances from a dark ring to twice its radius at which the next bright one is searched


@dataclass(frozen=True)
class SpreadFunction:
    """The image of one point, computed from a transfer function: value and derivatives at distances (n,) in um.

    It is the integral of 2 pi f H J0(2 pi f r), on Gauss-Legendre nodes.
    """

    frequency: FloatArray
    weight: FloatArray  # of the node, with the transfer function

    def value(self, r: FloatArray) -> FloatArray:
        z = 2 * np.pi * np.multiply.outer(np.asarray(r, np.float64), self.frequency)
        return np.asarray(scipy.special.j0(z) @ (2 * np.pi * self.frequency * self.weight), np.float64)

    def slope(self, r: FloatArray) -> FloatArray:
        z = 2 * np.pi * np.multiply.outer(np.asarray(r, np.float64), self.frequency)
        turn = 2 * np.pi * self.frequency
        return np.asarray(-scipy.special.j1(z) @ (turn**2 * self.weight), np.float64)

    def bend(self, r: FloatArray) -> FloatArray:
        """Return the second derivative along the line through both points."""
        z = 2 * np.pi * np.multiply.outer(np.asarray(r, np.float64), self.frequency)
        turn = 2 * np.pi * self.frequency
        share = np.where(z > 1e-4, scipy.special.j1(z) / np.where(z > 1e-4, z, 1.0), 0.5 - z * z / 16)
        return np.asarray((share - scipy.special.j0(z)) @ (turn**3 * self.weight), np.float64)

    @property
    def highest(self) -> float:
        return float(self.frequency[-1] + self.frequency[0])


def spread_of(otf: Transfer, highest: float, weights: ArrayLike | None = None, nodes: int = NODES) -> SpreadFunction:
    """Return the spread function of a transfer function.

    Parameters
    ----------
    otf : callable
        Radial frequency (n,) in cycles/um to the transfer function, (n,) or (wavelength, n); the real part is taken.
        For a lens with a square pixel, the function along one direction is used for all.
    highest : float, cycles/um
        Upper end of the integral: the cut-off, or where the transfer function is negligible. A cut-off below
        ``highest`` reduces the accuracy to 2e-6.
    weights : (wavelength,) array or None
        Photons by wavelength; None: equal bands.
    nodes : int
        Number of nodes of the integral, at least 16. Distances up to nodes/(2 highest) are resolved.

    Raises
    ------
    ValueError
        If arguments are out of range, or the transfer function has another shape or values that are not finite.
    """
    require.only(0 < highest < math.inf, "highest", highest, "a finite frequency above 0")
    require.only(nodes >= 16, "nodes", nodes, "at least 16")
    places, width = _gauss(nodes)
    frequency = 0.5 * highest * (places + 1)
    found = np.real(np.asarray(otf(frequency)))
    require.that(
        found.shape[-1:] == frequency.shape and found.ndim <= 2,
        f"otf returns shape {found.shape}; it must be ({nodes},) or (wavelength, {nodes})",
    )
    if found.ndim == 2:
        share = (
            np.full(len(found), 1 / len(found))
            if weights is None
            else np.asarray(weights, np.float64) / np.sum(weights)
        )
        require.shape(share.shape == found.shape[:1], "weights", share, f"one for each of {len(found)} wavelengths")
        found = share @ found
    require.that(
        np.isfinite(found).all(), "otf returns values that are not finite; it must be a transfer function up to highest"
    )
    return SpreadFunction(frequency, 0.5 * highest * width * found)


@lru_cache(maxsize=8)
def _gauss(nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return Gauss-Legendre nodes and weights, cached because 400 nodes take 0.1 s."""
    places, width = np.polynomial.legendre.leggauss(nodes)
    places.flags.writeable = width.flags.writeable = False
    return places, width


def two_point_saddle(
    separation: ArrayLike,
    otf: Transfer,
    highest: float,
    weights: ArrayLike | None = None,
    *,
    nodes: int = NODES,
) -> tuple[FloatArray, FloatArray]:
    """Return the depth of the dip between the images of two equal incoherent points, and the place of the peaks.

    Parameters
    ----------
    separation : (...) array, um, 0 or above
    otf, highest, weights, nodes
        As for `spread_of`.

    Returns
    -------
    ratio : (...) array, 1
        Brightness midway over the brightness of a peak; 1 if the images have merged.
    offset : (...) array, um
        Distance of a peak from the midpoint; 0 if the images have merged.

    Raises
    ------
    ValueError
        If a separation is negative; also as for `spread_of`.

    Notes
    -----
    Error against the closed form of the Airy disc: 2e-13 of the ratio, for separations up to 4 lambda N.
    """
    places = np.asarray(separation, np.float64)
    require.must((places >= 0).all(), "separation", places, "0 or above")
    spread = spread_of(otf, highest, weights, nodes)
    found = np.array([_saddle(spread, float(s)) for s in places.ravel()]).reshape(-1, 2)
    return found[:, 0].reshape(places.shape)[()], found[:, 1].reshape(places.shape)[()]


def separations(
    otf: Transfer, highest: float, weights: ArrayLike | None = None, *, nodes: int = NODES, within: float = 0.0
) -> tuple[float, float]:
    """Return Rayleigh's and Sparrow's separation of two points, um, from one spread function.

    Rayleigh's: one point lies on the other's first dark ring. A ring is dark if the first minimum of the spread is
    at most ``DARK`` of its peak and a brighter maximum follows. Without a dark ring (mixed wavelengths, a pixel, an
    aberrated lens) the result is the separation at which the midpoint has 0.7350 of the brightness of a peak, as for
    two Airy discs at Rayleigh's separation, so that the two rules agree for an Airy disc. Sparrow's: the dip between
    the points just disappears. It is twice the first distance at which the second derivative of the spread function
    vanishes. NaN if there is no such distance within the resolution of ``nodes``. Error: 1e-12 of the Airy disc's
    1.219670 and 0.947155 lambda N, and 1e-12 of Sparrow's 2 sigma of a Gaussian.

    Arguments as for `spread_of`; ``within``: relative error allowed for a separation's root, 0: full precision.
    """
    spread = spread_of(otf, highest, weights, nodes=nodes)
    half = _first_rise(spread, spread.bend, within)
    sparrow = math.nan if half is None else 2 * half
    return _rayleigh(spread, sparrow, within), sparrow


def _rayleigh(spread: SpreadFunction, sparrow: float, within: float = 0.0) -> float:
    peak = spread.value(np.zeros(1))[0]
    ring = _first_rise(spread, spread.slope, within)
    if ring is not None:
        depth = spread.value(np.array([ring]))[0]
        behind = spread.value(np.linspace(ring, 2 * ring, RINGS)).max()
        if abs(depth) <= DARK * peak < behind - depth:  # a monotonic spread has no ring
            return ring
    near = sparrow
    if math.isnan(near):
        return near
    far = near
    while far < NODES / spread.highest:
        near, far = far, 1.1 * far
        if _saddle(spread, far, within)[0] <= RAYLEIGH_SADDLE:
            return roots.between(
                lambda s: _saddle(spread, s, within)[0] - RAYLEIGH_SADDLE, near, far, max(within, 1e-13) * far
            )
    return math.nan


def _first_rise(
    spread: SpreadFunction, derivative: Callable[[FloatArray], FloatArray], within: float = 0.0
) -> float | None:
    """Return the first distance (um) at which a derivative that starts negative rises through 0; None without one."""
    step, last = STEP / spread.highest, int(0.5 * len(spread.frequency) / STEP)
    for start in range(1, last, AT_ONCE):
        r = step * np.arange(start, min(start + AT_ONCE, last) + 1)
        up = np.flatnonzero(derivative(r) >= 0)
        if up.size:
            at = float(r[up[0]])
            low = max(at - step, 0.01 * step)
            if not derivative(np.array([low]))[0] < 0:
                return None
            return roots.between(lambda x: float(derivative(np.array([x]))[0]), low, at, max(within, 1e-14) * at)
    return None


def _saddle(spread: SpreadFunction, separation: float, within: float = 0.0) -> tuple[float, float]:
    """Return ratio and offset as in `two_point_saddle`. The ratio is stationary at the peak, whose place therefore
    needs an accuracy of sqrt(within) only.
    """
    half = 0.5 * separation

    def both(x: FloatArray) -> FloatArray:
        return spread.value(np.abs(x - half)) + spread.value(x + half)

    def slope(x: float) -> float:
        own = spread.slope(np.array([abs(x - half), x + half]))
        return float(own[0] * np.sign(x - half) + own[1])

    if separation == 0 or (spread.bend(np.array([half]))[0] < 0 and separation < 1 / spread.highest):
        return 1.0, 0.0
    high = half + 0.5 / spread.highest
    x = np.linspace(0.0, high, min(max(3, math.ceil(high * spread.highest / STEP)), MOST) + 1)
    at = int(both(x).argmax())
    below, above = float(x[max(at - 1, 0)]), float(x[min(at + 1, len(x) - 1)])
    below = max(below, 1e-6 * half)
    if not slope(below) > 0 > slope(above):
        peak = float(x[at])
    else:
        peak = roots.between(slope, below, above, max(math.sqrt(within), 1e-15) * above)
    middle, top = both(np.array([0.0, peak]))
    return (1.0, 0.0) if middle >= top else (float(middle / top), peak)
