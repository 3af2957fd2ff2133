"""Names of array types for annotations.

Out: names of types.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # numbers, booleans or texts, as the variable declares
FloatArray = NDArray[np.floating]  # of any precision
CellArrays = dict[str, Any]  # by variable: an array, its bands, or what an observer has made of it
