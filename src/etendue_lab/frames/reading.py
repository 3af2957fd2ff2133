"""Open a measurement: a folder, a table, or a file of arrays.

In:  a path, a window.
Out: its frames, with times and light.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from etendue.errors import RequestError
from etendue_camera.arrays import Array
from etendue_lab.frames.arrays import ArrayMember, read_npz
from etendue_lab.frames.frame_set import MOST_FRAMES, Frame, FrameSet, Source, Window
from etendue_lab.frames.pictures import PICTURES, PictureFrame
from etendue_lab.frames.tables import COLUMNS, Line, read_csv, read_descriptor

TABLES: dict[str, Callable[[Path], tuple[list[Line], bool]]] = {".csv": read_csv, ".txt": read_descriptor}
MOST_FILES = 10 * MOST_FRAMES
KINDS = "a folder, .npz, .csv (a table of frames), .txt (an EMVA descriptor)"


def are_frames(path: Path) -> bool:
    """Return whether a path is a measurement: real frames, and neither a pipeline nor an archive."""
    if path.is_dir():
        return not any((path / name).exists() for name in ("data.zarr", "journal.jsonl", "manifest.json")) and any(
            one.suffix.lower() in PICTURES | {".npy", ".npz", *TABLES}
            for one in itertools.islice(path.rglob("*"), MOST_FILES)
        )
    return path.suffix.lower() in {".npz", ".npy", *TABLES} | PICTURES


def open_frames(path: Path, window: Window | None = None, pattern: str | None = None) -> FrameSet:
    """Open a measurement.

    Raises
    ------
    RequestError
        The path is not a measurement; the message names the file and the reason.
    """
    if not path.exists():
        raise RequestError(f"{path}: file not found; give {KINDS}")
    found = _folder(path) if path.is_dir() else _file(path)
    found = found.windowed(window).unshifted()
    return replace(found, pattern=_pattern(pattern)) if pattern else found


def _pattern(text: str) -> str:
    if text != "mono" and (len(text) != 4 or not text.isalpha()):
        raise RequestError(f"--pattern {text}: give mono, or the four letters of a 2 x 2 mosaic, such as RGGB")
    return text


def _file(path: Path) -> FrameSet:
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return read_npz(path)
    if suffix in TABLES:
        lines, photons = TABLES[suffix](path)
        return _listed(path, lines, photons)
    if suffix == ".npy" or suffix in PICTURES:
        raise RequestError(f"{path}: a frame alone does not state its exposure; list them in a CSV table: {COLUMNS}")
    raise RequestError(f"{path}: this is not a measurement; give {KINDS}")


def _sources(path: Path) -> list[tuple[Source, int]]:
    """Return the frames of one file, each as a source and the index of the frame in it."""
    if path.is_dir() or not path.exists():
        raise RequestError(f"{path}: {'is a folder' if path.is_dir() else 'file not found'}; a frame is needed")
    if path.suffix.lower() == ".npy":
        member = ArrayMember(path, "")
        return [(member, i) for i in range(member.count)]
    if path.suffix.lower() in PICTURES:
        return [(PictureFrame(path), 0)]
    raise RequestError(f"{path}: this is not a frame; give PNG, TIFF, DNG or .npy")


def frame_of(path: Path) -> Array:
    """Return the mean of the frames of one file, DN (y, x).

    Raises
    ------
    RequestError
        The file is not a frame.
    """
    found = _sources(path)
    total = np.zeros(found[0][0].shape)
    for source, index in found:
        total += source.read(index)
    return total / len(found)


def _listed(path: Path, lines: list[Line], photons: bool) -> FrameSet:
    frames, patterns, opened = [], set(), dict[Path, list[tuple[Source, int]]]()
    for line in lines:
        if line.file not in opened:
            opened[line.file] = _sources(line.file)
        for source, index in opened[line.file]:
            time = line.time
            if isinstance(source, PictureFrame):
                patterns.add(source.pattern)
                time = source.time() if math.isnan(time) else time
            frames.append(Frame(source, index, time, line.light))
    return FrameSet(path, frames, photons, path.suffix.lower()[1:], _one(path, patterns))


def _one(path: Path, patterns: set[str]) -> str:
    if len(patterns) > 1:
        raise RequestError(f"{path}: expected frames with one colour filter array, got {', '.join(sorted(patterns))}")
    return next(iter(patterns), "mono")


def _folder(path: Path) -> FrameSet:
    """Read a folder that contains one table, or one ``.npz``, or pictures with exposure times. Dark frames have
    ``dark`` in their name or in the name of their sub-folder.
    """
    inside = sorted(one for one in itertools.islice(path.rglob("*"), MOST_FILES) if one.is_file())
    lists = [one for one in inside if one.suffix.lower() in TABLES and one.parent == path]
    tables = [one for one in lists or inside if one.suffix.lower() == ".csv"] or lists
    stored = [one for one in inside if one.suffix.lower() == ".npz"]
    if len(tables) == 1:
        return _file(tables[0])
    if len(tables) > 1:
        raise RequestError(f"{path}: has {len(tables)} tables, {tables[0].name} and {tables[1].name}; give one of them")
    pictures = [one for one in inside if one.suffix.lower() in PICTURES]
    if len(stored) == 1 and not pictures:
        return read_npz(stored[0])
    if not pictures:
        raise RequestError(
            f"{path}: contains no frames; give a CSV table with the columns {COLUMNS}, one .npz file, or pictures"
        )
    return _pictures(path, pictures)


def _pictures(path: Path, pictures: list[Path]) -> FrameSet:
    """Read the pictures in a folder; those with ``dark`` in the name of file or folder are dark frames."""
    frames, patterns = [], set[str]()
    for one in pictures:
        source = PictureFrame(one)
        patterns.add(source.pattern)
        time = source.time()
        if math.isnan(time):
            raise RequestError(
                f"{one}: does not state its exposure time; list the frames in a CSV table in the folder: {COLUMNS}"
            )
        dark = any("dark" in part.lower() for part in one.relative_to(path).parts)
        frames.append(Frame(source, 0, time, 0.0 if dark else time))
    if not any(one.light == 0 for one in frames):
        raise RequestError(
            f"{path}: has no dark frames: put them into a folder named dark, or list them in a CSV table"
        )
    return FrameSet(path, frames, False, "pictures", _one(path, patterns))
