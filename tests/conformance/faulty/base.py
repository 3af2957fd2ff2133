"""What the faulty stages are made of: sound declarations of charge, of colours and of light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from etendue.api import Stage, Transfer, proved


@dataclass(frozen=True, kw_only=True)
class OfCharge(Stage):
    """Reads and writes charge; states an error of a few roundings."""

    reads: ClassVar = {"charge": "y x [electron]"}
    writes: ClassVar = {"charge": "y x [electron]"}
    negative: ClassVar = "keep"
    error: ClassVar = proved(8e-6, 1e-12)


@dataclass(frozen=True, kw_only=True)
class OfColours(Stage):
    reads: ClassVar = {"rgb_camera": "channel y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    negative: ClassVar = "keep"
    error: ClassVar = proved(8e-6, 1e-12)


@dataclass(frozen=True, kw_only=True)
class OfLight(Transfer):
    reads: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    writes: ClassVar = {"irradiance": "wavelength y x [W m-2 nm-1]"}
    negative: ClassVar = "keep"
    gain: ClassVar = 1.0


def box(values: Any, mode: str = "symmetric") -> Any:
    """Mean over 3 x 3 neighbours."""
    import numpy as np

    wide = np.pad(values, [(0, 0)] * (values.ndim - 2) + [(1, 1), (1, 1)], mode=mode)
    rows, columns = values.shape[-2:]
    return sum(wide[..., i : i + rows, j : j + columns] for i in range(3) for j in range(3)) / values.dtype.type(9)
