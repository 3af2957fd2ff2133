"""Adapt the function Menon 2007 of colour-demosaicing to the conventions of a kernel: any frame size, the precision of
the input, no side effects of the import.

In:  Bayer mosaic (y, x), linear, in any unit; its pattern.
Out: planes (3, y, x) of red, green, blue in the same unit; measured samples unchanged.
Source: Menon, Andriani, Calvagno, "Demosaicing with directional filtering and a posteriori decision", IEEE Trans. Image
        Processing 16 (2007) 132, as implemented by the package colour-demosaicing.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue_camera.mosaic.bilinear import bilinear

SMALLEST = 6  # smallest side for the filters of the package; smaller frames are mirrored
MARGIN = 6  # even, so that the pattern is unchanged
REACH = 12  # rows that affect a pixel: 6 by the direction, 2 by red and blue, 3 by their refinement; made even

_importing = threading.Lock()
_loaded: list[Callable[..., Any]] = []


def implementation() -> Callable[..., Any]:
    """Return the function of the package colour-demosaicing. The package is imported at the first call, because it
    imports colour-science, which takes a second or more.

    The import warns about a deprecated SciPy namespace (and about optional packages of colour-science), and resets
    numpy's global print options to those of version 1.13; both are suppressed here.
    """
    with _importing:
        if not _loaded:
            with warnings.catch_warnings(), np.printoptions():
                warnings.simplefilter("ignore")
                from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007
            _loaded.append(demosaicing_CFA_Bayer_Menon2007)
    return _loaded[0]


def menon(mosaic: NDArray, pattern: str, refine: bool = True) -> NDArray:
    """Interpolate green along the direction of the smoother colour differences, then red and blue.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    pattern : str
        One of `etendue_camera.sensor.cfa.BAYER`.
    refine : bool
        Whether to apply the method's last step, which smooths the differences along the chosen direction.

    Returns
    -------
    (3, y, x) array, unit and dtype of mosaic (integers become float64)
        Values may exceed the range of the mosaic: nothing is clipped. If both sides are at least 6, this is the
        package's own result, computed in float64.

    Raises
    ------
    ValueError
        If mosaic is not a non-empty (y, x) array, or the pattern is not one of the four.

    Notes
    -----
    Smaller frames are mirrored about their outermost samples to a size that the method accepts, and the result is
    cropped. A frame of one row or one column has no second direction; it is interpolated linearly along its length.
    """
    mosaic = np.asarray(mosaic)
    if mosaic.ndim != 2 or mosaic.size == 0 or 1 in mosaic.shape:
        return bilinear(mosaic, pattern)
    bilinear(mosaic[:1, :1], pattern)  # rejects an unknown pattern before the import
    dtype = mosaic.dtype if np.issubdtype(mosaic.dtype, np.floating) else np.dtype(np.float64)
    margins = [MARGIN if size < SMALLEST else 0 for size in mosaic.shape]
    framed = np.pad(mosaic, [(margin, margin) for margin in margins], mode="reflect") if any(margins) else mosaic
    found = implementation()(framed.astype(np.float64), pattern, refining_step=refine)
    rows, columns = (slice(margin, margin + size) for margin, size in zip(margins, mosaic.shape, strict=True))
    return np.ascontiguousarray(np.moveaxis(found[rows, columns], -1, 0), dtype=dtype)
