"""Array types of kernels: floating-point arrays of any precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
Floats = Any  # a float or a FloatArray; the output has the shape of the input
