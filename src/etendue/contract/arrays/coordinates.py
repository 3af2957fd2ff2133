"""Coordinates as arrays, which stages can get in addition to their inputs.

In:  grids by name.
Out: read-only arrays: ``y`` ``x`` as on the grid, ``y_um`` ``x_um`` on the image plane, centres of bands with their
     edges.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from etendue.contract.arrays.grid import Bands, Grid, Line
from etendue.types.arrays import Array


def coordinates_of(grids: Mapping[str, Grid], prefix: str = "") -> dict[str, Array]:
    """Return the coordinate arrays of some grids by name, with a prefix."""
    found: dict[str, Array] = {}
    for grid in grids.values():
        for dim, coordinate in grid.entries:
            if f"{prefix}{dim}" in found:
                continue
            if isinstance(coordinate, Bands):
                found[f"{prefix}{dim}_edges"] = np.array(coordinate.edges)
                found[f"{prefix}{dim}"] = np.array(coordinate.values())
            elif isinstance(coordinate, Line):
                start, step = coordinate.um()
                found[f"{prefix}{dim}"] = coordinate.start + coordinate.step * np.arange(coordinate.size)
                found[f"{prefix}{dim}_um"] = start + step * np.arange(coordinate.size)
            else:
                found[f"{prefix}{dim}"] = np.array(coordinate.values())
    for array in found.values():
        array.flags.writeable = False
    return found
