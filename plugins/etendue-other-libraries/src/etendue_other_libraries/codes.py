"""Conversion of floats to integers and back, for libraries that only accept integers.

In:  floats about 0 and above, 1 at clipping.
Out: codes of 8 or 16 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

BELOW = 1 / 16  # of the largest value: noise about black is not clipped


@dataclass(frozen=True)
class Codes:
    """Linear codes: ``largest`` is the highest code and -``largest``/16 is code 0; values outside this range are
    clipped.
    """

    largest: float
    bits: int

    @property
    def step(self) -> float:
        return self.largest * (1 + BELOW) / (2**self.bits - 1)

    def of(self, values: Any) -> Any:
        """Return rounded codes. Within the range the error is at most half a step, and step / sqrt(12) rms."""
        codes = np.rint((np.asarray(values, np.float64) + BELOW * self.largest) / self.step)
        return np.clip(codes, 0, 2**self.bits - 1).astype(np.uint16 if self.bits > 8 else np.uint8)

    def back(self, codes: Any, dtype: Any) -> Any:
        return (codes * self.step - BELOW * self.largest).astype(dtype)
