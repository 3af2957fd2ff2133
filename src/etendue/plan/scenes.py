"""What scenes hold, found once for every scene that was ever planned: kept in the user's cache by the scene's digest.

In:  a source and its grids.
Out: its ``Spectrum``, and the seconds that looking at it took.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from etendue import scenes
from etendue.plan.keys import code_digest, key_of, parameters_for_key
from etendue.scenes import light_of
from etendue.spec.capabilities import Source
from etendue.spec.facts import Spectrum
from etendue.spec.grid import Grid

FORM = 1  # of the file
__all__ = ["light_of", "spectrum_of"]
_KNOWN: dict[str, Spectrum | None] = {}


def folder() -> Path:
    """Where spectra of scenes are kept between runs: ``ETENDUE_CACHE``, or the user's folder for caches."""
    own = os.environ.get("ETENDUE_CACHE")
    return Path(own) if own else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "etendue"


def spectrum_of(source: Source, grids: Mapping[str, Grid]) -> tuple[Spectrum | None, float]:
    """What the light of a scene holds, and the seconds spent on it now."""
    grid = sorted((name, repr(grid)) for name, grid in grids.items())
    key = key_of({"form": FORM, "code": code_digest(type(source)), "parameters": parameters_for_key(source), "grid": grid})
    if key in _KNOWN:
        return _KNOWN[key], 0.0
    began = time.perf_counter()
    path = folder() / "scenes" / f"{key}.json"
    found = _read(path)
    if found is None:
        found = scenes.spectrum_of(source, grids)
        if found is not None:
            _write(path, found)
    _KNOWN[key] = found
    return found, time.perf_counter() - began


def _read(path: Path) -> Spectrum | None:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        power, amplitude = (tuple(map(tuple, document[name])) for name in ("power", "amplitude"))
        edges, low, mean, high = (tuple(map(float, document[name])) for name in ("edges", "low", "mean", "high"))
        return Spectrum(float(document["full"]), edges, power, amplitude, low, mean, high)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(path: Path, spectrum: Spectrum) -> None:
    """Whole or not at all; where nothing can be written, the next run looks again."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
            json.dump(asdict(spectrum), file)
        os.replace(file.name, path)
    except OSError:
        return
