"""Blur that changes over the field: every point of the image spreads by the point spread function of its own place.

In:  planes on the image grid (um), a ``PsfBank``.
Out: blurred planes; how they were computed and how wrong that is at most.
Sources: eigen-PSF expansion (Lauer, Proc. SPIE 4847, 167, 2002; Jee et al., PASP 119, 1403, 2007), with the mean taken
out before the expansion so that every truncation keeps the flux; interpolated kernels (Nagy & O'Leary, SIAM J. Sci.
Comput. 19, 1063, 1998).

The exact answer is the direct sum over all samples of the image in front of the lens: each is spread by
``PsfBank.kernel_at`` its own position (``weights = "source"``). The flux of every point is then kept exactly. A uniform
plane stays uniform but for the divergence of the mean displacement and half the second derivatives of the second
moments of the bank: for spots of some um in a field of some mm 1e-3 and 1e-6, the first gone with
``centre = "centroid"``. With ``weights = "image"`` each sample of the result gathers with the kernel of its own place:
a uniform plane stays uniform exactly, and the flux of a point changes by as much. Beyond the border stands the mirror
image, with its own kernels.

Both methods take kernels at the nodes of a grid over the window and mix them bilinearly in between. ``tiles`` convolves
the light around each node with the kernel of the node; ``eigen`` expands the nodes' kernels about their mean in as few
kernels as the tolerance allows, for each of which the whole plane is convolved. Errors are bounds on the result as a
share of its full scale: half the sum of the absolute differences of two kernels of equal flux, the largest over the
field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.field.convolve import Weights, eigen, fast, hats_of, tiles
from etendue_camera.field.expansion import BASIS_NODES, expansion
from etendue_camera.field.psf_bank import PsfBank
from etendue_camera.field.psf_kernels import Centre, Light, Sampler

Method = Literal["auto", "eigen", "tiles"]
Level = tuple[tuple[int, int], FloatArray, float]  # nodes, their kernels, error of mixing them

_LARGEST = 512 << 20  # bytes of kernels
_MOST = 100_000  # kernels: a minute or two
_EIGEN_SHARE = 0.6  # of what is allowed, for mixing bilinearly where eigen-PSFs are cut off too
_KERNEL_SHARE = 0.1  # of the tolerance, for the tails that the kernels cut off
_HEIGHT_SHARE = 0.1  # of the tolerance, for mixing heights linearly
_CALL = 3.5e5  # what the calls for one tile cost, as N log2 N of a transform: 40 us
_FAIR = 0.25  # fall of the error of bilinear mixing when the grid is refined to half


@dataclass(frozen=True)
class Choice:
    """How a field-dependent blur is computed.

    Attributes
    ----------
    method : "eigen" or "tiles"
    count : eigen-PSFs beside the mean (the most any plane takes), or tiles
    grid : nodes along y and x
    error : predicted largest error, share of full scale
    cost : per plane, in real transforms of the padded frame
    size : samples along one side of a kernel
    others : (method, count, error, cost) of what was not chosen
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
    """Everything about one window, bank and tolerance that does not depend on the light: see ``prepare``."""

    choice: Choice
    shape: tuple[int, int]
    weights: Weights
    mix: FloatArray  # (planes, bank wavelengths)
    kernels: FloatArray  # (nodes y, nodes x, bank wavelengths, size, size); none for eigen
    bases: tuple[FloatArray, ...] = ()  # by plane: (1 + count, size, size), the mean first
    coefficients: tuple[FloatArray, ...] = ()  # by plane: (count, nodes y, nodes x)

    def take(self, planes: slice) -> Prepared:
        """The same for some of the planes."""
        return replace(self, mix=self.mix[planes], bases=self.bases[planes], coefficients=self.coefficients[planes])

    @property
    def nbytes(self) -> int:
        return int(self.kernels.nbytes + sum(a.nbytes for a in (*self.bases, *self.coefficients)))


def blur(
    planes: FloatArray,
    y_um: FloatArray,
    x_um: FloatArray,
    wavelengths_um: Any,
    bank: PsfBank,
    method: Method = "auto",
    tolerance: float = 1e-3,
    **how: Any,
) -> FloatArray:
    """Spread every point by the point spread function of its place and wavelength.

    Parameters
    ----------
    planes : (L, Y, X) array, any unit
        float32 stays float32.
    y_um, x_um : (Y,), (X,) arrays, um
        Positions on the image plane from the axis of the lens; evenly spaced, the same spacing along both.
    wavelengths_um : (L,) array, um
    bank : PsfBank
    method : {"auto", "eigen", "tiles"}
        ``auto`` takes whichever is cheaper for the tolerance.
    tolerance : float
        Largest error, as a share of full scale, above 0.
    how
        ``count``, ``weights``, ``light``, ``centre``, ``lost``: see ``prepare``.

    Returns
    -------
    (L, Y, X) array

    Raises
    ------
    ValueError
        As ``prepare``; for planes that do not fit the positions.
    """
    return apply(planes, prepare(bank, y_um, x_um, wavelengths_um, method, tolerance, **how))


