"""What JPEG keeps of a plane: cosine transforms of 8 x 8 pixels, rounded to the steps of a table.

In:  a plane of 8-bit numbers (y, x), a quantisation table, where the first block begins.
Out: the plane as a decoder gives it.
Source: ITU-T T.81 (baseline DCT; entropy coding loses nothing and is left out).
"""

import numpy as np
import scipy
from numpy.typing import NDArray

BLOCK = 8
TOP, MIDDLE = 255.0, 128.0


def coded(plane: NDArray, table: NDArray, first: tuple[int, int] = (0, 0)) -> NDArray:
    """A plane behind coding and decoding.

    Parameters
    ----------
    plane : (y, x) array, 0 to 255
        Rounded to whole numbers first.
    table : (8, 8) array
        Steps of the coefficients, frequency along y first.
    first : (int, int), 0 to 7
        Row and column of a block at which the plane begins.

    Returns
    -------
    (y, x) array of whole numbers, 0 to 255

    Notes
    -----
    Blocks that go on beyond the plane are filled with its outermost pixels. Decoders differ from each other by one
    number at most.
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
