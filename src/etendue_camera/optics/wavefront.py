"""Aberrations of the wavefront in the exit pupil: Zernike and Seidel terms, defocus, Strehl ratio.

In:  pupil coordinates y, x in pupil radii (the f-number's circle), coefficients (um of optical path), image heights.
Out: optical path (um) over the pupil; its rms; the Strehl ratio.
Sources: ANSI Z80.28 and OSA standard indices; Noll, Journal of the Optical Society of America 66 (1976), 207; Hopkins,
Wave Theory of Aberrations (1950); Welford, Aberrations of Optical Systems; Mahajan, JOSA 73 (1983), 860.

Signs: a positive optical path W adds exp(+2 pi i W/lambda) to the pupil and moves light along its gradient: the ray
through (y, x) lands 2 N_w grad W away, on the side of the image towards which W grows. Pupil and image axes are
parallel.
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
    """Radial order n and signed azimuthal order m of Noll's index, which starts at 1 (m < 0: sine).

    Raises
    ------
    ValueError
        For an index below 1.
    """
    require.that(not j < 1 and j == int(j), f"j is {j}; Noll's index is a whole number from 1")
    n = (isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2 - 1  # within the order
    m = 2 * ((place + 1) // 2) if n % 2 == 0 else 2 * (place // 2) + 1
    return n, m if j % 2 == 0 else -m


def ansi_order(j: int) -> tuple[int, int]:
    """Radial order n and signed azimuthal order m of the ANSI/OSA index, which starts at 0 (m < 0: sine).

    Raises
    ------
    ValueError
        For an index below 0.
    """
    require.that(not j < 0 and j == int(j), f"j is {j}; the ANSI index is a whole number from 0")
    n = (isqrt(8 * j + 1) - 1) // 2
    return n, 2 * j - n * (n + 2)


def zernike(n: int, m: int, y: Floats, x: Floats) -> Floats:
    """Zernike polynomial, orthonormal over the unit disc: its rms there is 1 (n > 0).

    Parameters
    ----------
    n, m : int
        Radial order and signed azimuthal order: cos(m t) for m >= 0, sin(|m| t) for m < 0, t from +x towards +y.
    y, x : arrays that broadcast, 1
        Pupil coordinates; beyond the unit circle the polynomial goes on.

    Returns
    -------
    broadcast array, 1

    Raises
    ------
    ValueError
        For n < 0, |m| > n or n - m odd.

    Notes
    -----
    Source: Noll 1976 eqs. 1-3, the radial part as rho^|m| times a Jacobi polynomial by its three-term recurrence: the
    sum of factorials that books print loses all digits near order 40.
    Error: 1e-14 relative to the largest value for n <= 40 inside the disc.
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
    """(n, m) of the first ``count`` terms.

    Raises
    ------
    ValueError
        For an unknown index.
    """
    require.must(index in ("noll", "ansi"), "index", repr(index), "'noll' or 'ansi'")
    return [noll_order(j + 1) if index == "noll" else ansi_order(j) for j in range(count)]


def zernike_sum(coefficients: tuple[float, ...], y: Floats, x: Floats, index: Index = "noll") -> Floats:
    """Wavefront of Zernike coefficients.

    Parameters
    ----------
    coefficients : sequence of float, um
        The first is piston: Noll's 1, or ANSI's 0.
    y, x : arrays that broadcast, 1
    index : {"noll", "ansi"}

    Returns
    -------
    broadcast array, um
        The rms over the unit disc is the root of the sum of squares of all but the first.

    Raises
    ------
    ValueError
        For an unknown index and coefficients that are not finite.
    """
    require.that(np.all(np.isfinite(coefficients)), f"coefficients are {coefficients}; they must be finite")
    total = np.zeros(np.broadcast(y, x).shape)
    for value, (n, m) in zip(coefficients, zernike_orders(len(coefficients), index), strict=True):
        if value:
            total = total + value * zernike(n, m, y, x)
    return total


