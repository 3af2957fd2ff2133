"""What stages are tried with beside arrays: coordinates of dims, figures of a data sheet, transfer functions.

In:  dims, and what distributions say of them.
Out: the example of each, where nobody says one a plain one of its own.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from etendue.contract import dims
from etendue.contract.capabilities import Sheet, Summed, Transfer
from etendue.contract.grid import Coordinate, Labels, Line
from etendue.plugins import discovery
from etendue.types.arrays import Array

EDGES = (500.0, 520.0, 540.0, 560.0, 580.0, 600.0)  # of bins, where their dim has no example
GUESSED = Labels((0.0, 1.0, 2.0))  # of a dim of which nothing is known


class Blur(Transfer):
    """What probes look at: a Gaussian transfer function."""

    def transfer(self, fy: Array, fx: Array, band: Array) -> Array:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.ones_like(band)


class BlurAndSum(Summed):
    """The same, ending in a sum over bands."""

    def transfer(self, fy: Array, fx: Array, band: Array, prepared: Array) -> Array:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.ones_like(band)

    def prepare(self, coordinates: Mapping[str, Array]) -> Array:
        return np.stack([np.linspace(low, 1.0, coordinates[dims.banded(coordinates)].size) for low in (0.1, 0.5, 0.9)])

    def weights(self, prepared: Array) -> Array:
        return prepared


def exemplary(dim: str) -> Coordinate | None:
    """The coordinate with which stages are tried, as a distribution says of a dim; None where nobody does."""
    declared = dims.dim(dim)
    entries = declared.example
    if not entries:
        return None
    if isinstance(entries[0], str):
        return Labels(entries)
    return Line(len(entries), float(entries[0]), float(entries[1] - entries[0]), declared.units or "1")


def edges_of(dim: str) -> tuple[float, ...]:
    """Edges of bins along a dim, with which stages are tried."""
    return dims.dim(dim).example or EDGES


def edges() -> tuple[float, ...]:
    """The same of the dim that has bins."""
    return next((edges_of(dim) for dim in dims.declared_dims() if dims.dim(dim).bins), EDGES)


def sheet() -> Sheet:
    """Figures of a stage, as those are given that look at data sheets."""
    brought = discovery.installed().first("examples", "datasheet")
    return Sheet(str(brought.value["role"]), dict(brought.value["figures"])) if brought else Sheet("", {})
