"""Examples with which stages are tested besides arrays: coordinates of dims, numbers of a datasheet, transfer
functions.

In:  dims, and their declarations by distributions.
Out: the declared example of each, or a plain default.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from etendue.contract.arrays import dims
from etendue.contract.arrays.grid import Coordinate, Labels, Line
from etendue.contract.capabilities import Sheet, Summed, Transfer
from etendue.plugins import discovery
from etendue.types.arrays import Array

EDGES = (500.0, 520.0, 540.0, 560.0, 580.0, 600.0)  # edges of bins, if their dim has no example
GUESSED = Labels((0.0, 1.0, 2.0))  # entries of an undeclared dim


class GaussianTransfer(Transfer):
    """A Gaussian transfer function, for testing stages that look at transfer functions."""

    def transfer(self, fy: Array, fx: Array, band: Array) -> Array:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.ones_like(band)


class BlurAndSum(Summed):
    """A Gaussian transfer function that ends in a sum over bands."""

    def transfer(self, fy: Array, fx: Array, band: Array, prepared: Array) -> Array:
        return np.exp(-4.0 * (fy**2 + fx**2)) * np.ones_like(band)

    def prepare(self, coordinates: Mapping[str, Array]) -> Array:
        return np.stack([np.linspace(low, 1.0, coordinates[dims.banded(coordinates)].size) for low in (0.1, 0.5, 0.9)])

    def weights(self, prepared: Array) -> Array:
        return prepared


def exemplary(dim: str) -> Coordinate | None:
    """Return the coordinate that a distribution gives as the example of a dim; None if there is none."""
    declared = dims.dim(dim)
    entries = declared.example
    if not entries:
        return None
    if isinstance(entries[0], str):
        return Labels(entries)
    return Line(len(entries), float(entries[0]), float(entries[1] - entries[0]), declared.units or "1")


def edges_of(dim: str) -> tuple[float, ...]:
    """Return the edges of bins along a dim with which stages are tested."""
    return dims.dim(dim).example or EDGES


def edges() -> tuple[float, ...]:
    """Return the example edges of the first declared dim that has bins."""
    return next((edges_of(dim) for dim in dims.declared_dims() if dims.dim(dim).bins), EDGES)


def sheet() -> Sheet:
    """Return the example datasheet for a port that reads the datasheets of other stages."""
    brought = discovery.installed().first("examples", "datasheet")
    return Sheet(str(brought.value["role"]), dict(brought.value["figures"])) if brought else Sheet("", {})