@dataclass(frozen=True)
class Seidel:
    """Wavefront coefficients of the third order, um of optical path at the edge of the pupil and at full image height.

    W = W040 rho^4 + W131 h rho^3 cos t + W222 h^2 rho^2 cos^2 t + W220 h^2 rho^2 + W311 h^3 rho cos t, with h the image
    height over the full one and t counted from the direction of the image point.
    """

    w040: float = 0.0
    w131: float = 0.0
    w222: float = 0.0
    w220: float = 0.0
    w311: float = 0.0

    def at(self, y: Floats, x: Floats, height_y: float, height_x: float) -> Floats:
        """Optical path (um) at pupil coordinates y, x for an image point at the heights, in units of the full height.

        W311 is left out: a tilt moves the image, and `tilt` says how far.

        Notes
        -----
        Source: Hopkins 1950. Written in dot products of height and pupil vectors, which need no angle on the axis.
        Error: 4e-16 relative to the sum of the terms' sizes.
        """
        square = y * y + x * x
        along = height_y * y + height_x * x
        height = height_y * height_y + height_x * height_x
        return square * (self.w040 * square + self.w131 * along + self.w220 * height) + self.w222 * along * along

    def tilt(self, height_y: float, height_x: float) -> tuple[float, float]:
        """Slopes (um per pupil radius) along y and x of the W311 term: the image moves by 2 N_w times these."""
        height = self.w311 * (height_y * height_y + height_x * height_x)
        return height * height_y, height * height_x


def defocus(shift: float, f_number: float, y: Floats, x: Floats) -> Floats:
    """Optical path over the pupil of an image that lies behind the sensor.

    Parameters
    ----------
    shift : float, um
        From the sensor to the image, positive where the image lies behind it.
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
        For an f-number that is not above 0, a shift that is not finite, and pupil coordinates beyond 2 f_number.

    Notes
    -----
    Source: the path between two spheres of a lens that keeps the sine condition, shift (1 - cos t) with
    sin t = rho/(2 N_w), written without a difference. The paraxial W020 rho^2, W020 = shift/(8 N_w^2), is less than
    that by 1/(16 N_w^2) at the edge: 3.3 % at f/1.4, 0.8 % at f/2.8, 0.1 % at f/8; and after refocusing by 0.25 of
    that.
    Error: 4e-16 relative.
    """
    require.positive("f_number", f_number)
    require.must(np.isfinite(shift), "shift", shift, "finite, in um")
    sine = (np.asarray(y * y + x * x, float)) / (4.0 * f_number * f_number)
    if np.any(sine > 1.0 + 1e-12):
        raise ValueError(
            f"f_number is {f_number}; an aplanatic pupil reaches to 2 f_number radii, here {2 * f_number:g}"
        )
    return shift * (sine / (1.0 + np.sqrt(np.maximum(1.0 - sine, 0.0))))


def defocus_w020(shift: Floats, f_number: Floats) -> Floats:
    """The paraxial defocus coefficient shift/(8 N_w^2), in the unit of the shift; `defocus` says how far it is off.

    Raises
    ------
    ValueError
        For an f-number that is not above 0.
    """
    require.positive("f_number", f_number)
    return shift / (8.0 * f_number * f_number)


def rms(amplitude: FloatArray, path: FloatArray) -> float:
    """Standard deviation of the optical path over the pupil, in its unit; amplitude (1) is the share of each cell that
    is open.

    Raises
    ------
    ValueError
        For an amplitude that sums to nothing.
    """
    total = float(np.sum(amplitude))
    require.that(total > 0.0, f"amplitude sums to {total}; it must be above 0")
    mean = float(np.sum(amplitude * path)) / total
    return sqrt(float(np.sum(amplitude * (path - mean) ** 2)) / total)


def strehl_ratio(amplitude: FloatArray, path: FloatArray, wavelength: float) -> float:
    """Brightness at the centre of the image of a point over that without aberrations, |mean exp(2 pi i W/lambda)|^2.

    Parameters
    ----------
    amplitude : (ny, nx) array, 1
        Share of each pupil cell that is open.
    path : (ny, nx) array, um
    wavelength : float, um
        Above 0.

    Returns
    -------
    float, 1
        In [0, 1]; exp(-(2 pi rms/lambda)^2) to the fourth power of rms/lambda (Mahajan 1983).

    Raises
    ------
    ValueError
        For a wavelength that is not above 0 and an amplitude that sums to nothing.
    """
    require.positive("wavelength", wavelength, " um")
    total = float(np.sum(amplitude))
    require.that(total > 0.0, f"amplitude sums to {total}; it must be above 0")
    wave = np.sum(amplitude * np.exp(2j * np.pi / wavelength * path)) / total
    return float(min(wave.real**2 + wave.imag**2, 1.0))
