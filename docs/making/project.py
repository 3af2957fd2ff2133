"""Who makes etendue and where it is found, from the one place that says so: ``pyproject.toml``.

In:  ``[project]``, ``[project.urls]`` and ``[tool.hatch.version]`` of ``pyproject.toml``.
Out: authors, the contact and addresses for the site. What the owner has not filled in yet is left out.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

UNFILLED = ".invalid"  # a domain that never leads anywhere (RFC 2606)


@dataclass(frozen=True)
class Project:
    """What ``pyproject.toml`` says of the project."""

    says: dict[str, Any]
    version: str  # without git: of the release that was made last, or that is made next

    @property
    def authors(self) -> list[str]:
        return [one["name"] for one in self.says["authors"]]

    @property
    def contacts(self) -> dict[str, str]:
        """Whom to write to: addresses by author, once they are filled in."""
        found = {one["name"]: one.get("email", UNFILLED) for one in self.says["authors"]}
        return {name: address for name, address in found.items() if is_filled(address)}

    def url(self, label: str) -> str | None:
        """An address, once it is filled in."""
        found = self.says["urls"][label]
        return found if is_filled(found) else None


def is_filled(address: str) -> bool:
    """Whether an address of a page or a person is one that the owner has given."""
    host = address.rpartition("@")[2].removeprefix("https://").partition("/")[0]
    return not host.endswith(UNFILLED)


def project_of(root: Path) -> Project:
    """Of the repository at ``root``."""
    document = tomllib.loads((root / "pyproject.toml").read_text())
    return Project(document["project"], document["tool"]["hatch"]["version"]["fallback-version"])
