"""Photodiode: blur of the pixel, and conversion of photons to electrons.

In:  spatial frequency (cycles/um), absorption (1/um), photodiode geometry and diffusion length (um).
Out: aperture transfer function (signed), collected electrons per photon D(f), and D(f)/D(0).
Sources: the paper (docs/paper.md), section 2.4, eqs. 6-8, for the n+/p-sub photodiode, with D(f) derived anew from the
diffusion equation; departures are documented where they occur.

Light that enters the silicon generates electrons at a depth z with density alpha exp(-alpha z). In the depletion layer
all electrons are collected. Below it, over a depth L, they diffuse until they reach the depletion layer, recombine
(diffusion length Ln), or meet the back contact. A pattern of frequency f decays over L_f, with 1/L_f^2 = 1/Ln^2 + (2 pi
f)^2, which causes the blur.
"""

import math
from functools import lru_cache
from typing import Literal

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray, Floats

Back = Literal["absorbing", "reflecting"]
FEW = 8192  # number of frequencies up to which all bands are evaluated at once; more would exceed the processor's cache


def aperture_otf(frequency: Floats, width: float) -> Floats:
    """Return the contrast after averaging over a window along one axis, sin(pi f w)/(pi f w).

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Along one axis; a square window is the product over two axes.
    width : float, um
        Width of the light-sensitive window, 0 or above; not the pixel pitch.

    Returns
    -------
    (...) array, 1
        Exactly 1 at zero. Negative above 1/width: contrast reversal, whose sign callers need.

    Raises
    ------
    ValueError
        For a negative, infinite or NaN width.

    Notes
    -----
    Source: the paper, eqs. 6 and 8 without their leading w (w^2), which would make the value at zero w instead of 1,
    and without the modulus. Error: below 3e-16 (float64) and 2e-7 (float32) absolute.

    Examples
    --------
    >>> from etendue_camera.sensor.photodiode import aperture_otf
    >>> round(float(aperture_otf(0.1, width=5.0)), 4)  # at Nyquist, all of the pixel sensitive: 2/pi
    0.6366
    """
    require.must(0.0 <= width < np.inf, "width", width, "finite and 0 or above, in um")
    return np.sinc(frequency * float(width))


def collection(
    frequency: Floats,
    absorption: float,
    depletion: float,
    diffusion_depth: float,
    diffusion_length: float,
    back: Back = "absorbing",
) -> Floats:
    """Return the electrons collected per photon that enters the silicon, for a pattern of frequency f: D(f).

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Radial spatial frequency; the sign does not matter.
    absorption : float, 1/um
        Absorption coefficient alpha of silicon, 0 or above.
    depletion : float, um
        Thickness Ld of the depletion layer at the surface, 0 or above; may be infinite.
    diffusion_depth : float, um
        Thickness L of the field-free silicon below the depletion layer, 0 or above; may be infinite.
    diffusion_length : float, um
        Diffusion length Ln of electrons in the field-free silicon, above 0; may be infinite.
    back : {"absorbing", "reflecting"}
        Boundary at depth Ld + L: carriers vanish (a contact, a highly doped substrate), or are reflected (an
        epitaxial layer).

    Returns
    -------
    (...) array, 1
        In [0, 1], decreasing with frequency towards 1 - exp(-alpha Ld). At zero it is the internal quantum efficiency.
        0 for alpha = 0.

    Raises
    ------
    ValueError
        For inputs outside these ranges, a photodiode of zero thickness, or an unknown ``back``.

    Notes
    -----
    Source: the paper, section 2.4. The printed closed form is 0/0 at alpha L_f = 1 and overflows for thick
    layers; this form avoids both (see `_field_free`).
    Error: below 5e-15 (float64) and 4e-7 (float32) relative over alpha 1e-6..1e3, Ld 1e-3..1e2, L 1e-2..1e3,
    Ln 0.1..1e5, f 1e-5..1e3 (3000 random points against 60-digit arithmetic). The same holds for weaker absorption as
    long as the result is above 2e-308, below which floats lose digits.
    """
    diode = _diode(absorption, depletion, diffusion_depth, diffusion_length, back)
    if absorption == 0.0:
        return np.zeros_like(require.floating(frequency))[()]
    return np.minimum(float(absorption) * _collection_per_absorption(frequency, *diode), 1.0)


