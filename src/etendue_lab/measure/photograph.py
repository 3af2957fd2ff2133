"""A photograph as numbers proportional to light: the decoded values of a file, or the mosaic of a raw file.

In:  a path; the encoding of its values.
Out: planes in linear light, the file's own numbers, its scale, the sites of each colour of a mosaic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue.types.arrays import Array, FloatArray
from etendue_camera.colour import encoding as transfer
from etendue_camera.picture_files import check_directories, read_picture
from etendue_camera.quality.block_coding import BLOCK, coded

ENCODINGS = ("sRGB", "BT.709", "linear")
Cut = slice | tuple[slice, ...]  # a part of a picture
PLANES = ("red", "green", "blue")
RAW = frozenset(
    {
        ".dng",
        ".nef",
        ".nrw",
        ".cr2",
        ".cr3",
        ".crw",
        ".arw",
        ".sr2",
        ".raf",
        ".orf",
        ".rw2",
        ".pef",
        ".srw",
        ".raw",
        ".3fr",
        ".iiq",
        ".x3f",
    }
)
MOST_PIXELS = 160_000_000  # Pillow opens at most 179 million
INSTALL = "pip install 'etendue[raw]'"
Curve = Callable[[FloatArray], FloatArray]
LINEARISED: dict[str, Curve] = {
    "sRGB": transfer.srgb_decode,
    "BT.709": transfer.bt709_decode,
    "linear": lambda values: values,
}

ENCODED: dict[str, Curve] = {
    "sRGB": transfer.srgb_encode,
    "BT.709": transfer.bt709_encode,
    "linear": lambda values: values,
}


@dataclass(frozen=True)
class PhotographFile:
    """An open picture file; pixels are counted from 0 at the upper left."""

    path: Path
    values: Array  # (rows, columns, 1 or 3), the file's own numbers; for a raw file (rows, columns, 1), above black
    full: float  # value at the end of the scale
    encoding: str  # one of ENCODINGS
    weights: tuple[float, ...]  # of red, green and blue in luminance
    notes: tuple[str, ...] = ()
    colours: Any = None  # (rows, columns): letters of a mosaic; None if every pixel has all channels
    black: float = 0.0  # of a raw file, in its numbers; already subtracted
    table: Any = None  # (8, 8): quantisation of a JPEG's brightness; None for other files

    @property
    def rows(self) -> int:
        return int(self.values.shape[0])

    @property
    def columns(self) -> int:
        return int(self.values.shape[1])

    @property
    def is_raw(self) -> bool:
        return self.colours is not None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its channels."""
        if self.is_raw:
            return tuple(name for name, letter in zip(PLANES, "RGB", strict=True) if letter in self._letters) or (
                "grey",
            )
        return PLANES if self.values.shape[2] == 3 else ("grey",)

    @cached_property
    def _letters(self) -> frozenset[str]:
        return frozenset(np.unique(self.colours).tolist())

    def channel(self, asked: str | None) -> str:
        """Return the channel to measure.

        Raises
        ------
        RequestError
            The picture does not have this channel.
        """
        if self.names == ("grey",):
            if asked in PLANES:
                raise RequestError(f"--channel {asked}: {self.path.name} is grey; omit --channel")
            return "grey"
        if asked is None:
            return "green" if self.is_raw else "luminance"
        if self.is_raw and asked == "luminance":
            raise RequestError("--channel luminance: each pixel of a raw file has one colour; give red, green or blue")
        return asked

    def linear(self, channel: str, cut: Cut = np.s_[:]) -> tuple[Any, Array | None]:
        """Return a part of a channel in linear light (y, x), 1 at full scale, and a mask of its pixels; None: all."""
        part = self.values[cut]
        if self.is_raw:
            return part[..., 0] / self.full, self.sites(channel, cut)
        if channel == "luminance":
            return sum(weight * self._decoded(part[..., i]) for i, weight in enumerate(self.weights)), None
        return self._decoded(part[..., max(self.names.index(channel), 0)]), None

    def sites(self, channel: str, cut: Cut = np.s_[:]) -> Any:
        """Return a mask of the mosaic's pixels under the filter of ``channel``; None if this is every pixel."""
        if not self.is_raw or self.names == ("grey",):
            return None
        return self.colours[cut] == channel[0].upper()

    def step(self, level: float) -> float:
        """Return the step in linear light between neighbouring numbers of the file at a level, 1 at full scale; 0 for
        floating-point files.
        """
        if self.is_raw:
            return 1 / self.full
        if self.values.dtype.kind == "f":
            return 0.0
        each = 0.5 / self.full
        encoded = float(np.clip(ENCODED[self.encoding](np.array(level)), each, 1 - each))
        below, above = LINEARISED[self.encoding](np.array([encoded - each, encoded + each]))
        return float(above - below)

    def coarse(self, low: float, high: float) -> float:
        """Return the mean quantisation step of a JPEG divided by the height of an edge between two levels of linear
        light, both in numbers of the file; 0 for other files.
        """
        if not self.lossy:
            return 0.0
        below, above = ENCODED[self.encoding](np.clip(np.array([low, high]), 0.0, 1.0))
        return float(np.mean(self.table) / max(self.full * (above - below), 1.0))

    @property
    def lossy(self) -> bool:
        """Whether the file is a JPEG, which stores quantised cosine transforms of blocks."""
        return self.table is not None

    def written(self, linear: Array, rng: np.random.Generator) -> FloatArray:
        """Return a plane in linear light after JPEG compression with the table of this file. Block position and level
        offsets are random.
        """
        encoded = self.full * ENCODED[self.encoding](np.clip(linear, 0.0, 1.0))
        dark, bright = np.percentile(encoded[::2, ::2], (5, 95))
        encoded += np.interp(encoded, (dark, max(bright, dark + 1)), rng.uniform(-0.5, 0.5, 2))
        down, right = (int(one) for one in rng.integers(0, BLOCK, 2))
        return self._light[coded(encoded, self.table, (down, right)).astype(np.intp)]

    @cached_property
    def _light(self) -> FloatArray:
        """Linear light (1 at full scale) of each 8-bit number."""
        return self._decoded(np.arange(256))

    def planes(self, cut: Cut = np.s_[:]) -> Array:
        """Return all channels in linear light, (channel, y, x)."""
        return self._decoded(np.moveaxis(self.values[cut], -1, 0))

    def clipped(self, cut: Cut = np.s_[:]) -> Any:
        """Return a mask (y, x) of pixels with a channel at an end of its scale; in a raw file only at the upper end,
        because noise at the lower end is not clipped.
        """
        part = self.values[cut]
        top = (part >= self.full).any(-1)
        return top if self.is_raw else top | (part <= 0).any(-1)

    def _decoded(self, values: Array) -> FloatArray:
        return LINEARISED[self.encoding](np.asarray(values, np.float64) / self.full)


