"""Files of lenses: all calibrations that a database has for one lens name, with their source and licence.

In:  a path.
Out: ``LensFile``, cached until the file changes.
The file is JSON. An archive keeps a copy, so it can be recomputed without the database.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from etendue import plain_files
from etendue.contract.stage import file_state
from etendue.types.documents import DocumentView
from etendue_camera.field.lens_calibration import MODELS, Lens, Point

FORM = "etendue lens 1"
ENDING = ".lens"


@dataclass(frozen=True)
class LensFile:
    """All entries of one lens name, with their source and licence."""

    name: str
    source: str
    licence: str
    entries: tuple[Lens, ...]

    def text(self) -> str:
        """Return the text of the file; equal lenses have equal texts."""
        document = {
            "form": FORM,
            "name": self.name,
            "source": self.source,
            "licence": self.licence,
            "entries": [asdict(one) for one in self.entries],
        }
        return json.dumps(document, indent=None, separators=(", ", ": "), ensure_ascii=False) + "\n"


def lens_file(path: str) -> LensFile:
    """Return the lens in a file.

    Raises
    ------
    ValueError
        If the file cannot be read, or a value is missing, has the wrong type, is not finite or is out of range.
    """
    return _read(path, file_state(path))


@lru_cache(maxsize=256)
def _read(path: str, state: tuple[int, int]) -> LensFile:
    try:
        document = json.loads(plain_files.table(path))
        if document["form"] != FORM:
            raise ValueError(f"form is {document['form']!r}, expected {FORM!r}")
        entries = tuple(_lens(one) for one in document["entries"])
        if not 1 <= len(entries) <= 64:
            raise ValueError(f"{len(entries)} entries; expected 1 to 64")
        name, source, licence = (_text(document[key]) for key in ("name", "source", "licence"))
        return LensFile(name, source, licence, entries)
    except OSError as error:
        raise ValueError(f"{Path(path).name}: cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
        raise ValueError(f"{Path(path).name} is not a lens file: {what}") from None


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > 400:
        raise ValueError(f"expected text, got {str(value)[:40]!r}")
    return value


def _numbers(values: Any, count: int, low: float = -1e6, high: float = 1e6) -> tuple[float, ...]:
    found = tuple(float(value) for value in values if not isinstance(value, bool | str))
    if len(found) != count or not all(math.isfinite(one) and low <= one <= high for one in found):
        raise ValueError(f"expected {count} numbers from {low:g} to {high:g}, got {str(values)[:60]}")
    return found


def _lens(one: DocumentView) -> Lens:
    pairs = {kind: tuple(_point(kind, point) for point in one[kind]) for kind in MODELS}
    crop, aspect = _numbers((one["crop_factor"], one["aspect"]), 2, 0.05, 100.0)
    low, high = _numbers(one["focal"], 2, 1e-3, 1e5)
    wide, narrow = _numbers(one["aperture"], 2, 0.0, 1e4)
    return Lens(
        _text(one["maker"]),
        _text(one["model"]),
        tuple(map(_text, one["mounts"])),
        tuple(map(_text, one["fits"])),
        crop,
        aspect,
        (low, high),
        (wide, narrow),
        **pairs,
    )


def _point(kind: str, one: DocumentView) -> Point:
    model = _text(one["model"])
    if model not in MODELS[kind]:
        raise ValueError(f"{kind} has a model {model!r}; known are {', '.join(MODELS[kind])}")
    (focal,) = _numbers((one["focal"],), 1, 1e-3, 1e5)
    lowest = 1e-3 if kind == "vignetting" else 0.0
    aperture, distance = _numbers((one["aperture"], one["distance"]), 2, lowest, 1e6)
    return Point(model, _numbers(one["terms"], MODELS[kind][model]), focal, aperture, distance)
