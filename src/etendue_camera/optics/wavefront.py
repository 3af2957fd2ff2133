"""Wavefront aberrations in the exit pupil: Zernike and Seidel terms, defocus, rms.

In:  pupil coordinates y, x in pupil radii (the f-number's circle), coefficients (um of optical path), image heights.
Out: optical path (um) over the pupil; its rms.
Sources: ANSI Z80.28 and OSA standard indices; Noll, Journal of the Optical Society of America 66 (1976), 207; Hopkins,
Wave Theory of Aberrations (1950); Welford, Aberrations of Optical Systems.

Signs: a positive optical path W multiplies the pupil by exp(+2 pi i W/lambda) and moves light along its gradient: the
ray through (y, x) lands 2 N_w grad W away, towards the side on which W increases. Pupil and image axes are parallel.
"""

from dataclasses import dataclass
from math import isqrt, sqrt
from typing import Literal

import numpy as np
import scipy

from etendue import require
from etendue_camera.arrays import FloatArray, Floats

Index = Literal["noll", "ansi"]


def noll_order(j: int) -> tuple[int, int]:
    """Return the radial order n and signed azimuthal order m of a Noll index, which starts at 1 (m < 0: sine).

    Raises
    ------
    ValueError
        For an index below 1.
    """
    require.that(not j < 1 and j == int(j), f"j is {j}; Noll's index is a whole number from 1")
    n = (isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2 - 1  # position within the radial order
    m = 2 * ((place + 1) // 2) if n % 2 == 0 else 2 * (place // 2) + 1
    return n, m if j % 2 == 0 else -m


def ansi_order(j: int) -> tuple[int, int]:
    """Return the radial order n and signed azimuthal order m of an ANSI/OSA index, which starts at 0 (m < 0: sine).

    Raises
    ------
    ValueError
        For an index below 0.
    """
    require.that(not j < 0 and j == int(j), f"j is {j}; the ANSI index is a whole number from 0")
    n = (isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def zernike(n: int, m: int, y: Floats, x: Floats) -> Floats:
    """Return a Zernike polynomial, orthonormal over the unit disc: its rms there is 1 (n > 0).

    Parameters
    ----------
    n, m : int
        Radial order and signed azimuthal order: cos(m t) for m >= 0, sin(|m| t) for m < 0, t from +x towards +y.
    y, x : arrays that broadcast, 1
        Pupil coordinates; the polynomial continues beyond the unit circle.

    Returns
    -------
    broadcast array, 1

    Raises
    ------
    ValueError
        For n < 0, |m| > n or odd n - m.

    Notes
    -----
    Source: Noll 1976 eqs. 1-3. The radial part is rho^|m| times a Jacobi polynomial, evaluated by its three-term
    recurrence; the textbook sum of factorials loses all digits near order 40.
    Error: 1e-14 relative to the largest value, for n <= 40 inside the disc.
    """
    require.that(
        not n < 0 and not abs(m) > n and not (n - m) % 2,
        f"n is {n} and m is {m}; a Zernike polynomial has n >= |m| with n - m even",
    )
    square = np.asarray(y * y + x * x, float)
    norm = sqrt((n + 1.0) * (2.0 if m else 1.0))
    radial = scipy.special.eval_jacobi((n - abs(m)) // 2, 0, abs(m), 2.0 * square - 1.0)
    if m == 0:
        return norm * radial
    powers = (np.asarray(x, float) + 1j * np.asarray(y, float)) ** abs(m)  # rho^m exp(i m t), smooth at the centre
    return norm * radial * (powers.real if m > 0 else powers.imag)


def zernike_orders(count: int, index: Index = "noll") -> list[tuple[int, int]]:
    """Return the radial and azimuthal orders (n, m) of the first ``count`` terms in the order of Noll or ANSI.

    Raises
    ------
    ValueError
        For an unknown index.
    """
    require.must(index in ("noll", "ansi"), "index", repr(index), "'noll' or 'ansi'")
    return [noll_order(j + 1) if index == "noll" else ansi_order(j) for j in range(count)]


@dataclass(frozen=True)
class Seidel:
    """Third-order (Seidel) wavefront coefficients, in um of optical path at the pupil edge and full image height.

    W = W040 rho^4 + W131 h rho^3 cos t + W222 h^2 rho^2 cos^2 t + W220 h^2 rho^2 + W311 h^3 rho cos t, where h is the
    image height relative to the full height and t the pupil angle from the direction of the image point.
    """

    w040: float = 0.0
    w131: float = 0.0
    w222: float = 0.0
    w220: float = 0.0
    w311: float = 0.0

    def at(self, y: Floats, x: Floats, height_y: float, height_x: float) -> Floats:
        """Return the optical path (um) at pupil coordinates y, x for an image point at heights relative to the full
        height.

        W311 is omitted because it only moves the image; `tilt` returns this shift.

        Notes
        -----
        Source: Hopkins 1950. Computed from dot products of height and pupil vectors, which need no angle on the axis.
        Error: 4e-16 relative to the sum of the absolute terms.
        """
        square = y * y + x * x
        along = height_y * y + height_x * x
        height = height_y * height_y + height_x * height_x
        return square * (self.w040 * square + self.w131 * along + self.w220 * height) + self.w222 * along * along

    def tilt(self, height_y: float, height_x: float) -> tuple[float, float]:
        """Return the y and x slopes (um per pupil radius) of the W311 term; the image moves by 2 N_w times these."""
        height = self.w311 * (height_y * height_y + height_x * height_x)
        return height * height_y, height * height_x


def defocus(shift: float, f_number: float, y: Floats, x: Floats) -> Floats:
    """Return the optical path over the pupil due to defocus.

    Parameters
    ----------
    shift : float, um
        Distance from the sensor to the image, positive where the image lies behind the sensor.
    f_number : float, 1
        Working f-number, above 0.
    y, x : arrays that broadcast, 1
        Pupil coordinates, up to 2 f_number.

    Returns
    -------
    broadcast array, um

    Raises
    ------
    ValueError
        For an f-number that is not above 0, a shift that is not finite, or pupil coordinates beyond 2 f_number.

    Notes
    -----
    Source: the path between two spheres for a lens that obeys the sine condition, shift (1 - cos t) with sin t = rho/(2
    N_w), evaluated without cancellation. The paraxial path W020 rho^2 with W020 = shift/(8 N_w^2) is smaller by a
    fraction of 1/(16 N_w^2) at the edge: 3.3 % at f/1.4, 0.8 % at f/2.8, 0.1 % at f/8. After refocusing, a quarter of
    this difference remains.
    Error: 4e-16 relative.
    """
    require.positive("f_number", f_number)
    require.must(np.isfinite(shift), "shift", shift, "finite, in um")
    sine = (np.asarray(y * y + x * x, float)) / (4.0 * f_number * f_number)
    if np.any(sine > 1.0 + 1e-12):
        raise ValueError(
            f"f_number is {f_number}; an aplanatic pupil extends to at most 2 f_number radii, here {2 * f_number:g}"
        )
    return shift * (sine / (1.0 + np.sqrt(np.maximum(1.0 - sine, 0.0))))


def rms(amplitude: FloatArray, path: FloatArray) -> float:
    """Return the standard deviation of the optical path over the pupil, in the unit of ``path``.

    Each cell is weighted by its open fraction, ``amplitude`` (1).

    Raises
    ------
    ValueError
        For an amplitude whose sum is not above 0.
    """
    total = float(np.sum(amplitude))
    require.that(total > 0.0, f"amplitude sums to {total}; it must be above 0")
    mean = float(np.sum(amplitude * path)) / total
    return sqrt(float(np.sum(amplitude * (path - mean) ** 2)) / total)
