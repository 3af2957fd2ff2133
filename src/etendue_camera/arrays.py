"""What kernels take and give: arrays of floating-point numbers of any precision."""

from __future__ import annotations

from typing import Any

from etendue.types.arrays import Array, FloatArray

__all__ = ["Array", "FloatArray", "Floats"]

Floats = Any  # a float or a FloatArray; what comes out has the shape of what goes in
