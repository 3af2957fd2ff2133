"""Colour filter arrays of any period: which pixel is behind which filter.

In:  the name of an array, its letters row by row ("RG/GB"), one letter, or a table of them; planes by channel; pixel
     indices.
Out: a ``Mask``; one value per pixel; the index of each pixel's channel; positions beyond the border.
Sources: Bayer, US patent 3971065 (1976). Quad-Bayer: each site of a Bayer cell four pixels large. RGBW: Compton and
Hamilton, US patent 8139130 (2012), with panchromatic pixels on a checkerboard. X-Trans: the 6 x 6 cell of Fujifilm's X
sensors, as used by raw converters. RCCC: one red and three clear pixels, of driver-assistance cameras.

A letter names a channel and its column in a sensitivity table: R, G, B, W or C for clear, or any other letter that the
table has. Masks are periodic and belong to the sensor: pixel (i, j) has the letter at (i mod rows, j mod columns) for
any window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from etendue import plain_files, require

BAYER = ("RGGB", "BGGR", "GRBG", "GBRG")
COLOURS = "RGB"
LARGEST_PERIOD = 64
_OTHERS = {
    "RGBW": ("WGWR", "GWRW", "WBWG", "BWGW"),
    "X-Trans": ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"),
    "RCCC": ("RC", "CC"),
    "mono": ("W",),
}
NAMES = (*BAYER, *(f"quad-{name}" for name in BAYER), *_OTHERS)


@dataclass(frozen=True)
class Mask:
    """One period of a colour filter array, row by row, already reduced to its smallest period."""

    rows: tuple[str, ...]

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Return the letters in plane order: R, G, B, then others as they appear."""
        seen = dict.fromkeys("".join(self.rows))
        return (*(c for c in "RGB" if c in seen), *(c for c in seen if c not in "RGB"))

    @property
    def period(self) -> tuple[int, int]:
        return len(self.rows), len(self.rows[0])

    @property
    def bayer(self) -> str | None:
        """Return the name of the Bayer order; None for any other array."""
        name = "".join(self.rows)
        return name if self.period == (2, 2) and name in BAYER else None

    def sites(self, channel: str) -> list[tuple[int, int]]:
        """Return the positions of a channel in the period."""
        return [(y, x) for y, row in enumerate(self.rows) for x, letter in enumerate(row) if letter == channel]

    def __str__(self) -> str:
        return "/".join(self.rows)


def read(pattern: str) -> Mask:
    """Return the mask of a camera's ``pattern``: from `parse`, or from the rows in a .csv file.

    Raises
    ------
    ValueError
        As for `parse` and `parse_rows`, and for a file that cannot be read; the message names the file.
    """
    if not pattern.endswith(".csv"):
        return parse(pattern)
    try:
        return parse_rows(plain_files.table(pattern).decode("utf-8-sig"))
    except OSError as error:
        raise ValueError(f"{pattern}: {error.strerror}") from None
    except ValueError as error:  # also encoding errors
        raise ValueError(f"{pattern}: {error}") from None


