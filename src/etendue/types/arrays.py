"""What arrays are called in annotations.

Out: names of types.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # numbers, truth or texts, as its variable is declared
FloatArray = NDArray[np.floating]  # of any precision