def open_photograph(path: Path, encoding: str, weights: tuple[float, ...]) -> PhotographFile:
    """Open a PNG, JPEG or TIFF file, or a raw file with LibRaw.

    Raises
    ------
    RequestError
        The file does not exist, is not a supported picture, or is a raw file and rawpy is missing.
    """
    if not path.exists():
        raise RequestError(f"{path}: file not found")
    if path.is_dir():
        raise RequestError(f"{path}: is a folder; give a picture: PNG, JPEG, TIFF or a raw file")
    try:
        plain_files.check_plain(path)
    except OSError as error:
        raise RequestError(f"{path}: {error.strerror}; give a picture: PNG, JPEG, TIFF or a raw file") from None
    if path.suffix.lower() in RAW:
        return _raw(path, weights)
    try:
        found = read_picture(str(path), MOST_PIXELS)
    except ValueError as error:
        raise RequestError(str(error)) from None
    return PhotographFile(
        path, found.values, found.full, encoding, weights, (found.note,) if found.note else (), table=found.table
    )


def reader() -> Any:
    """Return rawpy.

    Raises
    ------
    RequestError
        rawpy is not installed.
    """
    try:
        import rawpy
    except ImportError:
        raise RequestError(f"raw files need rawpy, which is not installed: {INSTALL}") from None
    return rawpy


def _raw(path: Path, weights: tuple[float, ...]) -> PhotographFile:
    """Read the mosaic above its black level, not demosaiced, in the orientation of the sensor."""
    rawpy = reader()
    try:
        check_directories(path)
        with rawpy.imread(str(path)) as file:
            mosaic = file.raw_image_visible
            if mosaic is None or mosaic.ndim != 2:
                raise RequestError(
                    f"{path.name} holds no mosaic, but all colours at every pixel; save it as 16-bit TIFF"
                )
            index = np.array(file.raw_colors_visible)
            letters = np.array(list(file.color_desc.decode("ascii", "replace")))
            black = np.array(file.black_level_per_channel, float)
            values = mosaic.astype(np.float64) - black[np.minimum(index, len(black) - 1)]
            white = float(file.white_level)
            colours = np.full(index.shape, "W") if file.num_colors == 1 else letters[index]
    except RequestError:
        raise
    except Exception as error:
        raise RequestError(f"{path} cannot be read as a raw file: {told(error)}") from None
    if not white > black.max():
        raise RequestError(
            f"{path.name} has a white level of {white:g}; it must be above the black level, {black.max():g}"
        )
    return PhotographFile(
        path, values[..., None], white - float(black.max()), "linear", weights, (), colours, float(black.mean())
    )


def developed(path: Path) -> Any:
    """Return a raw file converted by LibRaw to linear sRGB, (rows, columns, 3), with the white balance of the camera;
    the white level is 1.
    """
    rawpy = reader()
    try:
        with rawpy.imread(str(path)) as file:
            return file.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                output_color=rawpy.ColorSpace.sRGB,
                user_flip=0,
            )
    except Exception as error:
        raise RequestError(f"{path.name} cannot be developed by LibRaw: {told(error)}") from None


def told(error: Exception) -> str:
    """Return the message of a LibRaw error as one line of text."""
    text = next((one.decode("ascii", "replace") for one in error.args if isinstance(one, bytes)), str(error))
    return " ".join(text.split())[:150]
