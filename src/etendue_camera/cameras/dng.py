"""Read the camera data in a DNG file: levels, pattern, colour matrices, noise, shading and distortion of the lens.

In:  the content of a file; its picture is not decoded.
Out: ``Raw``.
Sources: Adobe, Digital Negative Specification 1.7.1 (2023), chapters 4 and 7; TIFF 6.0.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.types.documents import Document
from etendue_camera.arrays import FloatArray

MOST_TAGS, MOST_DIRECTORIES, MOST_VALUES = 4096, 64, 1 << 20
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_CODES = {3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 13: "I"}
_COLOURS = "RGBCMYW"
SUBS, MODEL, PATTERN_DIM, PATTERN = 330, 50708, 33421, 33422
BLACK, WHITE, NOISE = 50714, 50717, 51041
MATRICES, LIGHTS = (50721, 50722), (50778, 50779)
OPCODES = (51008, 51009, 51022)
ISO, EXIF = 34855, 34665
WARP_RECTILINEAR, VIGNETTE_RADIAL = 1, 3


@dataclass(frozen=True)
class Raw:
    """The camera data of a DNG; None or empty if the file has no such value.

    ``noise``: scale S and offset O of each plane: a value x from 0 to 1 has the variance S x + O. ``matrices``: by
    calibration illuminant (EXIF light source), from XYZ to the camera. ``warp``: (planes, 6) terms of WarpRectilinear;
    ``vignette``: five terms of FixVignetteRadial; ``other``: identifiers of opcodes that are not read.
    """

    model: str
    width: int
    height: int
    black: float | None
    white: float | None
    pattern: str
    iso: float | None
    noise: tuple[tuple[float, float], ...]
    matrices: tuple[tuple[int, FloatArray], ...]
    warp: FloatArray | None
    vignette: tuple[float, ...]
    other: tuple[int, ...]

    def full_scale(self) -> float | None:
        """Return the charge (electron) that gives the white level at the ISO of the file, 1/S of the plane with the
        least noise; None if the file has no noise profile.
        """
        return 1.0 / min(s for s, _ in self.noise) if self.noise else None

    def read_noise(self) -> float | None:
        """Return the read noise (electron) at the file's ISO: sqrt(O)/S."""
        if not self.noise:
            return None
        scale, offset = min(self.noise)
        return math.sqrt(max(offset, 0.0)) / scale

    def fall_off(self, r: FloatArray) -> FloatArray | None:
        """Return the relative illumination at r (r = 1 at the corner): the inverse of the gain of FixVignetteRadial."""
        if not self.vignette:
            return None
        square = r * r
        gain = np.ones_like(r)
        for power, term in enumerate(self.vignette, 1):
            gain = gain + term * square**power
        return 1.0 / gain

    def real(self, r: FloatArray) -> FloatArray | None:
        """Return the real heights (heights, planes) of ideal heights by WarpRectilinear, both in units of the corner's
        height.
        """
        if self.warp is None:
            return None
        square = r[:, None] ** 2
        k = self.warp[:, :4]
        return r[:, None] * (k[:, 0] + square * (k[:, 1] + square * (k[:, 2] + square * k[:, 3])))


def raw(data: bytes, name: str) -> Raw:
    """Return the camera data of a file's content.

    Raises
    ------
    ValueError
        If the content is not a DNG, or declares an impossible length; the message has one line.
    """
    try:
        if data[:2] not in (b"II", b"MM") or len(data) < 8:
            raise ValueError("it does not begin as a TIFF")
        order = "<" if data[:2] == b"II" else ">"
        if struct.unpack(f"{order}H", data[2:4])[0] != 42:
            raise ValueError("it is not a TIFF with 32-bit offsets")
        directories = list(_directories(data, order))
        merged: dict[int, Any] = {}
        for one in directories:
            merged = {**one, **merged}
        if MODEL not in merged:
            raise ValueError("it has no UniqueCameraModel")
        frame = next((one for one in directories if one.get(262, (0,))[0] == 32803), directories[0])
        own = {**merged, **frame}
        return Raw(
            model=_text(own[MODEL]),
            width=int(own.get(256, (0,))[0]),
            height=int(own.get(257, (0,))[0]),
            black=float(np.mean(own[BLACK])) if BLACK in own else None,
            white=float(min(own[WHITE])) if WHITE in own else None,
            pattern=_pattern(own),
            iso=float(own[ISO][0]) if ISO in own else None,
            noise=_noise(own.get(NOISE, ())),
            matrices=tuple(
                (int(own.get(light, (0,))[0]), np.array(own[tag], dtype=float).reshape(3, 3))
                for tag, light in zip(MATRICES, LIGHTS, strict=True)
                if len(own.get(tag, ())) == 9
            ),
            **_opcodes(own),
        )
    except (struct.error, IndexError, ValueError, OverflowError, ZeroDivisionError) as error:
        raise ValueError(f"{name} is not a DNG: {' '.join(str(error).split())[:160]}") from None


