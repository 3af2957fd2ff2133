"""Random texture scenes: they show whether fine detail survives in areas without edges.

In:  a chart's geometry (um on the image plane), an illuminant, the luminance of a white diffuser.
Out: ``radiance`` (wavelength, y, x) and ``white_radiance`` (wavelength), W m-2 sr-1 nm-1, bin means.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from etendue.api import Facts, Grid, param
from etendue_camera.arrays import Array, FloatArray
from etendue_camera.scene import charts, dead_leaves
from etendue_camera.scene.stages.scene import Scene

# largest error relative to the range of levels, at 1-fold oversampling; it falls with the square of oversampling
SOFT_ERROR, HARD_ERROR = (0.06, 0.25)
FEW_SAMPLES = 4.0  # samples in the radius of the smallest leaf: smaller leaves have larger errors


@dataclass(frozen=True, kw_only=True)
class DeadLeaves(Scene):
    """Draw dead leaves: overlapping discs of all sizes and greys, which depend on the chart's seed only, not on the
    camera's noise.
    """

    nanoseconds: ClassVar = 40.0

    seed: int = param(1, at_least=0, doc="seed of the chart, independent of the noise")
    smallest: float = param(5.0, units="um", above=0, doc="radius of the smallest leaves")
    largest: float = param(100.0, units="um", above=0, doc="radius of the largest leaves")
    exponent: float = param(3.0, at_least=-10, at_most=10, doc="radii have density r^-exponent; 3 is scale-invariant")
    low: float = param(0.1, at_least=0, at_most=1)
    high: float = param(0.9, at_least=0, at_most=1)
    softness: float = param(
        1.0,
        at_least=0,
        held=(0, 100),
        fidelity=True,
        reference="the ideal chart",
        studied=True,
        settings=(4.0, 2.0, 1.0, 0.5, 0.25, 0.0),
        doc="rms width in samples of the Gaussian that band-limits the rendered chart; 0: "
        "ideal chart, for light = 'cells'",
    )
    oversampling: int = param(
        4,
        at_least=1,
        at_most=32,
        fidelity=True,
        reference="32",
        settings=(1, 2, 4, 8, 16, 32),
        costs=(0.4, 0.5, 1.0, 3.0, 15.0, 60.0),
        doc="oversampling of the cells on which leaves are drawn",
    )

    def chart(self) -> dead_leaves.Leaves:
        return dead_leaves.leaves(
            dead_leaves.LeafChart(
                self.width, self.height, self.smallest, self.largest, self.low, self.high, self.seed, self.exponent
            )
        )

    def known(self) -> Facts:
        charts.require_levels(self.low, self.high)
        self.chart()
        return Facts(uniform=False, contrast=self.high / self.low if self.low > 0 else float("inf"))

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        said = super().warn(facts, grids)
        if self.smallest < self.spacing:
            said.append(
                f"leaves down to {self.smallest:g} um are drawn with a sample spacing of {self.spacing:g} um, which "
                "does not resolve them"
            )
        return said

    def error(self, facts: Facts, grid: Mapping[str, Grid], precision: str) -> tuple[float, str]:
        """Return a bound on the error of a sample relative to 32-fold oversampling, plus the error of the tables."""
        worst = SOFT_ERROR if self.softness >= 1 else HARD_ERROR
        crowded = max(1.0, FEW_SAMPLES * self.spacing / self.smallest)
        painted = min(1.0, worst * crowded / self.oversampling**2) * (self.high - self.low)
        return super().error(facts, grid, precision)[0] + painted, "measured"

    def run(self, out_y: FloatArray, out_x: FloatArray, prepared: FloatArray) -> dict[str, Array]:
        y, x = self.centred(out_y, out_x)
        return self.grey(
            dead_leaves.dead_leaves(y, x, self.chart(), self.softness_um(self.softness), self.cell, self.oversampling),
            prepared,
        )
