"""Regions of a picture as written on the command line, in pixels from its upper left corner.

In:  strings such as 120,80,200,300.
Out: windows, circles, corners; one clear error for each invalid string.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from etendue.errors import RequestError

if TYPE_CHECKING:
    from etendue.types.arrays import FloatArray

FOUND = "auto"  # value of --edge: find the strongest slanted edge


@dataclass(frozen=True)
class PixelWindow:
    """A rectangle: its upper left pixel and its size."""

    x: int
    y: int
    width: int
    height: int

    @property
    def cut(self) -> tuple[slice, slice]:
        return np.s_[self.y : self.y + self.height, self.x : self.x + self.width]

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"


@dataclass(frozen=True)
class Circle:
    """A star: its centre and radius."""

    x: float
    y: float
    radius: float

    def __str__(self) -> str:
        return f"{self.x:g},{self.y:g},{self.radius:g}"


def numbers(option: str, text: str, count: int, form: str) -> list[float]:
    """Parse the numbers of a text.

    Raises
    ------
    RequestError
        The text does not contain ``count`` numbers.
    """
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count or not np.isfinite(found).all():
        raise RequestError(f"{option} {text}: expected {form}, in pixels from the upper left corner")
    return found


def window(option: str, text: str, columns: int, rows: int) -> PixelWindow:
    """Parse a rectangle inside a picture."""
    x, y, width, height = (round(one) for one in numbers(option, text, 4, "X,Y,WIDTH,HEIGHT"))
    if not (x >= 0 and y >= 0 and width > 0 and height > 0 and x + width <= columns and y + height <= rows):
        raise RequestError(f"{option} {text}: outside the picture of {columns} x {rows} pixels (X,Y,WIDTH,HEIGHT)")
    return PixelWindow(x, y, width, height)


def circle(option: str, text: str, columns: int, rows: int) -> Circle:
    """Parse a circle inside a picture."""
    x, y, radius = numbers(option, text, 3, "X,Y,RADIUS")
    if not (
        radius > 0
        and x - radius >= -0.5
        and y - radius >= -0.5
        and x + radius <= columns - 0.5
        and y + radius <= rows - 0.5
    ):
        raise RequestError(f"{option} {text}: outside the picture of {columns} x {rows} pixels (X,Y,RADIUS)")
    return Circle(x, y, radius)


def corners(option: str, text: str, columns: int, rows: int) -> FloatArray:
    """Parse (4, 2): the four corners of a chart inside a picture, x and y."""
    found = np.array(numbers(option, text, 8, "X0,Y0,X1,Y1,X2,Y2,X3,Y3")).reshape(4, 2)
    inside = (found >= -0.5).all() and (found[:, 0] <= columns - 0.5).all() and (found[:, 1] <= rows - 0.5).all()
    if not inside:
        raise RequestError(f"{option} {text}: outside the picture of {columns} x {rows} pixels")
    return found
