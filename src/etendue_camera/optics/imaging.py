"""From the pupil to the image of a point: spread function and transfer function of an aberrated lens.

In:  share of each pupil cell that is open (1), optical path over the pupil (um), wavelength (um), working f-number.
Out: point spread function (um-2) at any positions (um); transfer function at any frequencies (cycles/um).
Sources: Goodman, Introduction to Fourier Optics, sections 6.3-6.4; Hopkins, Proceedings of the Royal Society A 231
(1955), 91, and Stokseth, JOSA 59 (1969), 1314, for defocus; matrix Fourier transforms after Soummer, Optics Express 15
(2007), 15935.

The sensor sees the pupil in units of lambda N_w: a cell of width c pupil radii adds a wave of frequency c/(2 lambda
N_w).
"""

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue import require
from etendue_camera.arrays import Array, FloatArray, Floats
from etendue_camera.optics.diffraction import spot
from etendue_camera.optics.pupil import cell_centres, lagrange_weights

ComplexArray = NDArray[np.complexfloating]

_POINTS = 6  # of the polynomial between lattice shifts
_BLOCK = 2**18  # elements of a block of Gauss points, 2 MB


def pupil_psf(
    amplitude: FloatArray,
    path: FloatArray | None,
    wavelength: float,
    f_number: float,
    y: FloatArray,
    x: FloatArray,
    reach: float = 1.0,
) -> FloatArray:
    """Point spread function of a sampled pupil at any rows and columns.

    Parameters
    ----------
    amplitude : (n, n) array, 1
        Share of each cell that is open (`pupil.amplitude`).
    path : (n, n) array, um
        Optical path at the cells' centres; None: no aberrations.
    wavelength, f_number : float, um and 1
        Above 0; the working f-number.
    y, x : (ny,) and (nx,) arrays, um
        Positions from the image of the chief ray.
    reach : float, 1
        Half the side of the square of cells, in pupil radii.

    Returns
    -------
    (ny, nx) array, um-2
        Unit energy over the plane.

    Raises
    ------
    ValueError
        For arrays that do not fit, wavelength or f-number not above 0, positions beyond lambda N_w n/(2 reach): there
        the samples repeat themselves.

    Notes
    -----
    Two matrix products (a matrix Fourier transform), with frequencies of the pupil in proportion to lambda N_w: no grid
    of positions is imposed. Where the pupil is its own mirror image the sums are folded into cosines of half the size.
    Error: clear circle at f/2.8 against the Airy pattern over 512 x 512 samples of 0.5 um, 128, 256 and 512 cells:
    5e-5, 1.2e-5 and 3e-6 of the peak, falling like n^-2; with cells in or out 2e-3, 6e-4 and 3e-4.
    """
    scale = 2.0 * spot(wavelength, f_number)
    require.that(
        amplitude.ndim == 2 and amplitude.shape[0] == amplitude.shape[1],
        f"amplitude has shape {amplitude.shape}; it must be square",
    )
    if path is not None and path.shape != amplitude.shape:
        raise ValueError(f"path has shape {path.shape}; it must be that of amplitude, {amplitude.shape}")
    samples = amplitude.shape[0]
    farthest = max(np.abs(np.asarray(y)).max(initial=0.0), np.abs(np.asarray(x)).max(initial=0.0))
    if not farthest <= 0.25 * scale * samples / reach:
        raise ValueError(
            f"positions reach {farthest:g} um, but {samples} samples of the pupil carry "
            f"{0.25 * scale * samples / reach:g} um; use more"
        )
    pupil = amplitude if path is None else amplitude * np.exp(2j * np.pi / wavelength * path)
    centres = cell_centres(samples, reach) / scale
    left, rows = _waves(y, centres, np.array_equal(pupil, pupil[::-1]))
    right, columns = _waves(x, centres, np.array_equal(pupil, pupil[:, ::-1]))
    field = left @ pupil[rows, columns] @ right.T
    cell = (2.0 * reach / samples) ** 2
    # |sum P dA|^2 over area (2 lambda N)^2: Parseval, with the true area of the aperture
    return (field.real**2 + field.imag**2) * (cell / (float(np.sum(amplitude)) * scale * scale))


