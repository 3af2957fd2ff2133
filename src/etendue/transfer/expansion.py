"""Sums over bands of filtered light, with a few transforms instead of one per band.

In:  the weights of the channels by band; transfer functions by band and radial frequency.
Out: a basis over the bands, radial tables that are interpolated on planes of frequencies, and the residual of an
     expansion.

A channel c is sum_l w_c(l) T_l(f) X_l(f). If the transfer function changes slowly from band to band, all w_c(l) T_l(f)
are close to sum_k u_ck(f) g_k(l) with few functions g_k, and the sum over l can be taken before the transform:
sum_k u_ck(f) FFT[ sum_l g_k(l) x_l ].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from etendue.types.arrays import FloatArray

ComplexArray = NDArray[np.complexfloating]

FEW_NODES, MANY_NODES = 8192, 32768
"""Number of radial frequencies of a table, for frames below and above a million samples; linear between."""


FITTED = 257
BLOCK = 1 << 15  # samples of a plane in one product of matrices
"""Radial frequencies at which a basis is fitted."""

FLAT_BELOW = 1 / 64
"""Fraction of the highest frequency up to which all frequencies have equal importance in the fit; beyond it, importance
falls as 1/f, like amplitudes in pictures.
"""


def importance(frequency: FloatArray) -> FloatArray:
    """Return the weight that a basis fit gives to errors at each radial frequency: 1 at low frequencies, then falling
    as 1/f. The same weight suits any pixel size.
    """
    flat = FLAT_BELOW * float(frequency.max()) or 1.0
    return np.minimum(1.0, flat / np.maximum(frequency, 1e-300))


def band_basis(weights: FloatArray, planes: int, transfer: FloatArray, passed: FloatArray) -> FloatArray:
    """Return the basis in which the weighted transfer functions of all channels are expanded: functions of the band.

    Parameters
    ----------
    weights : (channel, band) array, not negative
    planes : int
        At least the number of channels; capped at the number of bands with weight.
    transfer : (band, frequency) array
        The transfer functions at some radial frequencies.
    passed : (frequency,) array, not negative
        Importance of an error at each of these frequencies.

    Returns
    -------
    (planes, band) array
        g, the weight of each band in each plane; orthonormal with the weight 1 / (total weight of the band), and 0 in
        bands without weight. Its span contains the weights of the channels, so that uniform light is exact.

    Raises
    ------
    ValueError
        For weights that are negative or all zero, and for fewer planes than channels.

    Notes
    -----
    Source: besides the weights, the basis consists of the singular vectors of the remaining part of the weighted
    transfer functions, which have the smallest mean square error for their number (Eckart and Young 1936). They are
    computed as eigenvectors of the (band, band) matrix of products. Functions that contribute less than 1e-8 of the
    first have no defined order.
    """
    weights, scale = _scaled(weights)
    if planes < weights.shape[0]:
        raise ValueError(f"planes must be at least {weights.shape[0]}, one per channel; it is {planes}")
    if np.any(weights < 0) or not np.all(weights.max(axis=1) > 0):
        raise ValueError("weights must not be negative, and every channel needs one greater than 0")
    own, _ = np.linalg.qr((weights * scale).T)
    wanted = ((weights * scale)[:, :, None] * transfer * passed).transpose(1, 0, 2).reshape(transfer.shape[0], -1)
    rest = wanted - own @ (own.T @ wanted)
    vectors = np.linalg.eigh(rest @ rest.T)[1][:, ::-1][:, : planes - weights.shape[0]]
    vectors = vectors - own @ (own.T @ vectors)
    with np.errstate(divide="ignore"):
        back = np.where(scale > 0, 1.0 / scale, 0.0)
    return np.hstack([own, vectors]).T * back


def _scaled(weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights scaled to a sum of 1 per channel, and, by band, 1 / sqrt(sum over channels), 0 in bands
    without weight.
    """
    weights = np.asarray(weights, dtype=float)
    sums = weights.sum(axis=1, keepdims=True)
    weights = np.divide(weights, sums, out=np.zeros_like(weights), where=sums > 0)
    total = weights.sum(axis=0)
    with np.errstate(divide="ignore"):
        return weights, np.where(total > 0, 1.0 / np.sqrt(total), 0.0)


def coefficients(weights: FloatArray, basis: FloatArray, transfer: FloatArray) -> FloatArray:
    """Return u, (channel, planes, frequency), for which sum_k u_ck(f) g_k(l) is closest to w_c(l) T_l(f)."""
    seen = basis * _scaled(weights)[1] ** 2
    return np.einsum("cl,kl,lf->ckf", np.asarray(weights, dtype=float), seen, transfer, optimize=True)


def expansion_residual(weights: FloatArray, transfer: FloatArray, basis: FloatArray) -> FloatArray:
    """Return the residual of an expansion in every band, relative to the channel's full scale for light that is equal
    in all bands.

    Parameters
    ----------
    weights : (channel, band) array
    transfer : (band, frequency) array
    basis : (planes, band) array
        From ``band_basis``.

    Returns
    -------
    (channel, band, frequency) array
        |w_l T_l - sum_k u_k g_k(l)| / sum_l w_l.
    """
    weights = np.asarray(weights, dtype=float)
    made = np.einsum("ckf,kl->clf", coefficients(weights, basis, transfer), basis)
    return np.abs(weights[:, :, None] * transfer - made) / weights.sum(axis=1)[:, None, None]


