"""The page: one self-contained HTML text with style, script and document, which requests nothing from the network.

In:  a document; whether it is live, beside a server on this machine.
Out: HTML. Style and script are allowed by their SHA-256 alone; no text of the document is ever interpreted as markup.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from functools import cache
from importlib.resources import files

from etendue.present.page.document import plain
from etendue.types.documents import DocumentView

SCRIPTS = (
    "base.js",
    "charts.js",
    "maps.js",
    "panels.js",
    "sections.js",
    "opening.js",
    "explore.js",
    "tables.js",
    "live.js",
    "panes.js",
    "start.js",
)


@cache
def static(name: str) -> str:
    return files("etendue.present.page").joinpath("static", name).read_text(encoding="utf-8")


@cache
def _script() -> str:
    """Return all scripts in one function, so that nothing is global."""
    return "(() => {\n'use strict';\n" + "\n".join(static(name) for name in SCRIPTS) + "\n})();\n"


def page(document: DocumentView, live: bool = False) -> str:
    """Return the HTML of a document."""
    style, script = static("page.css"), _script()
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src '{_digest(script)}'",
            f"style-src '{_digest(style)}'",
            "img-src data: blob:",
            "connect-src 'self'" if live else "connect-src 'none'",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    # of the pipeline, of the folder
    names = dict.fromkeys([str(document["name"]), str(document.get("archive", document["name"]))])
    text = json.dumps(plain(document), ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    parts = {
        "policy": policy,
        "title": html.escape(" · ".join([*names, "etendue"])),
        "style": style,
        # without any text that an HTML parser would take for the end of the element
        "document": text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"),
        "script": script,
    }
    return "".join(parts.get(piece, piece) for piece in static("page.html").split("@@"))


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
