"""The site: ``nox -s docs``. Pages below ``docs/made`` are generated here, from the installed packages."""

from __future__ import annotations

import os
import re
import shutil
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parent
MADE = HERE / "made"
sys.path.insert(0, str(HERE))

from pygments.lexers.special import TextLexer  # noqa: E402
from sphinx.highlighting import lexers  # noqa: E402

from making import commands, copies, gallery, python, sensors, stages  # noqa: E402
from making.project import project_of  # noqa: E402

lexers["csv"] = TextLexer()  # which Pygments does not know

about = project_of(ROOT)
project = about.says["name"]
author = copyright = ", ".join(about.authors)
version = release = metadata.version(project)

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "sphinx_design"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "making"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
highlight_language = "none"
default_role = "code"
smartquotes = False  # two dashes begin an option
add_module_names = False

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_param = False  # types are words and shapes, not names to look up
napoleon_use_rtype = False
napoleon_use_ivar = True

linkcheck_timeout, linkcheck_retries, linkcheck_workers = 20, 2, 4
linkcheck_report_timeouts_as_broken = True

html_theme = "pydata_sphinx_theme"
html_title = project
html_baseurl = about.url("Documentation") or ""
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_sidebars = {"index": [], "made/gallery": []}
html_theme_options = {
    "logo": {"text": project},
    "icon_links": [
        {"name": label, "url": url, "icon": "fa-solid fa-code"} for label in ("Source",) if (url := about.url(label))
    ],
    "navbar_align": "left",
    "header_links_before_dropdown": 7,
    "secondary_sidebar_items": ["page-toc"],
    "show_toc_level": 2,
    "collapse_navigation": True,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
}


def _write(pages: dict[str, str]) -> None:
    """Write pages; unchanged ones keep their modification time, so that sphinx does not read them again."""
    for name, text in pages.items():
        path = MADE / f"{name}.md"
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text() != text + "\n":
            path.write_text(text + "\n")


def make(app: Any) -> None:
    """Generate all pages and pictures; ``ETENDUE_DOCS_PICTURES=keep`` keeps the pictures of an earlier build."""
    begun = time.perf_counter()
    pictures = MADE / "pictures"
    kept = os.environ.get("ETENDUE_DOCS_PICTURES") == "keep" and (MADE / "gallery.md").exists()
    pages = {**copies.copies(ROOT), **commands.pages(), **python.pages(), "sensors": sensors.page()}
    if kept:
        names = {path.stem: "what it writes" for path in pictures.glob("*.png")}
        pages["gallery"] = (MADE / "gallery.md").read_text().rstrip("\n")
    else:
        shutil.rmtree(MADE, ignore_errors=True)
        pictures.mkdir(parents=True)
        found = gallery.taken(ROOT)
        for name, picture in found.items():
            picture.save(pictures / f"{name}.png")
        names = {name: picture.variable for name, picture in found.items()}
        pages["gallery"] = gallery.page(found)
    _write({**pages, **stages.pages(ROOT, names)})
    print(f"{len(pages)} pages and {len(names)} pictures made in {time.perf_counter() - begun:.1f} s")


def lead_to_copies(app: Any, name: str, source: list[str]) -> None:
    """Redirect links to files at the top of the repository to their copies."""
    if not name.startswith("made/"):
        source[0] = copies.within_documents(source[0], name.count("/"))


_PROSE_SIGNS = re.compile(r"(?<!\|)\|(?!\|)|(?<![*`])\*(?=\w)|(?<=\w)_(?=[\s,.;:)]|$)")


def _flows(lines: list[str]) -> list[str]:
    """Return the inputs and outputs of a file (``In:``, ``Out:``, ``Sources:``) as a list."""
    made: list[str] = []
    inside = False
    for line in lines:
        begins = re.match(r"(In|Out|Sources?):\s+", line)
        inside = bool(begins) or (inside and bool(line.strip()))
        if begins:
            made += ["", f"- **{begins[1]}:** {line[begins.end() :]}"]
        else:
            made.append(f"  {line.strip()}" if inside else line)
    return made


def as_prose(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Escape docstrings as plain text: bars, stars and trailing underscores belong to formulas, not to markup."""
    if what == "module":
        lines[:] = _flows(lines)
    for number, line in enumerate(lines):
        if line.lstrip().startswith((">>> ", "... ")):  # examples are shown unchanged
            continue
        parts = re.split(r"(``.+?``|`[^`]+`|:[a-z]+:)", line)
        lines[number] = "".join(
            part if at % 2 else _PROSE_SIGNS.sub(lambda found: "\\" + found[0], part) for at, part in enumerate(parts)
        )


def setup(app: Any) -> dict[str, Any]:
    """Register the hooks of this site."""
    app.connect("builder-inited", make)
    app.connect("source-read", lead_to_copies)
    app.connect("autodoc-process-docstring", as_prose, priority=100)
    return {"parallel_read_safe": True}