def pupil_lattice(amplitude: FloatArray, path: FloatArray, wavelength: float) -> ComplexArray:
    """What aberrations change in the transfer function, at shifts of the pupil by whole cells.

    Parameters
    ----------
    amplitude : (n, n) array, 1
        Share of each cell that is open.
    path : (n, n) array, um
    wavelength : float, um
        Above 0.

    Returns
    -------
    (2n + 5, 2n + 5) complex array, 1
        Transfer function with aberrations minus that without; no shift in the middle, exactly 0 there; the outermost
        three rows and columns lie at or beyond the cut-off and are 0.

    Raises
    ------
    ValueError
        For arrays that do not fit, a wavelength that is not above 0 and a pupil that lets nothing through.

    Notes
    -----
    Source: the transfer function is the pupil's autocorrelation over its area (Goodman eq. 6-28), by two fast
    transforms. The difference is kept because what is wrong with a sampled pupil is wrong with both: the corner of the
    transfer function at zero frequency, where cells overlap themselves, and the weights of the edge cancel.
    """
    require.that(
        amplitude.ndim == 2 and amplitude.shape[0] == amplitude.shape[1] and path.shape == amplitude.shape,
        f"amplitude has shape {amplitude.shape} and path {path.shape}; both must be the same square",
    )
    samples = amplitude.shape[0]
    total = _area(amplitude, wavelength)
    wave = scipy.fft.fft2(amplitude * np.exp(2j * np.pi / wavelength * path), (2 * samples, 2 * samples), workers=1)
    clear = scipy.fft.fft2(amplitude, (2 * samples, 2 * samples), workers=1)
    power = wave.real**2 + wave.imag**2 - (clear.real**2 + clear.imag**2)
    change = scipy.fft.fftshift(scipy.fft.fft2(power, workers=1)) / (4.0 * samples * samples * total)
    lattice = np.zeros((2 * samples + 5, 2 * samples + 5), complex)
    lattice[2 : 2 * samples + 2, 2 : 2 * samples + 2] = change
    lattice[samples + 2, samples + 2] = 0.0
    return lattice


def from_lattice(
    lattice: ComplexArray, fy: FloatArray, fx: FloatArray, wavelength: float, f_number: float, reach: float = 1.0
) -> ComplexArray:
    """The change of the transfer function at rows and columns of frequencies, from `pupil_lattice`.

    Parameters
    ----------
    lattice : (2n + 5, 2n + 5) array, real or complex, 1
    fy, fx : (ny,) and (nx,) arrays, cycles/um
    wavelength, f_number : float, um and 1
    reach : float, 1
        Half the side of the square of cells, in pupil radii.

    Returns
    -------
    (ny, nx) array, 1
        0 beyond the lattice.

    Notes
    -----
    Polynomials through six lattice shifts along either axis, as two sparse matrix products.
    """
    samples = (lattice.shape[0] - 5) // 2
    scale = spot(wavelength, f_number) * samples / reach  # lattice steps per cycle/um
    rows, columns = (_between(np.asarray(f, float).ravel() * scale, samples) for f in (fy, fx))
    return (columns @ (rows @ lattice).T).T


