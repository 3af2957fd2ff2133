"""Documents of bodies and lenses, in the form of sensor files: every value with its source, licence and note.

In:  values by quantity.
Out: TOML, and the path of a file with it in the user's cache folder, named by its content.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from etendue import cache
from etendue.pipeline import toml
from etendue.types.documents import Document


@dataclass(frozen=True)
class Value:
    """A value and its source. The source ``typical`` marks a stand-in for a value that no source gives."""

    value: Any
    source: str
    note: str = ""
    licence: str = ""

    def table(self) -> Document:
        found = {"value": self.value, "source": self.source, "licence": self.licence, "note": self.note}
        return {key: one for key, one in found.items() if one != "" or key == "value"}


@dataclass(frozen=True)
class Named:
    """The body or lens that a name denotes."""

    title: str
    kind: str
    description: str
    camera: Mapping[str, Value]
    facts: Mapping[str, Value] = field(default_factory=dict)

    def toml(self) -> str:
        """Return the text of its file; equal values give equal texts."""
        parts = {"camera": self.camera, "facts": self.facts}
        document = {
            "title": self.title,
            "kind": self.kind,
            "description": self.description,
            **{name: {key: one.table() for key, one in own.items()} for name, own in parts.items()},
        }
        return toml.dumps(document)


def kept(text: str, ending: str) -> Path:
    """Return the path of a file with this text, in the cache folder or, if that is not writable, in a temporary
    folder.
    """
    name = hashlib.sha256(text.encode()).hexdigest() + ending
    for folder in (cache.folder() / "cameras", Path(tempfile.gettempdir()) / "etendue-cameras"):
        path = folder / name
        try:
            if path.is_file() and path.read_text(encoding="utf-8") == text:
                return path
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
                file.write(text)
            Path(file.name).replace(path)
            return path
        except OSError:
            continue
    raise OSError("neither the cache folder nor the temporary folder can be written")
