"""The user's own copies of camera and lens databases, and an index of the lens database.

In:  the folders in which packages install databases, and ``ETENDUE_CAMERAS``: folders and files, separated as in
     ``PATH``.
Out: paths; mounts, cameras and lens names of the lens database with the file of each. The index is cached.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from etendue import cache
from etendue.types.documents import Document
from etendue_camera.cameras.lensfun import Camera, Database, read_database
from etendue_camera.cameras.names import full_name
from etendue_camera.field.lens_calibration import Lens

VARIABLE = "ETENDUE_CAMERAS"
INSTALL = "apt install liblensfun-data-v1, or pip install lensfunpy; ETENDUE_CAMERAS may name another copy of it"
_FORM = "3"  # version of the cached index
_PLACES = (
    "/usr/share/lensfun/version_2",
    "/usr/share/lensfun/version_1",
    "/usr/share/lensfun",
    "/usr/local/share/lensfun",
)
_UPDATES = "~/.local/share/lensfun/updates/version_1"


@dataclass(frozen=True)
class Index:
    """The lens database without its calibrations. ``lenses``: for each lens name, the files that contain its
    entries.
    """

    folder: Path
    mounts: dict[str, tuple[str, ...]]
    cameras: tuple[Camera, ...]
    lenses: dict[str, tuple[str, ...]]
    refused: tuple[tuple[str, str], ...]

    def source(self) -> str:
        """Return the source of an entry, without its path on this machine."""
        return "lensfun database (https://lensfun.github.io)"

    def entries(self, name: str) -> list[Lens]:
        """Return all entries of a lens name, each with the mounts of the bodies that take it."""
        whole = read_database(self.folder / file for file in self.lenses[name])
        every = Database(mounts=self.mounts)
        own = [one for one in whole.lenses if full_name(one.maker, one.model) == name]
        return [Lens(**{**vars(one), "fits": every.bodies_of(one.mounts)}) for one in own]


def given_files(suffix: str, name: str = "") -> Iterator[Path]:
    """Yield the files with this suffix or name that ``ETENDUE_CAMERAS`` lists, or that lie in a folder it lists."""
    for text in os.environ.get(VARIABLE, "").split(os.pathsep):
        path = Path(text).expanduser()
        if not text:
            continue
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        yield from (one for one in inside if one.suffix == suffix and (not name or one.name == name) and one.is_file())


def installed_files(*places: str) -> list[Path]:
    """Return the paths at which packages install their files; no path if ``ETENDUE_CAMERAS`` is ``none``."""
    return [] if os.environ.get(VARIABLE) == "none" else [Path(text).expanduser() for text in places]


def lens_folder() -> Path | None:
    """Return the folder with the lens database; None if there is none."""
    own = next((path.parent for path in given_files(".xml")), None)
    if own is not None or os.environ.get(VARIABLE) == "none":
        return own
    for folder in installed_files(_UPDATES, *_PLACES):
        if folder.is_dir() and next(folder.glob("*.xml"), None):
            return folder
    try:
        found = importlib.util.find_spec("lensfunpy")
    except (ImportError, ValueError):
        return None
    for place in (found.submodule_search_locations or ()) if found else ():
        if (Path(place) / "db_files").is_dir():
            return Path(place) / "db_files"
    return None


def lens_index() -> Index | None:
    """Return the index of the lens database; None if there is none.

    Raises
    ------
    ValueError
        If one of its files cannot be read.
    """
    folder = lens_folder()
    if folder is None:
        return None
    states = tuple((path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in sorted(folder.glob("*.xml")))
    return _index(folder, states)


@lru_cache(4)
def _index(folder: Path, states: tuple[tuple[str, int, int], ...]) -> Index:
    key = hashlib.sha256(repr((_FORM, str(folder), states)).encode()).hexdigest()
    kept = cache.read("cameras", f"{key}.json")
    document: Document | None = None
    try:
        document = json.loads(kept) if kept else None
    except ValueError:
        pass
    if document is None:
        document = _document(folder, [name for name, _, _ in states])
        cache.write("cameras", f"{key}.json", json.dumps(document).encode())
    return Index(
        folder,
        {name: tuple(others) for name, others in document["mounts"].items()},
        tuple(
            Camera(maker, model, mount, crop, tuple(also)) for maker, model, mount, crop, also in document["cameras"]
        ),
        {name: tuple(files) for name, files in document["lenses"].items()},
        tuple((name, why) for name, why in document["refused"]),
    )


def _document(folder: Path, files: list[str]) -> Document:
    mounts: dict[str, tuple[str, ...]] = {}
    cameras: list[list[object]] = []
    lenses: dict[str, list[str]] = {}
    refused: list[tuple[str, str]] = []
    for file in files:
        part = read_database([folder / file])
        mounts |= part.mounts
        cameras += [[one.maker, one.model, one.mount, one.crop_factor, one.also] for one in part.cameras]
        refused += part.refused
        for name in dict.fromkeys(full_name(one.maker, one.model) for one in part.lenses):
            lenses.setdefault(name, []).append(file)
    return {"mounts": mounts, "cameras": cameras, "lenses": lenses, "refused": refused}
