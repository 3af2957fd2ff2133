"""The authors and URLs of etendue, from their only source: ``pyproject.toml``.

In:  ``[project]``, ``[project.urls]`` and ``[tool.hatch.version]`` of ``pyproject.toml``.
Out: authors, the contact and URLs for the site. Values that are not filled in yet are omitted.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

UNFILLED = ".invalid"  # a domain that never leads anywhere (RFC 2606)


@dataclass(frozen=True)
class Project:
    """The project as described by ``pyproject.toml``."""

    says: dict[str, Any]
    version: str  # the fallback without git: of the last or the next release

    @property
    def authors(self) -> list[str]:
        return [one["name"] for one in self.says["authors"]]

    @property
    def contacts(self) -> dict[str, str]:
        """Return e-mail addresses by author, as far as they are filled in."""
        found = {one["name"]: one.get("email", UNFILLED) for one in self.says["authors"]}
        return {name: address for name, address in found.items() if is_filled(address)}

    def url(self, label: str) -> str | None:
        """Return a URL, or None if it is not filled in."""
        found = self.says["urls"][label]
        return found if is_filled(found) else None


def is_filled(address: str) -> bool:
    """Return whether a URL or e-mail address has been filled in."""
    host = address.rpartition("@")[2].removeprefix("https://").partition("/")[0]
    return not host.endswith(UNFILLED)


def project_of(root: Path) -> Project:
    """Return the project of the repository at ``root``."""
    document = tomllib.loads((root / "pyproject.toml").read_text())
    return Project(document["project"], document["tool"]["hatch"]["version"]["fallback-version"])
