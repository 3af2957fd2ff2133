"""Where the code of others stands: files of modules, found as an import finds them and without importing, and the
distribution they are of.

In:  names of modules, paths of their files.
Out: paths; ``Installed`` for what an installer has put in its place, whose files and digests stand in its record.
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

# Libraries that the engine itself depends on, by the name under which they are imported: each counts by its version.
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
SITES = ("site-packages", "dist-packages")  # folders that hold the distributions of many
CODE = (".py", ".pyc", ".pyo")
_OF_ETENDUE = re.compile(r"^Requires-Dist: *etendue(?![\w.-])", re.MULTILINE)
_REQUIRED = re.compile(r"^Requires-Dist: *([\w.-]+)([^\n]*)", re.MULTILINE)


@dataclass(frozen=True)
class ModulePlace:
    """Where a module stands: its file, none of a namespace; the folders of its submodules, none of what is no
    package.
    """

    file: Path | None
    folders: tuple[str, ...] = ()


@cache
def place_of(module: str) -> ModulePlace | None:
    """Where an import would find a module; None where there is none, and for what is no file."""
    loaded = sys.modules.get(module)
    spec = getattr(loaded, "__spec__", None)
    if spec is None and getattr(loaded, "__file__", None):  # a script
        return ModulePlace(Path(str(loaded.__file__)))  # type: ignore[union-attr]
    spec = spec or _spec_of(module)
    if spec is None:
        return None
    folders = tuple(spec.submodule_search_locations or ())
    file = Path(spec.origin) if spec.origin and spec.has_location else None
    if file is not None and not file.is_file():  # in an archive of modules
        file = next((above for above in file.parents if above.is_file()), None)
    return ModulePlace(file, folders) if file or folders else None


def _spec_of(module: str) -> ModuleSpec | None:
    """What the first finder that knows a module says of it; its packages are asked first."""
    package = module.rpartition(".")[0]
    within = place_of(package) if package else None
    if package and (within is None or not within.folders):
        return None
    for finder in sys.meta_path:
        try:
            spec = finder.find_spec(module, list(within.folders) if within else None)
        except Exception:  # of a finder that somebody has put there
            continue
        if spec is not None:
            return spec
    return None


# ------------------------------------------------------------------------------------------- what is installed


@dataclass(frozen=True)
class Installed:
    """A distribution in a folder of the path, by its folder of metadata."""

    folder: Path

    @cached_property
    def metadata(self) -> str:
        try:
            return (self.folder / "METADATA").read_text(encoding="utf-8", errors="replace").partition("\n\n")[0]
        except OSError:
            return ""

    @cached_property
    def knows_etendue(self) -> bool:
        """Whether it builds upon etendue, or brings something: what of it a stage reaches is followed file by file."""
        points = self.folder / "entry_points.txt"
        return bool(_OF_ETENDUE.search(self.metadata)) or (
            points.is_file() and "[etendue]" in points.read_text(encoding="utf-8")
        )

    def files(self) -> Iterator[tuple[Path, str]]:
        """What it has put beside its metadata, with the digests of the record; '' where that has none, or the file
        is newer.
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
        """Of all its files."""
        lines = sorted(
            f"{path.relative_to(self.folder.parent).as_posix()} {known or sha256(path)}" for path, known in self.files()
        )
        return digest("\n".join(lines).encode())

    @cached_property
    def requires(self) -> tuple[str, ...]:
        """The distributions that it requires, extras aside, as they are named."""
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
    """As a record has it."""
    with path.open("rb") as file:
        return "sha256=" + base64.urlsafe_b64encode(hashlib.file_digest(file, "sha256").digest()).rstrip(b"=").decode()


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "_", name).lower()


@cache
def _metadata_in(site: Path) -> dict[str, Path]:
    """The folders of metadata in a folder of the path, by the plain name of the distribution."""
    return {
        _plain(path.name.partition("-")[0]): path
        for path in sorted(site.glob("*.dist-info"))
        if (path / "RECORD").is_file()
    }


@cache
def owner_of(top: Path) -> Installed | None:
    """The distribution that an installer has put into a folder of the path with something of this name; None of what
    is edited in place.
    """
    every = _metadata_in(top.parent)
    name, first = top.name.encode(), _plain(top.name.partition(".")[0])
    for plain in sorted(every, key=lambda plain: plain != first):
        record = b"\n" + (every[plain] / "RECORD").read_bytes()
        if b"\n" + name + (b"," if top.is_file() else b"/") in record:
            return Installed(every[plain])
    return None


@cache
def whole(one: Installed) -> tuple[dict[str, str], frozenset[str]]:
    """Digests, by name and version, of a distribution and of all that it requires; libraries of the engine among
    that by their name.
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
