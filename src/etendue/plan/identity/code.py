"""Digest the code that a stage depends on: everything its module imports, from any distribution, and the engine.

In:  the class of a stage.
Out: 128-bit BLAKE2b digests, in total and by module, so that a change can be named. Editing a kernel changes them;
     editing a report does not.

Imports are followed from file to file, including imports in functions and under conditions. A library that does not
depend on etendue is not followed: it counts as a whole, with its requirements. The same applies to a distribution with
an import that cannot be followed. The standard library, numpy and scipy belong to the platform, which is in the key
already; the engine's other libraries count by version.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from pkgutil import iter_modules
from types import FunctionType
from typing import TYPE_CHECKING, NamedTuple

from etendue.contract.arrays.dims import dim
from etendue.contract.capabilities import bands_of, is_transfer
from etendue.contract.stage import Stage, patterns_of, per_kind
from etendue.plan.identity import sources
from etendue.plan.identity.distributions import CODE, SITES, VERSIONED, Installed, owner_of, place_of, sha256, whole
from etendue.plan.identity.engine import ENGINE, TRANSFER_KERNELS, only_moves
from etendue.plan.identity.keys import digest
from etendue.plugins import discovery

if TYPE_CHECKING:
    from types import CellType

OWN = "etendue"
DOOR = (
    "api"  # a package's module of this name only re-exports: names taken from it are followed to where they are defined
)
IN_PLATFORM = {"numpy", "scipy"}


class Code(NamedTuple):
    """The code that a stage depends on."""

    sources: dict[str, str]  # digests by module, file or library
    libraries: frozenset[str]  # libraries that count by version


@per_kind
def code_digest(kind: type[Stage]) -> str:
    """Return the digest of the code of a stage and of the engine."""
    found = digest("\n".join(f"{name} {one}" for name, one in sorted(code_of(kind).sources.items())).encode())
    sources.keep()
    return found


def libraries_of(kind: type[Stage]) -> frozenset[str]:
    """Return the distributions whose versions are in the keys of a stage: the distributions that the stage names or
    imports.
    """
    return code_of(kind).libraries.union(kind.libraries)


@per_kind
def code_of(kind: type[Stage]) -> Code:
    """Return the digests of all code that can change the outputs of a stage."""
    # A method may come from any base class, and a decorated one may wrap a function of another module.
    roots = {module for base in kind.__mro__ for module in (base.__module__, *_modules_in(vars(base).values()))}
    if is_transfer(kind):
        roots.update(TRANSFER_KERNELS)
    found = _reached(roots)
    found.sources.update(_said_of(kind))
    if place_of(kind.__module__) is None:  # no file, as in a notebook: digest the class's own text
        found.sources[kind.__module__] = digest(_text_of(kind).encode())
    return Code({**engine(), **found.sources}, found.libraries)


def _said_of(kind: type[Stage]) -> Iterator[tuple[str, str]]:
    """Yield digests of the declarations in manifests for a stage's dims and fixed patterns. They determine at which
    band values the stage is evaluated and which patterns it receives.
    """
    if bands := bands_of(kind):
        yield f"the dim {bands}", digest(f"{dim(bands).factor!r}".encode())
    for name, identity in patterns_of(kind).items():
        yield f"the patterns {name}", digest(identity.encode())


@cache
def engine() -> dict[str, str]:
    """Return the digests of the engine's modules that can change a bit of a cell."""
    return {name: sources.known(_own_file(name) or Path(name)).digest for name in ENGINE}


@cache
def code_at(module: str) -> str:
    """Return the digest of a module of the package and of all its direct and indirect imports, including the engine's
    modules.
    """
    return digest(
        "\n".join(f"{name} {one}" for name, one in sorted({**engine(), **_reached([module]).sources}.items())).encode()
    )


def _modules_in(values: Iterable[object]) -> Iterator[str]:
    """Yield the modules of functions, of the functions that they wrap, and of functions called by a ``partial``."""
    for value in values:
        value = value.func if isinstance(value, partial) else getattr(value, "__func__", value)
        if isinstance(value, FunctionType):
            yield value.__module__
            yield from (
                inner.__module__ for cell in value.__closure__ or () if isinstance(inner := _inside(cell), FunctionType)
            )


