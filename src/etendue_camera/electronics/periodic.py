"""Periodic offset patterns of a read-out: interference that is locked to the pixel clock.

In:  rows and columns (absolute), amplitudes (electrons), frequencies (cycles/pixel), phases (cycles).
Out: an offset for every pixel, electrons.
Sources: EMVA 1288 release 4 (linear), spectrograms of DSNU.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def offsets(
    rows: ArrayLike,
    columns: ArrayLike,
    amplitudes: Sequence[float],
    along_y: Sequence[float],
    along_x: Sequence[float],
    phases: Sequence[float],
) -> NDArray:
    """Return a sum of waves at the pixels of a window.

    Parameters
    ----------
    rows, columns : (y,), (x,) array
        Absolute coordinates, in pixels.
    amplitudes : (wave,) floats, electrons
        Half of the peak-to-peak value of each wave.
    along_y, along_x : (wave,) floats, cycles/pixel
    phases : (wave,) floats, cycles
        At row 0 and column 0.

    Returns
    -------
    (y, x) array of float64, electrons
        sum_k a_k cos(2 pi (fy_k row + fx_k column + p_k)).

    Raises
    ------
    ValueError
        If the numbers of values differ.

    Notes
    -----
    Phases are reduced to a cycle before the cosine. Error: 1e-12 of the amplitude at coordinates up to 10,000.
    """
    if len({len(amplitudes), len(along_y), len(along_x), len(phases)}) > 1:
        raise ValueError(
            f"{len(amplitudes)} amplitudes, {len(along_y)} and {len(along_x)} frequencies and {len(phases)} phases; "
            f"every wave needs one of each"
        )
    y, x = np.asarray(rows, float)[:, None], np.asarray(columns, float)[None, :]
    found = np.zeros((y.size, x.size))
    for amplitude, fy, fx, phase in zip(amplitudes, along_y, along_x, phases, strict=True):
        found += amplitude * np.cos(2 * np.pi * np.mod(np.mod(fy * y, 1.0) + np.mod(fx * x, 1.0) + phase, 1.0))
    return found
