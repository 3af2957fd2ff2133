"""Read RawTherapee's ``camconst.json``: black and white levels, and the makers' colour matrices for D65.

In:  the content of the file, JSON with comments.
Out: ``Constants`` by camera name.
The file is under GPL-3. The user's own copy is read (Debian package ``rawtherapee-data``); this package contains none
of it.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.types.documents import Document
from etendue_camera.arrays import FloatArray
from etendue_camera.cameras.names import full_name

LICENCE = "GPL-3.0"
SOURCE = "camconst.json of RawTherapee (https://rawtherapee.com)"
_PARTS = re.compile(r'"(?:[^"\\\n]|\\.)*"|//[^\n]*|/\*.*?\*/', re.DOTALL)
_TRAILING = re.compile(r'("(?:[^"\\\n]|\\.)*")|,(?=\s*[\]}])')


@dataclass(frozen=True)
class Constants:
    """The values that the file has for a camera; None or empty if the file has no such value.

    ``matrix`` (3, 3) maps XYZ under D65 to the camera's channels; ``white`` is the white level (DN) at the base ISO,
    and ``by_iso`` holds pairs of ISO and white level.
    """

    black: float | None
    white: float | None
    by_iso: tuple[tuple[float, float], ...]
    matrix: FloatArray | None


def constants(data: bytes, name: str) -> dict[str, Constants]:
    """Return the constants of every camera by name.

    Raises
    ------
    ValueError
        If the content does not have this form; the message has one line.
    """
    try:
        text = data.decode("utf-8")
        text = _PARTS.sub(lambda found: found[0] if found[0].startswith('"') else " ", text)
        text = _TRAILING.sub(lambda found: found[1] or "", text)
        listed = json.loads(text)["camera_constants"]
        found: dict[str, Constants] = {}
        for entry in listed:
            makes = entry["make_model"]
            own = _entry(entry)
            for one in makes if isinstance(makes, list) else [makes]:
                maker, _, model = str(one).partition(" ")
                found[full_name(maker, model)] = own
        return found
    except KeyError as error:
        raise ValueError(f"{name} is not a camconst.json: {error} is missing") from None
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{name} is not a camconst.json: {' '.join(str(error).split())[:160]}") from None


def _entry(entry: Document) -> Constants:
    ranges = entry.get("ranges", {})
    black, _ = _levels(ranges.get("black"))
    white, by_iso = _levels(ranges.get("white"))
    matrix = entry.get("dcraw_matrix")
    if matrix is not None:
        if len(matrix) != 9:
            matrix = None  # of four channels
        else:
            matrix = np.array([_number(one) / 1e4 for one in matrix]).reshape(3, 3)
    return Constants(black, white, by_iso, matrix)


def _levels(value: Any) -> tuple[float | None, tuple[tuple[float, float], ...]]:
    """Return the level at the lowest ISO from 100 up, and the levels by ISO; if channels have different levels, the
    smallest one counts.
    """
    if value is None:
        return None, ()
    if not isinstance(value, list) or not value or not isinstance(value[0], dict):
        return _least(value), ()
    rows = []
    for one in value:
        isos = one.get("iso", 0)
        rows += [(_number(iso), _least(one["levels"])) for iso in (isos if isinstance(isos, list) else [isos])]
    rows.sort()
    return next((level for iso, level in rows if iso >= 100), rows[0][1]), tuple(rows)


def _least(value: Any) -> float:
    return min(_number(one) for one in (value if isinstance(value, list) else [value]))


def _number(value: Any) -> float:
    if isinstance(value, bool | str) or not math.isfinite(float(value)) or abs(float(value)) > 1e9:
        raise ValueError(f"expected a number, got {str(value)[:40]}")
    return float(value)
