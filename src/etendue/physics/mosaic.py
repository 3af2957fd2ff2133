"""The Bayer colour filter array: which pixel sees which colour.

In:  three colour planes, or a frame size, and the name of a pattern.
Out: one value per pixel, or the index of its colour (0 red, 1 green, 2 blue).
Sources: Bayer, US patent 3971065 (1976). A pattern is named by its 2 x 2 cell at pixel (0, 0), row by row.
"""

import numpy as np
from numpy.typing import NDArray

PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
COLOURS = "RGB"


def phase(pattern: str) -> dict[str, list[tuple[int, int]]]:
    """Where in the 2 x 2 cell each colour sits.

    Parameters
    ----------
    pattern : str
        One of `PATTERNS`.

    Returns
    -------
    dict
        "R", "G", "B" to a list of (row offset, column offset); green has two.

    Raises
    ------
    ValueError
        If the pattern is not one of the four.
    """
    if pattern not in PATTERNS:
        raise ValueError(f"pattern is {pattern!r}; allowed are {', '.join(PATTERNS)}")
    return {c: [divmod(i, 2) for i in range(4) if pattern[i] == c] for c in COLOURS}


def pick(planes: NDArray, pattern: str) -> NDArray:
    """What the sensor keeps of three full planes: one colour per pixel.

    Parameters
    ----------
    planes : (3, y, x) array, any unit
        Red, green, blue.
    pattern : str
        One of `PATTERNS`.

    Returns
    -------
    (y, x) array, unit and dtype of planes
        Copies of samples, bit for bit.

    Raises
    ------
    ValueError
        If planes is not (3, y, x), or the pattern is not one of the four.
    """
    planes = np.asarray(planes)
    if planes.ndim != 3 or planes.shape[0] != 3:
        raise ValueError(f"planes has shape {planes.shape}; allowed is (3, y, x): red, green, blue")
    mosaic = np.empty(planes.shape[1:], planes.dtype)
    for colour, places in phase(pattern).items():
        for row, column in places:
            sites = np.s_[row::2, column::2]
            mosaic[sites] = planes[COLOURS.index(colour)][sites]
    return mosaic


def colour_index(pattern: str, rows: int, columns: int) -> NDArray[np.uint8]:
    """The colour of every pixel of a frame: 0 red, 1 green, 2 blue.

    Parameters
    ----------
    pattern : str
        One of `PATTERNS`.
    rows, columns : int
        At or above 0.

    Returns
    -------
    (rows, columns) array of uint8

    Raises
    ------
    ValueError
        If the pattern is not one of the four.
    """
    index = np.empty((rows, columns), np.uint8)
    for colour, places in phase(pattern).items():
        for row, column in places:
            index[row::2, column::2] = COLOURS.index(colour)
    return index
