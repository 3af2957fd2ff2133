"""Frames of a measurement, with the exposure of each, read one at a time.

In:  sources: files with one or more frames.
Out: levels: frames of one exposure time and one light.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue_camera.arrays import Array

MOST_FRAMES = 100_000
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
    series: str = ""  # of frames taken together: those of two series are two levels, whatever their labels

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
    """Rectangle that is used, pixels from the upper left."""

    x: int
    y: int
    width: int
    height: int

    @classmethod
    def read(cls, text: str) -> Window:
        """Read X,Y,WIDTH,HEIGHT."""
        parts = text.split(",")
        if len(parts) != 4 or not all(one.strip().isdecimal() for one in parts):
            raise RequestError(f"--window {text}: give X,Y,WIDTH,HEIGHT in whole pixels, such as 100,200,512,512")
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
        """Rows and columns that are used."""
        rows, columns = self.frames[0].source.shape
        return (self.window.height, self.window.width) if self.window else (rows, columns)

    def cut(self, frame: Frame) -> Array:
        """Return a frame, cut to the window."""
        found = frame.read()
        w = self.window
        return found if w is None else found[w.y : w.y + w.height, w.x : w.x + w.width]

    def windowed(self, window: Window | None) -> FrameSet:
        """Return the same with a window, which must lie within the frames."""
        rows, columns = self.frames[0].source.shape
        if window and not (0 < window.width <= columns - window.x and 0 < window.height <= rows - window.y):
            raise RequestError(
                f"--window {window.x},{window.y},{window.width},{window.height}: beyond the frames of {columns} x "
                f"{rows} pixels"
            )
        return FrameSet(self.path, self.frames, self.photons, self.kind, self.pattern, self.notes, window)

    def levels(self) -> list[Level]:
        """Return levels, the dark ones first, by light and time."""
        found: dict[tuple[float, float, str], list[Frame]] = {}
        for frame in self.frames:
            light = frame.light if not (frame.time == 0 and frame.light > 0 and not self.photons) else 0.0
            found.setdefault((light, frame.time, frame.series), []).append(frame)
        keys = sorted(found, key=lambda key: (key[0] > 0, key[0], -1.0 if math.isnan(key[1]) else key[1], key[2]))
        return [Level(key[1], key[0], tuple(found[key])) for key in keys]

    def digests(self) -> dict[str, str]:
        """Return the SHA-256 of every file, by name."""
        return {path.name: sha256(path) for path in dict.fromkeys(one.source.path for one in self.frames)}


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
    if values.dtype.kind == "i" and values.dtype.itemsize <= 8:
        if values.size and int(values.min()) < 0:
            raise RequestError(
                f"{path}: holds negative numbers; raw frames, from which nothing is subtracted, are needed"
            )
        return values.astype(np.uint32 if values.itemsize > 2 else np.uint16)
    if values.dtype.kind == "f":
        if not np.isfinite(values).all() or (values < 0).any() or (values != np.floor(values)).any():
            raise RequestError(f"{path}: holds fractions, NaN or negative numbers; whole raw codes are needed")
        return values.astype(np.uint32)
    raise RequestError(f"{path}: holds values of type {values.dtype}; whole raw codes are needed")


def each(frames: FrameSet, level: Level) -> Iterator[Array]:
    """Read the frames of a level one by one."""
    for frame in level.frames:
        yield frames.cut(frame)
