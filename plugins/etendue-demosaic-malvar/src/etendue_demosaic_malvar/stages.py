"""The stage ``demosaic_malvar``, a thin wrapper of the kernel.

In:  ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``rgb_camera`` (channel, y, x), linear camera RGB.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from etendue.api import RGB, Haloed, quantity
from etendue_camera.sensor import cfa
from etendue_demosaic_malvar.kernel import MARGIN, malvar


@dataclass(frozen=True, kw_only=True)
class DemosaicMalvar(Haloed):
    """Demosaic by bilinear interpolation, corrected by the Laplacian of the measured colour (Malvar, He and Cutler
    2004)."""

    role: ClassVar = "demosaicing"
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    gain: ClassVar = 2.5  # sum of the absolute coefficients: 2 for green, 20/8 for red and blue
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 10.0

    pattern: str = quantity("pattern")

    def __post_init__(self) -> None:
        self.order(0, 0)

    def order(self, row: int, column: int) -> str:
        """Return the Bayer order as seen by a window that starts at this pixel of the sensor."""
        name = None if self.pattern.endswith(".csv") else cfa.parse(self.pattern).bayer
        if name is None:
            raise ValueError(
                f"demosaic_malvar supports {', '.join(cfa.BAYER)} only, not {self.pattern!r}; use demosaic_any"
            )
        return cfa.shifted_bayer(name, row, column)

    def run(self, mosaic_linear: Any, y: Any, x: Any) -> dict[str, Any]:
        return {"rgb_camera": malvar(mosaic_linear, self.order(round(float(y[0])), round(float(x[0]))))}

    def halo(self) -> int:
        return MARGIN

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the arithmetic error. The interpolation error of the method is not included."""
        return (5e-7 if precision == "float32" else 1e-15), "measured"
