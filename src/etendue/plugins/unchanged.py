"""Cache documents that depend on all installed code, as long as no file of that code changes.

In:  a kind, and a JSON document computed from the contributions of distributions.
Out: the document in a later process, which imports none of that code; None if anything has changed.

An entry names the modules that were loaded when it was made, and the packages of the manifests. It holds one digest of
the state of their files, of all other files in these packages, of other files on the path with the name of such a
module, and of the list of distributions with their entry points. A file that has changed within the last seconds may
change again without its time stamp showing it: nothing is cached then.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import time
from collections.abc import Collection, Iterable, Iterator
from types import ModuleType
from typing import Any

from etendue import cache

KIND = "listings"
FORM = 1  # of an entry; raised whenever the meaning of a field changes
MOST = 16  # entries, of 0.4 MB for a hundred stages
SETTLED = 10.0  # s
SUM = 32  # hex digits of a digest
_INSTALLED = (".dist-info", ".egg-info")
_SAID = ("METADATA", "PKG-INFO", "entry_points.txt")
_State = tuple[int, int, int, int]


def recall(kind: str) -> Any:
    """Return the document stored last, if nothing has changed since; else None."""
    data = cache.read(KIND, _key(kind)) or b""
    if data[:SUM].decode("ascii", "replace") != _digest(data[SUM:]):
        return None
    found = json.loads(data[SUM:])
    return found["document"] if _sum(found["files"], found["folders"], found["tops"])[0] == found["sum"] else None


def keep(kind: str, document: Any, packages: Iterable[str]) -> None:
    """Store a document that depends on the modules loaded so far and on the content of some packages."""
    loaded = {name: module for name, module in list(sys.modules.items()) if isinstance(module, ModuleType)}
    files = sorted({os.path.abspath(file) for module in loaded.values() if (file := vars(module).get("__file__"))})
    paths = [vars(loaded[name]).get("__path__", ()) for name in packages if name in loaded]
    folders = sorted({os.path.abspath(folder) for own in paths for folder in own})
    tops = sorted({name.partition(".")[0] for name in loaded})
    total, newest = _sum(files, folders, tops)
    text = json.dumps({"files": files, "folders": folders, "tops": tops, "sum": total, "document": document})
    if time.time() - newest / 1e9 > SETTLED and json.loads(text)["document"] == document:
        cache.write(KIND, _key(kind), f"{_digest(text.encode())}{text}".encode())
        cache.keep_newest(KIND, MOST)


def _key(kind: str) -> str:
    return _digest(repr((FORM, kind, __file__, sys.version, sys.flags, sys.path)).encode())


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=SUM // 2).hexdigest()


def _sum(files: Iterable[str], folders: Iterable[str], tops: Iterable[str]) -> tuple[str, int]:
    """Return the digest of the state of everything on which an entry depends, and the time of the latest
    change (ns).
    """
    states = [(path, _state(path)) for path in (*files, *_below(folders), *_on_the_path(frozenset(tops)))]
    newest = max((max(state[:2]) for _, state in states if state), default=0)
    return _digest(repr(states).encode()), newest


def _state(path: str) -> _State | None:
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ctime_ns, found.st_size, found.st_ino


def _below(folders: Iterable[str]) -> Iterator[str]:
    """Yield the files of some packages, except bytecode and hidden files."""
    for folder in folders:
        for above, inside, names in os.walk(folder):
            inside[:] = sorted(name for name in inside if name != "__pycache__" and not name.startswith("."))
            yield from (os.path.join(above, name) for name in sorted(names) if not name.startswith("."))


def _on_the_path(tops: Collection[str]) -> Iterator[str]:
    """Yield the files on the path that may be one of some modules, and the files that list the contributions of a
    distribution.
    """
    for folder in sys.path:
        try:
            names = sorted(os.listdir(folder or "."))
        except OSError:
            continue
        for name in names:
            if name.endswith(_INSTALLED):
                yield from (os.path.join(folder, name, said) for said in _SAID)
            elif name.partition(".")[0] in tops:
                path = os.path.join(folder, name)  # a folder changes with the bytecode in it
                yield os.path.join(path, "__init__.py") if os.path.isdir(path) else path