def collection_mtf(
    frequency: Floats,
    absorption: float,
    depletion: float,
    diffusion_depth: float,
    diffusion_length: float,
    back: Back = "absorbing",
) -> Floats:
    """Return the contrast after charge diffusion, D(f)/D(0).

    Parameters
    ----------
    frequency, absorption, depletion, diffusion_depth, diffusion_length, back
        As for `collection`, which also lists the exceptions. absorption = 0 gives the limit of weak absorption.

    Returns
    -------
    (...) array, 1
        In [0, 1], exactly 1 at zero, falling with the frequency.

    Notes
    -----
    Source: the paper, eq. 6. Radial: in two dimensions f is the length of the frequency vector.
    Error: below 5e-15 (float64) and 4e-7 (float32) relative over the box of `collection`, and for any absorption down
    to 5e-324, the smallest number (54 points of 5e-324..1e-200 against 400-digit arithmetic: 9e-16).
    """
    diode = _diode(absorption, depletion, diffusion_depth, diffusion_length, back)
    if depletion == np.inf:
        return np.ones_like(require.floating(frequency))[()]
    at_zero = float(_collection_per_absorption(0.0, *diode))
    if at_zero == np.inf:  # weak absorption, infinite depth and lifetime: all charge comes from infinitely far
        return np.where(np.asarray(frequency) == 0.0, 1.0, np.zeros_like(require.floating(frequency)))[()]
    ratio = np.minimum(_collection_per_absorption(frequency, *diode) / at_zero, 1.0)
    return np.where(np.asarray(frequency) == 0.0, np.ones_like(ratio), ratio)[()]


def collection_per_absorption(
    frequency: Floats,
    absorption: float,
    depletion: float,
    diffusion_depth: float,
    diffusion_length: float,
    back: Back = "absorbing",
) -> Floats:
    """Return D(f)/alpha, um, which has a limit at alpha = 0; inf at alpha = 0 for infinitely deep silicon without
    recombination.

    Parameters, errors and accuracy as in `collection`.
    """
    return _collection_per_absorption(
        frequency, *_diode(absorption, depletion, diffusion_depth, diffusion_length, back)
    )


def collection_mtf_bands(
    frequency: Floats,
    absorption: FloatArray,
    depletion: float,
    diffusion_depth: float,
    diffusion_length: float,
    back: Back = "absorbing",
    nodes: int = 4096,
) -> FloatArray:
    """Return `collection_mtf` for many absorptions on a frame of frequencies, from one table over radial frequency.

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Radial; finite, 0 or above.
    absorption : (n,) array, 1/um
    depletion, diffusion_depth, diffusion_length, back
        As for `collection`, which also lists the exceptions.
    nodes : int
        Number of table nodes; 0 evaluates every frequency. Tables larger than the frame are not used.

    Returns
    -------
    (n, ...) array, 1
        In [0, 1], exactly 1 at zero.

    Notes
    -----
    Cubic Hermite polynomials on evenly spaced nodes of v = ln(1 + s/s0), s = 1/L_f = hypot(1/Ln, 2 pi f), s0 the
    smallest of the rates 1/L (or alpha, for endless silicon) on which D depends: D is analytic in v within a strip of
    half-width 1.2 about the axis for any lengths. Error: decreases with the fourth power of the number of nodes; with
    4096 below 4e-14 for silicon from 0.38 to 0.78 um, below 1e-12 over the box of `collection` up to 10 cycles/um.
    Values at the nodes are exact, so that the result decreases with frequency to within that error.
    """
    frequency = np.asarray(frequency, dtype=float)
    alphas = np.ravel(np.asarray(absorption, dtype=float))
    diodes = [_diode(float(a), depletion, diffusion_depth, diffusion_length, back) for a in alphas]
    endless = any(d[1] == np.inf or (d[0] == 0.0 and d[2] == d[3] == np.inf) for d in diodes)
    highest = float(frequency.max(initial=0.0))
    nodes = max(nodes, 16) if nodes > 0 else 0
    if nodes == 0 or frequency.size <= 2 * nodes or endless or highest == 0.0:
        return _every_mtf(frequency, diodes)
    lowest = 1.0 / diffusion_length
    slowest = (
        1.0 / diffusion_depth if 0.0 < diffusion_depth < np.inf else float(np.min(alphas[alphas > 0.0], initial=np.inf))
    )
    slowest = min(slowest, max(2.0 * np.pi * highest, lowest)) if slowest < np.inf else lowest
    first, last = np.log1p(np.array([lowest, np.hypot(lowest, 2.0 * np.pi * highest)]) / slowest)
    step = (last - first) / (nodes - 1)
    if not step > 0.0:
        return _every_mtf(frequency, diodes)
    rate = slowest * np.expm1(first + step * np.arange(nodes))
    radii = np.sqrt(np.maximum((rate - lowest) * (rate + lowest), 0.0)) / (2.0 * np.pi)
    table = _every_mtf(radii, diodes)
    where = (np.log1p(np.hypot(lowest, (2.0 * np.pi) * frequency) / slowest) - first) / step
    place = np.clip(where.astype(np.intp), 0, nodes - 2)
    t = where - place
    result = np.empty((len(diodes), *frequency.shape))
    slopes = _slopes(table)
    for out, values, slope in zip(result, table, slopes, strict=True):
        # the cubic of each interval as coefficients, gathered once
        rise = np.diff(values)
        square = 3.0 * rise - 2.0 * slope[:-1] - slope[1:]
        cube = slope[:-1] + slope[1:] - 2.0 * rise
        np.take(cube, place, out=out)
        for coefficients in (square, slope, values):
            out *= t
            out += np.take(coefficients, place)
    np.clip(result, 0.0, 1.0, out=result)
    result[:, frequency == 0.0] = 1.0
    return result


