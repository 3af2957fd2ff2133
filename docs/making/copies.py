"""Copy the documents at the top of the repository to the site, with links between them and ``docs`` that work as on a
code host.
"""

import re
from pathlib import Path

COPIED = {
    "README.md": "readme",
    "CONTRIBUTING.md": "contributing",
    "CHANGELOG.md": "changelog",
    "CODE_OF_CONDUCT.md": "code_of_conduct",
    "SECURITY.md": "security",
}
_LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)(#[^)]*)?\)")


def copies(root: Path) -> dict[str, str]:
    """Return pages by name."""
    return {
        name: _LINK.sub(lambda found: _from_top(found, root), (root / file).read_text())
        for file, name in COPIED.items()
    }


def _from_top(link: re.Match[str], root: Path) -> str:
    """Return a link of a file at the top of the repository as it must be in ``docs/made``; for a folder without an
    index, only its text.
    """
    text, target, part = link[1], link[2], link[3] or ""
    if ":" in target:
        return link[0]
    if (root / target).is_dir():
        if not (root / target / "index.md").exists():
            return text
        target = f"{target}/index.md"
    path = (
        f"{COPIED[target]}.md"
        if target in COPIED
        else f"../{target.removeprefix('docs/')}"
        if target.startswith("docs/")
        else f"../../{target}"
    )
    return f"[{text}]({path}{part})"


def within_documents(text: str, depth: int) -> str:
    """Redirect links of a document from top-level files to their copies. ``depth``: folders below ``docs``."""
    for file, name in COPIED.items():
        text = text.replace(f"]({'../' * (depth + 1)}{file}", f"]({'../' * depth}made/{name}.md")
    return text
