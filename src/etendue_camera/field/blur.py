"""Field-dependent blur: every point of the image is blurred by the point spread function at its own position.

In:  planes on the image grid (um), a ``PsfBank``.
Out: blurred planes; how they were computed, and a bound on the error.
Sources: eigen-PSF expansion (Lauer, Proc. SPIE 4847, 167, 2002; Jee et al., PASP 119, 1403, 2007), with the mean
subtracted before the expansion so that every truncation conserves flux; interpolated kernels (Nagy & O'Leary, SIAM J.
Sci. Comput. 19, 1063, 1998).

With ``weights = "source"`` the exact result is the direct sum over all samples of the sharp image, each spread by the
kernel at its position (``PsfBank.kernel_at``). The flux of every point is then conserved exactly. A uniform plane
becomes non-uniform by the divergence of the mean displacement and by half the second derivatives of the PSFs' second
moments. For spots of a few um in a field of a few mm these terms are 1e-3 and 1e-6; the first vanishes with ``centre =
"centroid"``. With ``weights = "image"`` each sample of the result is gathered with the kernel of its own position: a
uniform plane stays uniform exactly, and the flux of a point changes by the same amounts. Beyond the border the plane is
continued by its mirror image, with mirrored kernels.

Both methods take kernels at the nodes of a grid over the window and interpolate them bilinearly. ``tiles`` convolves
the light around each node with the kernel of that node. ``eigen`` expands the kernels about their mean in as few
kernels as the tolerance allows, and convolves the whole plane with each. Errors are bounds relative to full scale: half
the sum of absolute differences between the exact and the computed kernel, which have equal flux, at the worst point of
the field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.field import node_grids
from etendue_camera.field.convolve import Weights, eigen, fast, hats_of, tiles
from etendue_camera.field.expansion import BASIS_NODES, expansion
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.psf_kernels import Centre, Light, Sampler

Method = Literal["auto", "eigen", "tiles"]

_EIGEN_SHARE = 0.6  # fraction of the allowed error for bilinear interpolation; truncating the expansion gets the rest
_KERNEL_SHARE = 0.1  # of the tolerance for truncated kernel tails
_HEIGHT_SHARE = 0.1  # of the tolerance for linear interpolation between heights
_CALL = 3.5e5  # call overhead of one tile (40 us), in the unit N log2 N of a transform


@dataclass(frozen=True)
class BlurChoice:
    """The chosen method for a field-dependent blur.

    Attributes
    ----------
    method : "eigen" or "tiles"
    count : number of eigen-PSFs in addition to the mean (maximum over the planes), or of tiles
    grid : nodes along y and x
    error : predicted largest error, relative to full scale
    cost : cost per plane, in units of one real transform of the padded frame
    size : samples along one side of a kernel
    others : (method, count, error, cost) of the alternatives not chosen
    """

    method: str
    count: int
    grid: tuple[int, int]
    error: float
    cost: float
    size: int
    others: tuple[tuple[str, int, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Prepared:
    """Everything for one window, bank and tolerance that does not depend on the light; see ``prepare``."""

    choice: BlurChoice
    shape: tuple[int, int]
    weights: Weights
    mix: FloatArray  # (planes, bank wavelengths)
    kernels: FloatArray  # (nodes y, nodes x, bank wavelengths, size, size); empty for eigen
    bases: tuple[FloatArray, ...] = ()  # by plane: (1 + count, size, size), the mean first
    coefficients: tuple[FloatArray, ...] = ()  # by plane: (count, nodes y, nodes x)

    def take(self, planes: slice) -> Prepared:
        """Return these preparations for a slice of the planes."""
        return replace(self, mix=self.mix[planes], bases=self.bases[planes], coefficients=self.coefficients[planes])

    @property
    def nbytes(self) -> int:
        return int(self.kernels.nbytes + sum(a.nbytes for a in (*self.bases, *self.coefficients)))


def blur(
    planes: FloatArray,
    y_um: FloatArray,
    x_um: FloatArray,
    wavelengths_um: FloatArray,
    bank: PsfBank,
    method: Method = "auto",
    tolerance: float = 1e-3,
    **how: Any,
) -> FloatArray:
    """Blur every point with the point spread function at its position and wavelength.

    Parameters
    ----------
    planes : (L, Y, X) array, any unit
        float32 stays float32.
    y_um, x_um : (Y,), (X,) arrays, um
        Positions on the image plane relative to the lens axis; evenly spaced, with the same spacing along both.
    wavelengths_um : (L,) array, um
    bank : PsfBank
    method : {"auto", "eigen", "tiles"}
        ``auto`` chooses the cheaper method that meets the tolerance.
    tolerance : float
        Largest error relative to full scale, above 0.
    how
        ``count``, ``weights``, ``light``, ``centre``, ``lost``: see ``prepare``.

    Returns
    -------
    (L, Y, X) array

    Raises
    ------
    ValueError
        As for ``prepare``; also for planes whose shape does not match the positions.
    """
    return apply(planes, prepare(bank, y_um, x_um, wavelengths_um, method, tolerance, **how))


def choose(
    bank: PsfBank,
    y_um: FloatArray,
    x_um: FloatArray,
    wavelengths_um: FloatArray,
    method: Method = "auto",
    tolerance: float = 1e-3,
    **how: Any,
) -> BlurChoice:
    """Return the choice that ``blur`` would make, without convolving; arguments as for ``blur`` and ``prepare``."""
    return prepare(bank, y_um, x_um, wavelengths_um, method, tolerance, **how).choice


def prepare(
    bank: PsfBank,
    y_um: FloatArray,
    x_um: FloatArray,
    wavelengths_um: FloatArray,
    method: Method = "auto",
    tolerance: float = 1e-3,
    count: int = 0,
    weights: Weights = "source",
    light: Light = "bandlimited",
    centre: Centre = "reference",
    lost: float | None = None,
) -> Prepared:
    """Compute kernels, their grid, the method and the number of terms for one window.

    Parameters
    ----------
    bank, y_um, x_um, wavelengths_um, method, tolerance
        As for ``blur``.
    count : int
        0: as the tolerance requires. Otherwise the number of eigen-PSFs in addition to the mean, or of nodes along the
        longer side of the window; the choice then states the resulting error.
    weights : {"source", "image"}
        Use the kernel of the position from which the light comes (conserves flux), or of the position on which it falls
        (keeps uniform planes).
    light, centre
        As for ``Sampler``.
    lost : float, optional
        Fraction of the flux of a PSF, in its tails, that a kernel may cut off; the rest is scaled to 1. Default: a
        tenth of the tolerance, as part of it. A given value adds to the error that the tolerance allows.

    Raises
    ------
    ValueError
        For a tolerance that is not above 0, positions that are not evenly spaced, or if the grid required by the
        tolerance would take more than 512 MB or 100 000 kernels.

    Notes
    -----
    The grid spacing is halved until the largest measured difference between a kernel and the interpolation of its
    neighbours, at the midpoints of edges and cells, is below the tolerance; each halving reduces the error by a factor
    of four. The cost of a real transform of N samples is N log2 N. ``eigen`` with R terms takes R + 1 transforms of
    planes, as many of kernels and one inverse; ``tiles`` takes three small transforms per node plus call overhead.
    Measured run times lie within a factor of 1.6 of this for 256 x 256 to 1024 x 1024 samples.
    """
    require.must(0.0 < tolerance < np.inf, "tolerance", tolerance, "finite and above 0")
    require.must(method in ("auto", "eigen", "tiles"), "method", repr(method), "'auto', 'eigen' or 'tiles'")
    require.must(weights in ("source", "image"), "weights", repr(weights), "'source' or 'image'")
    require.must(
        count >= 0 and (not count or method != "auto"), "count", count, "0 with method 'auto', and not below 0"
    )
    y, x = np.asarray(y_um, dtype=float), np.asarray(x_um, dtype=float)
    spacing = node_grids.spacing_of(y, x, float(bank.spacing_um[0]))
    allowed = (1 - _HEIGHT_SHARE) * tolerance if lost is not None else (1 - _HEIGHT_SHARE - _KERNEL_SHARE) * tolerance
    lost = _KERNEL_SHARE * tolerance if lost is None else lost
    size = bank.size(spacing, lost, light)
    mix = bank.mix(wavelengths_um)
    used = np.flatnonzero(mix.any(axis=0))
    mix = mix[:, used]
    sampler = Sampler(bank, spacing, size, light, centre, tuple(int(i) for i in used), _HEIGHT_SHARE * tolerance)
    extra = lost + _HEIGHT_SHARE * tolerance
    within = extra + allowed * (1 + 1e-9)
    offers = _offers(sampler, y, x, method, allowed, count, extra)
    best = min(offers, key=lambda one: (not count and one.error > within, one.cost))
    others = tuple((one.method, one.count, one.error, one.cost) for one in offers if one is not best)
    if best.method == "eigen":  # the bank wavelengths bound the error; expand the interpolated kernels of each plane
        mixed = (np.tensordot(best.level.kernels, row, axes=(2, 0)) for row in mix)
        best = replace(_expanded(best.level, mixed, allowed, count, extra), cost=best.cost)
    require.that(
        count or not best.error > within,
        f"eigen-PSFs made from {BASIS_NODES} kernels reach an error of {best.error:.2g}, not {tolerance:g}; use "
        f"method 'tiles'",
    )
    return Prepared(
        BlurChoice(best.method, best.count, best.level.grid, best.error, best.cost, size, others),
        (y.size, x.size),
        weights,
        mix,
        best.level.kernels if best.method == "tiles" else np.zeros((0, 0, used.size, size, size)),
        tuple(basis for basis, _ in best.terms),
        tuple(coefficients for _, coefficients in best.terms),
    )


@dataclass(frozen=True, eq=False)
class _Offer:
    """One way to compute the blur from the kernels of a grid, with the fields of `BlurChoice` and, for eigen-PSFs, the
    expansion.
    """

    method: str
    count: int
    level: node_grids.Level
    error: float
    cost: float
    terms: tuple[tuple[FloatArray, FloatArray], ...] = ()  # bases and coefficients


def _offers(
    sampler: Sampler, y: FloatArray, x: FloatArray, method: Method, allowed: float, count: int, extra: float
) -> list[_Offer]:
    """Return an offer for the requested method, or for each candidate with "auto"."""
    try:
        finest = allowed if method == "tiles" else _EIGEN_SHARE * allowed
        levels = node_grids.refined(sampler, y, x, allowed, finest, count if method == "tiles" else 0)
    except ValueError:
        if method != "auto":
            raise
        method = "tiles"  # the finer grid for eigen-PSFs exceeds the limits; that for tiles may not
        levels = node_grids.refined(sampler, y, x, allowed, allowed, 0)
    tiled = [] if method == "eigen" else [_tiled(levels[0], y.size, x.size, sampler.size, extra)]
    if method == "tiles":
        return tiled
    # The run time of eigen-PSFs does not depend on the grid; a finer grid leaves more of the error for truncation.
    planes = (levels[-1].kernels[:, :, number] for number in range(sampler.wavelengths))
    return [*tiled, _expanded(levels[-1], planes, allowed, count, extra)]


def _tiled(level: node_grids.Level, ny: int, nx: int, size: int, extra: float) -> _Offer:
    grid = level.grid
    sides = [(n if g == 1 else min(2 * n / (g - 1), n)) + size for n, g in zip((ny, nx), grid, strict=True)]
    one = 3 * _transform(int(sides[0]), int(sides[1])) + _CALL
    cost = grid[0] * grid[1] * one / _transform(ny + size, nx + size)
    return _Offer("tiles", grid[0] * grid[1], level, level.error + extra, cost)


def _expanded(
    level: node_grids.Level, planes: Iterable[FloatArray], allowed: float, count: int, extra: float
) -> _Offer:
    """Return an eigen-PSF offer with enough terms for every plane of kernels (nodes y, nodes x, size, size)."""
    found = [expansion(kernels, allowed - level.error, count) for kernels in planes]
    most, worst = max(len(terms) for _, terms, _ in found), max(error for *_, error in found)
    terms = tuple((basis, coefficients) for basis, coefficients, _ in found)
    return _Offer("eigen", most, level, level.error + extra + worst, 2.0 * (most + 1) + 1.0, terms)


def _transform(*shape: int) -> float:
    ny, nx = fast(*shape)
    return ny * nx * math.log2(max(ny * nx, 2))


def apply(planes: FloatArray, prepared: Prepared) -> FloatArray:
    """Return planes (L, Y, X), blurred with the result of ``prepare``."""
    planes = np.asarray(planes)
    require.that(
        planes.shape == (len(prepared.mix), *prepared.shape),
        f"planes have shape {planes.shape}; the blur was prepared for {(len(prepared.mix), *prepared.shape)}",
    )
    kind: Any = planes.dtype if planes.dtype in (np.float32, np.float64) else np.dtype(float)
    out = np.empty(planes.shape, dtype=kind)
    hats = [hats_of(n, g).astype(kind) for n, g in zip(prepared.shape, prepared.choice.grid, strict=True)]
    for number, plane in enumerate(planes):
        plane = plane.astype(kind, copy=False)
        if prepared.choice.method == "eigen":
            coefficients = prepared.coefficients[number].astype(kind)
            out[number] = eigen(plane, prepared.bases[number].astype(kind), coefficients, hats, prepared.weights)
        else:
            kernels = np.tensordot(prepared.kernels, prepared.mix[number], axes=(2, 0)).astype(kind)
            out[number] = tiles(plane, kernels, hats, prepared.weights)
    return out


def unevenness(bank: PsfBank) -> float:
    """Return the non-uniformity of a blurred uniform plane with ``weights = "source"``: the largest divergence of the
    mean displacement.
    """
    heights, radial = bank.heights_um, bank.centroids()[:, :, 0]
    slope = np.gradient(radial, heights, axis=0) if heights.size > 1 else np.zeros_like(radial)
    held = heights > 0
    return float(np.abs(slope[held] + radial[held] / heights[held, None]).max(initial=0.0))
