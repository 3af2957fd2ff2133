"""Light as means over grid cells, after transfer functions and on pixels: exact flux, no negative light, at any
sampling.

In:  transfer functions H at any frequency (cycles/um), periodic axes of cells (padded size, um), windows (um).
Out: tables that multiply the transform of cell means, and pixel values at any separable set of positions.
Sources: the discrete Fourier transform; Poisson's summation formula.

In the light model `cells` the light is constant within each cell. After a blur h its mean over cell i is the sum of c_j
times the share of cell j's light that falls on cell i, (box * h * box)(x_i - x_j)/D^2. That share is not negative where
h is not, and all shares of a cell sum to one. Its transfer function on the cells is the sum over all aliases m of H(f +
m/D) sinc^2(D f + m), along both axes: frequencies that the grid cannot resolve are folded back and never cut off. A
pixel value is the same sum with sinc(D f + m) A(f + m/D) instead: the cell's sinc once, the pixel's window A once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue import require
from etendue.types.arrays import Array, FloatArray

Transfer = Callable[[FloatArray, FloatArray], Array]  # fy (n, 1), fx (1, m) cycles/um -> (n, m)
Weights = Callable[[FloatArray], Array]  # frequency index K = 0, 1, 2... -> factor; that of -K is the conjugate

ZERO = 1e-15  # values of a transfer function below this count as 0
FURTHEST = 64  # aliases searched for the end of a transfer function
UNENDING = 16  # aliases kept if it has no end
LONGEST = 1024  # the same for a product over the axes, which costs only one axis each
BLOCK = 2**20  # frequencies per call of a transfer function


class PeriodicAxis(NamedTuple):
    """A periodic axis of cells: their number and length (um)."""

    size: int
    step: float


class Reach(NamedTuple):
    """The behaviour of a transfer function at high frequencies."""

    radius: float  # cycles/um; beyond it only ``rest`` is left
    rest: float  # the value at any high frequency: the share of light that is not blurred at all
    even: bool  # real, and even along each axis
    separable: bool  # real, and a product of one factor along y and one along x

    @property
    def by_axis(self) -> bool:
        """Whether the transfer function is a product over the axes and does not end at any frequency. Each factor is
        evaluated on one axis only, so more aliases can be kept.
        """
        return self.separable and self.rest != 0 and self.radius > 0


class AliasRule(NamedTuple):
    """The weights of the aliases along one axis, and the sum of these weights over all aliases, which applies to light
    that is not blurred.
    """

    weights: Weights
    unblurred: Array  # (size,) or, for the halved axis, (size // 2 + 1,)


def reach_of(otf: Transfer, step: float) -> Reach:
    """Find the frequency (cycles/um) beyond which a transfer function is 0, its reach. The function is sampled on
    squares of 129 x 65 frequencies; the square is widened until the function ends inside it, then refined.

    Parameters
    ----------
    otf : transfer function of one band; exactly 1 at zero
    step : float, um
        The smaller side of a cell.

    Returns
    -------
    Reach
        If the function has no end within 64 aliases (diffusion alone, or no blur at all), ``rest`` is its value 32
        aliases from zero frequency, and 16 aliases are kept; see ``folded`` for the resulting error.
    """
    limit, narrowing = 4.0 / step, False
    while True:
        positive = np.linspace(0.0, limit, 65)
        value = _square(otf, positive)
        distance = np.hypot(np.linspace(-limit, limit, 129)[:, None], positive)
        even = bool(np.abs(value - value[::-1]).max() <= ZERO and np.abs(np.imag(value)).max() <= ZERO)
        separable = even and bool(np.abs(value - value[:, :1] * value[64]).max() <= 4 * ZERO)
        radius = float(distance[np.abs(value) > ZERO].max()) + 1.5 * limit / 64
        if radius < 0.25 * limit:  # sampled too coarsely
            limit, narrowing = 2.0 * radius, True
            continue
        if radius < limit or narrowing:
            return Reach(radius, 0.0, even, separable)
        if limit * step >= FURTHEST:
            break
        limit *= 2
    radius = UNENDING / step
    # for a 1/f decay, the value here is the mean over all farther aliases with weights 1/f^2
    far = np.array([2.0 * radius])
    rest = 0.5 * float(
        np.real(otf(far[:, None], 0 * far[None, :])).item() + np.real(otf(0 * far[:, None], far[None, :])).item()
    )
    if np.abs(value - rest).max() <= ZERO:
        radius = 0.0
    return Reach(radius, rest, even, separable)


def _square(otf: Transfer, positive: FloatArray) -> Array:
    signed = np.concatenate([-positive[:0:-1], positive])
    return np.broadcast_to(otf(signed[:, None], positive[None, :]), (signed.size, positive.size))


# -- weights ----------------------------------------------------------------------------------------------


def mean_rule(axis: PeriodicAxis, half: bool) -> AliasRule:
    """Return the rule for means over the cells themselves: weights sinc^2, whose sum over all aliases is 1."""
    size = axis.size // 2 + 1 if half else axis.size
    return AliasRule(lambda k: np.sinc(k / axis.size) ** 2, np.ones(size))


def window_rule(axis: PeriodicAxis, width: float, offset: float, half: bool) -> AliasRule:
    """Return the rule for means over windows (the light is given by cells).

    Parameters
    ----------
    width : float, um, 0 or above
        Width of the window.
    offset : float, cells
        Distance from the centre of a cell to the centre of its window.
    """
    require.must(0.0 <= width < np.inf, "width", width, "finite and not negative, in um")

    def weights(k: FloatArray) -> Array:
        real = np.sinc(k / axis.size) * np.sinc(k * (width / (axis.size * axis.step)))
        return real if offset == 0 else real * np.exp((2j * np.pi * offset / axis.size) * k)

    shares = overlaps(np.array([offset]), width / axis.step, axis.size)[0]
    unblurred = scipy.fft.ifft(shares) * axis.size  # conjugated, because cell j lies ahead by j
    if offset == 0:
        unblurred = unblurred.real
    return AliasRule(weights, unblurred[: axis.size // 2 + 1] if half else unblurred)


def overlaps(centres: FloatArray, width: float, size: int) -> FloatArray:
    """Return the share of each window that lies on each cell of a periodic axis.

    Parameters
    ----------
    centres : (n,) array, cells
        Centres of the windows; 0 is the centre of cell 0.
    width : float, cells, from 0 (a point) to ``size``
    size : int

    Returns
    -------
    (n, size) array, 0 to 1; rows sum to 1

    Notes
    -----
    The areas are exact: the shares give the value of a pixel in light that no optics has blurred.
    """
    centres = np.asarray(centres, dtype=float)
    found = np.zeros((centres.size, size))
    rows = np.arange(centres.size)
    if width < 1e-9:  # a point
        found[rows, np.floor(centres + 0.5).astype(int) % size] = 1.0
        return found
    low, high = centres - 0.5 * width, centres + 0.5 * width
    first = np.floor(low + 0.5).astype(int)
    for ahead in range(int(np.ceil(width)) + 1):
        cell = first + ahead
        length = np.minimum(high, cell + 0.5) - np.maximum(low, cell - 0.5)
        np.add.at(found, (rows, cell % size), np.maximum(length, 0.0) / width)
    return found


# -- tables on the cells' own frequencies -----------------------------------------------------------------


def folded(
    otf: Transfer, reach: Reach, y: PeriodicAxis, x: PeriodicAxis, along_y: AliasRule, along_x: AliasRule
) -> Array:
    """Return the transfer function on cells: the weighted sum of all aliases within reach.

    Parameters
    ----------
    otf : transfer function of one band
    reach : from ``reach_of``
    y, x : PeriodicAxis
    along_y, along_x : AliasRule
        ``along_x`` with ``half=True``.

    Returns
    -------
    (y.size, x.size // 2 + 1) array, real or complex
        Multiplies the half transform of cell means.

    Notes
    -----
    Exact to rounding (1e-15) if H ends. If H does not end, it is split into ``rest``, which is summed in closed form,
    and a decaying part, which is cut off after 16 aliases (1024 for a product over the axes). The error is below 2/(16
    pi^2) = 1.3 % of H - ``rest`` at the cut-off: 2e-6 for diffusion in silicon and cells of up to 5 um. The value at
    zero frequency is exactly H(0) in any case, so that flux is not affected.
    """
    table = reach.rest * along_y.unblurred[:, None] * along_x.unblurred
    if not reach.radius:
        return table
    if reach.separable:
        own_y, own_x = factors_of(otf)
        return _line(own_y, y, along_y)[:, None] * _line(own_x, x, along_x)
    if not reach.even or np.iscomplexobj(table):
        table = table.astype(complex)
    for k, positive, negative in _rows(otf, reach, y, x):
        weights_x = along_x.weights(np.arange(positive.shape[1], dtype=float))
        plus, minus = _fold(positive, weights_x, x.size)
        if negative is positive:
            ahead = behind = plus + np.conj(minus)
        else:
            other_plus, other_minus = _fold(negative, weights_x, x.size)
            ahead, behind = plus + np.conj(other_minus), other_plus + np.conj(minus)
        weights_y = along_y.weights(k.astype(float))[:, None]
        table[k % y.size] += weights_y * ahead
        start = int(k[0] == 0)  # zero has no negative
        table[-k[start:] % y.size] += np.conj(weights_y[start:]) * behind[start:]
    return table


def _rows(
    otf: Transfer, reach: Reach, y: PeriodicAxis, x: PeriodicAxis
) -> Iterator[tuple[NDArray[np.int_], Array, Array]]:
    """Yield H - rest on the extended lattice, some rows at a time: the row numbers K, and the values in the rows K and
    in the rows -K (the same array if H is even).

    Blocks never cross a multiple of the axis, so that each row of a block folds onto a different place.
    """
    last = int(np.ceil(reach.radius * y.size * y.step))
    start = 0
    while start <= last:
        low = start / (y.size * y.step)
        high = np.sqrt(max(reach.radius**2 - low**2, 0.0)) if reach.rest == 0 else reach.radius
        columns = np.arange(int(np.ceil(high * x.size * x.step)) + 1)
        fits = max(1, BLOCK // columns.size)
        stop = min(start + fits, last + 1, (start // y.size + 1) * y.size)
        k = np.arange(start, stop)
        fy, fx = (k / (y.size * y.step))[:, None], (columns / (x.size * x.step))[None, :]
        shape = (k.size, columns.size)
        positive = np.broadcast_to(otf(fy, fx), shape) - reach.rest
        if reach.even:
            positive = np.real(positive)
            yield k, positive, positive
        else:
            yield k, positive, np.broadcast_to(otf(-fy, fx), shape) - reach.rest
        start = stop


def _fold(values: Array, weights: Array, size: int) -> tuple[Array, Array]:
    """Sum weighted columns K = 0, 1, ... onto k = 0...size//2, separately for K = k and K = -k modulo ``size``."""
    half, count = size // 2, values.shape[1]
    weighted = values * weights
    plus = np.zeros((values.shape[0], half + 1), dtype=weighted.dtype)
    minus = np.zeros_like(plus)
    for start in range(0, count, size):
        part = weighted[:, start : start + half + 1]
        plus[:, : part.shape[1]] += part
    for end in range(size, count + half, size):
        # if the last block is cut off, the columns of the largest k are left
        part = weighted[:, end - half : end + 1]
        minus[:, half + 1 - part.shape[1] :] += part[:, ::-1]
    return plus, minus


def factors_of(otf: Transfer) -> tuple[Callable[[FloatArray], Array], Callable[[FloatArray], Array]]:
    """Return a transfer function as two functions: along y at fx = 0, and along x at fy = 0."""
    zero = np.zeros((1, 1))
    return (
        lambda f: np.broadcast_to(otf(f[:, None], zero), (f.size, 1))[:, 0],
        lambda f: np.broadcast_to(otf(zero, f[None, :]), (1, f.size))[0],
    )


def _line(otf: Callable[[FloatArray], Array], axis: PeriodicAxis, rule: AliasRule) -> Array:
    """Compute ``folded`` along one axis."""
    values, rest = far_line(otf, axis)
    weights = rule.weights(np.arange(values.size, dtype=float))
    plus, minus = _fold((values - rest)[None, :], weights, axis.size)
    half = (plus + np.conj(minus))[0]
    if rule.unblurred.size > half.size:
        half = np.concatenate([half, np.conj(half[1 : axis.size - half.size + 1])[::-1]])
    return half + rest * rule.unblurred


def far_line(otf: Callable[[FloatArray], Array], axis: PeriodicAxis) -> tuple[Array, float]:
    """Return one factor of a separable transfer function at K = 0, 1, ... up to its end, and its value beyond."""
    aliases = 2
    while True:
        f = np.linspace(0.5, 1.0, 257) * (aliases / axis.step)
        ended = np.abs(otf(f)).max() <= ZERO
        if ended or aliases >= LONGEST:
            break
        aliases *= 2
    values = np.real(otf(np.arange(aliases * axis.size) / (axis.size * axis.step)))
    return values, 0.0 if ended else float(values[-axis.size :].mean())


def planes_of(half_transform: Array, y: PeriodicAxis, x: PeriodicAxis) -> FloatArray:
    """Return all cells of the periodic plane with this half transform, (..., y.size, x.size)."""
    return scipy.fft.irfft2(half_transform, s=(y.size, x.size), workers=1)