def radial_changes(
    amplitude: FloatArray, path: Callable[[FloatArray], FloatArray], wavelengths: FloatArray
) -> FloatArray:
    """What round aberrations change in the transfer function of a round pupil, at shifts by whole cells.

    Parameters
    ----------
    amplitude : (n, n) array, 1
        Share of each cell that is open, over the square around the unit circle.
    path : callable
        Optical path (um) of the squared distance from the pupil's centre.
    wavelengths : (bands,) array, um

    Returns
    -------
    (bands, n + 1) array, 1
        At nu = 0, 1/n, ... 1 in units of 1/(lambda N_w); real, exactly 0 at both ends. See `from_radial`.

    Raises
    ------
    ValueError
        As `pupil_lattice`.

    Notes
    -----
    As `pupil_lattice`, along one axis: every row of cells is correlated with itself, so n^2 log n operations suffice.
    """
    samples = amplitude.shape[0]
    total = _area(amplitude, wavelengths)
    half = samples // 2
    centres = cell_centres(samples)
    weights = np.where(centres[half:] == 0.0, 1.0, 2.0)  # rows below are those above
    changes = np.zeros((len(wavelengths), samples + 1))
    block = max(1, 2**19 // samples)
    for start in range(half, samples, block):
        rows = slice(start, min(start + block, samples))
        open_ = amplitude[rows]
        long = path(centres[rows, None] ** 2 + centres**2)
        clear = _power(open_, weights[rows.start - half : rows.stop - half])
        for band, wavelength in enumerate(wavelengths):
            power = (
                _power(open_ * np.exp(2j * np.pi / wavelength * long), weights[rows.start - half : rows.stop - half])
                - clear
            )
            changes[band, 1:samples] += scipy.fft.fft(power).real[1:samples]
    return changes / (2.0 * samples * total)


def from_radial(nodes: FloatArray, values: FloatArray, nu: FloatArray) -> FloatArray:
    """Values at growing nodes from 0 to 1, at |frequency| lambda N_w: a cubic spline; 0 beyond the cut-off."""
    return np.where(nu < 1.0, scipy.interpolate.CubicSpline(nodes, values)(np.minimum(nu, 1.0)), 0.0)


def radial_otf(
    nu: FloatArray,
    path: Callable[[FloatArray], FloatArray],
    wavelength: float,
    obstruction: float = 0.0,
    nodes: int = 48,
) -> FloatArray:
    """Transfer function of a round pupil with round aberrations, to rounding.

    Parameters
    ----------
    nu : (...) array, 1
        Frequency in units of the cut-off 1/(lambda N_w), 0 or above.
    path : callable
        Optical path (um) of the squared distance from the pupil's centre, smooth over the unit disc.
    wavelength : float, um
        Above 0.
    obstruction : float, 1
        From 0 to below 1.
    nodes : int
        Of either Gauss rule: at least 20 plus 7 for each wave of path per pupil radius.

    Returns
    -------
    (...) array, 1
        Real; exactly 1 at zero frequency.

    Raises
    ------
    ValueError
        For a wavelength or nodes not above 0, or an obstruction outside [0, 1).

    Notes
    -----
    Source: Hopkins 1955, the integral of cos(2 pi (W(u + nu) - W(u - nu))/lambda) over the area that the shifted pupils
    share: disc on disc, plus hole on hole, minus twice disc on hole. Each area is two circular segments, on which
    x = R cos(p), y = R sin(p) t makes the integrand smooth and Gauss's rule exponentially exact.
    Error: 1e-13/(1 - eps^2) absolute (up to three waves of defocus, 48 nodes).
    """
    require.positive("wavelength", wavelength, " um")
    require.must(0.0 <= obstruction < 1.0, "obstruction", obstruction, "at least 0 and below 1")
    require.must(nodes >= 1, "nodes", nodes, "at least 1")
    shift = np.asarray(nu, float)
    total = 2.0 * _segment_integral(1.0, 1.0, shift, path, wavelength, nodes)
    if obstruction > 0.0:
        total += 2.0 * _segment_integral(obstruction, obstruction, shift, path, wavelength, nodes)
        total -= 2.0 * _segment_integral(1.0, obstruction, shift, path, wavelength, nodes)
        total -= 2.0 * _segment_integral(obstruction, 1.0, shift, path, wavelength, nodes)
    found = total / (np.pi * (1.0 - obstruction) * (1.0 + obstruction))
    return np.where(shift == 0.0, 1.0, found)[()]


def radial_nodes(obstruction: float, count: int) -> FloatArray:
    """Frequencies (in cut-offs) from 0 to 1 at which to tabulate a radial transfer function: ``count`` to a smooth
    piece.

    They crowd where one piece meets the next: where the shifted hole touches the aperture or itself, and at both ends.
    """
    joints = np.unique(
        [0.0, 1.0, *(v for v in (0.5 * (1 - obstruction), obstruction, 0.5 * (1 + obstruction)) if obstruction)]
    )
    share = 0.5 - 0.5 * np.cos(np.pi * np.arange(count) / count)
    return np.append((joints[:-1, None] + np.diff(joints)[:, None] * share).ravel(), 1.0)


def steepest_slope(path: FloatArray, amplitude: FloatArray, reach: float = 1.0) -> float:
    """Steepest slope of an optical path along either axis of the open pupil.

    Parameters
    ----------
    path : (n, n) array, um
    amplitude : (n, n) array, 1
        Share of each cell that is open.
    reach : float, 1
        Half the side of the square of cells, in pupil radii.

    Returns
    -------
    float, um per pupil radius
        From differences of neighbouring open cells. Eight cells across the pupil for each wave of it keep the steps of
        what is correlated below half a wave.
    """
    open_ = amplitude > 0.0
    both = (open_[1:] & open_[:-1], open_[:, 1:] & open_[:, :-1])
    steps = (float(np.max(np.abs(np.diff(path, axis=axis)), where=both[axis], initial=0.0)) for axis in (0, 1))
    return max(steps) * path.shape[0] / (2.0 * reach)


def _waves(position: FloatArray, centres: FloatArray, even: bool) -> tuple[Array, slice]:
    """Waves of the cells at the positions, and the cells they belong to: cosines of one half where the pupil is
    even.
    """
    position, samples = np.asarray(position, float).ravel(), centres.size
    if not even:
        return np.exp(-2j * np.pi * np.outer(position, centres)), slice(None)
    half = slice(samples // 2, None)
    return np.cos(2.0 * np.pi * np.outer(position, centres[half])) * np.where(centres[half] == 0.0, 1.0, 2.0), half


def _area(amplitude: FloatArray, wavelength: Floats) -> float:
    require.positive("wavelength", wavelength, " um")
    total = float(np.sum(amplitude))
    require.that(total > 0.0, f"amplitude sums to {total}; it must be above 0")
    return total


def _between(place: FloatArray, samples: int) -> scipy.sparse.csr_array:
    """Sparse matrix from a lattice of 2 samples + 5 steps, 0 in the middle, to places between them."""
    size = 2 * samples + 5
    t = place + (samples + 2)
    first = np.clip(np.floor(t).astype(np.intp) - (_POINTS // 2 - 1), 0, size - _POINTS)
    weights = np.stack(lagrange_weights(t - first, _POINTS), axis=1) * (np.abs(place) < samples)[:, None]
    columns = first[:, None] + np.arange(_POINTS)
    starts = _POINTS * np.arange(place.size + 1)
    return scipy.sparse.csr_array((weights.ravel(), columns.ravel(), starts), shape=(place.size, size))


def _power(rows: FloatArray, weights: FloatArray) -> FloatArray:
    """Power spectrum of rows, padded to twice their length, summed with weights."""
    wave = scipy.fft.fft(rows, 2 * rows.shape[1], axis=1, workers=1)
    return weights @ (wave.real**2 + wave.imag**2)


def _segment_integral(
    own: float, other: float, shift: FloatArray, path: Callable[[FloatArray], FloatArray], wavelength: float, nodes: int
) -> FloatArray:
    """Over the part of a disc of radius ``own`` beyond the common chord with another at distance 2 shift; half of
    both segments.
    """
    points, weights = np.polynomial.legendre.leggauss(nodes)
    t, wt = 0.5 * (1.0 + points), 0.5 * weights
    with np.errstate(divide="ignore", invalid="ignore"):
        chord = ((own - other) * (own + other) / (4.0 * shift) if own != other else 0.0 * shift) + shift
    opening = np.arccos(np.clip(chord / own, -1.0, 1.0))
    found = np.empty(shift.size)
    rows = max(1, _BLOCK // nodes**2)
    for start in range(0, shift.size, rows):  # in blocks of bounded memory
        some = slice(start, start + rows)
        angle = opening.ravel()[some, None] * t
        x, y = own * np.cos(angle), (own * np.sin(angle))[..., None] * t
        far = (2.0 * shift.ravel()[some, None] - x)[..., None]
        phase = (2.0 * np.pi / wavelength) * (path(x[..., None] ** 2 + y * y) - path(far * far + y * y))
        found[some] = (np.sin(angle) ** 2 * (np.cos(phase) @ wt)) @ wt
    return 2.0 * own * own * opening * found.reshape(shift.shape)
