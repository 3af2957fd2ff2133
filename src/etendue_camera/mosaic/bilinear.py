"""Bilinear, nearest and colour-difference demosaicing of Bayer mosaics.

In:  Bayer mosaic (y, x), linear, in any unit; its pattern.
Out: planes (3, y, x) of red, green, blue in the same unit; measured samples are unchanged.
Sources: bilinear and nearest as in textbooks; colour differences as in section 2.7 of the paper (docs/paper.md).

Frames may have any size from 1 x 1; see `frame` for values beyond the border and for frames of one line. Each of the
four sites of the 2 x 2 cell is computed for a whole tile at once, on slices of step 2.
"""

import numpy as np
from numpy.typing import NDArray

from etendue_camera.mosaic.frame import (
    BLUE,
    GREEN,
    RED,
    checked,
    follow_green,
    in_tiles,
    line_bilinear,
    line_nearest,
    mirrored,
    one_line,
    own,
    quarter,
)
from etendue_camera.sensor.cfa import COLOURS, phase, shifted_bayer

REACH = 2  # pixels: of the mean of neighbours, and of the interpolation of red and blue from green


def nearest(mosaic: NDArray, pattern: str, row: int = 0, column: int = 0) -> NDArray:
    """Take the missing colours of every pixel from its own 2 x 2 cell.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    pattern : str
        One of `cfa.BAYER`, the pattern at the frame's first pixel.
    row, column : int
        Position of the frame's first pixel on the sensor.

    Returns
    -------
    (3, y, x) array, unit and dtype of mosaic
        Of the two greens in a cell, use the green sample in the row of the pixel. Cells start at even rows and columns
        of the sensor; incomplete cells at a border are completed by mirroring.

    Raises
    ------
    ValueError
        If mosaic is not (y, x) with at least one sample, or the pattern is not one of the four.

    Notes
    -----
    Chroma moves by up to one pixel. This is the fast preview, and the baseline for better methods.
    """
    checked(mosaic, pattern)
    mosaic = np.asarray(mosaic)
    if 1 in mosaic.shape:
        return one_line(mosaic, pattern, line_nearest)
    rows, columns = mosaic.shape
    framed = mirrored(mosaic, 1)
    up, left = row % 2, column % 2
    if up or left:
        return nearest(framed[1 - up : 1 + rows, 1 - left : 1 + columns], shifted_bayer(pattern, up, left))[
            :, up:, left:
        ]
    planes = np.empty((3, rows, columns), mosaic.dtype)
    for colour, places in phase(pattern).items():
        plane = planes[COLOURS.index(colour)]
        for y in (0, 1):
            row = next((r for r, _ in places if r == y), places[0][0])
            column = next(c for r, c in places if r == row)
            for x in (0, 1):
                plane[y::2, x::2] = framed[1 + row : 1 + row - y + rows : 2, 1 + column : 1 + column - x + columns : 2]
    return planes