class RadialPlane:
    """Look-up of functions of radial frequency on the half plane of a transform.

    Parameters
    ----------
    rows, columns : 1-d arrays, cycles/um
        Frequencies of the transform along y (all, in the order of the transform) and x (not negative).
    precision : dtype
        Type of the results.
    nodes : int
        Nodes of the tables; 0: by the size of the frame.

    Notes
    -----
    Rows of opposite frequency are looked up once. Linear interpolation: the error is (spacing of the nodes)^2 / 8 times
    the second derivative: 1e-7 for a smooth function with few nodes; at most 6e-6 and 2.4e-6 at the kink of a
    diffraction cut-off (f/16 on a grid of 0.5 um), where the planes contain almost no energy.
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
        """Interpolate a table at the frequencies of the rows from 0 up; return a (rows // 2 + 1, columns) array."""
        table = np.asarray(table, dtype=self.kind)
        step = np.append(np.diff(table), 0).astype(self.kind)
        found = np.empty(self.below.shape, dtype=self.kind)
        for rows in _blocks(*self.below.shape):
            np.take(step, self.below[rows], out=found[rows], mode="clip")
            found[rows] *= self.beyond[rows]
            found[rows] += np.take(table, self.below[rows], mode="clip")
        return found

    def add_product(self, sums: ComplexArray, half_transform: ComplexArray, table: FloatArray) -> None:
        """Compute sums += half_transform * table in place."""
        factor = self.upper(table)
        for rows in _blocks(*half_transform.shape):
            for own, mirrored in (
                (slice(rows.start, min(rows.stop, self.half + 1)), False),
                (slice(max(rows.start, self.half + 1), rows.stop), True),
            ):
                if own.stop > own.start:
                    part = (
                        factor[self.rows - own.stop + 1 : self.rows - own.start + 1][::-1] if mirrored else factor[own]
                    )
                    sums[own] += half_transform[own] * part

    def combine(self, half_transforms: list[ComplexArray], tables: FloatArray) -> None:
        """Replace half transform c by the sum over k of tables[c, k] * half_transforms[k], for each channel c, with the
        same bits as ``add_product``.

        Parameters
        ----------
        half_transforms : list of k (rows, columns) arrays
        tables : (channel, k, node) array
            At most k channels. The transforms after those of the channels are removed from the list.
        """
        tables = tables.astype(self.kind)
        steps = np.diff(tables, append=tables[..., -1:])
        for rows in _blocks(*self.below.shape):
            # rows of opposite frequency, in the order of the transform
            first, stop = max(rows.start, 1), min(rows.stop, self.rows - self.half)
            opposite = slice(self.rows - stop + 1, self.rows - first + 1) if stop > first else slice(0, 0)
            found = [
                [np.zeros_like(half_transforms[0][own]) for own in (rows, opposite)] for _ in range(tables.shape[0])
            ]
            for number, transform in enumerate(half_transforms):
                for channel, (upper, lower) in enumerate(found):
                    factor = np.take(steps[channel, number], self.below[rows], mode="clip")
                    factor *= self.beyond[rows]
                    factor += np.take(tables[channel, number], self.below[rows], mode="clip")
                    upper += transform[rows] * factor
                    lower += transform[opposite] * factor[first - rows.start : stop - rows.start][::-1]
            for transform, (upper, lower) in zip(half_transforms, found, strict=False):
                transform[rows], transform[opposite] = upper, lower
        del half_transforms[tables.shape[0] :]

    def multiply(self, half_transform: ComplexArray, table: FloatArray) -> None:
        """Multiply a half transform (rows, columns) by a table in place."""
        factor = self.upper(table)
        half_transform[: self.half + 1] *= factor
        half_transform[self.half + 1 :] *= factor[1 : self.rows - self.half][::-1]


def _blocks(rows: int, columns: int) -> list[slice]:
    """Return slices of rows in blocks that fit a core's cache."""
    each = max(1, (1 << 16) // max(columns, 1))
    return [slice(start, min(start + each, rows)) for start in range(0, rows, each)]


def add_weighted(sums: list[ComplexArray], weights: FloatArray, half_transform: ComplexArray) -> None:
    """Compute sums[c] += weights[c] * half_transform in place, block by block."""
    kind = sums[0].real.dtype
    for rows in _blocks(*half_transform.shape):
        block = half_transform[rows]
        for channel, weight in enumerate(weights):
            if weight:
                sums[channel][rows] += kind.type(weight) * block


def add_projected(sums: list[FloatArray], factors: FloatArray, bands: list[FloatArray]) -> None:
    """Compute sums[k] += sum over the given bands of factors[k, band] * band in place, block by block.

    Parameters
    ----------
    sums : list of k (y, x) arrays
    factors : (k, bands) array
    bands : list of (y, x) arrays
    """
    kind = sums[0].dtype
    flat = [own.reshape(-1) for own in sums]
    planes = [np.ascontiguousarray(band).reshape(-1) for band in bands]
    matrix = np.ascontiguousarray(factors, dtype=kind)
    block = np.empty((len(planes), BLOCK), dtype=kind)
    for start in range(0, flat[0].size, BLOCK):
        stop = min(start + BLOCK, flat[0].size)
        for number, plane in enumerate(planes):
            block[number, : stop - start] = plane[start:stop]
        for own, found in zip(flat, matrix @ block[:, : stop - start], strict=True):
            own[start:stop] += found