def choose(
    bank: PsfBank,
    y_um: FloatArray,
    x_um: FloatArray,
    wavelengths_um: Any,
    method: Method = "auto",
    tolerance: float = 1e-3,
    **how: Any,
) -> Choice:
    """The decision ``blur`` would take, before anything is convolved (arguments of ``blur`` and ``prepare``)."""
    return prepare(bank, y_um, x_um, wavelengths_um, method, tolerance, **how).choice


def prepare(
    bank: PsfBank,
    y_um: FloatArray,
    x_um: FloatArray,
    wavelengths_um: Any,
    method: Method = "auto",
    tolerance: float = 1e-3,
    count: int = 0,
    weights: Weights = "source",
    light: Light = "bandlimited",
    centre: Centre = "reference",
    lost: float | None = None,
) -> Prepared:
    """Kernels, their grid, the method and the number of terms for one window.

    Parameters
    ----------
    count : int
        0: as the tolerance asks. Else the number of eigen-PSFs beside the mean, or of nodes along the longer side of
        the window; the choice then says how wrong that is.
    weights : {"source", "image"}
        Kernel of the place the light comes from (flux exact), or of the place it falls on (uniformity exact).
    light, centre
        As for ``Sampler``.
    lost : float, optional
        Flux in the tails of the pictures that kernels may cut off; the rest is scaled to 1. Default: a tenth of the
        tolerance. A value given comes on top of the tolerance.

    Raises
    ------
    ValueError
        For a tolerance that is not above 0, positions that are not evenly spaced, or where the grid that the tolerance
        asks for would take more than 512 MB of kernels or 100 000 of them.

    Notes
    -----
    The grid is refined to half until the largest measured difference between a kernel and the mix of its neighbours, at
    the points in the middle of nodes and cells, is below the tolerance; the error falls by four each time. Cost of a
    real transform of N samples: N log2 N. ``eigen`` with R terms takes R + 1 transforms of planes, as many of kernels
    and one back; ``tiles`` three small ones per node, and the calls. Measured run times lie within a factor of 1.6 of
    this from 256 x 256 to 1024 x 1024 samples.
    """
    require.must(0.0 < tolerance < np.inf, "tolerance", tolerance, "finite and above 0")
    require.must(method in ("auto", "eigen", "tiles"), "method", repr(method), "'auto', 'eigen' or 'tiles'")
    require.must(weights in ("source", "image"), "weights", repr(weights), "'source' or 'image'")
    require.must(
        count >= 0 and (not count or method != "auto"), "count", count, "0 with method 'auto', and not below 0"
    )
    y, x = np.asarray(y_um, dtype=float), np.asarray(x_um, dtype=float)
    spacing = _spacing(y, x, bank)
    allowed = (1 - _HEIGHT_SHARE) * tolerance if lost is not None else (1 - _HEIGHT_SHARE - _KERNEL_SHARE) * tolerance
    lost = _KERNEL_SHARE * tolerance if lost is None else lost
    size = bank.size(spacing, lost, light)
    mix = bank.mix(wavelengths_um)
    used = np.flatnonzero(mix.any(axis=0))
    mix = mix[:, used]
    sampler = Sampler(bank, spacing, size, light, centre, tuple(int(i) for i in used), _HEIGHT_SHARE * tolerance)
    extra = lost + _HEIGHT_SHARE * tolerance
    try:
        finest = allowed if method == "tiles" else _EIGEN_SHARE * allowed
        levels = _refined(sampler, y, x, allowed, finest, count if method == "tiles" else 0)
    except ValueError:
        if method != "auto":
            raise
        method = "tiles"  # the finer grid of the eigen-PSFs does not fit; that of the tiles may
        levels = _refined(sampler, y, x, allowed, allowed, 0)
    offers: dict[str, tuple[int, float, float]] = {}
    if method != "eigen":
        (grid, _, between) = levels[0]
        offers["tiles"] = (grid[0] * grid[1], between + extra, _cost_of_tiles(grid, y.size, x.size, size))
    room = 0.0
    if method != "tiles":
        # its run time does not depend on the grid: the finer one leaves more room for truncation
        grid, kernels, between = levels[-1]
        room = allowed - between
        # the ends of the mixed wavelengths bound what lies between them
        tried = [expansion(kernels[:, :, number], room, count) for number in range(used.size)]
        most, worst = max(len(c) for _, c, _ in tried), max(e for _, _, e in tried)
        offers["eigen"] = (most, between + extra + worst, _cost_of_eigen(most))
    best = min(offers, key=lambda name: (not count and offers[name][1] > extra + allowed * (1 + 1e-9), offers[name][2]))
    grid, kernels, between = levels[0 if best == "tiles" else -1]
    terms: list[tuple[FloatArray, FloatArray]] = []
    if best == "eigen":
        truncated = 0.0
        for row in mix:
            basis, coefficients, error = expansion(np.tensordot(kernels, row, axes=(2, 0)), room, count)
            terms.append((basis, coefficients))
            truncated = max(truncated, error)
        offers["eigen"] = (max(len(c) for _, c in terms), between + extra + truncated, offers["eigen"][2])
    number, error, cost = offers.pop(best)
    if not count and error > extra + allowed * (1 + 1e-9):
        raise ValueError(
            f"eigen-PSFs made from {BASIS_NODES} kernels reach an error of {error:.2g}, not {tolerance:g}; take method "
            f"'tiles'"
        )
    choice = Choice(best, number, grid, error, cost, size, tuple((name, *offer) for name, offer in offers.items()))
    return Prepared(
        choice,
        (y.size, x.size),
        weights,
        mix,
        kernels if best == "tiles" else np.zeros((0, 0, used.size, size, size)),
        tuple(b for b, _ in terms),
        tuple(c for _, c in terms),
    )


