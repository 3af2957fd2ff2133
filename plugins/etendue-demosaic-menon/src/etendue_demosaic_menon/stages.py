"""The stage ``demosaic_menon``, a thin wrapper of the adapter.

In:  ``mosaic_linear`` (y, x), 1 at clipping.
Out: ``rgb_camera`` (channel, y, x), linear camera RGB.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from etendue.api import RGB, Haloed, param, quantity
from etendue_camera.sensor import cfa
from etendue_demosaic_menon.adapter import REACH, implementation, menon


@dataclass(frozen=True, kw_only=True)
class DemosaicMenon(Haloed):
    """Demosaic by directional filtering with a posteriori decision (Menon, Andriani and Calvagno 2007), computed by
    colour-demosaicing.
    """

    role: ClassVar = "demosaicing"
    decides: ClassVar = True  # between two directions
    handed: ClassVar = True  # if both directions are equally good, the library always chooses the same one
    reads: ClassVar = {"mosaic_linear": "y x [1]"}
    writes: ClassVar = {"rgb_camera": "channel y x [1]"}
    creates: ClassVar = {"channel": RGB}
    libraries: ClassVar = ("colour-demosaicing", "scipy")
    gain: ClassVar = None  # a small difference may change its choice between row and column
    negative: ClassVar = "keep"
    nanoseconds: ClassVar = 300.0
    working: ClassVar = 15.0

    pattern: str = quantity("pattern")
    refine: bool = param(
        True, doc="whether to smooth colour differences along the chosen direction, the method's last step"
    )

    def __post_init__(self) -> None:
        self.order(0, 0)

    def order(self, row: int, column: int) -> str:
        """Return the Bayer order as seen by a window that starts at this pixel of the sensor."""
        name = None if self.pattern.endswith(".csv") else cfa.parse(self.pattern).bayer
        if name is None:
            raise ValueError(
                f"demosaic_menon supports {', '.join(cfa.BAYER)} only, not {self.pattern!r}; use demosaic_any"
            )
        return cfa.shifted_bayer(name, row, column)

    def prepare(self, coordinates: Any) -> None:
        """Import the package before cells run, so that the import does not count towards the time of a cell."""
        implementation()

    def run(self, mosaic_linear: Any, y: Any, x: Any, prepared: Any) -> dict[str, Any]:
        return {"rgb_camera": menon(mosaic_linear, self.order(round(float(y[0])), round(float(x[0]))), self.refine)}

    def halo(self) -> int:
        return REACH

    def error(self, facts: Any, grid: Any, precision: str) -> tuple[float, str]:
        """Bound the arithmetic error in double precision and the rounding of the result to the output precision.
        Interpolation error is not included.
        """
        return (3e-7 if precision == "float32" else 2e-15), "measured"
