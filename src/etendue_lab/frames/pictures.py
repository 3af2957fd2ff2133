"""Frames in picture files: PNG, TIFF and DNG.

In:  a path.
Out: raw codes, the exposure time if the file states it, the colour filter array of a DNG.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from etendue import plain_files
from etendue.errors import RequestError
from etendue.process import unwarned
from etendue_camera.arrays import Array
from etendue_camera.picture_files import check_directories, read_picture
from etendue_lab.frames.frame_set import as_codes
from etendue_lab.measure.photograph import MOST_PIXELS, RAW, reader, told

PICTURES = frozenset({".png", ".tif", ".tiff"}) | RAW
_EXIF, _EXPOSURE_TIME = 0x8769, 0x829A


class PictureFrame:
    """A picture file with one frame."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_raw = path.suffix.lower() in RAW
        self.pattern = "mono"
        try:
            plain_files.check_plain(path)
        except OSError as error:
            raise RequestError(f"{path}: {error.strerror or error}") from None
        self.shape = self._raw_shape() if self.is_raw else _size(path)

    def _raw_shape(self) -> tuple[int, int]:
        rawpy = reader()
        try:
            check_directories(self.path)
            with rawpy.imread(str(self.path)) as file:
                mosaic = file.raw_image_visible
                index = np.array(file.raw_colors_visible)
                letters = file.color_desc.decode("ascii", "replace")
                if mosaic is None or mosaic.ndim != 2:
                    raise RequestError(f"{self.path}: holds no mosaic, but all colours at every pixel")
                if file.num_colors > 1:
                    self.pattern = "".join(letters[int(one)] for one in index[:2, :2].ravel())
                return int(mosaic.shape[0]), int(mosaic.shape[1])
        except RequestError:
            raise
        except Exception as error:
            raise RequestError(f"{self.path}: cannot be read as a raw file: {told(error)}") from None

    def read(self, index: int) -> Array:
        if self.is_raw:
            try:
                with reader().imread(str(self.path)) as file:
                    return as_codes(np.array(file.raw_image_visible), self.path)
            except RequestError:
                raise
            except Exception as error:
                raise RequestError(f"{self.path}: cannot be read as a raw file: {told(error)}") from None
        try:
            found = read_picture(str(self.path), MOST_PIXELS).values
        except ValueError as error:
            raise RequestError(str(error)) from None
        if found.ndim == 3 and found.shape[2] > 1:
            raise RequestError(f"{self.path}: has {found.shape[2]} colours at every pixel; raw frames have one number")
        plane = found[..., 0] if found.ndim == 3 else found
        if plane.shape != self.shape:
            raise RequestError(f"{self.path}: changed while it was read")
        return as_codes(plane, self.path)

    def time(self) -> float:
        """Return the exposure time (s) in the EXIF data of the file; NaN if there is none."""
        from PIL import Image

        try:
            if self.path.suffix.lower() in {".tif", ".tiff", ".dng"}:
                return _tiff_time(self.path)
            with Image.open(self.path) as picture:
                exif = picture.getexif()
                value = exif.get_ifd(_EXIF).get(_EXPOSURE_TIME, exif.get(_EXPOSURE_TIME))
            return math.nan if value is None else float(value)
        except Exception:  # a file without readable EXIF data has no time
            return math.nan


def _tiff_time(path: Path) -> float:
    import tifffile

    with tifffile.TiffFile(path) as file:
        tags: Any = file.pages.first.tags
        tag = tags.get(_EXPOSURE_TIME)
        value = tag.value if tag is not None else None
        if value is None and (exif := tags.get(_EXIF)) is not None:
            value = exif.value.get("ExposureTime")
    if value is None:
        return math.nan
    return float(value[0]) / float(value[1]) if isinstance(value, tuple) else float(value)


def _size(path: Path) -> tuple[int, int]:
    from PIL import Image

    try:
        with unwarned(), Image.open(path) as picture:
            return picture.size[1], picture.size[0]
    except Exception:  # Pillow does not open all formats; the reader below raises an error with the reason
        try:
            shape = read_picture(str(path), MOST_PIXELS).values.shape
        except ValueError as error:
            raise RequestError(str(error)) from None
        return int(shape[0]), int(shape[1])
