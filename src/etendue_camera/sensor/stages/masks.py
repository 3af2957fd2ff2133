"""The mask of a camera: read from its ``pattern``, and placed under a window of the sensor.

In:  the camera quantity ``pattern``: a name, letters, or the path of a CSV file; coordinates of a window.
Out: a ``cfa.Mask``; the first pixel of the window.
"""

from __future__ import annotations

from functools import lru_cache

from etendue.contract.stage import file_state
from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import cfa


def mask_of(pattern: str) -> cfa.Mask:
    """The mask of a camera's ``pattern``: a name, letters, or a CSV file with rows of letters."""
    return _mask(pattern, file_state(pattern) if pattern.endswith(".csv") else (0, 0))


@lru_cache(maxsize=64)
def _mask(pattern: str, state: tuple[int, int]) -> cfa.Mask:
    return cfa.read(pattern)


def bayer_order(pattern: str, what: str) -> str:
    """The name of a Bayer order; ValueError for another array, naming what cannot work on it."""
    mask = mask_of(pattern)
    if mask.bayer is None:
        raise ValueError(
            f"{what} knows Bayer arrays only ({', '.join(cfa.BAYER)}), and the pattern is {pattern!r}; use demosaic_any"
        )
    return mask.bayer


def first_pixel(y: FloatArray, x: FloatArray) -> tuple[int, int]:
    """Row and column on the sensor at which a window starts, from its coordinates."""
    return (round(float(y[0])) if len(y) else 0), (round(float(x[0])) if len(x) else 0)
