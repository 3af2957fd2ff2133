"""Sensors by name: values of camera quantities that distributions bring, each with the source it comes from.

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
from etendue.plugins import discovery
from etendue.telling import plain

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
    distribution: str
    version: str

    def values(self) -> dict[str, Any]:
        """As under ``[camera]``."""
        return {name: sourced.value for name, sourced in self.camera.items()}


def preset_names() -> tuple[str, ...]:
    return tuple(sorted(discovery.installed().names("sensors")))


@cache
def preset(name: str) -> Preset:
    """The sensor of a name.

    Raises
    ------
    RequestError
        There is none of that name, with the nearest one; two distributions bring it; what is brought cannot be read.
    """
    found = discovery.installed()
    brought = found.all("sensors", name)
    if not brought:
        hint = nearest(name, preset_names()) or "; etendue sensors lists them"
        raise RequestError(f"there is no sensor {name!r}{hint}{found.missed('sensors', name)}")
    if clash := found.clash("sensors", name):
        raise RequestError(f"the sensor {name!r} is {clash}")
    (one,) = brought
    try:
        document = one.value
        if not isinstance(document, Mapping):
            document = tomllib.loads(Path(document).read_text(encoding="utf-8"), parse_float=Decimal)
        tables = {
            table: {key: Sourced(entry["value"], entry["source"], entry.get("note", "")) for key, entry in document.get(table, {}).items()}
            for table in ("camera", "facts")
        }
        words = (document["title"], document["kind"], document["description"])
    except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
        lacking = f"{error} is lacking" if isinstance(error, KeyError) else plain(str(error))
        form = "expected title, kind, description, and a value and its source under camera.NAME"
        raise RequestError(f"the sensor {name!r} of {one.origin} cannot be read: {lacking}; {form}") from error
    return Preset(name, *words, tables["camera"], tables["facts"], one.distribution, one.version)