def _every_mtf(frequency: FloatArray, diodes: list[tuple[float, float, float, float, Back]]) -> FloatArray:
    """Return `collection_mtf` of diodes that differ only in absorption, (n, ...), computed together and bit-identical
    to separate calls.
    """
    _, depletion, depth, length, back = diodes[0]
    if not (0.0 < depth < np.inf and depletion < np.inf and frequency.size <= FEW):
        return np.stack([collection_mtf(frequency, *diode) for diode in diodes])
    at_zero, depleted, passed, absorption = _constants(diodes)
    flat = frequency.reshape(-1)
    decay = np.hypot(1.0 / length, (2.0 * np.pi) * flat)
    below = depth * _field_free(decay * depth, absorption * depth, back)
    ratio = np.minimum((depleted + passed * below) / at_zero, 1.0)
    ratio[:, flat == 0.0] = 1.0
    return ratio.reshape(len(diodes), *frequency.shape)


def _constants(diodes: list[tuple[float, float, float, float, Back]]) -> list[FloatArray]:
    """Return the frequency-independent terms of diodes that differ only in absorption, each (n, 1): D(0)/alpha, the
    part collected by the depletion layer, the part that passes this layer; and alpha.
    """
    _, depletion, depth, length, back = diodes[0]
    absorption = np.array([diode[0] for diode in diodes])[:, None]
    depleted, passed = (
        np.array(column)[:, None] for column in zip(*(_depleted(a, depletion) for a, *_ in diodes), strict=True)
    )
    below = depth * _field_free(np.hypot(1.0 / length, np.zeros(1)) * depth, absorption * depth, back)
    return [np.where(passed == 0.0, depleted, depleted + passed * below), depleted, passed, absorption]


def _depleted(absorption: float, depletion: float) -> tuple[float, float]:
    """Return the charge generated in the depletion layer divided by alpha, um, and the fraction of light passing it."""
    # as a product it would be a subnormal number of few digits, and the quotient wrong by several per cent
    weak = absorption == 0.0 or absorption * depletion < np.finfo(float).tiny * 2.0**53
    depleted = depletion if weak else float(-np.expm1(-absorption * depletion)) / absorption
    return depleted, float(np.exp(-absorption * depletion)) if depletion < np.inf else 0.0


def _slopes(values: FloatArray) -> FloatArray:
    """Return fourth-order derivatives with respect to the node number, along the last axis, including the ends."""
    slopes = np.empty_like(values)
    v = values
    slopes[:, 2:-2] = (8.0 * (v[:, 3:-1] - v[:, 1:-3]) - (v[:, 4:] - v[:, :-4])) / 12.0
    ends = np.array([[-25.0, 48.0, -36.0, 16.0, -3.0], [-3.0, -10.0, 18.0, -6.0, 1.0]]) / 12.0
    slopes[:, :2] = v[:, :5] @ ends.T
    slopes[:, -1:-3:-1] = -(v[:, -1:-6:-1] @ ends.T)
    return slopes


def _diode(
    absorption: float, depletion: float, depth: float, length: float, back: Back
) -> tuple[float, float, float, float, Back]:
    """Return the checked parameters as plain floats, so that the frequencies determine the precision."""
    require.must(0.0 <= absorption < np.inf, "absorption", absorption, "finite and 0 or above, in 1/um")
    for name, value in (("depletion", depletion), ("diffusion_depth", depth)):
        require.must(value >= 0.0, name, value, "0 or above, in um")
    require.positive("diffusion_length", length, " um")
    require.that(
        depletion + depth != 0.0, "depletion and diffusion_depth are both 0; a photodiode needs some thickness"
    )
    require.must(back in ("absorbing", "reflecting"), "back", repr(back), "'absorbing' or 'reflecting'")
    return float(absorption), float(depletion), float(depth), float(length), back


