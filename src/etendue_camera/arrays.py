"""What kernels take and give: arrays of floating-point numbers of any precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
Floats = Any  # a float or a FloatArray; what comes out has the shape of what goes in
