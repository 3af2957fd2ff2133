"""Common parts of demosaicing methods: borders, tiles, quarter planes, and frames of one line.

In:  Bayer mosaic (y, x), linear, in any unit; its pattern.
Out: planes (3, y, x), filled tile by tile by the given method.

Beyond the border the mosaic is mirrored about its outermost samples, without repeating them. Mirrored neighbours
therefore have the colours that the pattern expects. Tiles begin on even rows and columns, so each has the pattern of
the frame; the result for a pixel does not depend on the tile it lies in. Tiles are small enough for their temporaries
to stay in the cache; with larger tiles, memory bandwidth would limit numpy.

A *method* takes a mosaic (y, x) and a pattern, one of `cfa.BAYER`, and returns (3, y, x) in its unit and dtype
(integers become float64). It raises ValueError if the mosaic is not (y, x) with at least one sample, or the pattern is
not one of the four.

A *quarter plane* holds the values at one site of the 2 x 2 cell, contiguous, in a tile and one pixel around it.
"""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from etendue import require
from etendue_camera.sensor.cfa import COLOURS, phase

RED, GREEN, BLUE = range(3)
TILE_PIXELS, TILE_WIDTH = 2**16, 512


def checked(mosaic: NDArray, pattern: str) -> NDArray:
    """Return the mosaic in floating point (integers become float64) after checking its shape and the pattern.

    Raises
    ------
    ValueError
        If mosaic is not (y, x) with at least one sample, or the pattern is not one of the four.
    """
    mosaic = np.asarray(mosaic)
    require.shape(mosaic.ndim == 2 and mosaic.size != 0, "mosaic", mosaic, "(y, x), at least 1 x 1")
    phase(pattern)
    return require.floating(mosaic)


def mirrored(mosaic: NDArray, reach: int) -> NDArray:
    """Return the frame with `reach` more samples per side, mirrored about the outermost samples; for 2 x 2
    and larger.
    """
    rows, columns = mosaic.shape
    framed = np.empty((rows + 2 * reach, columns + 2 * reach), mosaic.dtype)
    framed[reach:-reach, reach:-reach] = mosaic
    before, after = _mirror_images(columns, reach)
    framed[reach:-reach, :reach], framed[reach:-reach, -reach:] = mosaic[:, before], mosaic[:, after]
    before, after = _mirror_images(rows, reach)
    framed[:reach], framed[-reach:] = framed[reach + before], framed[reach + after]
    return framed


def _mirror_images(size: int, reach: int) -> tuple[NDArray, NDArray]:
    """Return the indices of `reach` mirrored samples before the first and after the last sample of a line of `size`."""
    period = 2 * (size - 1)
    beyond = np.concatenate([np.arange(-reach, 0), np.arange(size, size + reach)]) % period
    beyond = np.minimum(beyond, period - beyond)
    return beyond[:reach], beyond[reach:]


