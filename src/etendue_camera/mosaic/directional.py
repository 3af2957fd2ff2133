"""Directional demosaicing: colour differences along rows and columns, weighted by their smoothness along each.

In:  Bayer mosaic (y, x), linear, in any unit; its pattern.
Out: planes (3, y, x) of red, green, blue in the same unit; measured samples are unchanged.
Sources: section 2.7 of the paper (docs/paper.md) describes interpolation of colour differences, and cites a method
whose title adds "direction similarity". This module reconstructs the idea from those words; it is not the published
method. The directional estimate follows Hamilton and Adams (US patent 5629734, 1997).

For the row through a pixel (columns are treated alike; signs are those at a red or blue site):

1. p(x) = m(x-1) + m(x+1), and 4 K(x) = 2 p(x) - p(x-1) - p(x+1), which is green minus the other colour of that row, and
   has the opposite sign at green sites. The taps on the mosaic are [-1, 2, -2, 2, -1] / 4.
2. The noise of the estimate alternates in sign from sample to sample: K is smoothed by [1, 2, 1] / 4 along the row.
3. Dissimilarity: |K(x+1) - K(x-1)|, summed with the weights [1, 2, 2, 2, 1] along both axes.
4. At red and blue sites K = (K_row / d_row^2 + K_column / d_column^2) / (1 / d_row^2 + 1 / d_column^2) and green =
   m + K; red and blue are computed from green as in `bilinear.colour_difference`.

Steps 1 to 4 run on one flat array per tile, with its rows joined. A shift by a row or a column is then an offset, and
every operation is one contiguous pass inside the cache. Values that wrap around from row to row stay in the margin.
"""

import numpy as np
from numpy.typing import NDArray

from etendue_camera.mosaic.frame import GREEN, checked, follow_green, in_tiles, line_following, one_line, own, quarter
from etendue_camera.sensor.cfa import phase

REACH = 6  # along the line 3 for the estimate or 5 for the similarity, plus 1 for red and blue
FLOOR = 1e-3  # of full scale, 1


def directional(mosaic: NDArray, pattern: str, floor: float = FLOOR) -> NDArray:
    """Interpolate G - R and G - B along rows and along columns, and average both estimates, weighted by the smoothness
    of the colour difference along each.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    pattern : str
        One of `cfa.BAYER`.
    floor : float, unit of mosaic
        Above 0. If mean dissimilarities are well below it, rows and columns have equal weights.

    Returns
    -------
    (3, y, x) array, unit and dtype of mosaic (integers become float64)
        May leave the range of the mosaic; negative values are kept.

    Raises
    ------
    ValueError
        If mosaic is not (y, x) with at least one sample, the pattern is not one of the four, or floor is not above 0.

    Notes
    -----
    Frames of one line are interpolated along it. Mean CPSNR with the protocol of `benchmarks/demosaic.py`: 39.9 dB on
    Kodak and 34.6 dB on McMaster pictures. Exact for constant planes, for grey ramps inside the border, and where
    G - R and G - B are constant along one axis and vary only along the other. Mirroring the mosaic mirrors the
    result bit for bit; transposing it transposes the result up to rounding.
    """
    mosaic = checked(mosaic, pattern)
    if not 0 < floor < np.inf:
        raise ValueError(f"floor is {floor}; allowed: numbers above 0, in the unit of the mosaic")
    if 1 in mosaic.shape:
        return one_line(mosaic, pattern, _line_directional)
    work = np.zeros((7, 0), mosaic.dtype)
    lowest = mosaic.dtype.type(256 * floor)  # the window's weights sum to 64, and the estimates are 4 K
    sixteenth = mosaic.dtype.type(1 / 16)

    def method(planes: NDArray, framed: NDArray) -> None:
        nonlocal work
        if work.shape[1] < framed.size:
            work = np.zeros((7, framed.size), mosaic.dtype)
        mixed = _differences(framed, work[:, : framed.size], lowest)
        green, inner = planes[GREEN], framed[REACH:-REACH, REACH:-REACH]
        for y, x in phase(pattern)["G"]:
            green[y::2, x::2] = inner[y::2, x::2]
        differences = {}
        for colour in "RB":
            [(y, x)] = phase(pattern)[colour]
            differences[colour] = quarter(mixed, REACH, (y, x)) * sixteenth
            np.add(inner[y::2, x::2], own(differences[colour], (y, x), green.shape), out=green[y::2, x::2])
        follow_green(planes, framed, REACH, pattern, differences)

    with np.errstate(over="ignore", invalid="ignore"):  # in the margins, and for infinite ratios of dissimilarities
        return in_tiles(mosaic, REACH, method)


def _differences(framed: NDArray, work: NDArray, lowest: np.floating) -> NDArray:
    """Return 16 K (colour difference) of a tile, valid at red and blue sites at least 5 samples inside its border."""
    mosaic, a, b, c, ratio, along_rows, along_columns = work
    stride = framed.shape[1]
    mosaic.reshape(framed.shape)[...] = framed
    for step, across, estimate, total in ((1, stride, along_rows, ratio), (stride, 1, along_columns, a)):
        _moved(np.add, mosaic, -step, mosaic, step, a)
        _moved(np.subtract, a, 0, a, -step, b)
        _moved(np.subtract, b, 0, b, step, c)  # 4 K, of alternating sign
        _moved(np.subtract, c, 0, c, -step, b)
        _moved(np.subtract, b, 0, b, step, estimate)  # 16 K, smoothed: the sign alternates, so a mean is a difference
        _moved(np.subtract, c, step, c, -step, a)
        np.abs(a, out=a)
        for way, result in ((step, a), (across, total)):
            _moved(np.add, a, 0, a, way, b)
            _moved(np.add, b, -way, b, way, c)
            _moved(np.add, c, 0, c, -way, result)
        total += lowest
    ratio /= a
    ratio *= ratio
    ratio += 1
    along_rows -= along_columns
    along_rows /= ratio
    along_rows += along_columns
    return along_rows.reshape(framed.shape)


def _moved(operation: np.ufunc, first: NDArray, by: int, second: NDArray, by_second: int, out: NDArray) -> None:
    """Compute out[i] = operation(first[i + by], second[i + by_second]) wherever both exist."""
    start, stop = max(0, -by, -by_second), out.size - max(0, by, by_second)
    operation(first[start + by : stop + by], second[start + by_second : stop + by_second], out=out[start:stop])


def _line_directional(line: NDArray, green: int) -> NDArray:
    """Return both colours, interpolated along the line; a method for `one_line`."""
    framed = np.pad(line, 3, mode="reflect")
    p = framed[:-2] + framed[2:]
    k = (p[1:-1] - p[:-2]) - (p[2:] - p[1:-1])
    smooth = (k[1:-1] - k[:-2]) - (k[2:] - k[1:-1])
    return line_following(line, green, smooth * line.dtype.type(1 / 16))
