"""The loss of JPEG coding in one plane: cosine transforms of 8 x 8 pixels, rounded to the steps of a table.

In:  a plane of 8-bit numbers (y, x), a quantisation table, the position of the first block.
Out: the plane as a decoder returns it.
Source: ITU-T T.81 (baseline DCT; entropy coding is lossless and therefore omitted).
"""

import numpy as np
import scipy
from numpy.typing import NDArray

BLOCK = 8
TOP, MIDDLE = 255.0, 128.0


def coded(plane: NDArray, table: NDArray, first: tuple[int, int] = (0, 0)) -> NDArray:
    """Return a plane after coding and decoding.

    Parameters
    ----------
    plane : (y, x) array, 0 to 255
        Rounded to whole numbers before coding.
    table : (8, 8) array
        Quantisation steps of the coefficients, frequency along y first.
    first : (int, int), 0 to 7
        Row and column, within a block, of the plane's first pixel.

    Returns
    -------
    (y, x) array of whole numbers, 0 to 255

    Notes
    -----
    Blocks that extend beyond the plane are filled with its outermost pixels. Decoders differ from each other by at
    most one.
    """
    rows, columns = plane.shape
    top, left = first
    fill = [(start, -(start + size) % BLOCK) for start, size in ((top, rows), (left, columns))]
    values = np.pad(np.rint(np.clip(plane, 0.0, TOP)) - MIDDLE, fill, mode="edge")
    blocks = values.reshape(values.shape[0] // BLOCK, BLOCK, values.shape[1] // BLOCK, BLOCK).swapaxes(1, 2)
    kept = np.rint(_WAVES @ blocks @ _WAVES.T / table) * table
    seen = (_WAVES.T @ kept @ _WAVES).swapaxes(1, 2).reshape(values.shape) + MIDDLE
    return np.asarray(np.clip(np.rint(seen), 0.0, TOP)[top : top + rows, left : left + columns])


_WAVES = scipy.fft.dct(np.eye(BLOCK), axis=0, norm="ortho")
