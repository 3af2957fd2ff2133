"""Photographs on another grid: exact area averages.

In:  numbers of samples before and after.
Out: the matrix that resamples one axis.
"""

import numpy as np
import numpy.typing as npt


def area_weights(n_in: int, n_out: int) -> npt.NDArray[np.float64]:
    """Matrix that resamples one axis of a photograph by exact area averaging, in linear light.

    Parameters
    ----------
    n_in, n_out : int, above 0
        Samples before and after, on the same length.

    Returns
    -------
    (n_out, n_in) array
        ``rows @ image @ columns.T`` resamples both axes. Rows add up to 1 and columns to n_out / n_in, so
        flat areas stay flat and the mean is kept; larger n_out repeats samples, smaller averages them.

    Raises
    ------
    ValueError
        A count that is not a whole number above 0.

    Notes
    -----
    Overlaps are counted in whole parts of the length, n_in n_out of them: a weight is one rounded quotient.
    """
    for name, value in (("n_in", n_in), ("n_out", n_out)):
        if value != int(value) or value < 1:
            raise ValueError(f"{name} must be a whole number above 0, got {value}")
    n_in, n_out = int(n_in), int(n_out)
    out_start, in_start = n_in * np.arange(n_out)[:, None], n_out * np.arange(n_in)
    overlap = np.minimum(out_start + n_in, in_start + n_out) - np.maximum(out_start, in_start)
    return np.maximum(overlap, 0) / n_in
