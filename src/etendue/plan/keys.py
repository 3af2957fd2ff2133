"""Keys: equal key means equal result. Recipes are hashed, not pixels.

In:  a stage's class, its resolved parameters, the keys of what it reads.
Out: 128-bit BLAKE2b digests, and the fields they were made of, so that a change can be named.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

from etendue.spec.capabilities import is_transfer
from etendue.spec.found import Found
from etendue.spec.stage import Stage, file_state, files_of, parameters_of

PACKAGE = Path(__file__).parent.parent
FOLLOWED = ("etendue.physics", "etendue.spec", "etendue.spectra", "etendue.constants", "etendue.stages", "etendue.api")
SEGMENT_MODULES = ("etendue.physics.light.sampling", "etendue.physics.light.cell_pixels")


def digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def canonical(value: Any) -> Any:
    """A value as JSON that is the same text for the same value: floats in hex."""
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, Found):  # the key of the cell that finds it stands among the inputs
        return "found"
    if isinstance(value, dict):
        return {str(k): canonical(v) for k, v in sorted(value.items())}
    if isinstance(value, list | tuple):
        return [canonical(v) for v in value]
    return value


def key_of(fields: dict[str, Any]) -> str:
    return digest(json.dumps(canonical(fields), sort_keys=True).encode())


def _module_file(module: str) -> Path | None:
    base = PACKAGE.parent / Path(*module.split("."))
    for candidate in (base.with_suffix(".py"), base / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


@cache
def _imported(path: Path) -> frozenset[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


@cache
def _only_words(path: Path) -> bool:
    """Whether a file holds a docstring and nothing else: what a folder says of itself computes nothing."""
    return path.name == "__init__.py" and all(isinstance(n, ast.Expr) for n in ast.parse(path.read_text(encoding="utf-8")).body)


@cache
def _reaches(module: str) -> frozenset[str]:
    """The module and every module of stages, physics, spec, spectra and constants that it imports, at any depth."""
    seen: set[str] = set()
    open_ = [module]
    while open_:
        name = open_.pop()
        path = _module_file(name)
        if name in seen or path is None or _only_words(path):
            continue
        seen.add(name)
        open_ += [m for m in _imported(path) if m.startswith(FOLLOWED)]
    return frozenset(seen)


@cache
def _built_in_digest(module: str, extra: tuple[str, ...]) -> str:
    modules = set(_reaches(module))
    for name in extra:
        modules |= _reaches(name)
    parts = []
    for name in sorted(modules):
        path = _module_file(name)
        assert path is not None
        source = path.read_bytes()
        parts.append(f"{name} {digest(source)}")
        if b"importlib.resources" in source or b"importlib import resources" in source:
            parts += [f"{p.name} {digest(p.read_bytes())}" for p in sorted((PACKAGE / "data").glob("*.csv"))]
    return digest("\n".join(parts).encode())


@cache
def _tree_digest(root: str) -> str:
    """Digest of a plugin's whole package: every file but bytecode."""
    base = Path(root)
    files = [base] if base.is_file() else sorted(p for p in base.rglob("*") if p.is_file() and "__pycache__" not in p.parts)
    return digest("\n".join(f"{p.relative_to(base.parent)} {digest(p.read_bytes())}" for p in files).encode())


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
    return _tree_digest(str(path.parent if path.name == "__init__.py" else path))


@cache
def version_of(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "missing"


def file_digest(path: str) -> str:
    """SHA-256 of a file, or of the names and contents of a folder's files: file parameters count by content."""
    return _file_digest(path, file_state(path))


@cache
def _file_digest(path: str, state: tuple[int, int]) -> str:
    whole = Path(path)
    if not whole.is_dir():
        with whole.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    found = hashlib.sha256()
    for part in sorted(p for p in whole.rglob("*") if p.is_file()):
        with part.open("rb") as file:
            found.update(f"{part.relative_to(whole).as_posix()} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return found.hexdigest()


def parameters_for_key(stage: Stage) -> dict[str, Any]:
    """Resolved parameters with files replaced by their content's digest."""
    files = files_of(stage)
    return {n: f"sha256:{file_digest(files[n])}" if n in files else getattr(stage, n) for n in parameters_of(type(stage))}


def parameters_digest(stage: Stage) -> str:
    return key_of(parameters_for_key(stage))
