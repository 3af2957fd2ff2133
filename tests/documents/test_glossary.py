"""The glossary explains our words beside those of the field, and only words that somebody meets."""

from __future__ import annotations

import re

from tests.documents.pages import DOCS, ROOT

MOST = 25
ROWS = [line for line in (DOCS / "glossary.md").read_text().splitlines() if line.startswith("| ")][1:]


def test_each_word_has_a_neighbour_and_one_sentence():
    assert 10 < len(ROWS) <= MOST
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in ROWS]
    assert all(len(row) == 3 and all(row) for row in cells)
    assert [row[0] for row in cells] == sorted(row[0] for row in cells)
    for word, _, said in cells:
        assert said[0].isupper() and said.endswith(".") and len(said) < 200, word


def test_each_word_is_met_in_the_documents_or_on_the_screen():
    places = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "src").rglob("*.py")]
    places += [path for path in DOCS.glob("*.md") if path.name != "glossary.md"]
    text = "\n".join(path.read_text() for path in places)
    words = [word for row in ROWS for word in row.split("|")[1].strip().split(", ")]
    assert [word for word in words if not re.search(rf"\b{word}s?\b", text)] == []