def in_tiles(mosaic: NDArray, reach: int, method: Callable[[NDArray, NDArray], None]) -> NDArray:
    """Return the three planes of a frame, 2 x 2 or larger, filled by a method that reads `reach` samples around a tile.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    reach : int
        Even.
    method : callable
        Called with the (3, h, w) view to fill and the (h + 2 reach, w + 2 reach) mosaic around it.

    Returns
    -------
    (3, y, x) array, unit and dtype of mosaic
    """
    rows, columns = mosaic.shape
    framed = mirrored(mosaic, reach)
    planes = np.empty((3, rows, columns), mosaic.dtype)
    width = _even_share(columns, TILE_WIDTH)
    height = _even_share(rows, TILE_PIXELS // width)
    for top in range(0, rows, height):
        for left in range(0, columns, width):
            tile = planes[:, top : top + height, left : left + width]
            bottom, right = (start + size + 2 * reach for start, size in zip((top, left), tile.shape[1:], strict=True))
            method(tile, framed[top:bottom, left:right])
    return planes


def _even_share(size: int, most: int) -> int:
    """Return an even number, at most `most`, that divides the size into roughly equal parts."""
    parts = -(-size // most)
    return 2 * -(-size // (2 * parts))


def quarter(framed: NDArray, reach: int, place: tuple[int, int], down: int = 0, right: int = 0) -> NDArray:
    """Return a view of the samples at (down, right) from each site of the cell, for a tile and a pixel around it."""
    offset = reach - 1
    (first, last), (start, stop) = (
        (offset + (site + 1) % 2 + move, size - offset + move)
        for site, move, size in zip(place, (down, right), framed.shape, strict=True)
    )
    return framed[first:last:2, start:stop:2]


def follow_green(
    planes: NDArray, framed: NDArray, reach: int, pattern: str, differences: Mapping[str, NDArray]
) -> None:
    """Fill red and blue of a tile: green minus the bilinearly interpolated G - R and G - B.

    Parameters
    ----------
    planes : (3, h, w) array
        Green is already filled.
    framed : (h + 2 reach, w + 2 reach) array
        The mosaic; measured samples are copied bit for bit.
    pattern : str
    differences : mapping
        "R" and "B" to the quarter planes of G - R and G - B. Sums pair opposite neighbours, so that mirrored input
        gives exactly mirrored results.
    """
    green = planes[GREEN]
    rows, columns = green.shape
    inner = framed[reach:-reach, reach:-reach]
    half, fourth = framed.dtype.type(0.5), framed.dtype.type(0.25)
    for colour in "RB":
        plane, k = planes[COLOURS.index(colour)], differences[colour]
        [(row, column)] = phase(pattern)[colour]
        high, wide = len(range(row, rows, 2)), len(range(column, columns, 2))
        other_high, other_wide = rows - high, columns - wide
        own_rows, own_columns = slice(row, row + high), slice(column, column + wide)
        plane[row::2, column::2] = inner[row::2, column::2]
        beside = k[own_rows, :other_wide] + k[own_rows, 1 : 1 + other_wide]
        beside *= half
        np.subtract(green[row::2, 1 - column :: 2], beside, out=plane[row::2, 1 - column :: 2])
        above = k[:other_high, own_columns] + k[1 : 1 + other_high, own_columns]
        above *= half
        np.subtract(green[1 - row :: 2, column::2], above, out=plane[1 - row :: 2, column::2])
        corners = k[:other_high, :other_wide] + k[1 : 1 + other_high, 1 : 1 + other_wide]
        corners += k[1 : 1 + other_high, :other_wide] + k[:other_high, 1 : 1 + other_wide]
        corners *= fourth
        np.subtract(green[1 - row :: 2, 1 - column :: 2], corners, out=plane[1 - row :: 2, 1 - column :: 2])


def own(differences: NDArray, place: tuple[int, int], shape: tuple[int, ...]) -> NDArray:
    """Return the part of a quarter plane that belongs to the tile itself."""
    (row, column), (rows, columns) = place, shape
    return differences[row : row + len(range(row, rows, 2)), column : column + len(range(column, columns, 2))]


def one_line(mosaic: NDArray, pattern: str, method: Callable[[NDArray, int], NDArray]) -> NDArray:
    """Demosaic a frame of one row or one column, which contains two colours, or one if it is a single pixel.

    The frame is interpolated along its length only; a missing colour is the mean of the colours that it contains.
    `method` gets the line and the offset of its green samples, and returns the colour of the even samples and the
    colour of the odd samples, each at all positions.
    """
    places = {place: COLOURS.index(c) for c, sites in phase(pattern).items() for place in sites}
    along = [places[0, 0], places[(0, 1) if mosaic.shape[0] == 1 else (1, 0)]]
    line = mosaic.reshape(-1)
    present = along[: line.size]
    values = np.empty((3, line.size), mosaic.dtype)
    if line.size == 1:
        values[present[0]] = line
    else:
        for colour, plane in zip(along, method(line, along.index(GREEN)), strict=True):
            values[colour] = plane
    mean = values[present].mean(axis=0).astype(mosaic.dtype)
    for colour in {RED, GREEN, BLUE}.difference(present):
        values[colour] = mean
    return values.reshape(3, *mosaic.shape)


def _line_parts(line: NDArray) -> Iterator[tuple[int, NDArray, NDArray]]:
    """Yield, for even and odd samples, their offset and the samples before and after them, mirrored at the ends."""
    framed = np.concatenate([line[1:2], line, line[-2:-1]])
    for offset in (0, 1):
        yield offset, framed[offset : line.size : 2], framed[2 + offset :: 2]


def line_nearest(line: NDArray, green: int) -> NDArray:
    """Return both colours, the missing colour from the other sample of the pair; a method for `one_line`."""
    pair = np.stack([line, line])
    for offset, before, after in _line_parts(line):
        pair[1 - offset, offset::2] = after if offset == 0 else before
    return pair


def line_bilinear(line: NDArray, green: int) -> NDArray:
    """Return both colours, the missing colour as the mean of the samples before and after; a method for `one_line`."""
    pair = np.stack([line, line])
    for offset, before, after in _line_parts(line):
        pair[1 - offset, offset::2] = (before + after) * line.dtype.type(0.5)
    return pair


def line_following(line: NDArray, green: int, differences: NDArray) -> NDArray:
    """Return both colours; ``differences`` are green minus the other colour, used at the samples that are not green."""
    pair = np.stack([line, line])
    pair[green, 1 - green :: 2] += differences[1 - green :: 2]
    pair[1 - green] = pair[green] - line_bilinear(differences, green)[1 - green]
    pair[1 - green, 1 - green :: 2] = line[1 - green :: 2]
    return pair
