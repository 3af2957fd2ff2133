"""Convolution with field-dependent kernels: an expansion in a few kernels, or bilinearly blended tiles.

In:  a plane, kernels, weights of the nodes of a grid.
Out: the blurred plane. Beyond the border, plane and weights are continued by their mirror images.
Sources: see ``blur``; fast convolution by discrete Fourier transforms of blocks (overlap-add).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy

from etendue_camera.arrays import Array, FloatArray

Weights = Literal["source", "image"]


def _half_transform(array: FloatArray, shape: tuple[int, int]) -> Array:
    """Return the real transform of a zero-padded array, without transforming the zero rows."""
    return scipy.fft.fft(
        scipy.fft.rfft(array, shape[1], axis=1, workers=1), shape[0], axis=0, workers=1, overwrite_x=True
    )


def _plane_of(transform: Array, shape: tuple[int, int], rows: slice, columns: slice) -> FloatArray:
    some = scipy.fft.ifft(transform, axis=0, workers=1, overwrite_x=True)[rows]
    return scipy.fft.irfft(some, shape[1], axis=1, workers=1)[:, columns]


def fast(*lengths: int) -> tuple[int, int]:
    """Return two lengths, increased to lengths whose transforms are fast."""
    ny, nx = (int(scipy.fft.next_fast_len(n, real=True)) for n in lengths)
    return ny, nx


def eigen(
    plane: FloatArray, basis: FloatArray, coefficients: FloatArray, hats: list[FloatArray], weights: Weights
) -> FloatArray:
    """Return the sum of a plane convolved with the mean kernel and with each of the other kernels, weighted by its map.

    Parameters
    ----------
    plane : (Y, X) array
    basis : (1 + R, n, n) array, n odd
        The mean kernel first.
    coefficients : (R, nodes y, nodes x) array
        Coefficients of the other kernels at the nodes: the map of each.
    hats : (Y, nodes y) and (X, nodes x) arrays
        Interpolation weights, as returned by ``hats_of``.
    weights : {"source", "image"}
        Whether a map weights the light before the convolution or after it.

    Returns
    -------
    (Y, X) array, with the dtype of the plane
    """
    reach = basis.shape[-1] // 2
    shape = fast(*(n + 2 * reach for n in plane.shape))
    rows, columns = (slice(2 * reach, 2 * reach + n) for n in plane.shape)

    def padded(array: FloatArray) -> Array:
        return _half_transform(np.pad(array, reach, mode="symmetric"), shape)

    maps = (hats[0] @ c @ hats[1].T for c in coefficients)
    whole = padded(plane)
    if weights == "source":
        total = whole * _half_transform(basis[0], shape)
        for kernel, share in zip(basis[1:], maps, strict=True):
            total += padded(plane * share) * _half_transform(kernel, shape)
        return _plane_of(total, shape, rows, columns)
    out = _plane_of(whole * _half_transform(basis[0], shape), shape, rows, columns)
    for kernel, share in zip(basis[1:], maps, strict=True):
        out += share * _plane_of(whole * _half_transform(kernel, shape), shape, rows, columns)
    return out


def tiles(plane: FloatArray, kernels: FloatArray, hats: list[FloatArray], weights: Weights) -> FloatArray:
    """Return a plane convolved with kernels (nodes y, nodes x, n, n), n odd, interpolated bilinearly between the nodes;
    the other arguments are those of ``eigen``.
    """
    size = kernels.shape[-1]
    reach = size // 2
    ny, nx = plane.shape
    wide = np.pad(plane, reach, mode="symmetric")
    out = np.zeros_like(plane)
    if weights == "source":
        hats = [np.asarray(np.pad(hat, ((reach, reach), (0, 0)), mode="symmetric")) for hat in hats]
    spans = [[_span(column) for column in hat.T] for hat in hats]
    for i, (top, bottom) in enumerate(spans[0]):
        wy = hats[0][top:bottom, i, None]
        for j, (left, right) in enumerate(spans[1]):
            share = wy * hats[1][left:right, j]
            block: Array
            if weights == "source":
                block = wide[top:bottom, left:right] * share
                shape = fast(block.shape[0] + size - 1, block.shape[1] + size - 1)
                # sample t of the full convolution lies at row top + t - 2 reach of the frame
                y0, x0 = max(0, top - 2 * reach), max(0, left - 2 * reach)
                y1, x1 = min(ny, bottom), min(nx, right)
                rows, columns = (
                    slice(y0 - top + 2 * reach, y1 - top + 2 * reach),
                    slice(x0 - left + 2 * reach, x1 - left + 2 * reach),
                )
                transform = _half_transform(block, shape) * _half_transform(kernels[i, j], shape)
                out[y0:y1, x0:x1] += _plane_of(transform, shape, rows, columns)
            else:
                block = wide[top : bottom + 2 * reach, left : right + 2 * reach]
                shape = fast(*block.shape)
                rows, columns = slice(2 * reach, block.shape[0]), slice(2 * reach, block.shape[1])
                transform = _half_transform(block, shape) * _half_transform(kernels[i, j], shape)
                out[top:bottom, left:right] += share * _plane_of(transform, shape, rows, columns)
    return out


def _span(weights: FloatArray) -> tuple[int, int]:
    held = np.flatnonzero(weights)
    return int(held[0]), int(held[-1]) + 1


def hats_of(samples: int, nodes: int) -> FloatArray:
    """Return the weights (samples, nodes) of linear interpolation between nodes spaced evenly from the first sample to
    the last.
    """
    if nodes == 1:
        return np.ones((samples, 1))
    place = np.arange(samples) * ((nodes - 1) / (samples - 1))
    low = np.minimum(place.astype(int), nodes - 2)
    share = place - low
    hats = np.zeros((samples, nodes))
    hats[np.arange(samples), low] = 1 - share
    hats[np.arange(samples), low + 1] += share
    return hats