def apply(planes: FloatArray, prepared: Prepared) -> FloatArray:
    """Blur planes with what ``prepare`` made; (L, Y, X) in and out."""
    planes = np.asarray(planes)
    if planes.shape != (len(prepared.mix), *prepared.shape):
        raise ValueError(f"planes have shape {planes.shape}; prepared for {(len(prepared.mix), *prepared.shape)}")
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
    """How much ``weights = "source"`` makes a uniform plane uneven: the largest divergence of the mean displacement."""
    heights, radial = bank.heights_um, bank.centroids()[:, :, 0]
    slope = np.gradient(radial, heights, axis=0) if heights.size > 1 else np.zeros_like(radial)
    held = heights > 0
    return float(np.abs(slope[held] + radial[held] / heights[held, None]).max(initial=0.0))


def _spacing(y: FloatArray, x: FloatArray, bank: PsfBank) -> float:
    steps = []
    for name, line in (("y_um", y), ("x_um", x)):
        if line.ndim != 1 or line.size < 1:
            raise ValueError(f"{name} has shape {line.shape}; it must be one-dimensional")
        if line.size > 1:
            step = (line[-1] - line[0]) / (line.size - 1)
            if not step > 0 or np.abs(np.diff(line) - step).max() > 1e-6 * step + 1e-9 * np.abs(line).max():
                raise ValueError(f"{name} must grow in even steps")
            steps.append(float(step))
    if len(steps) == 2 and abs(steps[0] - steps[1]) > 1e-6 * steps[0]:
        raise ValueError(
            f"samples are {steps[0]:g} um apart along y and {steps[1]:g} um along x; kernels need the same spacing "
            f"along both"
        )
    return steps[0] if steps else float(bank.spacing_um[0])


def _positions(line: FloatArray, nodes: int) -> FloatArray:
    return np.linspace(line[0], line[-1], nodes) if nodes > 1 else np.array([0.5 * (line[0] + line[-1])])


def _kernels(sampler: Sampler, y: FloatArray, x: FloatArray, grid: tuple[int, int]) -> FloatArray:
    yy, xx = np.meshgrid(_positions(y, grid[0]), _positions(x, grid[1]), indexing="ij")
    return sampler.kernels(yy.ravel(), xx.ravel()).reshape(*grid, -1, sampler.size, sampler.size)


def _grid_of(cells: int, ny: int, nx: int) -> tuple[int, int]:
    """Nodes along y and x for so many cells along the longer side of a frame."""
    longest = max(ny, nx)
    rows, columns = (1 if n == 1 else min(n, max(1, round(cells * n / longest)) + 1) for n in (ny, nx))
    return rows, columns


def _too_many(grid: tuple[int, int], size: int, wavelengths: int) -> bool:
    """Whether the next finer grid of nodes has more kernels than are held."""
    finer = (2 * grid[0] - 1) * (2 * grid[1] - 1)
    return finer * size**2 * wavelengths * 8 > _LARGEST or finer * wavelengths > _MOST


