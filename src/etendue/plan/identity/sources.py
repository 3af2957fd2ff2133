"""Analyse files of code, and cache the result between runs by the state of the file, so that no file is read twice.

In:  the path of a module, a table, a library.
Out: its digest, the modules it imports, and whether it has imports that cannot be followed.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import re
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from etendue import cache as kept
from etendue.plan.identity.keys import digest
from etendue.types.documents import Document

PACKAGE = Path(__file__).parents[2]
SETTLED = 2.0  # s; a file changed more recently may change again without its time stamp showing it
FORM = 3  # version of the cached form
MOST = 4000  # files cached; above this, entries of deleted files are dropped

CALLED = ("import_module", "__import__")  # with a literal name they are imports like any other
RESOURCES = ("files", "get_data")  # of a package given by a literal name
HIDDEN = frozenset(
    {
        "entry_points",
        "exec_module",
        "iter_modules",
        "lazy_import",
        "lazy_loader",
        "LazyLoader",
        "load_module",
        "module_from_spec",
        "resolve_name",
        "run_module",
        "run_path",
        "SourceFileLoader",
        "spec_from_file_location",
        "spec_from_loader",
        "walk_packages",
    }
)
BUILT_IN = ("exec", "eval", "execfile")  # only as bare names: as methods they mean other things
_MAY_HIDE = re.compile(
    rb"\b(?:%s)\b" % b"|".join(name.encode() for name in (*CALLED, *RESOURCES, *sorted(HIDDEN), *BUILT_IN))
)
_BESIDE = re.compile(rb"\b(?:__file__|resources|pkgutil)\b")
_CLASS = re.compile(r"\b[A-Z]\w+")


@dataclass(frozen=True)
class SourceFile:
    """The analysis of a file. ``imports``: names of imported modules and of names imported from them; relative names
    keep their dots.

    ``words``: whether the file contains only a docstring. ``hides``: whether it has imports that cannot be followed.
    ``beside``: whether its code reads files next to it. ``classes``: if it imports the ``models`` of a package, from
    which classes are loaded by name, every word in it that may be such a name.
    """

    digest: str
    imports: tuple[str, ...] = ()
    words: bool = False
    hides: bool = False
    beside: bool = False
    classes: tuple[str, ...] = ()


def _read(path: Path) -> SourceFile:
    if path.suffix != ".py":
        with path.open("rb") as file:
            return SourceFile(hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16)).hexdigest())
    source = path.read_bytes()
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError):  # written for another Python version, so its imports are unknown
        return SourceFile(digest(source), hides=True)
    found, hides = set(_imports(tree)), False
    if _MAY_HIDE.search(source):
        seen, hides = _called(tree)
        found |= seen
    words = path.name == "__init__.py" and all(isinstance(n, ast.Expr) for n in tree.body)
    models = any(name.split(".")[1:2] == ["models"] for name in found)
    classes = tuple(sorted(set(_CLASS.findall(source.decode("utf-8", "replace"))))) if models else ()
    return SourceFile(digest(source), tuple(sorted(found)), words, hides, bool(_BESIDE.search(source)), classes)


def _imports(tree: ast.Module) -> Iterator[str]:
    """Yield every imported name, including imports in functions, without imports for type checkers only."""
    open_: list[ast.AST] = [tree]
    while open_:  # only statements contain imports, and most of a tree is expressions
        node = open_.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")  # importing a name from it imports the module too
            yield from (f"{module}{'.' if node.module else ''}{alias.name}" for alias in node.names)
        typing_only = (
            isinstance(node, ast.If) and getattr(node.test, "id", getattr(node.test, "attr", "")) == "TYPE_CHECKING"
        )
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            found = getattr(node, name, None)
            if isinstance(found, list) and not (typing_only and name == "body"):
                open_ += found


def _called(tree: ast.Module) -> tuple[set[str], bool]:
    """Return the names that calls with a literal argument import, and whether there are imports that cannot be
    followed.
    """
    found, hides, followed = set[str](), False, set[ast.AST]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and _name_of(node.func) in (*CALLED, *RESOURCES):
            named = node.args[0] if node.args else None
            if isinstance(named, ast.Constant) and isinstance(named.value, str) and not named.value.startswith("."):
                found.add(named.value)
                followed.add(node.func)
    for node in ast.walk(tree):
        name = _name_of(node)
        if (
            name in HIDDEN
            or (name in CALLED and node not in followed)
            or (isinstance(node, ast.Name) and name in BUILT_IN)
        ):
            hides = True
        elif isinstance(node, ast.alias):
            hides = hides or node.name.split(".")[-1] in HIDDEN or (node.name in CALLED and bool(node.asname))
    return found, hides


def _name_of(node: ast.AST) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


# ---------------------------------------------------------------------------------------- cached between runs


@cache
def _kept() -> Document:
    """Return the state and content, by path, of files read in earlier runs; empty if the cache file is damaged."""
    data = kept.read("code", _place()) or b""
    try:
        found = json.loads(data[33:]) if data[:32].decode() == digest(data[33:]) else {}
    except ValueError:
        found = {}
    return found if isinstance(found, dict) else {}


_fresh: list[str] = []  # paths read in this process and not yet cached


@cache
def known(path: Path) -> SourceFile:
    """Return the analysis of a file. Its state is checked once per process, because loaded code does not change."""
    # Four fields together identify a version of the file: an edit that restores the size and mtime still changes ctime.
    name, found = str(path), os.stat(path)
    state = [found.st_mtime_ns, found.st_ctime_ns, found.st_size, found.st_ino]
    entry = _kept().get(name)
    if entry is not None and entry["state"] == state:
        words: Document = {
            word: tuple(value) if isinstance(value, list) else value for word, value in entry["source"].items()
        }
        return SourceFile(**words)
    own = _read(path)
    if time.time() - found.st_mtime > SETTLED:
        _kept()[name] = {"state": state, "source": asdict(own)}
        _fresh.append(name)
    return own


def keep() -> None:
    """Write the new analyses to the cache."""
    if not _fresh:
        return
    _fresh.clear()
    if len(_kept()) > MOST:
        for name in [name for name in list(_kept()) if not os.path.exists(name)]:
            del _kept()[name]
    body = json.dumps(dict(_kept())).encode()  # a copy, since other planning threads may add to it
    kept.write("code", _place(), digest(body).encode() + b"\n" + body)


@cache
def _place() -> str:
    """Return the cache file of this package, by its location, so that two checkouts do not overwrite each other's
    cache.
    """
    return digest(f"{FORM} {PACKAGE}".encode())
