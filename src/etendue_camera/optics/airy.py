"""The Airy pattern and its energy as functions of v = pi r/(lambda N), accurate to rounding for any v.

In:  v, 0 or above (array, dimensionless).
Out: pattern, slope, energy inside and outside a radius (dimensionless); a polynomial evaluator.
Sources: Born and Wolf, Principles of Optics, section 8.5; NIST Digital Library of Mathematical Functions
(DLMF) sections 10.8 and 10.17. `diffraction` provides the same quantities as functions of lengths.
"""

from math import factorial

import numpy as np
import scipy

from etendue_camera.arrays import FloatArray, Floats

_SERIES_BELOW = 1.0
_ASYMPTOTIC_ABOVE = 30.0
# v^2/4 (1 - v^2/8 + ...): the square of J1 (DLMF 10.8.3) integrated term by term, in powers of (v/2)^2
_ENCIRCLED_SERIES = [
    (-1) ** k * factorial(2 * k + 2) / (factorial(k) * factorial(k + 2) * factorial(k + 1) ** 2 * (k + 1))
    for k in range(11)
]


def horner(coefficients: list[float], x: Floats) -> Floats:
    """Return a polynomial at x, in the precision of x; the constant term is the first coefficient."""
    value = coefficients[-1] + 0.0 * x
    for coefficient in coefficients[-2::-1]:
        value = value * x + coefficient
    return value


def _hankel_terms(order: int, count: int = 18) -> list[float]:
    """Return the coefficients a_k of Hankel's expansions of J_order (DLMF 10.17.1)."""
    terms = [1.0]
    for k in range(1, count):
        terms.append(terms[-1] * (4 * order**2 - (2 * k - 1) ** 2) / (8.0 * k))
    return terms


def _alternating(terms: list[float]) -> list[float]:
    return [(-1) ** k * term for k, term in enumerate(terms)]


_P0, _Q0 = _alternating(_hankel_terms(0)[0::2]), _alternating(_hankel_terms(0)[1::2])
_P1, _Q1 = _alternating(_hankel_terms(1)[0::2]), _alternating(_hankel_terms(1)[1::2])


def _outside_far(v: Floats) -> Floats:
    """Return J0^2 + J1^2 from Hankel's expansions: a smooth part, and a ripple smaller by a factor of 1/(2v)."""
    inverse = 1.0 / v
    square = inverse * inverse
    p0, p1 = horner(_P0, square), horner(_P1, square)
    q0, q1 = inverse * horner(_Q0, square), inverse * horner(_Q1, square)
    # an infinite v has no phase and no ripple
    phase = np.where(np.isinf(v), 0.0, 2.0 * v)
    even, odd = p0 * p0 + q1 * q1, q0 * q0 + p1 * p1
    ripple = 0.5 * (even - odd) * np.sin(phase) - (p1 * q1 - p0 * q0) * np.cos(phase)
    return (2.0 / np.pi) * inverse * (0.5 * (even + odd) + ripple)


def amplitude(v: Floats) -> Floats:
    """Return 2 J1(v)/v for v of 0 or above; 0 at infinity. Below 1e-4 a series is used, because J1 underflows before v
    does.

    Error: 5e-16 relative for v < 1; for v from 1 to 1e8, 1e-15 v times the envelope 2 sqrt(2/(pi v^3)).
    """
    small = v < 1e-4
    bessel = 2.0 * scipy.special.j1(np.where(small, 1.0, v)) / np.where(small, 1.0, v)
    return np.where(np.isinf(v), 0.0, np.where(small, 1.0 - v * v / 8.0, bessel))


def pattern(v: Floats) -> Floats:
    """Return [2 J1(v)/v]^2, the square of `amplitude`; the sign of v does not matter.

    Error: 1e-15 relative for v < 1; for v from 1 to 1e8, 1e-15 v times the envelope 8/(pi v^3).
    """
    return (amplitude(np.abs(v)) ** 2)[()]


def slope(v: FloatArray) -> FloatArray:
    """Return the derivative of the pattern, -8 J1(v) J2(v) / v^2; v may be negative."""
    safe = np.where(np.abs(v) < 1e-8, 1.0, v)
    return np.where(
        np.abs(v) < 1e-8, -0.5 * v, -8.0 * scipy.special.j1(safe) * scipy.special.jv(2, safe) / (safe * safe)
    )


def encircled(v: Floats) -> Floats:
    """Return the energy inside v, 1 - J0^2 - J1^2, below v = 1 from its power series.

    Error: below 2e-15 relative for v from 1e-12 to 1e8.
    """
    power = np.minimum(v, _SERIES_BELOW) ** 2 / 4.0
    series = power * horner(_ENCIRCLED_SERIES, power)
    return np.where(v < _SERIES_BELOW, series, 1.0 - outside(v))[()]


def outside(v: Floats) -> Floats:
    """Return the energy outside v, J0^2 + J1^2. Error: below 3e-15 relative for v from 1e-12 to 1e8.

    Squaring library Bessel functions loses digits in proportion to v, because each function rounds its own phase (6e-11
    at v = 2e6, although the sum of squares hardly depends on the phase). Above v = 30 the sum of the squared asymptotic
    expansions is therefore evaluated in closed form.
    """
    near = np.minimum(v, _ASYMPTOTIC_ABOVE)
    far = np.maximum(v, _ASYMPTOTIC_ABOVE)
    return np.where(
        v < _ASYMPTOTIC_ABOVE, scipy.special.j0(near) ** 2 + scipy.special.j1(near) ** 2, _outside_far(far)
    )[()]
