"""Contributions of distributions to a page: sections (``etendue_sections``), wordings, and the order of preference.

In:  an archive opened for display.
Out: plain JSON. A section consists of paragraphs, tables and pictures; if one fails, the reason is shown and the others
     are unaffected.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Any

from etendue.archive.read.vouched.verified_store import open_archive
from etendue.contract import wording
from etendue.contract.arrays import dims
from etendue.contract.values import quantities
from etendue.errors import ArchiveError, PluginError
from etendue.plugins import discovery
from etendue.plugins.shares import shared_out
from etendue.present.page.opened import Opened
from etendue.types.documents import Document

PNG = b"\x89PNG\r\n\x1a\n"
DATA = "data:image/png;base64,"
FORM = (
    "expected a list of {'paragraph': text}, {'table': {'head': [...], 'rows': [[...]]}} and {'picture': bytes of a "
    "PNG, 'alt': text}"
)


@dataclass(frozen=True)
class Section:
    """``place``: ``module:function`` that takes the tree of an archive; ``title``: the heading."""

    place: str
    title: str


def wordings(opened: Opened) -> Document:
    """Return the texts that a page uses, from the distributions whose stages the archive contains, and the names to
    show first.
    """
    stages = frozenset(
        str(one).partition(" ")[0] for node in opened.record["nodes"].values() for one in node.get("distributions", ())
    )
    known = set(quantities.names())
    order = [name for name in wording.first("quantities") if name in known]
    off = {name: value for name in order if (value := quantities.declared(name).off) is not None}
    return {
        "words": dict(wording.words(stages)),
        "spelling": dict(wording.spelling()),
        "bins": [d for d in dims.declared_dims() if dims.dim(d).bins],
        "first": {"curves": list(wording.first("curves")), "quantities": order, "off": off},
        "shares": shared_out(),
    }


def sections(opened: Opened) -> list[Document]:
    """Return every section that has content or an error, in the order of registration."""
    every, tree = discovery.installed(), None
    found: list[Document] = []
    for name in every.names("sections"):
        brought = every.all("sections", name)[0]
        plain = "".join(c if c.isalnum() else "-" for c in name)
        said: Document = {"name": plain, "title": name, "origin": brought.origin, "blocks": [], "why": ""}
        try:
            one = discovery.made_of(Section, f"the section {name!r}", brought)
            said["title"] = str(one.title)
            tree = open_archive(opened.folder) if tree is None else tree
            with discovery.foreign(f"the section {name!r} of {brought.origin} failed"):
                given = EntryPoint(name, one.place, "").load()(tree)
            said["blocks"] = _blocks(given, f"the section {name!r} of {brought.origin}")
        except (PluginError, ArchiveError) as error:
            said["why"] = str(error)
        if said["blocks"] or said["why"]:
            found.append(said)
    return found


def _blocks(given: Any, what: str) -> list[Document]:
    if not isinstance(given, list | tuple):
        raise PluginError(f"{what} returns {type(given).__name__}; {FORM}")
    return [_block(one, f"{what}, block {number}") for number, one in enumerate(given, 1)]


def _block(one: Any, what: str) -> Document:
    own = dict(one) if isinstance(one, Mapping) else {}
    if isinstance(own.get("paragraph"), str):
        return {"paragraph": own["paragraph"]}
    if isinstance(own.get("table"), Mapping):
        head, rows = own["table"].get("head"), own["table"].get("rows")
        lists = isinstance(head, list | tuple) and isinstance(rows, list | tuple)
        if lists and all(isinstance(row, list | tuple) and len(row) == len(head) for row in rows):
            return {
                "table": {
                    "head": [str(text) for text in head],
                    "rows": [[_value(value) for value in row] for row in rows],
                }
            }
    picture = own.get("picture")
    if isinstance(picture, bytes) and picture.startswith(PNG):
        picture = DATA + base64.b64encode(picture).decode()
    if isinstance(picture, str) and picture.startswith(DATA):
        return {"picture": picture, "alt": str(own.get("alt", ""))}
    raise PluginError(f"{what} cannot be read; {FORM}")


def _value(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
