"""The code behind a stage, as a digest: a plugin's whole distribution, of what is built in the modules that a stage reaches.

In:  the class of a stage.
Out: 128-bit BLAKE2b digests. An edited kernel is seen, an edited report is not.

What a module holds and imports is kept between runs by the state of its file, so that no module is read twice (`cache`).
"""

from __future__ import annotations

import ast
import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from etendue import cache as kept
from etendue.plan.keys import digest
from etendue.spec.capabilities import is_transfer
from etendue.spec.stage import Stage

PACKAGE = Path(__file__).parent.parent
FOLLOWED = ("etendue.physics", "etendue.spec", "etendue.spectra", "etendue.constants", "etendue.stages", "etendue.api")
SEGMENT_MODULES = ("etendue.physics.light.sampling", "etendue.physics.light.cell_pixels")
TABLES = (".csv", ".npz")  # endings of data that kernels and spectra read as resources of the package
SETTLED = 2.0  # s; a file edited more recently may be edited again within the same tick of its clock
FORM = 1  # of what is kept


def code_digest(kind: type[Stage]) -> str:
    """Digest of the code behind a stage."""
    module = kind.__module__
    if module.startswith("etendue."):
        return _built_in_digest(module, SEGMENT_MODULES if is_transfer(kind) else ())
    top = sys.modules.get(module.split(".")[0])
    file = getattr(top, "__file__", None) or getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        return digest(module.encode())
    path = Path(file)
    own = _tree_digest(str(path.parent if path.name == "__init__.py" else path))
    models = sorted({base.__module__ for base in kind.__mro__ if base.__module__.startswith("etendue.stages.")})
    return digest(" ".join([own, *(_built_in_digest(one, ()) for one in models)]).encode()) if models else own


@cache
def _tree_digest(root: str) -> str:
    """Digest of a plugin's whole package: every file but bytecode."""
    base = Path(root)
    files = [base] if base.is_file() else sorted(p for p in base.rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    return digest("\n".join(f"{p.relative_to(base.parent)} {digest(p.read_bytes())}" for p in files).encode())


# ---------------------------------------------------------------------------------------- what is built in


@dataclass(frozen=True)
class _File:
    """What is known of a file of the package: its digest, what it imports, whether it is a docstring alone, whether it reads tables."""

    digest: str
    imports: tuple[str, ...] = ()
    words: bool = False
    tables: bool = False


@cache
def _built_in_digest(module: str, extra: tuple[str, ...]) -> str:
    names = set(_reaches(module)).union(*(_reaches(name) for name in extra))
    parts = []
    for name in sorted(names):
        path = _module_file(name)
        assert path is not None
        own = _known(path)
        parts.append(f"{name} {own.digest}")
        if own.tables:
            parts += [f"{p.name} {_known(p).digest}" for p in sorted((PACKAGE / "data").iterdir()) if p.suffix in TABLES]
    _keep()
    return digest("\n".join(parts).encode())


@cache
def _reaches(module: str) -> frozenset[str]:
    """The module and every module of stages, physics, spec, spectra and constants that it imports, at any depth."""
    seen: set[str] = set()
    open_ = [module]
    while open_:
        name = open_.pop()
        path = None if name in seen else _module_file(name)
        if path is None or _known(path).words:
            continue
        seen.add(name)
        open_ += [m for m in _known(path).imports if m.startswith(FOLLOWED)]
    return frozenset(seen)


@cache
def _module_file(module: str) -> Path | None:
    base = PACKAGE.parent / Path(*module.split("."))
    for candidate in (base.with_suffix(".py"), base / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def _statements(tree: ast.AST) -> Iterator[ast.AST]:
    """The statements of a module at any depth: nothing else holds an import, and most of a tree is expressions."""
    open_ = [tree]
    while open_:
        node = open_.pop()
        yield node
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            found = getattr(node, name, None)
            if isinstance(found, list):
                open_ += found


def _read(path: Path) -> _File:
    source = path.read_bytes()
    if path.suffix != ".py":
        return _File(digest(source))
    tree = ast.parse(source)
    found: set[str] = set()
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    words = path.name == "__init__.py" and all(isinstance(n, ast.Expr) for n in tree.body)
    tables = b"importlib.resources" in source or b"importlib import resources" in source
    return _File(digest(source), tuple(sorted(found)), words, tables)


# ---------------------------------------------------------------------------------------- kept between runs


@cache
def _kept() -> dict[str, Any]:
    """State and content by name of what earlier runs have read; empty where that is not whole."""
    data = kept.read("code", _place()) or b""
    try:
        found = json.loads(data[33:]) if data[:32].decode() == digest(data[33:]) else {}
    except ValueError:
        found = {}
    return found if isinstance(found, dict) else {}


_fresh: list[str] = []  # names that are read in this process and not yet kept


@cache
def _known(path: Path) -> _File:
    name, found = path.relative_to(PACKAGE).as_posix(), os.stat(path)
    state = [found.st_mtime_ns, found.st_ctime_ns, found.st_size, found.st_ino]
    entry = _kept().get(name)
    if entry is not None and entry[0] == state:
        return _File(entry[1], tuple(entry[2]), entry[3], entry[4])
    own = _read(path)
    if time.time() - found.st_mtime > SETTLED:
        _kept()[name] = [state, own.digest, own.imports, own.words, own.tables]
        _fresh.append(name)
    return own


def _keep() -> None:
    if _fresh:
        _fresh.clear()
        body = json.dumps(_kept()).encode()
        kept.write("code", _place(), digest(body).encode() + b"\n" + body)


@cache
def _place() -> str:
    """The file for this package, by where it stands: two checkouts do not take turns in one."""
    return digest(f"{FORM} {PACKAGE}".encode())