def _inside(cell: CellType) -> object:
    try:
        return cell.cell_contents
    except ValueError:  # the closure cell is empty
        return None


def _text_of(kind: type[Stage]) -> str:
    try:
        return inspect.getsource(kind)
    except (OSError, TypeError):
        return kind.__module__


# ------------------------------------------------------------------------------------------------ following imports


@dataclass(frozen=True)
class _Step:
    """The contribution of one imported name to a digest, and the names that it imports."""

    sources: Mapping[str, str] = field(default_factory=dict)
    libraries: frozenset[str] = frozenset()
    behind: Iterable[str] = ()


def _reached(roots: Iterable[str]) -> Code:
    """Return the code of some modules and of all that they import, directly or indirectly."""
    found, libraries, seen, open_ = dict[str, str](), set[str](), set[str](), list(roots)
    while open_:
        name = open_.pop()
        if name in seen:
            continue
        seen.add(name)
        step = _step(name)
        found.update(step.sources)
        libraries |= step.libraries
        open_ += step.behind
    return Code(found, frozenset(libraries - IN_PLATFORM))


@cache
def _step(name: str) -> _Step:
    top, _, rest = name.partition(".")
    if top in sys.stdlib_module_names and top != "__main__":
        return _Step()
    if top in VERSIONED:
        return _Step(libraries=frozenset({VERSIONED[top]}))
    package = name.rpartition(".")[0]
    above = (package,) if rest else ()
    if top in discovery.own_packages():
        return _of_own(name, above)
    if name.endswith(".*"):
        place = place_of(package)
        return _Step(
            behind=(*above, *(f"{package}.{one.name}" for one in iter_modules(place.folders if place else ())))
        )
    return _of_others(name, above)


def _behind(name: str, file: Path, source: sources.SourceFile) -> Iterator[str]:
    """Yield the names that a module imports, as absolute names."""
    package = name if file.name.startswith("__init__.") else name.rpartition(".")[0]
    for one in source.imports:
        dots = len(one) - len(one.lstrip("."))
        if dots:
            base = package.rsplit(".", dots - 1)[0] if dots > 1 else package
            one = f"{base}.{one[dots:]}".removesuffix(".")
        yield one
    for one in source.classes:
        if one in _models():
            yield _models()[one]


def _of_own(name: str, above: tuple[str, ...]) -> _Step:
    top, _, rest = name.partition(".")
    if rest == DOOR or rest.startswith(f"{DOOR}."):
        return _Step(behind=tuple(_through_the_door(f"{top}.{DOOR}", rest.removeprefix(DOOR).removeprefix("."))))
    if only_moves(name) or name in ENGINE or name in manifests():
        return _Step()
    file = _own_file(name)
    if file is None:
        return _Step(behind=above)
    source = sources.known(file)
    if source.words:
        return _Step(behind=above)
    found = {name: source.digest}
    if source.beside:
        text = file.read_text(encoding="utf-8")
        data = sources.PACKAGE.parent / top / "data"
        tables = (path for path in (data.iterdir() if data.is_dir() else ()) if path.is_file() and path.name in text)
        found |= {f"{data.parent.name}/data/{path.name}": sources.known(path).digest for path in tables}
    return _Step(found, behind=(*above, *_behind(name, file, source)))


def _through_the_door(door: str, name: str) -> Iterator[str]:
    """Yield the place where a name that an ``api`` module re-exports is defined; for the module itself, the places of
    all its re-exports.
    """
    file = _own_file(door)
    for one in sources.known(file).imports if file else ():
        if name in ("", "*") or one.rpartition(".")[2] == name:
            yield one


@cache
def manifests() -> frozenset[str]:
    """Return the names of the manifest modules of this distribution."""
    return frozenset(point.module for point in discovery.installed().points if point.dist and point.dist.name == OWN)


