"""Grids: the coordinates of an array before it exists. No arrays here.

A ``Grid`` maps dims to one of three kinds of coordinate: ``Line`` (evenly spaced), ``Bands`` (bins with edges)
and ``Labels`` (names or numbers). They are frozen, so equal grids can be recognised and hashed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """``size`` points at ``start + step * i``.

    On the image plane the points are positions in um. After sampling they are pixel indices, and ``position`` is
    (start, step) of the pixel centres on the image plane, um. ``cells``: each value is the mean over a cell of length
    ``step`` around its point, not a sample of band-limited light.
    """

    size: int
    start: float = 0.0
    step: float = 1.0
    units: str = "um"
    position: tuple[float, float] | None = None
    cells: bool = False

    def values(self) -> list[float]:
        return [self.start + self.step * i for i in range(self.size)]

    def um(self) -> tuple[float, float]:
        """Return start and step of the positions on the image plane, um."""
        return self.position if self.position is not None else (self.start, self.step)


@dataclass(frozen=True)
class Bands:
    """Bins by their edges, in the unit of their dim."""

    edges: tuple[float, ...]

    @property
    def size(self) -> int:
        return len(self.edges) - 1

    def values(self) -> list[float]:
        return [0.5 * (a + b) for a, b in zip(self.edges[:-1], self.edges[1:], strict=True)]


@dataclass(frozen=True)
class Labels:
    """Named or numbered entries, such as the channels R, G, B."""

    entries: tuple[str | float, ...]
    units: str = ""

    @property
    def size(self) -> int:
        return len(self.entries)

    def values(self) -> list[str | float]:
        return list(self.entries)


Coordinate = Line | Bands | Labels


@dataclass(frozen=True)
class Grid:
    """Coordinates by dim name, in no particular order; dims and their order come from the declaration."""

    entries: tuple[tuple[str, Coordinate], ...] = ()

    def __hash__(self) -> int:
        """Cached, because grids are keys of every table, and one grid serves thousands of cells."""
        known = self.__dict__.get("_hash")
        if known is None:
            known = hash(self.entries)
            object.__setattr__(self, "_hash", known)
        return known

    @property
    def count(self) -> int:
        """The number of values of an array with all dims of this grid; cached."""
        known = self.__dict__.get("_count")
        if known is None:
            known = math.prod(coordinate.size for _, coordinate in self.entries)
            object.__setattr__(self, "_count", known)
        return int(known)

    @classmethod
    def of(cls, coordinates: Mapping[str, Coordinate]) -> Grid:
        return cls(tuple(sorted(coordinates.items())))

    def __getitem__(self, dim: str) -> Coordinate:
        for name, coordinate in self.entries:
            if name == dim:
                return coordinate
        raise KeyError(dim)

    def __contains__(self, dim: object) -> bool:
        return any(name == dim for name, _ in self.entries)

    def line(self, dim: str) -> Line:
        """Return the coordinate of a dim; raise ``TypeError`` if it is not evenly spaced."""
        coordinate = self[dim]
        if not isinstance(coordinate, Line):
            raise TypeError(f"{dim} is not evenly spaced: {coordinate}")
        return coordinate

    def bands(self) -> Bands:
        """Return the bins of the dim that has bins."""
        for _, coordinate in self.entries:
            if isinstance(coordinate, Bands):
                return coordinate
        raise TypeError(f"no dim has bins: {', '.join(name for name, _ in self.entries) or 'it has none'}")

    @property
    def banded(self) -> str:
        """The dim that has bins; '' if none has."""
        return next((name for name, coordinate in self.entries if isinstance(coordinate, Bands)), "")

    def replace(self, **coordinates: Coordinate) -> Grid:
        return Grid.of({**dict(self.entries), **coordinates})

    def take(self, dims: tuple[str, ...]) -> Grid:
        """Return the grid with only these dims."""
        return Grid(tuple((name, coordinate) for name, coordinate in self.entries if name in dims))

    def shape(self, dims: tuple[str, ...]) -> tuple[int, ...]:
        return tuple(self[dim].size for dim in dims)


RGB = Labels(("R", "G", "B"))
XYZ = Labels(("X", "Y", "Z"))
