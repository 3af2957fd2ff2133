"""Array types of kernels: floating-point arrays of any precision."""

from __future__ import annotations

from typing import Any

from etendue.types.arrays import Array, FloatArray

__all__ = ["Array", "FloatArray", "Floats"]

Floats = Any  # a float or a FloatArray; the output has the shape of the input
