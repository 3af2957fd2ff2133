"""Locate the code of other distributions: find the files of modules as an import would, without importing, and the
distribution they belong to.

In:  names of modules, paths of their files.
Out: paths; ``Installed`` for an installed distribution, with the files and digests of its record.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.machinery import ModuleSpec
from pathlib import Path

from etendue.plan.identity.keys import digest

# Libraries that the engine itself depends on, by the name under which they are imported; each counts by its version.
VERSIONED = {
    "PIL": "pillow",
    "colour": "colour-science",
    "dask": "dask",
    "distributed": "distributed",
    "h5py": "h5py",
    "matplotlib": "matplotlib",
    "numcodecs": "numcodecs",
    "numpy": "numpy",
    "pandas": "pandas",
    "scipy": "scipy",
    "tifffile": "tifffile",
    "xarray": "xarray",
    "zarr": "zarr",
}
SITES = ("site-packages", "dist-packages")  # folders shared by many distributions
CODE = (".py", ".pyc", ".pyo")
_OF_ETENDUE = re.compile(r"^Requires-Dist: *etendue(?![\w.-])", re.MULTILINE)
_REQUIRED = re.compile(r"^Requires-Dist: *([\w.-]+)([^\n]*)", re.MULTILINE)


@dataclass(frozen=True)
class ModulePlace:
    """The location of a module: its file (None for a namespace package) and the folders of its submodules (empty unless
    it is a package).
    """

    file: Path | None
    folders: tuple[str, ...] = ()


@cache
def place_of(module: str) -> ModulePlace | None:
    """Return the place where an import would find a module; None if it does not exist or has no file."""
    loaded = sys.modules.get(module)
    spec = getattr(loaded, "__spec__", None)
    if spec is None and getattr(loaded, "__file__", None):  # a script
        return ModulePlace(Path(str(loaded.__file__)))  # type: ignore[union-attr]
    spec = spec or _spec_of(module)
    if spec is None:
        return None
    folders = tuple(spec.submodule_search_locations or ())
    file = Path(spec.origin) if spec.origin and spec.has_location else None
    if file is not None and not file.is_file():  # inside a zip archive: take the archive itself
        file = next((above for above in file.parents if above.is_file()), None)
    return ModulePlace(file, folders) if file or folders else None


def _spec_of(module: str) -> ModuleSpec | None:
    """Return the spec from the first finder that knows a module; its parent packages are located first."""
    package = module.rpartition(".")[0]
    within = place_of(package) if package else None
    if package and (within is None or not within.folders):
        return None
    for finder in sys.meta_path:
        try:
            spec = finder.find_spec(module, list(within.folders) if within else None)
        except Exception:  # a third-party finder may raise anything
            continue
        if spec is not None:
            return spec
    return None


# ------------------------------------------------------------------------------------------- installed distributions


@dataclass(frozen=True)
class Installed:
    """An installed distribution, by its metadata folder."""

    folder: Path

    @cached_property
    def metadata(self) -> str:
        try:
            return (self.folder / "METADATA").read_text(encoding="utf-8", errors="replace").partition("\n\n")[0]
        except OSError:
            return ""

    @cached_property
    def knows_etendue(self) -> bool:
        """Whether the distribution requires etendue or provides plugins for it. If so, the code that a stage imports
        from it is followed file by file.
        """
        points = self.folder / "entry_points.txt"
        return bool(_OF_ETENDUE.search(self.metadata)) or (
            points.is_file() and "[etendue]" in points.read_text(encoding="utf-8")
        )

    def files(self) -> Iterator[tuple[Path, str]]:
        """Yield the files of the distribution outside its metadata, each with its digest from the installation's
        record; '' if the record has no digest, or the file is newer than the record.
        """
        record, site = self.folder / "RECORD", self.folder.parent
        since = record.stat().st_mtime_ns
        with record.open(encoding="utf-8", newline="") as file:
            for path, known, *_ in csv.reader(file):
                if (
                    path.startswith(("..", "/", self.folder.name + "/"))
                    or "__pycache__" in path.split("/")
                    or path.endswith(CODE[1:])
                ):
                    continue
                place = site / path
                try:
                    newer = os.stat(place).st_mtime_ns > since
                except OSError:
                    continue
                yield place, "" if newer else known

    @cached_property
    def digest(self) -> str:
        """The digest of all its files."""
        lines = sorted(
            f"{path.relative_to(self.folder.parent).as_posix()} {known or sha256(path)}" for path, known in self.files()
        )
        return digest("\n".join(lines).encode())

    @cached_property
    def requires(self) -> tuple[str, ...]:
        """The distributions that it requires, without extras, by normalised name."""
        return tuple(
            sorted(
                {
                    _plain(name)
                    for name, rest in _REQUIRED.findall(self.metadata)
                    if "extra" not in rest.partition(";")[2]
                }
            )
        )


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file in the form of a RECORD."""
    with path.open("rb") as file:
        return "sha256=" + base64.urlsafe_b64encode(hashlib.file_digest(file, "sha256").digest()).rstrip(b"=").decode()


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "_", name).lower()


@cache
def _metadata_in(site: Path) -> dict[str, Path]:
    """Return the metadata folders in a folder of the path, by normalised name of the distribution."""
    return {
        _plain(path.name.partition("-")[0]): path
        for path in sorted(site.glob("*.dist-info"))
        if (path / "RECORD").is_file()
    }


@cache
def owner_of(top: Path) -> Installed | None:
    """Return the installed distribution that placed this file or folder; None if the code is run or edited in place."""
    every = _metadata_in(top.parent)
    name, first = top.name.encode(), _plain(top.name.partition(".")[0])
    # The distribution of the same name first: it is nearly always the owner, and saves reading the other records.
    for plain in sorted(every, key=lambda plain: plain != first):
        record = b"\n" + (every[plain] / "RECORD").read_bytes()
        if b"\n" + name + (b"," if top.is_file() else b"/") in record:
            return Installed(every[plain])
    return None


@cache
def whole(one: Installed) -> tuple[dict[str, str], frozenset[str]]:
    """Return digests, by name and version, of a distribution and all its requirements; libraries of the engine are
    included by name only.
    """
    found, libraries, open_ = dict[str, str](), set[str](), [one]
    versioned = {_plain(name): name for name in VERSIONED.values()}
    while open_:
        each = open_.pop()
        title = each.folder.name.removesuffix(".dist-info").replace("-", " ")
        if title in found:
            continue
        found[title] = each.digest
        beside = _metadata_in(each.folder.parent)
        libraries |= {versioned[name] for name in each.requires if name in versioned}
        open_ += [
            Installed(beside[name])
            for name in each.requires
            if name in beside and name not in versioned and name != "etendue"
        ]
    return found, frozenset(libraries)