def bilinear(mosaic: NDArray, pattern: str) -> NDArray:
    """Interpolate missing colours as the mean of their two or four nearest samples.

    Arguments, result and errors are the same as for every method (see `frame`).

    Notes
    -----
    Exact for constant planes everywhere, and for linear planes inside the border. If the scene is mirrored or
    transposed, the result is mirrored or transposed bit for bit. Rounding: 3 operations.

    Examples
    --------
    >>> import numpy as np
    >>> from etendue_camera.mosaic.bilinear import bilinear
    >>> bilinear(np.full((4, 6), 0.5), "RGGB").shape
    (3, 4, 6)
    """
    mosaic = checked(mosaic, pattern)
    if 1 in mosaic.shape:
        return one_line(mosaic, pattern, line_bilinear)
    half, fourth = mosaic.dtype.type(0.5), mosaic.dtype.type(0.25)
    places = phase(pattern)

    def method(planes: NDArray, framed: NDArray) -> None:
        shape = planes.shape[1:]
        for y, x in places["G"]:
            planes[GREEN, y::2, x::2] = _sites(framed, shape, y, x, 0, 0)
        for (y, x), own_plane, other_plane in (
            (*places["R"], planes[RED], planes[BLUE]),
            (*places["B"], planes[BLUE], planes[RED]),
        ):
            own_plane[y::2, x::2] = _sites(framed, shape, y, x, 0, 0)
            total = _pair(framed, shape, y, x, (0, 1))
            total += _pair(framed, shape, y, x, (1, 0))
            np.multiply(total, fourth, out=planes[GREEN, y::2, x::2])
            total = _pair(framed, shape, y, x, (1, 1))
            total += _pair(framed, shape, y, x, (1, -1))
            np.multiply(total, fourth, out=other_plane[y::2, x::2])
            np.multiply(_pair(framed, shape, y, 1 - x, (0, 1)), half, out=own_plane[y::2, 1 - x :: 2])
            np.multiply(_pair(framed, shape, 1 - y, x, (1, 0)), half, out=own_plane[1 - y :: 2, x::2])

    return in_tiles(mosaic, REACH, method)


def colour_difference(mosaic: NDArray, pattern: str) -> NDArray:
    """Interpolate green bilinearly, then red and blue by G - R and G - B, which vary less than R and B.

    Arguments, result and errors are the same as for every method (see `frame`). Results may leave the range of the
    mosaic; negative values are kept.

    Notes
    -----
    Source: the paper, section 2.7: KR = G - R and KB = G - B at red and blue sites, interpolated bilinearly,
    then R = G - KR and B = G - KB. CPSNR is 2.7 dB (Kodak) and 1.1 dB (McMaster) above bilinear
    (`benchmarks/demosaic.py`). The direction similarity of the method that the paper cites is in
    `directional`.
    """
    mosaic = checked(mosaic, pattern)
    if 1 in mosaic.shape:
        return one_line(mosaic, pattern, _line_colour_difference)
    fourth = mosaic.dtype.type(0.25)
    places = phase(pattern)

    def method(planes: NDArray, framed: NDArray) -> None:
        green, shape = planes[GREEN], planes.shape[1:]
        for y, x in places["G"]:
            green[y::2, x::2] = _sites(framed, shape, y, x, 0, 0)
        differences = {}
        for colour in "RB":
            [place] = places[colour]
            around = quarter(framed, 2, place, 0, 1) + quarter(framed, 2, place, 0, -1)
            around += quarter(framed, 2, place, 1, 0) + quarter(framed, 2, place, -1, 0)
            around *= fourth
            green[place[0] :: 2, place[1] :: 2] = own(around, place, shape)
            around -= quarter(framed, 2, place)
            differences[colour] = around
        follow_green(planes, framed, 2, pattern, differences)

    return in_tiles(mosaic, REACH, method)


def _pair(framed: NDArray, shape: tuple[int, ...], y: int, x: int, step: tuple[int, int]) -> NDArray:
    """Return the sum of the two neighbours at +step and -step of every site (y::2, x::2)."""
    down, right = step
    return _sites(framed, shape, y, x, down, right) + _sites(framed, shape, y, x, -down, -right)


def _sites(framed: NDArray, shape: tuple[int, ...], y: int, x: int, down: int, right: int) -> NDArray:
    """Return a view of the sites (y::2, x::2) of a tile, shifted by (down, right); `framed` has a border of two on each
    side.
    """
    rows, columns = shape
    return framed[2 + y + down : 2 + rows + down : 2, 2 + x + right : 2 + columns + right : 2]


def _line_colour_difference(line: NDArray, green: int) -> NDArray:
    pair = line_bilinear(line, green)
    differences = line_bilinear(pair[green] - line, green)[1 - green]
    kept = line[1 - green :: 2]
    pair[1 - green] = pair[green] - differences
    pair[1 - green, 1 - green :: 2] = kept
    return pair
