"""The colour filter array of a camera: read from its ``pattern`` and aligned with a window of the sensor.

In:  the camera quantity ``pattern``: a name, letters, or the path of a CSV file; coordinates of a window.
Out: a ``cfa.Mask``; the first pixel of the window.
"""

from __future__ import annotations

from functools import lru_cache

from etendue.contract.stage import file_state
from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import cfa


def mask_of(pattern: str) -> cfa.Mask:
    """Return the mask of a camera's ``pattern``: a name, letters, or a CSV file with rows of letters."""
    return _mask(pattern, file_state(pattern) if pattern.endswith(".csv") else (0, 0))


@lru_cache(maxsize=64)
def _mask(pattern: str, state: tuple[int, int]) -> cfa.Mask:
    return cfa.read(pattern)


def bayer_order(pattern: str, what: str) -> str:
    """Return the name of a Bayer order; for any other array raise ValueError, naming the method ``what``."""
    mask = mask_of(pattern)
    if mask.bayer is None:
        raise ValueError(
            f"{what} supports Bayer arrays only ({', '.join(cfa.BAYER)}), not {pattern!r}; use demosaic_any"
        )
    return mask.bayer


def first_pixel(y: FloatArray, x: FloatArray) -> tuple[int, int]:
    """Return the row and column on the sensor of a window's first pixel, from the coordinates of the window."""
    return (round(float(y[0])) if len(y) else 0), (round(float(x[0])) if len(x) else 0)