@cache
def _own_file(module: str) -> Path | None:
    base = sources.PACKAGE.parent / Path(*module.split("."))
    above = _own_file(module.rpartition(".")[0]) if module.count(".") > 1 else None
    if above is not None and above.name != "__init__.py":
        return None  # the name is an attribute of a module, not a module
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


@cache
def _models() -> dict[str, str]:
    """Return the modules of this distribution's stages by class name, for code that takes classes from ``models``."""
    found = discovery.installed()
    brought = (found.first("stages", name) for name in found.names("stages"))
    places = (
        one.value for one in brought if one is not None and one.distribution == OWN and isinstance(one.value, str)
    )
    return {kind: module for module, _, kind in (place.partition(":") for place in places)}


# ------------------------------------------------------------------------------------------------ other distributions


def _of_others(name: str, above: tuple[str, ...]) -> _Step:
    place = place_of(name)
    if place is None or place.file is None:
        return _Step(behind=above)
    depth = name.count(".") - (not place.file.name.startswith("__init__."))
    top = place.file.parents[depth] if depth >= 0 else place.file  # the top-level package or module
    owner = owner_of(top)
    if owner is not None and not owner.knows_etendue:
        return _Step(*whole(owner))
    source = sources.known(place.file)
    found, libraries = {name: source.digest}, frozenset[str]()
    if source.hides and owner is not None:
        more, libraries = whole(owner)
        found |= more
    elif source.hides:
        found |= {path.relative_to(top.parent).as_posix(): sources.known(path).digest for path in _around(top)}
    found |= _data(place.file, top, owner, source)
    behind = tuple(_behind(name, place.file, source))
    if "etendue.api.labelled" in behind or "etendue.api.*" in behind:
        libraries |= {"xarray"}
    return _Step(found, libraries, (*above, *behind))


@cache
def _under(folder: Path) -> tuple[Path, ...]:
    """Return the files of a folder, except bytecode and hidden files."""
    found = []
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if (
            path.is_file()
            and path.suffix not in CODE[1:]
            and not any(part.startswith(".") or part == "__pycache__" for part in parts)
        ):
            found.append(path)
    return tuple(found)


def _around(top: Path) -> Iterator[Path]:
    """Yield the files of a top-level module or package and of its neighbours: the sources of a distribution that is
    run in place, not installed.
    """
    beside = [top] if top.parent.name in SITES else sorted(top.parent.iterdir())
    for path in beside:
        if path.is_dir() and (path == top or (path / "__init__.py").is_file()):
            yield from _under(path)
        elif path == top or (path.is_file() and path.suffix in (".py", ".so", ".pyd")):
            yield path


def _data(file: Path, top: Path, owner: Installed | None, source: sources.SourceFile) -> dict[str, str]:
    """Return the digests of non-code files that a module may read: all of its distribution or package; for a single
    module, the files next to it.
    """
    if owner is not None:
        return _data_of(owner)
    package = next(
        (
            folder
            for folder in reversed(file.parents)
            if folder.is_relative_to(top) and (folder / "__init__.py").is_file()
        ),
        None,
    )
    if package is not None:
        return _digests(_under(package), top.parent)
    if not source.beside or top.parent.name in SITES:
        return {}
    text = file.read_text(encoding="utf-8", errors="replace")
    beside = [path for path in file.parent.iterdir() if path.is_file() and not path.name.startswith(".")]
    named = (folder for folder in file.parent.iterdir() if folder.is_dir() and folder.name in text)
    return _digests((*beside, *(path for folder in named for path in _under(folder))), top.parent)


@cache
def _digests(paths: tuple[Path, ...], root: Path) -> dict[str, str]:
    """Return the digests of the files that are not code, by path relative to ``root``."""
    return {path.relative_to(root).as_posix(): sources.known(path).digest for path in paths if path.suffix not in CODE}


@cache
def _data_of(owner: Installed) -> dict[str, str]:
    site = owner.folder.parent
    return {
        path.relative_to(site).as_posix(): known or sha256(path)
        for path, known in owner.files()
        if path.suffix not in CODE
    }