def _collection_per_absorption(
    frequency: Floats, absorption: float, depletion: float, depth: float, length: float, back: str
) -> Floats:
    """Return D(f)/alpha in um, which has a limit at alpha = 0."""
    frequency = require.floating(frequency)
    depleted, passed = _depleted(absorption, depletion)
    if passed == 0.0 or depth == 0.0:
        return np.full_like(frequency, depleted)[()]
    # hypot, not 1/sqrt(Ln^2/(1 + ...)): Ln may be infinite
    decay = np.hypot(1.0 / length, (2.0 * np.pi) * np.atleast_1d(frequency))
    if depth == np.inf:
        rate = absorption + decay
        below = np.divide(1.0, rate, out=np.full_like(rate, np.inf), where=rate != 0.0)
    else:
        below = depth * _field_free(decay * depth, absorption * depth, back)
    return (depleted + passed * below).reshape(frequency.shape)[()]


def _field_free(x: FloatArray, a: Floats, back: str) -> FloatArray:
    """Return the charge from the field-free layer: the integral of exp(-a y) g(x, y) over y in 0..1, for x = L/L_f and
    a = alpha L, a scalar or (n, 1).

    g is the probability to reach the top from depth y: sinh(x(1 - y))/sinh(x) over an absorbing back and cosh(x(1 -
    y))/cosh(x) over a reflecting back. With E1(u) = (1 - exp(-u))/u, which is 1 at 0, the integral is [E1(a + x) -+ T]
    / (1 -+ exp(-2x)), with the upper signs for an absorbing back and T = E1(|x - a|) exp(-x - min(x, a)). This form has
    no overflow and no singularity at a = x. With the upper signs the difference cancels for small x; there sinh is
    expanded, which leaves a sum of positive moments.
    """
    if back == "reflecting":
        return (_decline(a + x) + _returning(x, a)) / (1.0 + np.exp(-2.0 * x))
    out = np.empty(np.broadcast_shapes(np.shape(a), x.shape), x.dtype)
    thick = ~(x < 1.0)  # NaN too
    far = x[thick]
    out[..., thick] = (_decline(a + far) - _returning(far, a)) / -np.expm1(-2.0 * far)
    near = x[~thick]
    square = near * near
    total = np.zeros((*np.shape(a)[:-1], near.size), x.dtype)
    moments = np.moveaxis(np.array([_moments(float(one)) for one in np.ravel(a)]).reshape(*np.shape(a), -1), -1, 0)
    for coefficient in moments[::-1].astype(x.dtype):
        total = total * square + coefficient
    # x/sinh(x), 1 at 0
    out[..., ~thick] = total * np.divide(near, np.sinh(near), out=np.ones_like(near), where=near > 0.0)
    return out


def _decline(u: FloatArray) -> FloatArray:
    """Return E1(u) = (1 - exp(-u))/u for u >= 0, the mean of exp(-u y) over y in 0..1."""
    return np.divide(-np.expm1(-u), u, out=np.ones_like(u), where=u != 0.0)


def _returning(x: FloatArray, a: Floats) -> FloatArray:
    """Return exp(-a - x) expm1(a - x)/(a - x), written so that no exponent is positive."""
    return _decline(np.abs(x - a)) * np.exp(-x - np.minimum(x, a))


@lru_cache(maxsize=1)
def _gauss(count: int) -> tuple[FloatArray, FloatArray]:
    """Return Gauss-Legendre nodes and weights, cached because they take most of the time here."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.flags.writeable = weights.flags.writeable = False
    return nodes, weights


@lru_cache(maxsize=4096)
def _moments(a: float, count: int = 10) -> tuple[float, ...]:
    """Return integrals of (1 - y)^(2k+1) exp(-a y) over y in 0..1, divided by (2k+1)!.

    Gauss-Legendre on three panels that follow the decay of the exponential: below 1e-14 relative for any a. The
    truncation after ten terms is below 1e-17 for x < 1.

    """
    reach = min(1.0, 40.0 / a) if a > 0.0 else 1.0
    y, weights, powers = _panels(reach, count) if reach == 1.0 else _panels.__wrapped__(reach, count)
    sums = (weights * np.exp(-a * y) * powers).reshape(count, -1).sum(axis=1)
    return tuple((sums / _ODD_FACTORIALS[:count]).tolist())


_ODD_FACTORIALS = np.array([float(math.factorial(2 * k + 1)) for k in range(10)])


@lru_cache(maxsize=1)
def _panels(reach: float, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return nodes and weights on three panels up to ``reach``, and the odd powers of their distance from 1."""
    nodes, weights = _gauss(20)
    edges = reach * np.array([0.0, 0.15, 0.45, 1.0])
    half = 0.5 * np.diff(edges)[:, None]
    y = (edges[:-1, None] + half) + half * nodes
    powers = [1.0 - y]
    for _ in range(count - 1):
        powers.append(powers[-1] * (1.0 - y) ** 2)
    return y, half * weights, np.array(powers)
