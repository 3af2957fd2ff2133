"""16-bit TIFF: raw digital numbers unchanged, pictures of 0 to 1 scaled to 65535.

In:  (y, x) or (channel, y, x) array.
Out: an uncompressed TIFF file; encoded sRGB carries its profile.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from etendue import require
from etendue_camera.arrays import Array

if TYPE_CHECKING:
    from numpy.typing import NDArray

TOP = 65535


def codes(picture: Array) -> NDArray[np.uint16]:
    """Return uint16 (y, x) or (y, x, 3): integers unchanged; 0 to 1 scaled to 0 to 65535, rounded, clipped at both
    ends.

    Raises
    ------
    ValueError
        For other dims, channel counts other than 1 or 3, integers of more than 16 bits, or NaN.
    """
    picture = np.asarray(picture)
    if picture.ndim == 3 and picture.shape[0] in (1, 3):
        picture = np.moveaxis(picture, 0, -1) if picture.shape[0] == 3 else picture[0]
    elif picture.ndim != 2:
        raise ValueError(f"the picture has shape {picture.shape}; it must be (y, x), (1, y, x) or (3, y, x)")
    if picture.dtype.kind == "u":
        require.that(picture.dtype.itemsize <= 2, f"the picture is {picture.dtype}; integers must have at most 16 bits")
        return np.ascontiguousarray(picture, np.uint16)
    require.that(not np.isnan(picture).any(), "the picture contains NaN")
    return np.rint(np.clip(picture, 0, 1) * TOP).astype(np.uint16)


def srgb_profile() -> bytes:
    """Return an ICC profile of sRGB, identical every time: its creation date is fixed."""
    from PIL import ImageCms

    profile = bytearray(ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    profile[24:36] = bytes((7, 207, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0))  # 1999-01-01
    return bytes(profile)


def write(
    path: Path, picture: Array, description: str = "", software: str = "etendue", when: str = "", srgb: bool = False
) -> None:
    """Write one picture; ``srgb`` marks its values as sRGB-encoded."""

    import tifffile

    values = codes(picture)
    with tifffile.TiffWriter(path, bigtiff=values.nbytes > 2**32 - 2**25, byteorder="<") as file:
        file.write(
            values,
            photometric="rgb" if values.ndim == 3 else "minisblack",
            compression=None,
            metadata=None,
            resolution=(1, 1),
            description=description or None,
            software=software,
            datetime=when or None,
            iccprofile=srgb_profile() if srgb and values.ndim == 3 else None,
        )
