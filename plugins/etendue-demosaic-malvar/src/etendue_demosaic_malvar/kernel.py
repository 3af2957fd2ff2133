"""Gradient-corrected linear demosaicing: a bilinear estimate, corrected by the Laplacian of the measured colour.

In:  Bayer mosaic (y, x), linear, in any unit; its pattern.
Out: planes (3, y, x) of red, green, blue in the same unit; measured samples unchanged.
Source: Malvar, He, Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images",
        ICASSP 2004, with its gains alpha = 1/2, beta = 5/8, gamma = 3/4, which make all coefficients multiples of 1/16.

Beyond the border the mosaic is mirrored about its outermost samples, which are not repeated. Mirrored samples then have
the colour that the kernels expect at their position.

The mosaic is split into its four phase planes; every tap of a kernel is then a contiguous slice of one plane.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from etendue_camera.mosaic.bilinear import bilinear
from etendue_camera.sensor.cfa import COLOURS, phase

MARGIN = 2  # the kernels extend by two samples

Tap = Callable[[int, int], NDArray]


def malvar(mosaic: NDArray, pattern: str) -> NDArray:
    """Interpolate three colours at every pixel by the four 5 x 5 kernels of Malvar, He and Cutler.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    pattern : str
        One of `etendue_camera.sensor.cfa.BAYER`.

    Returns
    -------
    (3, y, x) array, unit and dtype of mosaic (integers become float64)
        May exceed the range of the mosaic: nothing is clipped.

    Raises
    ------
    ValueError
        If mosaic is not a non-empty (y, x) array, or the pattern is not one of the four.

    Notes
    -----
    A frame of one row or one column has no 5 x 5 neighbourhood; it is interpolated linearly along its length. The
    result is exact for constant planes and, inside the border, for planes that are the same linear ramp plus different
    constants. Opposite neighbours are added in pairs, so that mirroring the mosaic mirrors the result.
    """
    mosaic = np.asarray(mosaic)
    if mosaic.ndim != 2 or 1 in mosaic.shape or mosaic.size == 0:
        return bilinear(mosaic, pattern)
    if not np.issubdtype(mosaic.dtype, np.floating):
        mosaic = mosaic.astype(np.float64)
    colours = {place: colour for colour, places in phase(pattern).items() for place in places}
    split = _phase_planes(mosaic)
    planes = np.empty((3, *mosaic.shape), mosaic.dtype)
    for (y, x), colour in colours.items():
        site = np.s_[y::2, x::2]
        tap = _taps(split, mosaic.shape, y, x)
        planes[COLOURS.index(colour)][site] = mosaic[site]
        if colour == "G":
            beside, above = colours[y, 1 - x], colours[1 - y, x]
            _at_green(tap, planes[COLOURS.index(beside)][site], planes[COLOURS.index(above)][site])
        else:
            opposite = "B" if colour == "R" else "R"
            _at_chroma(tap, planes[COLOURS.index("G")][site], planes[COLOURS.index(opposite)][site])
    return planes


def _at_chroma(tap: Tap, green: NDArray, opposite: NDArray) -> None:
    """Interpolate green (alpha = 1/2) and the opposite colour (gamma = 3/4) at red and blue sites."""
    centre = tap(0, 0)
    number = centre.dtype.type
    far = (tap(0, -2) + tap(0, 2)) + (tap(-2, 0) + tap(2, 0))
    near = (tap(0, -1) + tap(0, 1)) + (tap(-1, 0) + tap(1, 0))
    corners = (tap(-1, -1) + tap(1, 1)) + (tap(-1, 1) + tap(1, -1))
    near *= number(0.25)
    near += number(0.5) * centre
    near -= number(0.125) * far
    green[...] = near
    corners *= number(0.25)
    corners += number(0.75) * centre
    far *= number(0.1875)
    corners -= far
    opposite[...] = corners


def _at_green(tap: Tap, beside: NDArray, above: NDArray) -> None:
    """Interpolate red and blue at green sites (beta = 5/8). One of these colours has samples to the left and right, the
    other above and below.
    """
    centre = tap(0, 0)
    number = centre.dtype.type
    corners = (tap(-1, -1) + tap(1, 1)) + (tap(-1, 1) + tap(1, -1))
    common = number(0.625) * centre
    corners *= number(0.125)
    common -= corners
    across, along = tap(0, -2) + tap(0, 2), tap(-2, 0) + tap(2, 0)
    for result, near, same, other in (
        (beside, tap(0, -1) + tap(0, 1), across, along),
        (above, tap(-1, 0) + tap(1, 0), along, across),
    ):
        near *= number(0.5)
        near += common
        near -= number(0.125) * same
        near += number(0.0625) * other
        result[...] = near


def _phase_planes(mosaic: NDArray) -> dict[tuple[int, int], NDArray]:
    """Return the four phases of the mosaic with its mirrored margin, each contiguous."""
    framed = np.pad(mosaic, MARGIN, mode="reflect")
    return {(y, x): np.ascontiguousarray(framed[y::2, x::2]) for y in (0, 1) for x in (0, 1)}


def _taps(split: dict[tuple[int, int], NDArray], shape: tuple[int, ...], y: int, x: int) -> Tap:
    """Return the samples at (down, right) from every site (y::2, x::2), as a view of one phase plane."""
    rows, columns = len(range(y, shape[0], 2)), len(range(x, shape[1], 2))

    def tap(down: int, right: int) -> NDArray:
        (top, row), (left, column) = divmod(MARGIN + y + down, 2), divmod(MARGIN + x + right, 2)
        return split[row, column][top : top + rows, left : left + columns]

    return tap