def _directories(data: bytes, order: str) -> Iterator[dict[int, Any]]:
    """Yield the tags of every directory, including directories that other directories refer to; each is read once."""
    todo, seen = [struct.unpack(f"{order}I", data[4:8])[0]], set[int]()
    while todo:
        place = todo.pop(0)
        if place == 0 or place in seen:
            continue
        seen.add(place)
        if len(seen) > MOST_DIRECTORIES:
            raise ValueError(f"it has more than {MOST_DIRECTORIES} directories")
        (count,) = struct.unpack_from(f"{order}H", data, place)
        if count > MOST_TAGS:
            raise ValueError(f"a directory has {count} tags")
        tags = {}
        for at in range(place + 2, place + 2 + 12 * count, 12):
            tag, kind, number = struct.unpack_from(f"{order}HHI", data, at)
            size = _SIZES.get(kind, 0) * number
            if not size or number > MOST_VALUES:
                continue
            start = at + 8 if size <= 4 else struct.unpack_from(f"{order}I", data, at + 8)[0]
            if start + size > len(data):
                raise ValueError(f"tag {tag} reaches beyond the end of the file")
            tags[tag] = _values(data, order, kind, number, start)
        yield tags
        todo += [int(one) for key in (SUBS, EXIF) for one in tags.get(key, ())][:MOST_DIRECTORIES]
        todo.append(struct.unpack_from(f"{order}I", data, place + 2 + 12 * count)[0])


def _values(data: bytes, order: str, kind: int, number: int, start: int) -> Any:
    if kind in (1, 2, 7):
        return data[start : start + number]
    if kind in (5, 10):
        pairs = struct.unpack_from(f"{order}{2 * number}{'I' if kind == 5 else 'i'}", data, start)
        return tuple(a / b if b else 0.0 for a, b in zip(pairs[::2], pairs[1::2], strict=True))
    return struct.unpack_from(f"{order}{number}{_CODES[kind]}", data, start)


def _text(value: bytes) -> str:
    text = value.split(b"\0")[0].decode("utf-8", "replace")
    return "".join(one for one in text if one.isprintable()).strip()[:100]


def _pattern(own: dict[int, Any]) -> str:
    """Return the letters of the colour filter array, with rows separated by / unless it is 2 x 2; '' if the file has
    none.
    """
    if PATTERN not in own:
        return ""
    rows, columns = (int(one) for one in own.get(PATTERN_DIM, (2, 2)))
    codes = list(own[PATTERN])
    if not 1 <= rows * columns == len(codes) <= 64 or max(codes) >= len(_COLOURS):
        raise ValueError("its CFAPattern has no known form")
    letters = "".join(_COLOURS[code] for code in codes)
    if (rows, columns) == (2, 2):
        return letters
    return "/".join(letters[i : i + columns] for i in range(0, len(letters), columns))


def _noise(values: Any) -> tuple[tuple[float, float], ...]:
    pairs = tuple(zip(values[::2], values[1::2], strict=True))
    if not all(math.isfinite(s) and math.isfinite(o) and s > 0 for s, o in pairs):
        raise ValueError("its NoiseProfile is not finite with scales above 0")
    return pairs


def _opcodes(own: dict[int, Any]) -> Document:
    """Return the opcodes that this module reads; their numbers are always big-endian."""
    warp, vignette, other = None, (), list[int]()
    for tag in OPCODES:
        block = bytes(own.get(tag, b""))
        if len(block) < 4:
            continue
        (count,), at = struct.unpack_from(">I", block), 4
        for _ in range(min(count, MOST_TAGS)):
            identifier, _, _, size = struct.unpack_from(">IIII", block, at)
            body = block[at + 16 : at + 16 + size]
            at += 16 + size
            if len(body) < size:
                raise ValueError("an opcode reaches beyond the end of its list")
            if identifier == WARP_RECTILINEAR:
                (planes,) = struct.unpack_from(">I", body)
                if not 1 <= planes <= 4:
                    raise ValueError(f"WarpRectilinear has {planes} planes")
                warp = np.array(struct.unpack_from(f">{6 * planes}d", body, 4)).reshape(planes, 6)
            elif identifier == VIGNETTE_RADIAL:
                vignette = struct.unpack_from(">5d", body)
            else:
                other.append(identifier)
    if not all(map(math.isfinite, vignette)) or (warp is not None and not np.isfinite(warp).all()):
        raise ValueError("an opcode has terms that are not finite")
    return {"warp": warp, "vignette": vignette, "other": tuple(other)}
