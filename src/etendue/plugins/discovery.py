"""The contributions of installed distributions, by name: stages, variables, shared quantities, roles, and further
vocabularies.

In:  entry points of the group ``etendue``, one manifest module per distribution, called through pluggy's hooks
     (``hookspecs``).
Out: the value under a name and the distribution that provides it. A broken manifest provides nothing, and the reason is
     given where one of its names is not found.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, fields
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import pluggy

from etendue.errors import PluginError, nearest
from etendue.interrupts import is_ours
from etendue.plugins import hookspecs
from etendue.plugins.guests import Guest
from etendue.process import FOLDER, return_to
from etendue.telling import said

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

HOOKS = tuple(name.removeprefix("etendue_") for name in vars(hookspecs) if name.startswith("etendue_"))
_LINE = re.compile(r"^(Name|Version):[ \t]*(\S+)[ \t]*$", re.MULTILINE)
OWN = "etendue"  # searched first: most names are its own
_Form = TypeVar("_Form")


@dataclass(frozen=True)
class Brought:
    """The value that a distribution provides under a name."""

    value: Any
    distribution: str
    version: str

    @property
    def origin(self) -> str:
        return f"{self.distribution} {self.version}"


@contextmanager
def foreign(what: str, guest: str = "") -> Iterator[None]:
    """Enclose import or call of a distribution's code: all its exceptions become ``PluginError``, and the working
    directory is restored.

    ``guest``: the name of foreign code, if it does not belong to etendue itself.
    """
    who, folder = FOLDER.begin()
    try:
        with Guest(guest) if guest else nullcontext():
            yield
    except BaseException as error:  # includes SystemExit: a module must not end the process at import
        if is_ours(error):
            raise
        raise PluginError(f"{what}: {' '.join(said(error).split())[:300]}") from error
    finally:
        FOLDER.end(who, lambda: return_to(folder))  # later relative paths of the request must resolve as before


def named(distribution: Distribution) -> tuple[str, str]:
    """Return name and version of a distribution, '' if unknown. They are read from the first lines of its metadata,
    which is faster than parsing all of it.
    """
    head = (distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or "").partition("\n\n")[0]
    found = dict(_LINE.findall(head))
    if found.keys() >= {"Name", "Version"}:
        return found["Name"].strip(), found["Version"].strip()
    return distribution.metadata["Name"] or "", distribution.metadata["Version"] or ""


class Discovery:
    """All vocabularies of some entry points. Built once per process by ``installed``; tests may build their own."""

    def __init__(self, points: Iterable[EntryPoint], former: Iterable[EntryPoint] = ()) -> None:
        known: dict[tuple[str, str], tuple[EntryPoint, str, str]] = {}
        for point in points:
            name, version = named(point.dist) if point.dist else ("?", "?")
            known.setdefault((name, point.value), (point, name, version))  # a folder may occur twice on the path
        self.points = [point for point, _, _ in known.values()]
        self._known = sorted(known.values(), key=lambda one: (one[1] != OWN, one[1], one[0].value))
        self._former = tuple(former)
        mine = (point.value for point, name, _ in self._known if name == OWN)
        self.own_packages = frozenset({OWN, *(value.partition(":")[0].partition(".")[0] for value in mine)})
        self._manager = pluggy.PluginManager(hookspecs.PROJECT)
        self._manager.add_hookspecs(hookspecs)
        self._lock = threading.Lock()
        self._answers: dict[tuple[str, str, str], dict[str, Brought]] = {}
        self._broken: dict[tuple[str, str, str], str] = {}
        self._declared: set[str] = set()  # vocabularies declared by manifests read so far

    def first(self, what: str, name: str) -> Brought | None:
        """Return what the first distribution provides under a name, without reading further manifests."""
        return next((answer[name] for answer in self._answered(what) if name in answer), None)

    def all(self, what: str, name: str) -> tuple[Brought, ...]:
        """Return what each distribution provides under a name."""
        return tuple(answer[name] for answer in self._answered(what) if name in answer)

    def names(self, what: str) -> list[str]:
        """Return all names, in the order in which they are provided."""
        return list(dict.fromkeys(name for answer in self._answered(what) for name in answer))

    def clash(self, what: str, name: str) -> str:
        """Return the fault of a name that several distributions provide; '' if only one does."""
        brought = self.all(what, name)
        return (
            f"provided by {' and '.join(one.distribution for one in brought)}; uninstall one of them"
            if len(brought) > 1
            else ""
        )

    def missed(self, what: str, name: str) -> str:
        """Return the end of a message, '; ...', with possible reasons why no distribution provides a name: broken
        manifests, or manifests in the form of earlier versions.
        """
        former = [point for point in self._former if point.name == name] if what == "stages" else []
        said = [_former_text(point) for point in former[:1]] or [
            text for (_, _, of), text in list(self._broken.items()) if of in ("", what)
        ]
        return "".join(f"; {text}" for text in dict.fromkeys(said))

    def notes(self) -> list[str]:
        """Return a line per distribution that provides nothing, or less than intended, with the reason."""
        for what in HOOKS:
            self.names(what)
        former = {point.dist.name if point.dist else "?": _former_text(point) for point in self._former}
        return [*dict.fromkeys(self._broken.values()), *former.values()]

    def _answered(self, what: str) -> Iterator[dict[str, Brought]]:
        for point, distribution, version in self._known:
            key = (distribution, point.value, what)
            if key not in self._answers:
                try:
                    module = self._module(point, f"{distribution} {version}", key)
                    if module is None:
                        continue
                    self._answers[key] = self._asked(module, what, distribution, version)
                except PluginError as error:
                    self._answers[key] = {}
                    self._broken.setdefault(key, str(error))
            yield self._answers[key]

    def _module(self, point: EntryPoint, origin: str, key: tuple[str, str, str]) -> ModuleType | None:
        """Return the registered manifest; None if it is being imported and its own code looks up a name."""
        broken = (*key[:2], "")
        if broken in self._broken:
            raise PluginError(self._broken[broken])
        plugin = f"{origin} {point.value}"
        guest = "" if key[0] == OWN else f"{origin}, when it was imported,"
        with self._lock:  # not while its hooks are being registered
            known: ModuleType | None = self._manager.get_plugin(plugin)
        if known is not None:
            return known
        module: Any = None
        try:
            # Load the entry point here: pluggy's own loader goes through all distributions, and a broken one would
            # break all.
            with foreign(f"{origin} cannot be read: its manifest {point.value}", guest):
                module = point.load()
                if getattr(getattr(module, "__spec__", None), "_initializing", False):
                    return None
                with self._lock:
                    if not self._manager.is_registered(module):
                        self._manager.register(module, plugin)
                        self._refuse_unknown(module)
        except PluginError as error:
            if module is not None and self._manager.is_registered(module):
                self._manager.unregister(module)
            self._broken[broken] = str(error)
            raise
        if not self._manager.get_hookcallers(module):
            self._broken[broken] = (
                f"{origin} cannot be read: its manifest {point.value} has no @hookimpl of {hookspecs.PROJECT}"
            )
            raise PluginError(self._broken[broken])
        found: ModuleType = module
        return found

    def _refuse_unknown(self, module: ModuleType) -> None:
        """Raise if a manifest implements an unknown hook."""
        own = getattr(module, "etendue_vocabularies", None)
        self._declared |= set(own() or ()) if callable(own) else set()
        tables = getattr(module, "etendue_tables", None)  # each table names the hook that provides its presets
        for table in (tables() or {}).values() if callable(tables) else ():
            for kind in (table, *dict(table.get("further", {})).values()):
                self._declared.add(str(kind.get("presets", "")))
        for name in vars(module):
            word = name.removeprefix("etendue_")
            known = (*HOOKS, *self._declared)
            if word != name and word not in known and self._manager.parse_hookimpl_opts(module, name) is not None:
                raise ValueError(f"unknown hook {name!r}{nearest(name, [f'etendue_{one}' for one in known])}")

    def _asked(self, module: ModuleType, what: str, distribution: str, version: str) -> dict[str, Brought]:
        others = self._manager.get_plugins() - {module}
        hook = f"etendue_{what}"
        origin = f"{distribution} {version}"
        if not hasattr(self._manager.hook, hook):  # a vocabulary without any entries
            return {}
        with foreign(f"{origin}: its {hook} failed", "" if distribution == OWN else f"{hook} of {origin}"):
            answers = self._manager.subset_hook_caller(hook, others)()
        for answer in answers:
            if not isinstance(answer, Mapping) or not all(isinstance(name, str) for name in answer):
                raise PluginError(
                    f"{distribution} {version}: its {hook} returned {type(answer).__name__}; expected a mapping by name"
                )
        return {name: Brought(value, distribution, version) for answer in answers for name, value in answer.items()}


def _former_text(point: EntryPoint) -> str:
    origin = f"{point.dist.name} {point.dist.version}" if point.dist else "a distribution"
    return (
        f"{origin} declares its stages as entry points of {hookspecs.FORMER_GROUP!r}, which are no longer read: "
        f"install a newer version, or "
        f"name its manifest once, [project.entry-points.etendue] and NAME = {point.module!r}, with {point.name!r} in "
        f"its etendue_stages()"
    )


def loaded(place: str, what: str) -> Any:
    """Return the object at "module:name" that a distribution names.

    Raises
    ------
    PluginError
        The object cannot be imported.
    """
    from importlib.metadata import EntryPoint

    with foreign(f"{what}, {place}, cannot be read"):
        return EntryPoint("", place, "").load()


@cache
def installed() -> Discovery:
    """Return the vocabularies of all installed distributions."""
    from importlib.metadata import entry_points  # imported late: defining a class without quantities needs no look-up

    points = entry_points()
    return Discovery(points.select(group=hookspecs.GROUP), points.select(group=hookspecs.FORMER_GROUP))


def own_packages() -> frozenset[str]:
    """Return the packages of this distribution: the engine, and the packages of its manifests."""
    return installed().own_packages


def made_of(form: type[_Form], what: str, brought: Brought) -> _Form:
    """Return a mapping that a distribution provides, as a dataclass with the same keys."""
    known = [field.name for field in fields(form)]  # type: ignore[arg-type]
    if not isinstance(brought.value, Mapping):
        raise PluginError(
            f"{what} of {brought.origin} is {type(brought.value).__name__}; expected a mapping with {', '.join(known)}"
        )
    for word in brought.value:
        if word not in known:
            raise PluginError(f"{what} of {brought.origin} has an unknown key {word!r}{nearest(str(word), known)}")
    try:
        return form(**brought.value)
    except (TypeError, ValueError) as error:
        raise PluginError(f"{what} of {brought.origin} cannot be read: {error}") from error


@dataclass(frozen=True)
class Vocabulary:
    """A vocabulary that distributions can extend. ``word``: the noun for what its names denote, used in messages;
    ``endings``: file name extensions, if the names denote tables in files; ``library``: the value that stands in place
    of a path for a table of a library.
    """

    word: str
    endings: tuple[str, ...] = ()
    library: str = ""


@cache
def table_vocabularies() -> dict[str, Vocabulary]:
    """Return the vocabularies whose names denote tables in files."""
    found = installed()
    every = {name: brought for name in found.names("vocabularies") if (brought := found.first("vocabularies", name))}
    made = {name: made_of(Vocabulary, f"the vocabulary {name!r}", brought) for name, brought in every.items()}
    return {name: one for name, one in made.items() if one.endings}


def is_table_file(text: str) -> bool:
    """Return True if a text is the path of a table file."""
    return any(text.endswith(tuple(one.endings)) for one in table_vocabularies().values()) or text.endswith(".csv")


def table_file(name: str) -> str:
    """Return the path of the file for the name or path of a table; '' for a table of a library, and for anything else.

    Raises
    ------
    ValueError
        Two distributions provide the name, or its file is missing.
    """
    if is_table_file(name):
        return name
    for which, vocabulary in table_vocabularies().items():
        brought = installed().all(which, name)
        if not brought or brought[0].value == vocabulary.library == brought[-1].value:
            continue
        if clash := installed().clash(which, name):
            raise ValueError(f"the {vocabulary.word} {name!r} is {clash}")
        try:
            path = os.fspath(brought[0].value)
        except TypeError:
            path = ""
        if not path.endswith(tuple(vocabulary.endings)) or not os.path.isfile(path):
            kinds = " or ".join(ending.removeprefix(".").upper() for ending in vocabulary.endings)
            raise ValueError(
                f"the {vocabulary.word} {name!r} of {brought[0].origin} has no {kinds} file: {brought[0].value!r}"
            )
        return str(path)
    return ""
