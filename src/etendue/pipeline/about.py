"""Authors and licence of a pipeline's results: the table ``[about]`` of a pipeline file.

In:  the table as written.
Out: ``About``; nothing in it changes a result.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from etendue.contract.values.units import as_written
from etendue.errors import Fault, nearest, unprintable
from etendue.types.documents import Document, DocumentView

KEYS = ("title", "license", "author")
OF_AN_AUTHOR = ("name", "orcid", "affiliation")
_ORCID = re.compile(r"(?:https://orcid\.org/)?(\d{4}-\d{4}-\d{4}-\d{3}[\dX])")
_LICENSE = re.compile(r"https?://\S+|[A-Za-z0-9][A-Za-z0-9.+-]*")


@dataclass(frozen=True)
class Author:
    """A person or a group; ``orcid`` as 0000-0002-1825-0097."""

    name: str
    orcid: str = ""
    affiliation: str = ""


@dataclass(frozen=True)
class About:
    """Statements about the results of a pipeline: title, licence, authors; each is empty if it is not given.

    ``license`` is a name of the SPDX list (CC-BY-4.0) or a URL.
    """

    title: str = ""
    license: str = ""
    authors: tuple[Author, ...] = ()

    def document(self) -> Document:
        """Return the table as written in a pipeline file, without empty entries."""
        authors = [{name: value for name in OF_AN_AUTHOR if (value := getattr(one, name))} for one in self.authors]
        said = {"title": self.title, "license": self.license, "author": authors}
        return {name: value for name, value in said.items() if value}


def read_about(table: object, faults: list[Fault]) -> About:
    """Read the table of a pipeline; add its faults to ``faults``."""
    if not isinstance(table, Mapping):
        faults.append(Fault("about", f"expected a table, got {as_written(table)}"))
        return About()
    for key in table:
        if key not in KEYS:
            faults.append(Fault(f"about.{key}", f"unknown key{nearest(str(key), KEYS)}"))
    license = _text(table, "license", faults)
    if license and not _LICENSE.fullmatch(license):
        what = "an SPDX licence name, such as CC-BY-4.0, or a URL"
        faults.append(Fault("about.license", f"expected {what}, got {as_written(license)}"))
        license = ""
    given = table.get("author", [])
    people = given if isinstance(given, list) else [given]
    authors = [author for one in people if (author := _author(one, faults)) is not None]
    return About(_text(table, "title", faults), license, tuple(authors))


def _text(table: DocumentView, key: str, faults: list[Fault], place: str = "about") -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or unprintable(value):
        faults.append(Fault(f"{place}.{key}", f"expected text, got {as_written(value)}"))
        return ""
    return value.strip()


def _author(written: object, faults: list[Fault]) -> Author | None:
    """Read an author: a name, or a table with name, orcid, affiliation."""
    place = "about.author"
    table = {"name": written} if isinstance(written, str) else written
    if not isinstance(table, Mapping) or not isinstance(table.get("name"), str) or not table["name"].strip():
        faults.append(
            Fault(
                place,
                f'expected a name, or {{ name = "..", orcid = "..", affiliation = ".." }}, got {as_written(written)}',
            )
        )
        return None
    for key in table:
        if key not in OF_AN_AUTHOR:
            faults.append(Fault(f"{place}.{key}", f"unknown key{nearest(str(key), OF_AN_AUTHOR)}"))
    orcid = _text(table, "orcid", faults, place)
    found = _ORCID.fullmatch(orcid)
    if orcid and not found:
        faults.append(
            Fault(f"{place}.orcid", f"expected an ORCID iD such as 0000-0002-1825-0097, got {as_written(orcid)}")
        )
    return Author(
        _text(table, "name", faults, place), found[1] if found else "", _text(table, "affiliation", faults, place)
    )
