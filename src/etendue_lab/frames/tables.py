"""Lists of frames: the CSV table of a measurement, and the descriptor of the EMVA reference sets.

In:  a text file that names frames, relative to its own folder.
Out: lines: name of the file, exposure time (s), photons or relative light.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from dataclasses import dataclass
from pathlib import Path

from etendue import plain_files
from etendue.errors import RequestError
from etendue_lab.frames.frame_set import MOST_FRAMES

COLUMNS = "file, time_s, photons or relative_light, kind (light or dark)"


@dataclass(frozen=True)
class Line:
    """One frame of a list."""

    file: Path
    time: float
    light: float
    number: int  # line number in the table


def _text(path: Path) -> str:
    try:
        return plain_files.table(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise RequestError(f"{path}: is not a text in UTF-8") from None
    except (OSError, ValueError) as error:
        raise RequestError(f"{path}: {getattr(error, 'strerror', None) or error}") from None


def read_csv(path: Path) -> tuple[list[Line], bool]:
    """Read a table with the columns `COLUMNS`; return its lines, and whether light is in photons.

    A line names one file or, by ``*``, ``?`` or a folder, all frames of one exposure. A line of the kind ``dark`` needs
    no light. Without the column ``kind``, frames with light 0 are dark. Without a column of light, the exposure time is
    used as relative light (constant lamp).
    """
    table = csv.DictReader(line for line in io.StringIO(_text(path)) if line.strip() and not line.startswith("#"))
    names = {name.strip().lower(): name for name in table.fieldnames or []}
    if "file" not in names or not {"time_s", "photons", "relative_light"} & set(names):
        raise RequestError(f"{path}: starts with {', '.join(names) or 'nothing'}; expected the columns {COLUMNS}")
    photons, found = "photons" in names, []
    light_name = "photons" if photons else "relative_light"
    for number, row in enumerate(table, 2):

        def number_of(name: str, where: int = number, own: dict[str, str] = row) -> float:
            text = (own.get(names.get(name, "")) or "").strip()
            if not text:
                return math.nan
            try:
                return float(text)
            except ValueError:
                raise RequestError(f"{path}, line {where}: {name} is {text[:30]!r}; expected a number") from None

        kind = (row.get(names.get("kind", "")) or "").strip().lower()
        if kind not in ("", "light", "dark"):
            raise RequestError(f"{path}, line {number}: kind is {kind[:30]!r}; expected light or dark")
        time, light = number_of("time_s"), number_of(light_name)
        if kind == "dark":
            light = 0.0
        elif light_name not in names:
            light = time
        if math.isnan(light):
            raise RequestError(f"{path}, line {number}: has no {light_name}, and is not dark")
        found += [Line(file, time, light, number) for file in _named(path, row[names["file"]], number)]
    return found, photons


def read_descriptor(path: Path) -> tuple[list[Line], bool]:
    """Read the descriptor of an EMVA reference set: lines ``b TIME_NS PHOTONS`` (light) and ``d TIME_NS`` (dark), each
    followed by lines ``i FILE``; other lines describe the camera.
    """
    found: list[Line] = []
    exposure: tuple[float, float] | None = None
    for number, text in enumerate(_text(path).splitlines(), 1):
        parts = text.split()
        if not parts or parts[0].startswith("#"):
            continue
        if parts[0] in ("b", "d"):
            try:
                time = float(parts[1]) * 1e-9
                exposure = (time, float(parts[2]) if parts[0] == "b" else 0.0)
            except (IndexError, ValueError):
                raise RequestError(
                    f"{path}, line {number}: {text.strip()[:60]!r}; expected b TIME_NS PHOTONS or d TIME_NS"
                ) from None
        elif parts[0] == "i" and len(parts) > 1:
            if exposure is None:
                raise RequestError(f"{path}, line {number}: a file is named before its exposure (a line b or d)")
            name = text.split(None, 1)[1].strip().replace("\\", "/")
            found.append(Line(_beside(path, name, number), *exposure, number))
    if not found:
        raise RequestError(f"{path}: names no frames; a descriptor has lines b TIME_NS PHOTONS, d TIME_NS, i FILE")
    return found, True


def _named(path: Path, name: str | None, number: int) -> list[Path]:
    """Return the file of a line, or all files that match a name with ``*`` or ``?`` or lie in a folder."""
    file = _beside(path, name, number)
    if file.is_dir():
        found = [one for one in file.iterdir() if one.is_file() and not one.name.startswith(".")]
    elif not file.exists() and any(sign in file.name for sign in "*?"):
        found = list(itertools.islice(path.parent.glob(str(file.relative_to(path.parent))), MOST_FRAMES))
    else:
        return [file]
    if not found:
        raise RequestError(f"{path}, line {number}: no file matches, or lies in, {str(name).strip()[:60]!r}")
    return sorted(found)


def _beside(path: Path, name: str | None, number: int) -> Path:
    text = (name or "").strip()
    if not text or Path(text).is_absolute() or ".." in Path(text).parts:
        raise RequestError(
            f"{path}, line {number}: the file {text[:60]!r} must be named relative to the table's folder"
        )
    return path.parent / text
