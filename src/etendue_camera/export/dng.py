"""Digital Negative: write one raw frame as a file that raw converters open.

In:  digital numbers, mask of the filters, levels, white, colour matrices, exposure.
Out: an uncompressed DNG 1.4 file with bit-exact digital numbers.
Sources: Adobe, Digital Negative Specification 1.4.0.0; EXIF 2.32 for exposure time, f-number, focal length, ISO.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from etendue import require
from etendue_camera.colour import matrices
from etendue_camera.export.container import ASCII, BYTE, LONG, RATIONAL, SHORT, SRATIONAL, UNDEFINED, Tag, write_picture

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from etendue_camera.arrays import FloatArray

COLOURS = "RGB"
# white of the profile connection space: ICC.1, and the DNG specification's forward matrices
D50_XYZ = (0.96422, 1.0, 0.82521)
OTHER_LIGHT = 255
LIGHTS = {"A": 17, "B": 18, "C": 19, "D55": 20, "D65": 21, "D75": 22, "D50": 23}  # EXIF LightSource
LARGEST_PERIOD = 8
FILTERS, LINEAR_RAW = 32803, 34892  # photometric interpretations
TOP = 2**31 - 1


@dataclass(frozen=True)
class RawFrame:
    """The content of a DNG for one frame. ``mask`` is one period of the filters, rows of R, G, B; None: no filters."""

    raw: NDArray[np.uint16]
    mask: tuple[str, ...] | None
    black: float
    white_level: int
    camera_white: NDArray[np.floating] | None = None  # camera signal of the scene white
    balanced_to_xyz: NDArray[np.floating] | None = None  # white-balanced camera RGB to XYZ, white Y = 1
    illuminant: str = ""
    exposure: float | None = None  # s
    f_number: float | None = None
    focal_length: float | None = None  # mm
    iso: float | None = None
    model: str = ""
    serial: str = ""
    description: str = ""
    software: str = "etendue"
    when: str = ""  # "YYYY:MM:DD hh:mm:ss"


def refusal(mask: tuple[str, ...] | None) -> str:
    """Return why a DNG cannot express a mask; '' if it can."""
    if mask is None:
        return ""
    others = sorted(set("".join(mask)) - set(COLOURS))
    if others:
        return f"raw converters support R, G, B only, not the filters {', '.join(others)}"
    if max(len(mask), len(mask[0])) > LARGEST_PERIOD:
        return f"the mask has a period of {len(mask)} x {len(mask[0])} pixels; the maximum is {LARGEST_PERIOD}"
    if set("".join(mask)) != set(COLOURS):
        return "the mask lacks one of R, G, B"
    return ""


def colour_matrices(camera_white: Any, balanced_to_xyz: Any) -> tuple[FloatArray, FloatArray]:
    """Return ``ColorMatrix1`` and ``ForwardMatrix1`` of the specification.

    Parameters
    ----------
    camera_white : (3,) array
        Camera signal of the scene white, in any scale, above 0.
    balanced_to_xyz : (3, 3) array
        White-balanced camera RGB to XYZ; the row sums are the white's XYZ.

    Returns
    -------
    (3, 3) array
        XYZ to camera, scaled so that the largest channel of the scene white is 1: diag(w / max w) M^-1.
    (3, 3) array
        White-balanced camera RGB to XYZ of D50 (Bradford from the scene white): the row sums are D50's.

    Raises
    ------
    ValueError
        If the white has a dead channel, or the matrix is singular.

    Notes
    -----
    DNG 1.4, "Mapping camera color space to CIE XYZ space". ColorMatrix1 times the white's XYZ is AsShotNeutral by
    construction, so that readers get the same white from either.
    """
    white, matrix = np.asarray(camera_white, float), np.asarray(balanced_to_xyz, float)
    require.allowed(
        white.shape == (3,) and np.all(white > 0) and np.all(np.isfinite(white)),
        "camera_white",
        white.tolist(),
        "three numbers above 0",
    )
    require.only(
        matrix.shape == (3, 3) and np.linalg.cond(matrix) < 1e9,
        "balanced_to_xyz",
        matrix.tolist(),
        "an invertible 3 x 3 matrix",
    )
    to_camera = (white / white.max())[:, None] * np.linalg.inv(matrix)
    return to_camera, matrices.von_kries_matrix(matrix.sum(axis=1), D50_XYZ, matrices.TRANSFORMS["bradford"]) @ matrix


def _ratios(values: ArrayLike, limit: int = 10**8) -> tuple[int, ...]:
    """Return alternating numerators and denominators, each in 32 bits; error below 1e-8 for values up to 20."""
    pairs = []
    for value in np.ravel(np.asarray(values, float)):
        ratio = Fraction(float(value)).limit_denominator(max(1, min(limit, int(TOP / max(abs(value), 1)))))
        pairs += [ratio.numerator, ratio.denominator]
    return tuple(pairs)


def tags(frame: RawFrame) -> list[Tag]:
    """Return the tags of the main directory, except the offset and the size of the samples."""
    rows, columns = frame.raw.shape
    found: list[Tag] = [
        (254, LONG, 0),  # the picture itself, no preview
        (256, LONG, columns),
        (257, LONG, rows),
        (258, SHORT, 16),
        (259, SHORT, 1),  # not compressed
        (262, SHORT, LINEAR_RAW if frame.mask is None else FILTERS),
        (271, ASCII, "etendue"),
        (272, ASCII, frame.model),
        (274, SHORT, 1),
        (277, SHORT, 1),
        (278, LONG, rows),
        (284, SHORT, 1),
        (305, ASCII, frame.software),
        (37398, BYTE, (1, 0, 0, 0)),  # TIFF/EP
        (50706, BYTE, (1, 4, 0, 0)),
        (50707, BYTE, (1, 4, 0, 0) if frame.mask is None else (1, 1, 0, 0)),  # the oldest version that reads it
        (50708, ASCII, f"etendue {frame.model}"),
        (50713, SHORT, (1, 1)),
        (50714, RATIONAL, _ratios(frame.black)),
        (50717, LONG, frame.white_level),
        (50718, RATIONAL, (1, 1, 1, 1)),
        (50719, LONG, (0, 0)),
        (50720, LONG, (columns, rows)),
        (50829, LONG, (0, 0, rows, columns)),
        (50781, BYTE, tuple(hashlib.blake2b(np.ascontiguousarray(frame.raw).tobytes(), digest_size=16).digest())),
    ]
    for code, text in ((270, frame.description), (306, frame.when), (50735, frame.serial)):
        found += [(code, ASCII, text)] if text else []
    if frame.mask is not None:
        to_camera, forward = colour_matrices(frame.camera_white, frame.balanced_to_xyz)
        neutral = np.asarray(frame.camera_white, float)
        found += [
            (33421, SHORT, (len(frame.mask), len(frame.mask[0]))),
            (33422, BYTE, tuple(COLOURS.index(letter) for letter in "".join(frame.mask))),
            (50710, BYTE, (0, 1, 2)),
            (50711, SHORT, 1),
            (50721, SRATIONAL, _ratios(to_camera)),
            (50728, RATIONAL, _ratios(neutral / neutral.max())),
            (50778, SHORT, LIGHTS.get(frame.illuminant, OTHER_LIGHT)),
            (50964, SRATIONAL, _ratios(forward)),
        ]
    return found


def exif(frame: RawFrame) -> list[Tag]:
    """Return the EXIF tags of the exposure, as far as known."""
    found: list[Tag] = [(36864, UNDEFINED, (48, 50, 51, 50))]  # EXIF 2.32
    for code, value in ((33434, frame.exposure), (33437, frame.f_number), (37386, frame.focal_length)):
        if value is not None and 1 / TOP < value < TOP:
            found.append((code, RATIONAL, _ratios(value, TOP)))
    if frame.iso is not None and 0.5 <= frame.iso < 65535:
        found.append((34855, SHORT, round(frame.iso)))
    if frame.when:
        found.append((36867, ASCII, frame.when))
    return found


def write(path: Path, frame: RawFrame) -> None:
    """Write one frame.

    Raises
    ------
    ValueError
        If raw is not (y, x) of uint16, the mask is not supported, colour filters lack white or matrix, or the levels
        are invalid.
    """
    require.that(
        frame.raw.ndim == 2 and frame.raw.dtype == np.uint16 and frame.raw.size,
        f"raw is {frame.raw.dtype} with shape {frame.raw.shape}; it must be (y, x) of uint16",
    )
    require.that(
        0 <= frame.black < frame.white_level <= 65535,
        f"black is {frame.black:g} and white_level {frame.white_level}; 0 <= black < white_level <= 65535 is required",
    )
    why = refusal(frame.mask)
    if why:
        raise ValueError(why)
    if frame.mask is not None and (frame.camera_white is None or frame.balanced_to_xyz is None):
        raise ValueError("colour filters require a white and a colour matrix")
    with open(path, "wb") as file:
        write_picture(file, np.ascontiguousarray(frame.raw, "<u2").tobytes(), tags(frame), exif(frame))
