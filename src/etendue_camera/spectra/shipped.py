"""The shipped tables of colour-science, which avoid seconds of import time in every run.

In:  kind and name of a table.
Out: plain read-only float64 arrays, bit-identical to the library's own.

``data/spectra.npz`` contains them, built by ``python -m etendue_camera.spectra.build`` from the version of
colour-science recorded in it; a test compares all with the library. If another version is installed, its own tables are
used: they are read from the library once and then from the user's cache folder. Other names are looked up in the
library itself.
"""

import hashlib
import io
import zipfile
from collections.abc import Iterator
from functools import lru_cache
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np

from etendue import cache
from etendue.types.documents import Document
from etendue_camera.arrays import Array
from etendue_camera.spectra import authority
from etendue_camera.spectra.bins import FloatArray

VERSION = "colour-science"  # the file stores the version it was built from under this name
Arrays = dict[str, Array]


@lru_cache(maxsize=1)
def arrays() -> Arrays:
    """Return all shipped tables, for the installed version of colour-science."""
    data = (files("etendue_camera") / "data" / "spectra.npz").read_bytes()
    found = unpacked(data)
    version = authority.colour_version()
    if str(found[VERSION]) == version:
        return found
    # the key includes the code that rebuilds the tables
    key = f"{version} {digest_of(data + Path(authority.__file__).read_bytes())}"
    kept = cache.read("spectra", key)
    if kept is not None:
        try:
            return unpacked(kept)
        except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile):
            pass  # a damaged file is rebuilt
    found = made()
    cache.write("spectra", key, packed(found))
    return found


def made() -> Arrays:
    """Build all tables from the installed library."""
    return {VERSION: np.array(authority.colour_version()), **authority.everything()}


def packed(found: Arrays) -> bytes:
    """Return an uncompressed ``.npz``: the same bytes for the same arrays."""
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **found)
    return file.getvalue()


def unpacked(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        found = {name: file[name] for name in file.files}
    for array in found.values():
        array.setflags(write=False)
    return found


def digest_of(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


# ------------------------------------------------------------------------------------------------------ parts


@lru_cache(maxsize=16)
def _places(kind: str) -> Document:
    """Return the row, or the slice of rows, of every table of a kind, by name."""
    names = arrays()[f"{kind}/names"].tolist()
    if f"{kind}/sizes" not in arrays():
        return {name: place for place, name in enumerate(names)}
    ends = np.concatenate([[0], np.cumsum(arrays()[f"{kind}/sizes"])]).tolist()
    return {name: slice(*two) for name, two in zip(names, pairwise(ends), strict=True)}


def names(kind: str) -> Iterator[str]:
    yield from _places(kind)


def curve(kind: str, name: str, besides: str = "") -> tuple[FloatArray, FloatArray]:
    """Return wavelengths (rows,) in nm and values of a table: (rows,) for lights and reflectances, (rows, k) for tables
    with channels.

    Kinds: illuminant, camera and display as tabulated; smooth camera, observer, patch and basis at 1 nm.

    Raises
    ------
    ValueError
        For an unknown name; the message gives the nearest names.
    """
    place = _places(kind).get(name)
    rows = arrays()[f"{kind}/rows"][place] if place is not None else authority.rows(kind, name, besides)
    return rows[:, 0], rows[:, 1] if rows.shape[1] == 2 else rows[:, 1:]


def space(name: str) -> Document:
    """Return an RGB space, as `authority.space_of` does; unknown names raise ValueError."""
    place = _places("space").get(name)
    if place is None:
        return authority.space_of(name)
    return {word: arrays()[f"space/{word}"][place] for word in ("matrix", "primaries", "white", "white_name")}


def white(name: str) -> FloatArray | None:
    """Return the published chromaticity (2,) of an illuminant (1931 observer); None if none is published."""
    place = _places("white").get(name)
    return None if place is None else arrays()["white/xy"][place]


def adaptation(name: str) -> FloatArray:
    """Return the matrix from XYZ to sharpened cone responses, (3, 3); unknown names raise ValueError."""
    place = _places("adaptation").get(name)
    return authority.adaptation_of(name) if place is None else arrays()["adaptation/matrix"][place]
