"""Eigen-PSFs: kernels of many image points as their mean plus a few principal components.

In:  kernels at the nodes of a grid, the allowed error.
Out: a basis, every truncation of which conserves flux, and the coefficients at the nodes.
Sources: as for `blur.py`.
"""

from __future__ import annotations

import numpy as np
import scipy

from etendue_camera.arrays import FloatArray

BASIS_NODES = 300  # the expansion is computed from at most this many kernels, and checked against all


def expansion(kernels: FloatArray, room: float, count: int) -> tuple[FloatArray, FloatArray, float]:
    """Expand kernels (nodes y, nodes x, size, size) about their mean, to an error of ``room`` or with ``count`` terms.

    Returns the basis (1 + terms, size, size), coefficients (terms, nodes y, nodes x) and the error. Each component of
    the kernels minus their mean sums to zero, so every truncation keeps the sum of 1.
    """
    grid, size = kernels.shape[:2], kernels.shape[-1]
    flat = kernels.reshape(grid[0] * grid[1], size * size)
    mean = flat.mean(axis=0)
    apart = flat - mean
    some = apart[:: -(-len(flat) // BASIS_NODES)]
    values, vectors = scipy.linalg.eigh(some @ some.T)
    singular = np.sqrt(np.maximum(values[::-1], 0.0))
    # a Gram matrix resolves singular values down to 1e-8 of the largest
    rank = int((singular > 1e-8 * singular[0]).sum()) if singular[0] > 1e-14 else 0
    directions = (some.T @ vectors[:, ::-1][:, :rank]) / singular[:rank]
    shares = apart @ directions

    def error(terms: int) -> float:
        return 0.5 * float(np.abs(apart - shares[:, :terms] @ directions[:, :terms].T).sum(axis=1).max())

    terms = min(count, rank)
    if not count and rank and error(0) > room:
        low, terms = 0, 1
        while terms < rank and error(terms) > room:
            low, terms = terms, min(2 * terms, rank)
        while terms - low > max(1, terms // 16):
            middle = (low + terms) // 2
            low, terms = (middle, terms) if error(middle) > room else (low, middle)
    basis = np.concatenate([mean[None], directions[:, :terms].T]).reshape(-1, size, size)
    basis[1:] -= basis[1:].mean(axis=(1, 2), keepdims=True)
    basis[0] /= basis[0].sum()
    return basis, np.ascontiguousarray(shares[:, :terms].T).reshape(-1, *grid), error(terms)
