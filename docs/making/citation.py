"""``CITATION.cff``, which code hosts and reference managers read: ``python docs/making/citation.py`` rewrites it.

In:  ``pyproject.toml``.
Out: a file of the Citation File Format 1.2.0; authors are entities, so that names need not be split.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "docs"))

from making.project import Project, project_of  # noqa: E402

MESSAGE = "If you use etendue, please cite it as below. Archives with an author carry a CITATION.cff of their own."


def citation(project: Project) -> str:
    """Return the text of the file."""
    return "".join(f"{line}\n" for line in _lines(project))


def _lines(project: Project) -> Iterator[str]:
    says = project.says
    yield "# Made from pyproject.toml by: python docs/making/citation.py"
    yield "cff-version: 1.2.0"
    yield f"message: {json.dumps(MESSAGE)}"
    yield "type: software"
    yield f"title: {json.dumps(says['name'])}"
    yield f"abstract: {json.dumps(says['description'])}"
    yield "authors:"
    yield from (f"  - name: {json.dumps(name, ensure_ascii=False)}" for name in project.authors)
    if project.contacts:
        yield "contact:"
    for name, address in project.contacts.items():
        yield f"  - name: {json.dumps(name, ensure_ascii=False)}"
        yield f"    email: {json.dumps(address)}"
    yield f"version: {json.dumps(project.version)}"
    yield f"license: {says['license']}"
    for field, label in {"repository-code": "Source", "url": "Documentation"}.items():
        if project.url(label):
            yield f"{field}: {json.dumps(project.url(label))}"
    yield "keywords:"
    yield from (f"  - {json.dumps(word)}" for word in says["keywords"])


if __name__ == "__main__":
    path = ROOT / "CITATION.cff"
    path.write_text(citation(project_of(ROOT)))
    print(path.relative_to(ROOT))
