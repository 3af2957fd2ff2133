"""Frames of a measurement with their exposures; frames are read one at a time.

In:  sources: files with one or more frames.
Out: levels: frames of one exposure time and one light.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue_camera.arrays import Array

MOST_FRAMES = 100_000
MANY_PIXELS = 1 << 20  # pixels examined first for the step of codes; every frame is checked when it is read
MANY_CODES = 8  # minimum number of different codes from which a step is derived
_BLOCK = 1 << 20


class Source(Protocol):
    """A file, or a part of one, with frames of one size."""

    path: Path
    shape: tuple[int, int]  # rows, columns

    def read(self, index: int) -> Array:
        """Return a frame (y, x), unsigned integers, DN."""


@dataclass(frozen=True)
class Frame:
    """One frame. ``light``: photons per pixel if known, else relative to other frames; 0 in the dark."""

    source: Source
    index: int
    time: float  # s; NaN if unknown
    light: float
    series: str = ""  # frames of one series form a level; two series are two levels even with equal labels

    def read(self) -> Array:
        return self.source.read(self.index)


@dataclass(frozen=True)
class Level:
    """Frames of one exposure."""

    time: float
    light: float
    frames: tuple[Frame, ...]

    @property
    def dark(self) -> bool:
        return self.light == 0


@dataclass(frozen=True)
class Window:
    """The rectangle to use, pixels from the upper left corner."""

    x: int
    y: int
    width: int
    height: int

    @classmethod
    def read(cls, text: str, option: str = "--window") -> Window:
        """Parse a window from a text X,Y,WIDTH,HEIGHT."""
        parts = text.split(",")
        if len(parts) != 4 or not all(one.strip().isdecimal() for one in parts):
            raise RequestError(f"{option} {text}: give X,Y,WIDTH,HEIGHT in whole pixels, such as 100,200,512,512")
        x, y, width, height = (int(one) for one in parts)
        return cls(x, y, width, height)


@dataclass
class FrameSet:
    """All frames of a measurement."""

    path: Path
    frames: list[Frame]
    photons: bool  # whether ``light`` counts photons per pixel
    kind: str  # what was read
    pattern: str = "mono"  # letters of the colour filter array, row by row
    notes: list[str] = field(default_factory=list)
    window: Window | None = None
    step: int = 1  # all stored codes are multiples of this: 16 for 12 bits in the upper bits of 16

    def __post_init__(self) -> None:
        if not self.frames:
            raise RequestError(f"{self.path}: holds no frames")
        if len(self.frames) > MOST_FRAMES:
            raise RequestError(f"{self.path}: {len(self.frames)} frames; at most {MOST_FRAMES} are read")
        sizes = {one.source.shape: one.source.path for one in self.frames}
        if len(sizes) > 1:
            (first, one), (second, other), *_ = sizes.items()
            raise RequestError(
                f"{self.path}: {one.name} has {first[1]} x {first[0]} pixels and {other.name} {second[1]} x "
                f"{second[0]}; all frames of a measurement must have one size"
            )
        for frame in self.frames:
            if frame.light < 0 or math.isinf(frame.light) or math.isnan(frame.light):
                raise RequestError(f"{frame.source.path}: light {frame.light!r}; it must be a number at or above 0")
            if frame.time < 0 or math.isinf(frame.time):
                raise RequestError(f"{frame.source.path}: time {frame.time!r} s; it must be a number at or above 0")

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns that are used."""
        rows, columns = self.frames[0].source.shape
        return (self.window.height, self.window.width) if self.window else (rows, columns)

    def cut(self, frame: Frame) -> Array:
        """Return a frame, cut to the window."""
        found, w = frame.read(), self.window
        if w is not None:
            found = found[w.y : w.y + w.height, w.x : w.x + w.width]
        if self.step == 1:
            return found
        if (found % self.step).any():
            raise RequestError(
                f"{frame.source.path}: codes are not multiples of {self.step}, unlike those of other frames"
            )
        return np.asarray(found // found.dtype.type(self.step))

    def windowed(self, window: Window | None) -> FrameSet:
        """Return the frames with a window, which must lie inside every frame."""
        rows, columns = self.frames[0].source.shape
        if window and not (0 < window.width <= columns - window.x and 0 < window.height <= rows - window.y):
            raise RequestError(
                f"--window {window.x},{window.y},{window.width},{window.height}: beyond the frames of {columns} x "
                f"{rows} pixels"
            )
        return replace(self, window=window)

    def unshifted(self) -> FrameSet:
        """Return the frames with codes divided by 2^n if all codes are multiples of 2^n, so that 1 DN is one step of
        the converter.
        """
        known: set[int] = set()
        for frame in (self.frames[i] for i in {0, len(self.frames) // 3, len(self.frames) // 2, len(self.frames) - 1}):
            known.update(int(one) for one in np.unique(self.cut(frame).ravel()[:MANY_PIXELS]))
        step = math.gcd(*known)
        step &= -step
        if step == 1 or len(known) < MANY_CODES:
            return self
        note = f"all codes are multiples of {step}: DN are the converter's own steps, codes divided by {step}"
        return replace(self, step=step, notes=[*self.notes, note])

    def levels(self) -> list[Level]:
        """Return levels ordered by light and time, dark levels first."""
        found: dict[tuple[float, float, str], list[Frame]] = {}
        for frame in self.frames:
            light = frame.light if not (frame.time == 0 and frame.light > 0 and not self.photons) else 0.0
            found.setdefault((light, frame.time, frame.series), []).append(frame)
        keys = sorted(found, key=lambda key: (key[0] > 0, key[0], -1.0 if math.isnan(key[1]) else key[1], key[2]))
        return [Level(key[1], key[0], tuple(found[key])) for key in keys]

    def digests(self) -> dict[str, str]:
        """Return the SHA-256 of every file, by its name in the folder of the measurement."""
        folder = self.path if self.path.is_dir() else self.path.parent
        paths = dict.fromkeys(one.source.path for one in self.frames)
        return {path.relative_to(folder).as_posix(): sha256(path) for path in paths}


def sha256(path: Path) -> str:
    """Return the digest of a file, which is read in blocks."""
    digest = hashlib.sha256()
    with plain_files.open_plain(path) as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def as_codes(values: Array, path: Path) -> Array:
    """Return frames as unsigned integers; refuse anything else."""
    if values.dtype.kind == "u" and values.dtype.itemsize <= 4:
        return values
    if values.dtype.kind in "iu":
        if values.size and int(values.min()) < 0:
            raise RequestError(
                f"{path}: holds negative numbers; give raw frames, from which nothing has been subtracted"
            )
        if values.size and int(values.max()) >= 1 << 32:
            raise RequestError(f"{path}: holds the code {int(values.max())}; codes of at most 20 bits are read")
        return values.astype(np.uint32 if values.itemsize > 2 else np.uint16)
    if values.dtype.kind == "f":
        if not ((values >= 0) & (values < 2.0**32) & (values == np.floor(values))).all():
            raise RequestError(
                f"{path}: holds fractions, NaN, or numbers below 0 or above 2^32; raw codes must be whole numbers"
            )
        return values.astype(np.uint32)
    raise RequestError(f"{path}: holds values of type {values.dtype}; raw codes must be whole numbers")


def each(frames: FrameSet, level: Level) -> Iterator[Array]:
    """Read the frames of a level one by one."""
    for frame in level.frames:
        yield frames.cut(frame)
