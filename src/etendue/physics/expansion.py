"""Sums over wavelength of filtered light: few transforms instead of one for every band.

In:  the weights of the channels by band, transfer functions by band and radial frequency.
Out: a basis over wavelength, radial tables looked up on planes of frequencies, and what an expansion leaves out.

A channel is sum_l w_l T_l(f) X_l(f). Where the transfer function changes slowly with wavelength, T_l(f) is close to
sum_j u_j(f) p_j(l) with few functions p_j, and the sum over l can be taken before the transform:
sum_j u_j(f) FFT[ sum_l w_l p_j(l) x_l ].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
ComplexArray = NDArray[np.complexfloating]

FEW_NODES, MANY_NODES = 8192, 32768
"""Radial frequencies of a table, for frames below and above a million samples; linear between them."""


FITTED = 257
"""Radial frequencies at which a basis is fitted."""


def wavelength_basis(weights: FloatArray, terms: int, transfer: FloatArray, passed: FloatArray) -> FloatArray:
    """Functions of wavelength in which a transfer function is expanded, orthonormal under each channel's weights.

    Parameters
    ----------
    weights : (channel, wavelength) array, not negative
    terms : int
        At least 1; no more are made than there are bands with weight.
    transfer : (wavelength, frequency) array
        The transfer functions at some radial frequencies.
    passed : (frequency,) array, not negative
        How much an error at each of these frequencies matters.

    Returns
    -------
    (channel, terms, wavelength) array
        p with sum_l w_l p_i(l) p_j(l) = 1 for i = j, else 0. The first is constant, so that uniform light is exact.

    Raises
    ------
    ValueError
        For weights that are negative or all zero, and for fewer than one term.

    Notes
    -----
    Source: the singular vectors of what is left of the transfer functions behind the constant: the best basis in the
    mean square for its number of terms (Eckart and Young 1936).
    """
    weights = np.asarray(weights, dtype=float)
    if terms < 1:
        raise ValueError(f"terms is {terms}; at least 1")
    if np.any(weights < 0) or not np.all(weights.max(axis=1) > 0):
        raise ValueError("weights must not be negative, and every channel needs one above 0")
    bands = weights.shape[1]
    found = np.zeros((weights.shape[0], terms, bands))
    for channel, own in enumerate(weights):
        root = np.sqrt(own / own.sum())
        rest = root[:, None] * transfer * passed
        rest = rest - root[:, None] * (root @ rest)
        vectors = np.linalg.svd(rest, full_matrices=False)[0].T[: terms - 1]
        vectors = vectors - (vectors @ root)[:, None] * root
        more = min(terms, int(np.count_nonzero(own))) - 1
        used = np.vstack([root, vectors[:more]])
        with np.errstate(divide="ignore", invalid="ignore"):
            found[channel, : used.shape[0]] = np.where(root > 0, used / root, 0.0) / np.sqrt(own.sum())
    return found


def expansion_residual(weights: FloatArray, transfer: FloatArray, basis: FloatArray) -> FloatArray:
    """What an expansion leaves out, for light of the same strength in every band, relative to the channel's full scale.

    Parameters
    ----------
    weights : (channel, wavelength) array
    transfer : (wavelength, frequency) array
    basis : (channel, terms, wavelength) array
        As ``wavelength_basis`` gives it.

    Returns
    -------
    (channel, frequency) array
        sum_l w_l |T_l - sum_j u_j p_j(l)| / sum_l w_l.
    """
    weights = np.asarray(weights, dtype=float)
    coefficients = np.einsum("cl,cjl,lf->cjf", weights, basis, transfer)
    rest = np.abs(transfer[None] - np.einsum("cjf,cjl->clf", coefficients, basis))
    return np.einsum("cl,clf->cf", weights, rest) / weights.sum(axis=1)[:, None]


class RadialPlane:
    """Values known by radial frequency, looked up on the half plane of a transform.

    Parameters
    ----------
    rows, columns : 1-d arrays, cycles/um
        Frequencies of the transform along y (all, in the order of the transform) and x (not negative).
    precision : dtype
        Of what comes out.
    nodes : int
        Of the tables; 0: by the size of the frame.

    Notes
    -----
    Rows of opposite frequency are looked up once. Linear interpolation: error (spacing of the nodes)^2 / 8 times the
    second derivative: 1e-7 for a smooth function with few nodes; at the kink of a diffraction cut-off 6e-6 and 2.4e-6
    at worst (f/16 on a grid of 0.5 um), where the planes have next to nothing.
    """

    def __init__(self, rows: FloatArray, columns: FloatArray, precision: object, nodes: int = 0) -> None:
        self.kind = np.dtype(precision)  # type: ignore[call-overload]
        nodes = nodes or (FEW_NODES if rows.size * columns.size < 1 << 19 else MANY_NODES)
        self.rows = rows.size
        self.half = rows.size // 2
        upper = np.abs(rows[: self.half + 1])
        highest = float(np.hypot(upper.max(), columns.max())) or 1.0
        self.nodes = np.linspace(0.0, highest, nodes + 1)
        place = np.hypot(upper[:, None], columns[None, :]) * (nodes / highest)
        self.below = np.minimum(place, nodes - 1).astype(np.int32)
        self.beyond = (place - self.below).astype(self.kind)

    def upper(self, table: FloatArray) -> FloatArray:
        """A table over the nodes, on the rows of frequency 0 and above: (rows // 2 + 1, columns)."""
        table = np.asarray(table, dtype=self.kind)
        step = np.append(np.diff(table), 0).astype(self.kind)
        found = np.empty(self.below.shape, dtype=self.kind)
        for rows in _blocks(*self.below.shape):
            np.take(step, self.below[rows], out=found[rows], mode="clip")
            found[rows] *= self.beyond[rows]
            found[rows] += np.take(table, self.below[rows], mode="clip")
        return found

    def multiply(self, half_spectrum: ComplexArray, table: FloatArray) -> None:
        """Multiply a half spectrum (rows, columns) by a table, in place."""
        factor = self.upper(table)
        half_spectrum[: self.half + 1] *= factor
        half_spectrum[self.half + 1 :] *= factor[1 : self.rows - self.half][::-1]


def _blocks(rows: int, columns: int) -> list[slice]:
    """Rows in blocks that stay in a core's cache."""
    each = max(1, (1 << 16) // max(columns, 1))
    return [slice(start, min(start + each, rows)) for start in range(0, rows, each)]


def add_weighted(sums: ComplexArray, weights: FloatArray, half_spectrum: ComplexArray) -> None:
    """sums[c] += weights[c] * half_spectrum, in place, block by block."""
    kind = sums.real.dtype
    for rows in _blocks(*half_spectrum.shape):
        block = half_spectrum[rows]
        for channel, weight in enumerate(weights):
            if weight:
                sums[channel, rows] += kind.type(weight) * block


def add_projected(sums: FloatArray, factors: FloatArray, bands: list[FloatArray]) -> None:
    """sums[k] += sum over the given bands of factors[k, band] * band, in place, block by block.

    Parameters
    ----------
    sums : (k, y, x) array
    factors : (k, bands) array
    bands : list of (y, x) arrays
    """
    kind = sums.dtype
    flat = sums.reshape(sums.shape[0], -1)
    planes = [np.ascontiguousarray(band).reshape(-1) for band in bands]
    matrix = np.ascontiguousarray(factors, dtype=kind)
    size = 1 << 15
    block = np.empty((len(planes), size), dtype=kind)
    for start in range(0, flat.shape[1], size):
        stop = min(start + size, flat.shape[1])
        for number, plane in enumerate(planes):
            block[number, : stop - start] = plane[start:stop]
        flat[:, start:stop] += matrix @ block[:, : stop - start]