def parse(text: str) -> Mask:
    """Return the mask with this name, or with these letters.

    Parameters
    ----------
    text : str
        One of `NAMES`, in any case; or rows of letters of equal length separated by "/", such as "RG/GB"; or one
        letter, for pixels that all have the same filter, such as a single plane.

    Returns
    -------
    Mask

    Raises
    ------
    ValueError
        For an unknown name, rows of different length, characters that are not letters, or a period above 64.
    """
    by_name = {name.casefold(): name for name in NAMES}
    name = by_name.get(text.strip().casefold())
    require.allowed(
        name is not None or "/" in text or (len(text.strip()) == 1 and text.strip().isalpha()),
        "pattern",
        text,
        f"{', '.join(BAYER)}, the same names with the prefix quad-, {', '.join(_OTHERS)}, rows such as 'RG/GB', "
        "or a .csv file",
    )
    if name in _OTHERS:
        rows = _OTHERS[name]
    elif name is not None:
        order = name.removeprefix("quad-")
        each = 2 if name.startswith("quad-") else 1
        rows = tuple("".join(letter * each for letter in order[i : i + 2]) for i in (0, 2) for _ in range(each))
    else:
        rows = tuple(row.strip().upper() for row in text.strip().strip("/").split("/"))
    require.allowed(
        len({len(row) for row in rows}) == 1 and all(row.isascii() and row.isalpha() for row in rows),
        "pattern",
        text,
        "rows of letters of one length, separated by '/', such as 'RG/GB'",
    )
    if max(len(rows), len(rows[0])) > LARGEST_PERIOD:
        raise ValueError(
            f"the pattern has a period of {len(rows)} x {len(rows[0])} pixels; the maximum is {LARGEST_PERIOD}"
        )
    across = _shortest(["".join(row[x] for row in rows) for x in range(len(rows[0]))])
    down = _shortest(list(rows))
    return Mask(tuple(row[:across] for row in rows[:down]))


def parse_rows(text: str) -> Mask:
    """Parse a mask from the lines of a table: letters, with optional commas and spaces between them; # starts a
    comment.

    Raises
    ------
    ValueError
        As for `parse`, and if there are no letters.
    """
    stripped = (line.partition("#")[0].replace(",", " ").split() for line in text.splitlines())
    rows = ["".join(cells) for cells in stripped if cells]
    require.that(rows, "there are no letters; expected rows such as R,G and G,B")
    return parse("/".join(rows) + "/")


def tint(channel: str) -> tuple[float, float, float]:
    """Return the display colour (red, green, blue) of a letter in pictures of a mosaic; grey for unknown letters."""
    known = {
        "R": (1.0, 0.0, 0.0),
        "G": (0.0, 1.0, 0.0),
        "B": (0.0, 0.0, 1.0),
        "Y": (1.0, 1.0, 0.0),
        "M": (1.0, 0.0, 1.0),
    }
    return known.get(channel, (1.0, 1.0, 1.0))