def kernels_fit(size: int, wavelengths: int, ny: int, nx: int) -> bool:
    """Whether the error of mixing kernels of this size can be looked for at all: the first grid of nodes is every
    sample, or can be halved.

    Parameters
    ----------
    size : int
        Samples along a side of a kernel.
    wavelengths : int
        Kernels at each node.
    ny, nx : int
        Samples of the frame.
    """
    grid = _grid_of(2, ny, nx)
    return grid == (ny, nx) or not _too_many(grid, size, wavelengths)


def _refined(sampler: Sampler, y: FloatArray, x: FloatArray, goal: float, last_goal: float, count: int) -> list[Level]:
    """Grids by halving: the first that is good enough for ``goal``, and the first for ``last_goal`` if that is
    another one.
    """
    grid = _grid_of(max(count - 1, 1) if count else 2, y.size, x.size)
    kernels, before = _kernels(sampler, y, x, grid), np.inf
    good: list[Level] = []
    while True:
        if grid == (y.size, x.size):
            return [*good, (grid, kernels, 0.0)]
        finer = (2 * grid[0] - 1, 2 * grid[1] - 1)
        too_many = _too_many(grid, sampler.size, sampler.wavelengths)
        if too_many and count and grid[0] % 2 and grid[1] % 2:
            return [(grid, kernels, _FAIR * _mixing_error(kernels[::2, ::2], kernels))]
        if too_many:
            raise ValueError(
                f"an error of {last_goal:.2g} of full scale asks for more than {grid[0]} x {grid[1]} kernels of "
                f"{sampler.size} x "
                f"{sampler.size} samples, which are {before * _FAIR:.2g} from what lies between them; allow a larger "
                f"error, or take a "
                "smaller window"
            )
        fine = _between_nodes(sampler, y, x, kernels, grid)
        error = _mixing_error(kernels, fine)
        if count:
            return [(grid, kernels, error)]
        falls_to = error * (_FAIR if not np.isfinite(before) else max(_FAIR, min(1.0, error / before)))
        if not good and error <= goal:
            good = [(grid, kernels, error)]
        if falls_to <= last_goal:
            return [*good, (finer, fine, falls_to)]
        if not all(f <= n for f, n in zip(finer, (y.size, x.size), strict=True)):  # every sample is a node
            grid = (y.size, x.size)
            kernels = _kernels(sampler, y, x, grid)
            continue
        grid, kernels, before = finer, fine, error


def _between_nodes(
    sampler: Sampler, y: FloatArray, x: FloatArray, kernels: FloatArray, grid: tuple[int, int]
) -> FloatArray:
    """Kernels of the grid refined to half; those that are known are taken over."""
    finer = (2 * grid[0] - 1, 2 * grid[1] - 1)
    out = np.empty((*finer, *kernels.shape[2:]))
    out[::2, ::2] = kernels
    yy, xx = np.meshgrid(_positions(y, finer[0]), _positions(x, finer[1]), indexing="ij")
    new = np.ones(finer, dtype=bool)
    new[::2, ::2] = False
    out[new] = sampler.kernels(yy[new], xx[new])
    return out


def _mixing_error(kernels: FloatArray, fine: FloatArray) -> float:
    """Largest half sum of |kernel - mix of its neighbours| at the nodes of the finer grid."""
    worst = 0.0
    for i in range(fine.shape[0]):
        row: Any = kernels[i // 2] if i % 2 == 0 else 0.5 * (kernels[i // 2] + kernels[i // 2 + 1])
        mixed = np.empty_like(fine[i])
        mixed[::2] = row
        mixed[1::2] = 0.5 * (row[:-1] + row[1:])
        worst = max(worst, float(np.abs(fine[i] - mixed).sum(axis=(-2, -1)).max()))
    return 0.5 * worst


def _transform(*shape: int) -> float:
    ny, nx = fast(*shape)
    return ny * nx * math.log2(max(ny * nx, 2))


def _cost_of_eigen(count: int) -> float:
    return 2.0 * (count + 1) + 1.0


def _cost_of_tiles(grid: tuple[int, int], ny: int, nx: int, size: int) -> float:
    sides = [(n if g == 1 else min(2 * n / (g - 1), n)) + size for n, g in zip((ny, nx), grid, strict=True)]
    one = 3 * _transform(int(sides[0]), int(sides[1])) + _CALL
    return grid[0] * grid[1] * one / _transform(ny + size, nx + size)
