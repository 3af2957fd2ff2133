"""Analyse the content of scenes. Each scene is analysed once; the result is cached by the digest of the scene.

In:  a source and its grids.
Out: its ``Content``, and the seconds spent on the analysis.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping
from dataclasses import asdict

from etendue import cache
from etendue.contract.arrays.facts import Content
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Source
from etendue.plan.identity.code import code_at, code_digest, libraries_of
from etendue.plan.identity.keys import key_of, parameters_for_key, version_of
from etendue.transfer import contents as scenes
from etendue.transfer.contents import light_of

FORM = 3  # version of the file format of the cache
__all__ = ["content_of", "light_of"]
MOST = 64  # contents kept in memory
_KNOWN: dict[str, Content | None] = {}
_lock = threading.Lock()


def content_of(source: Source, grids: Mapping[str, Grid]) -> tuple[Content | None, float]:
    """Return the content of a scene's light, and the seconds spent on it now."""
    # The key holds all that the content depends on: code, library versions, parameters and grid. So a cached entry is
    # valid for as long as its key can be formed.
    grid = sorted((name, repr(grid)) for name, grid in grids.items())
    code = [code_digest(type(source)), code_at("etendue.transfer.contents")]
    versions = {name: version_of(name) for name in sorted(libraries_of(type(source)))}
    key = key_of(
        {"form": FORM, "code": code, "versions": versions, "parameters": parameters_for_key(source), "grid": grid}
    )
    with _lock:
        if key in _KNOWN:
            return _KNOWN[key], 0.0
    began = time.perf_counter()
    found = _read(cache.read("scenes", key))
    if found is None:
        found = scenes.content_of(source, grids)
        if found is not None:
            cache.write("scenes", key, json.dumps(asdict(found)).encode())
    with _lock:
        while len(_KNOWN) >= MOST:
            _KNOWN.pop(next(iter(_KNOWN)))
        _KNOWN[key] = found
    return found, time.perf_counter() - began


def _read(data: bytes | None) -> Content | None:
    try:
        document = json.loads(data or b"")
        power, amplitude = (tuple(map(tuple, document[name])) for name in ("power", "amplitude"))
        edges, low, mean, high = (tuple(map(float, document[name])) for name in ("edges", "low", "mean", "high"))
        white = tuple(map(float, document["white"]))
        fields = (float(document["full"]), edges, power, amplitude, low, mean, high, white)
        widths, peaks = tuple(map(float, document["widths"])), tuple(map(tuple, document["peaks"]))
        return Content(*fields, widths=widths, peaks=peaks)
    except (ValueError, KeyError, TypeError):
        return None