def _shortest(items: list[str]) -> int:
    """Return the length of the shortest block whose repetition gives the items."""
    size = len(items)
    return next(n for n in range(1, size + 1) if size % n == 0 and items == items[:n] * (size // n))


def shifted_bayer(name: str, row: int, column: int) -> str:
    """Return the Bayer order seen by a window that starts at pixel (row, column) of a sensor with the order
    ``name``."""
    return "".join(name[2 * ((row + y) % 2) + (column + x) % 2] for y in (0, 1) for x in (0, 1))


def phase(pattern: str) -> dict[str, list[tuple[int, int]]]:
    """Return the positions of each colour in the 2 x 2 cell of a Bayer order.

    Parameters
    ----------
    pattern : str
        One of `BAYER`, named by its cell at pixel (0, 0), row by row (Bayer, US patent 3971065, 1976).

    Returns
    -------
    dict
        "R", "G", "B" to a list of (row offset, column offset); green has two.

    Raises
    ------
    ValueError
        If the pattern is not one of the four.
    """
    require.allowed(pattern in BAYER, "pattern", pattern, ", ".join(BAYER))
    return {c: [divmod(i, 2) for i in range(4) if pattern[i] == c] for c in COLOURS}


def channel_index(
    mask: Mask | str, rows: int, columns: int, first_row: int = 0, first_column: int = 0
) -> NDArray[np.uint8]:
    """Return the channel of every pixel of a window, as an index into ``mask.channels``.

    Parameters
    ----------
    mask : Mask or str
        A string is parsed.
    rows, columns : int
        Size of the window, at or above 0.
    first_row, first_column : int
        First pixel of the window on the sensor, of any sign.

    Returns
    -------
    (rows, columns) array of uint8
    """
    mask = parse(mask) if isinstance(mask, str) else mask
    table = np.array([[mask.channels.index(letter) for letter in row] for row in mask.rows], np.uint8)
    height, width = mask.period
    return table[(np.arange(rows) + first_row)[:, None] % height, (np.arange(columns) + first_column)[None, :] % width]


def frames_of_channel(
    frames: NDArray, mask: Mask | str, channel: str, first_row: int = 0, first_column: int = 0
) -> NDArray:
    """Return the pixels of one channel as one frame for each position of the channel in the period; these frames are
    stacked vertically.

    Parameters
    ----------
    frames : (..., y, x) array
    mask : Mask or str
    channel : str
        A letter of the mask.
    first_row, first_column : int
        First pixel of the frames on the sensor, of any sign.

    Returns
    -------
    (..., n, m) array
        Incomplete periods at the border are dropped. Inside each frame, pixels keep their order; neighbours have the
        same position in the period.
    """
    mask = parse(mask) if isinstance(mask, str) else mask
    height, width = mask.period
    rows, columns = frames.shape[-2] // height, frames.shape[-1] // width
    whole = frames[..., : rows * height, : columns * width]
    places = [((y - first_row) % height, (x - first_column) % width) for y, x in mask.sites(channel)]
    return np.concatenate([whole[..., y::height, x::width] for y, x in places], axis=-2)


def pick(planes: NDArray, mask: Mask | str, first_row: int = 0, first_column: int = 0) -> NDArray:
    """Sample full planes as the sensor does: one channel per pixel.

    Parameters
    ----------
    planes : (channel, y, x) array, any unit
        In the order of ``mask.channels``.
    mask : Mask or str
        A string is parsed.
    first_row, first_column : int
        First pixel of the planes on the sensor.

    Returns
    -------
    (y, x) array, unit and dtype of planes
        Copies of samples, bit for bit.

    Raises
    ------
    ValueError
        If there is not one plane for each channel.
    """
    planes, mask = np.asarray(planes), parse(mask) if isinstance(mask, str) else mask
    require.shape(
        planes.ndim == 3 and planes.shape[0] == len(mask.channels),
        "planes",
        planes,
        f"({len(mask.channels)}, y, x): {', '.join(mask.channels)}",
    )
    mosaic = np.empty(planes.shape[1:], planes.dtype)
    for plane, channel in zip(planes, mask.channels, strict=True):
        for where in sites_of(mask, channel, first_row, first_column):
            mosaic[where] = plane[where]
    return mosaic


def sites_of(mask: Mask, channel: str, first_row: int = 0, first_column: int = 0) -> list[tuple[slice, slice]]:
    """Return slices of a window that select all pixels of a channel."""
    height, width = mask.period
    return [
        (slice((y - first_row) % height, None, height), slice((x - first_column) % width, None, width))
        for y, x in mask.sites(channel)
    ]


def continued(size: int, period: int, margin: int) -> NDArray[np.intp]:
    """Return source pixels for positions beyond the border: mirrored by whole periods, which keeps colours in place.

    Parameters
    ----------
    size : int
        Pixels along the axis, at least 1.
    period : int
        Period of the mask along the axis.
    margin : int
        Pixels to add on each side, any number.

    Returns
    -------
    (size + 2 margin,) array of int
        Indices inside the frame for the positions -margin ... size + margin - 1, congruent to the position modulo the
        period; a frame shorter than the period repeats its outermost pixels instead. For a period of 2 this mirrors
        about the outermost pixels, for a period of 1 about the border.
    """
    position = np.arange(-margin, size + margin)
    if size < period:
        return np.clip(position, 0, size - 1)
    while True:
        outside = (position < 0) | (position >= size)
        if not outside.any():
            return position
        position = np.where(position < 0, _turned(position, period), position)
        position = np.where(position >= size, size - 1 - _turned(size - 1 - position, period), position)


def _turned(position: NDArray[np.intp], period: int) -> NDArray[np.intp]:
    """Reverse the order of blocks of one period about 0, without changing the order inside a block."""
    block, offset = np.divmod(position, period)
    return (-1 - block) * period + offset
