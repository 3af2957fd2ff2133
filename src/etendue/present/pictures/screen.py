"""The curve of a screen: linear values to those of a file that it shows."""

from __future__ import annotations

from typing import Any

import numpy as np


def encoded(linear: Any) -> Any:
    """(...) of values in 0 to 1: IEC 61966-2-1, in the dtype of what is given."""
    linear = np.asarray(linear)
    curve = np.maximum(linear, linear.dtype.type(0.0031308)) ** linear.dtype.type(1 / 2.4)
    return np.where(
        linear <= linear.dtype.type(0.0031308),
        linear * linear.dtype.type(12.92),
        linear.dtype.type(1.055) * curve - linear.dtype.type(0.055),
    )
