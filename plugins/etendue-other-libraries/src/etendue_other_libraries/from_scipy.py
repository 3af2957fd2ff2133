"""SciPy's local Wiener filter, written with labelled arrays.

In:  ``rgb_camera`` as a ``DataArray`` with its coordinates.
Out: the same, denoised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import scipy.signal
import xarray

from etendue.api import Stage, labelled, measured, param


@labelled
@dataclass(frozen=True, kw_only=True)
class LocalWiener(Stage):
    """Denoise with SciPy's Wiener filter (Lee 1980): areas that vary by no more than the noise are replaced by their
    local mean."""

    role: ClassVar = "denoising"
    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    libraries: ClassVar = ("scipy",)
    negative: ClassVar = "keep"
    gain: ClassVar = None
    error: ClassVar = measured(1e-7, 1e-12)
    nanoseconds: ClassVar = 60.0

    size: int = param(5, at_least=3, at_most=63, doc="side of the window, pixels")
    noise: float = param(4e-4, above=0, at_most=1, doc="variance of the noise, 1 at clipping")

    def run(self, data: Any) -> dict[str, Any]:
        picture = data["rgb_camera"]
        found = xarray.apply_ufunc(
            lambda plane: scipy.signal.wiener(plane, self.size, self.noise),
            picture.astype(float),
            input_core_dims=[["y", "x"]],
            output_core_dims=[["y", "x"]],
            vectorize=True,
        )
        return {"rgb_camera": found.astype(picture.dtype)}
