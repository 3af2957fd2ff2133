"""Sensors by name: values of camera quantities from packaged files, each with the source it comes from.

In:  ``[camera] sensor = "NAME"``.
Out: a ``Preset``: values as they would stand under ``[camera]``; what the pipeline itself says goes before them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

from etendue.errors import RequestError, nearest

FOLDER = Path(__file__).parents[1] / "data" / "sensors"
TYPICAL = "typical"
SPOKEN = (TYPICAL, "definition", "seed paper")  # how a source begins that is no address


@dataclass(frozen=True)
class Sourced:
    """One value, and who says so. ``typical``: nobody citable; a value that such sensors have."""

    value: Any
    source: str
    note: str = ""


@dataclass(frozen=True)
class Preset:
    """A sensor: what it gives the camera, and what else is published of it."""

    name: str
    title: str
    kind: str
    description: str
    camera: Mapping[str, Sourced]
    facts: Mapping[str, Sourced]

    def values(self) -> dict[str, Any]:
        """As under ``[camera]``."""
        return {name: sourced.value for name, sourced in self.camera.items()}


@cache
def preset_names() -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


@cache
def preset(name: str) -> Preset:
    """The sensor of a name.

    Raises
    ------
    RequestError
        There is none of that name: with the nearest one.
    """
    if name not in preset_names():
        raise RequestError(f"there is no sensor {name!r}{nearest(name, preset_names()) or '; etendue sensors lists them'}")
    document = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"), parse_float=Decimal)
    tables = {
        table: {key: Sourced(entry["value"], entry["source"], entry.get("note", "")) for key, entry in document.get(table, {}).items()}
        for table in ("camera", "facts")
    }
    return Preset(name, document["title"], document["kind"], document["description"], tables["camera"], tables["facts"])
