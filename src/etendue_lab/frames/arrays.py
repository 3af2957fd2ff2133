"""Frames in NumPy files: ``.npy`` (frame, y, x), and ``.npz`` of light and dark levels and stacks.

In:  a path.
Out: frames; compressed members are read forwards in a stream, one frame in memory at a time.
"""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue.types.documents import Document
from etendue_camera.arrays import Array
from etendue_lab.frames.frame_set import MOST_FRAMES, Frame, FrameSet, as_codes

MOST_BYTES = 1 << 28  # maximum bytes of one frame
KEYS = "light (level, frame, y, x) with light_time_s, and dark (level, frame, y, x) with dark_time_s"


class ArrayMember:
    """An array (frame, y, x) of a ``.npz`` or ``.npy`` file."""

    def __init__(self, path: Path, member: str) -> None:
        self.path, self.member = path, member
        self._file: IO[bytes] | None = None
        self._next = 0
        with self._opened() as file:
            self.full, self._dtype, self._start = _header(file, path, member)
        if len(self.full) < 2 or min(self.full[-2:]) < 1:
            raise RequestError(f"{path}: {member} has the shape {self.full}; expected (frame, y, x)")
        self.shape = (int(self.full[-2]), int(self.full[-1]))
        self.count = math.prod(self.full[:-2])
        self._bytes = math.prod(self.shape) * self._dtype.itemsize
        if self._bytes > MOST_BYTES:
            raise RequestError(f"{path}: {member} has frames of {self._bytes} bytes; at most {MOST_BYTES} are read")

    def _opened(self) -> IO[bytes]:
        return _opened(self.path, self.member)

    def read(self, index: int) -> Array:
        """Return frame ``index``. The stream can only be read forwards; if an earlier frame is requested, the file is
        read again from its start.
        """
        try:
            if self._file is None or index < self._next:
                if self._file is not None:
                    self._file.close()
                self._file, self._next = self._opened(), 0
                self._file.read(self._start)
            for _ in range(index - self._next):
                self._file.read(self._bytes)
            data = self._file.read(self._bytes)
        except (OSError, ValueError, zipfile.BadZipFile, zlib.error, EOFError, ArithmeticError) as error:
            raise RequestError(f"{self.path}: {self.member or 'the array'} is damaged: {error}") from None
        if len(data) != self._bytes:
            raise RequestError(f"{self.path}: {self.member or 'the array'} ends within frame {index}: it is truncated")
        self._next = index + 1
        return as_codes(np.frombuffer(data, self._dtype).reshape(self.shape), self.path)


class _Member(io.BufferedReader):
    """A member of a ZIP archive; closing the member closes the archive."""

    def __init__(self, archive: zipfile.ZipFile, name: str, file: IO[bytes]) -> None:
        super().__init__(archive.open(name))  # type: ignore[arg-type]
        self._kept = (archive, file)

    def close(self) -> None:
        super().close()
        for one in self._kept:
            one.close()


def _opened(path: Path, member: str) -> IO[bytes]:
    file = plain_files.open_plain(path)
    if not member:
        return file
    try:
        return _Member(zipfile.ZipFile(file), member + ".npy", file)
    except BaseException:
        file.close()
        raise


def _labels(path: Path, member: str) -> Any:
    """Return the exposure times, or the light, of the levels. The size of the array is checked before it is
    decompressed.
    """
    with _opened(path, member) as file:
        shape, dtype, _ = _header(file, path, member)
        size = math.prod(shape)
        if size > MOST_FRAMES or dtype.kind not in "uif":
            raise RequestError(f"{path}: {member} has {size} values of type {dtype}; expected a number for each level")
        data = file.read(size * dtype.itemsize)
    if len(data) != size * dtype.itemsize:
        raise RequestError(f"{path}: {member} is truncated")
    return np.frombuffer(data, dtype).astype(float)


def _header(file: IO[bytes], path: Path, member: str) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    what = f"{path}: {member}" if member else f"{path}"
    try:
        version = np.lib.format.read_magic(file)
        reading = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = reading(file)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise RequestError(f"{what} is not a NumPy array: {' '.join(str(error).split())[:120]}") from None
    if fortran or dtype.hasobject:
        raise RequestError(f"{what} is stored column by column, or as objects; save it again with np.ascontiguousarray")
    return tuple(shape), dtype, file.tell()


def read_npz(path: Path) -> FrameSet:
    """Read ``.npz`` with `KEYS`, and optionally ``light_photons_per_pixel``, ``light_stack``, ``dark_stack``.

    Raises
    ------
    RequestError
        A key is missing, or times and levels do not match.
    """
    try:
        plain_files.check_plain(path)
        with zipfile.ZipFile(path) as file:
            names = [one.removesuffix(".npy") for one in file.namelist()]
        labels = ("_time_s", "_photons_per_pixel", "_relative_light")
        small = {name: _labels(path, name) for name in names if name.endswith(labels)}
    except RequestError:
        raise
    except (OSError, ValueError, zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise RequestError(f"{path}: cannot be read as .npz: {' '.join(str(error).split())[:120]}") from None
    if "light" not in names or ("dark" not in names and "dark_stack" not in names):
        raise RequestError(f"{path}: has {', '.join(names[:8]) or 'nothing'}; needed: {KEYS}")
    frames: list[Frame] = []
    photons = any(name.endswith("_photons_per_pixel") for name in small)
    for name in ("dark", "light", "dark_stack", "light_stack"):
        if name in names:
            frames += _frames(path, name, small, photons)
    return FrameSet(path, frames, photons, "npz")


def _frames(path: Path, name: str, small: Document, photons: bool) -> list[Frame]:
    member = ArrayMember(path, name)
    if len(member.full) not in (3, 4):
        raise RequestError(
            f"{path}: {name} has the shape {member.full}; expected (level, frame, y, x) or (frame, y, x)"
        )
    repeats = member.full[1] if len(member.full) == 4 else member.full[0]
    levels = member.count // max(repeats, 1)
    times = _per_level(path, f"{name}_time_s", small.get(f"{name}_time_s", math.nan), levels)
    if name.startswith("dark"):
        lights = np.zeros(levels)
    else:
        key = f"{name}_photons_per_pixel" if photons else f"{name}_relative_light"
        given = small.get(key)
        if given is None and photons:
            raise RequestError(f"{path}: {key} is missing, though other levels have their photons")
        lights = _per_level(path, key, times if given is None else given, levels)
        if np.isnan(lights).any():
            raise RequestError(f"{path}: {name} has neither {name}_time_s nor light; needed: {KEYS}")
    series = "stack" if name.endswith("_stack") else ""
    return [
        Frame(member, i, float(times[i // repeats]), float(lights[i // repeats]), series) for i in range(member.count)
    ]


def _per_level(path: Path, key: str, values: Any, levels: int) -> Any:
    values = np.atleast_1d(np.asarray(values, float))
    if values.size not in (1, levels):
        raise RequestError(f"{path}: {key} has {values.size} values for {levels} levels")
    return np.broadcast_to(values, (levels,))
